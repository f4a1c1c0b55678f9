"""An avatar's surface in this frame's pose, as every pass that draws it shares it: mesh and bones on the GPU."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import moderngl
import numpy as np

from player.draw.drawing import Drawing
from player.draw.face import FaceOffsets, face_of
from player.draw.mesh import VERTEX, interleaved
from player.draw.plan import Attributes, Draft, vertex_order
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
        face = () if self.face is None else self.face.handles
        return (self.vertices, self.faces, *(handle for _, handle in self.blocks), *face)

    def array(self, draft: Draft, program: Handle[moderngl.Program], *more: Attributes) -> Handle[moderngl.VertexArray]:
        """The mesh as a program reads it, with further attributes of its vertices."""
        face = () if self.face is None else (self.face.buffer,)
        return draft.array(program, (self.vertices, *BASE), *face, *more, faces=self.faces)

    def pose(self, drawing: Drawing) -> None:
        """Bring bones and face of this frame to the GPU, unless another pass has, and bind them."""
        bones = drawing.bones[self.avatar]
        turns = cache(lambda: quaternions(bones))
        content: dict[str, Callable[[], np.ndarray]] = {
            "Bones": lambda: bones.view_from_canonical[:, :3], "Turns": turns,
            "Duals": lambda: dual_parts(bones, turns()),
        }  # fmt: skip
        for name, handle in self.blocks:
            drawing.bind(handle, name, lambda: np.ascontiguousarray(content[name](), np.float32))
        if self.face is not None:
            self.face.bind(drawing)

    def warm(self, resources: PlanResources) -> None:
        """Bones that put every vertex in one place."""
        for name, handle in self.blocks:
            resources.bind_zeros(handle, name)
        if self.face is not None:
            self.face.warm(resources)


def posed_mesh(draft: Draft, avatar: int, *, directions: bool = False, level: int | None = None) -> PosedMesh:
    """The mesh of an avatar as a plan draws it, or at another level of detail; with `directions`, shaders can turn
    directions back into the canonical frame (shaders/directions.glsl)."""
    first, level = draft.first(avatar), draft.detail[avatar] if level is None else level
    mesh, shared = draft.avatars[avatar].level(level), draft.tag(first)
    vertices = draft.buffer(
        f"{shared} vertices", VERTEX.itemsize * len(mesh.positions), first, level,
        content=lambda made: interleaved(mesh)[vertex_order(made, mesh)[0]].tobytes(),
    )  # fmt: skip
    faces = draft.buffer(
        f"{shared} faces", 12 * len(mesh.faces), first, level,
        content=lambda made: vertex_order(made, mesh)[1].tobytes(),
    )  # fmt: skip
    names = ("Turns", "Duals") if draft.dual else ("Bones", "Turns") if directions else ("Bones",)
    blocks = [
        (name, draft.buffer(f"{draft.tag(avatar)} {name.lower()}", block_bytes(name, draft.bones), avatar))
        for name in names
    ]
    return PosedMesh(avatar, vertices, faces, tuple(blocks), face_of(draft, avatar, level))


def normals_of(draft: Draft, avatar: int) -> Handle[moderngl.Buffer]:
    """The normals of an avatar's vertices, canonical, three floats each."""
    return draft.vertices("normals", avatar, 12, lambda: draft.levels[avatar].normals)
