"""An avatar's surface in this frame's pose, as every pass that draws it shares it: mesh and bones on the GPU."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache

import moderngl
import numpy as np

from player.draw.drawing import Drawing
from player.draw.face import FaceOffsets, face_of
from player.draw.mesh import VERTEX, interleaved
from player.draw.plan import Addition, Attributes, Draft, vertex_order
from player.draw.posing import dual_parts, quaternions
from player.draw.resources import AnyHandle, Handle, PlanResources
from player.gl.blocks import block_bytes

BASE = ("3f4 2f4 4u1 4f1", "position", "uv", "joints", "weights")


@dataclass(frozen=True)
class PosedMesh:
    """One avatar's mesh at its level of detail, and the blocks that hold its bones."""

    avatar: int
    vertices: Handle[moderngl.Buffer]
    faces: Handle[moderngl.Buffer]
    # LBS reads "Bones", dual quaternions read "Duals" and "Turns"
    blocks: tuple[tuple[str, Handle[moderngl.Buffer]], ...]
    # its programs have FACE 1; None: its face does not move
    face: FaceOffsets | None

    @property
    def handles(self) -> tuple[AnyHandle, ...]:
        return (self.vertices, self.faces, *(handle for _, handle in self.blocks))

    def pose(self, drawing: Drawing) -> None:
        """Bring the bones of this frame to the GPU, unless another pass has, and bind them."""
        bones = drawing.bones[self.avatar]
        turns = cache(lambda: quaternions(bones))
        content: dict[str, Callable[[], np.ndarray]] = {
            "Bones": lambda: bones.view_from_canonical[:, :3], "Turns": turns,
            "Duals": lambda: dual_parts(bones, turns()),
        }  # fmt: skip
        for name, handle in self.blocks:
            drawing.bind(handle, name, lambda: np.ascontiguousarray(content[name](), np.float32))

    def warm(self, resources: PlanResources) -> None:
        """Bones that put every vertex in one place."""
        for name, handle in self.blocks:
            resources.bind_zeros(handle, name)


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
    blocks = [
        (name, draft.buffer(f"{draft.tag(avatar)} {name.lower()}", block_bytes(name, draft.bones), avatar))
        for name in names
    ]
    return PosedMesh(avatar, vertices, faces, tuple(blocks), face_of(draft, avatar, level))


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
        self.mesh.pose(drawing)
        array = drawing.resources[self.array]
        for one in self.added:
            one.bind(drawing)
            one.apply(drawing, array.program)
        array.render()

    def warm(self, resources: PlanResources) -> None:
        """Draw a triangle to what is bound."""
        self.mesh.warm(resources)
        for one in self.added:
            one.warm(resources)
        resources[self.array].render(vertices=3)


def drawn_mesh(
    draft: Draft, mesh: PosedMesh, program: Handle[moderngl.Program], added: Iterable[Addition | None],
    *more: Attributes,
) -> DrawnMesh:  # fmt: skip
    """A mesh for a program, with its face, what there is of additions and further attributes of its vertices."""
    there = tuple(one for one in (mesh.face, *added) if one is not None)
    # two may bring the same one
    buffers = dict.fromkeys([*more, *(buffer for one in there for buffer in one.buffers)])
    array = draft.array(program, (mesh.vertices, *BASE), *buffers, faces=mesh.faces)
    reads = (handle for one in there for handle in one.handles)
    return DrawnMesh(mesh, (*mesh.handles, *reads, *(buffer[0] for buffer in more), array), array, there)


def normals_of(draft: Draft, avatar: int) -> Attributes:
    """The normals of an avatar's vertices, canonical, three floats each."""
    return draft.vertices("normals", avatar, 12, lambda: draft.levels[avatar].normals), "3f4", "normal"
