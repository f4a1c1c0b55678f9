"""An avatar's surface in this frame's pose, as every pass that draws it shares it: mesh and bones on the GPU."""

from dataclasses import dataclass
from functools import cache
from typing import Any

import moderngl
import numpy as np

from avatar.baked_avatar import Level
from player.draw.drawing import Drawing
from player.draw.mesh import VERTEX, draw_order, interleaved
from player.draw.plan import Draft
from player.draw.posing import dual_parts, quaternions
from player.draw.resources import Handle, PlanResources
from player.gl.blocks import BINDING, block_bytes

BASE = ("3f4 2f4 4u1 4f1", "position", "uv", "joints", "weights")


@dataclass(frozen=True)
class PosedMesh:
    """One avatar's mesh at its level of detail, and the blocks that hold its bones."""

    avatar: int
    # LBS reads `bones`, dual quaternions read `duals` and `turns`
    vertices: Handle[moderngl.Buffer]
    faces: Handle[moderngl.Buffer]
    bones: Handle[moderngl.Buffer] | None
    duals: Handle[moderngl.Buffer] | None
    turns: Handle[moderngl.Buffer] | None

    @property
    def handles(self) -> tuple[Handle[Any], ...]:
        found = (self.vertices, self.faces, self.bones, self.duals, self.turns)
        return tuple(handle for handle in found if handle is not None)

    def array(
        self, draft: Draft, program: Handle[moderngl.Program], *more: tuple[Any, ...]
    ) -> Handle[moderngl.VertexArray]:
        """The mesh as a program reads it, with further attributes of its vertices."""
        return draft.array(program, (self.vertices, *BASE), *more, faces=self.faces)

    def pose(self, drawing: Drawing) -> None:
        """Bring the bones of this frame to the GPU, unless another pass has, and bind them."""
        bones = drawing.bones[self.avatar]
        turns = cache(lambda: quaternions(bones))
        if self.turns is not None:
            _bind(drawing.write(self.turns, lambda: np.ascontiguousarray(turns(), np.float32)), "Turns")
        if self.duals is not None:
            _bind(drawing.write(self.duals, lambda: dual_parts(bones, turns()).astype(np.float32)), "Duals")
        if self.bones is not None:
            palette = bones.view_from_canonical[:, :3]
            _bind(drawing.write(self.bones, lambda: np.ascontiguousarray(palette, np.float32)), "Bones")

    def warm(self, resources: PlanResources) -> None:
        """Bones that put every vertex in one place."""
        for handle, block in ((self.bones, "Bones"), (self.turns, "Turns"), (self.duals, "Duals")):
            if handle is not None:
                buffer = resources[handle]
                buffer.write(bytes(buffer.size))
                _bind(buffer, block)


def posed_mesh(draft: Draft, avatar: int, *, directions: bool = False, level: int | None = None) -> PosedMesh:
    """The mesh of an avatar as a plan draws it, or at another level of detail; with `directions`, shaders can turn
    directions back into the canonical frame (shaders/directions.glsl)."""
    tag, first = draft.tag(avatar), draft.first(avatar)
    level = draft.detail[avatar] if level is None else level
    mesh = draft.avatars[avatar].level(level)
    shared = draft.tag(first)
    vertices = draft.buffer(
        f"{shared} vertices", VERTEX.itemsize * len(mesh.positions), first, level,
        content=lambda made: interleaved(mesh)[vertex_order(made, mesh)[0]].tobytes(),
    )  # fmt: skip
    faces = draft.buffer(
        f"{shared} faces", 12 * len(mesh.faces), first, level,
        content=lambda made: vertex_order(made, mesh)[1].tobytes(),
    )  # fmt: skip

    def block(name: str) -> Handle[moderngl.Buffer]:
        return draft.buffer(f"{tag} {name.lower()}", block_bytes(name, draft.bones), avatar)

    bones = None if draft.dual else block("Bones")
    duals = block("Duals") if draft.dual else None
    turns = block("Turns") if draft.dual or directions else None
    return PosedMesh(avatar, vertices, faces, bones, duals, turns)


def normals_of(draft: Draft, avatar: int) -> Handle[moderngl.Buffer]:
    """The normals of an avatar's vertices, canonical, three floats each."""
    level, first = draft.levels[avatar], draft.first(avatar)
    return draft.buffer(
        f"{draft.tag(first)} normals", level.normals.nbytes, first, draft.detail[avatar],
        content=lambda made: level.normals[vertex_order(made, level)[0]].tobytes(),
    )  # fmt: skip


def vertex_order(made: PlanResources, mesh: Level) -> tuple[np.ndarray, np.ndarray]:
    """The order in which vertices are stored, and the faces that count so."""
    return made.shared(("order", id(mesh)), lambda: draw_order(mesh.positions, mesh.faces))


def _bind(buffer: moderngl.Buffer, block: str) -> None:
    buffer.bind_to_uniform_block(BINDING[block][1])
