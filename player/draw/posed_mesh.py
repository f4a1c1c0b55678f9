"""An avatar's surface in this frame's pose, as every pass that draws it shares it: mesh and bones on the GPU."""

from collections.abc import Iterable
from dataclasses import dataclass

import moderngl
import numpy as np

from player.draw.drawing import Drawing
from player.draw.face import FaceOffsets, face_of
from player.draw.mesh import VERTEX, interleaved
from player.draw.plan import Addition, Attributes, Draft, vertex_order
from player.draw.posing import dual_parts, quaternions
from player.draw.resources import AnyHandle, Handle, PlanResources

BASE = ("3f4 2f4 4u1 4f1", "position", "uv", "joints", "weights")


@dataclass(frozen=True)
class PosedMesh(Addition):
    """One avatar's mesh at its level of detail; blocks: "Bones" for LBS, "Duals" and "Turns" for dual quaternions."""

    avatar: int
    faces: Handle[moderngl.Buffer]
    # its programs have FACE 1; None: its face does not move
    face: FaceOffsets | None

    @property
    def handles(self) -> tuple[AnyHandle, ...]:
        return (*super().handles, self.faces)

    def content(self, drawing: Drawing, block: str) -> np.ndarray:
        bones = drawing.bones[self.avatar]
        if block == "Bones":
            out = bones.view_from_canonical[:, :3]
        else:
            turns = drawing.once(("turns", self.avatar), lambda: quaternions(bones))
            out = turns if block == "Turns" else dual_parts(bones, turns)
        return np.ascontiguousarray(out, np.float32)


def posed_mesh(draft: Draft, avatar: int, *, directions: bool = False, level: int | None = None) -> PosedMesh:
    """The mesh of an avatar as a plan draws it, or at another level of detail; with `directions`, shaders can turn
    directions back into the canonical frame (shaders/directions.glsl)."""
    first, level = draft.first(avatar), draft.detail[avatar] if level is None else level
    mesh = draft.avatars[avatar].level(level)
    vertices = draft.vertices("vertices", avatar, VERTEX.itemsize, lambda: interleaved(mesh), level)
    faces = draft.buffer(
        f"{draft.tag(first)} faces", 12 * len(mesh.faces), first, level,
        content=lambda made: vertex_order(made, mesh)[1].tobytes(),
    )  # fmt: skip
    names = ("Turns", "Duals") if draft.dual else ("Bones", "Turns") if directions else ("Bones",)
    blocks = tuple(draft.block(name, avatar) for name in names)
    return PosedMesh(((vertices, *BASE),), blocks, avatar, faces, face_of(draft, avatar, level))


@dataclass(frozen=True)
class DrawnMesh:
    """An avatar's surface as one program draws it."""

    mesh: PosedMesh
    # all it reads
    handles: tuple[AnyHandle, ...]
    array: Handle[moderngl.VertexArray]
    added: tuple[Addition, ...]

    def shows(self, drawing: Drawing) -> bool:
        """Whether all that is added can be seen in this frame."""
        return all(one.shows(drawing) for one in self.added)

    def draw(self, drawing: Drawing) -> None:
        array = drawing.resources[self.array]
        for one in self.added:
            one.bind(drawing)
            one.apply(drawing, array.program)
        array.render()

    def warm(self, resources: PlanResources) -> None:
        """Draw a triangle to what is bound."""
        for one in self.added:
            one.warm(resources)
        resources[self.array].render(vertices=3)


def drawn_mesh(
    draft: Draft, mesh: PosedMesh, program: Handle[moderngl.Program], added: Iterable[Addition | None],
    *more: Attributes,
) -> DrawnMesh:  # fmt: skip
    """A mesh for a program, with its face, what there is of additions and further attributes of its vertices."""
    there = tuple(one for one in (mesh, mesh.face, *added) if one is not None)
    # two may bring the same one
    buffers = dict.fromkeys([*more, *(buffer for one in there for buffer in one.buffers)])
    array = draft.array(program, *buffers, faces=mesh.faces)
    reads = (handle for one in there for handle in one.handles)
    return DrawnMesh(mesh, (*reads, *(buffer[0] for buffer in more), array), array, there)


def normals_of(draft: Draft, avatar: int) -> Attributes:
    """The normals of an avatar's vertices, canonical, three floats each."""
    return draft.vertices("normals", avatar, 12, lambda: draft.levels[avatar].normals), "3f4", "normal"
