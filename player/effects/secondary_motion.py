"""Secondary motion: hair, skirts and sleeves follow the body, and swing on when it stops (loose_motion.py).

An avatar's file marks what is loose. The simulation goes on when the renderer moves to a moment (`Renderer.move`); here
its offsets are brought to the GPU, and the passes that draw the avatar add them in the vertex stage, in a variant of
their program (shaders/loose.glsl).
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Annotated, ClassVar

import numpy as np

from avatar.baked_avatar import Level
from avatar.camera import view_from_world
from command.settings import Above, AtLeast, AtMost, settings
from player.draw.drawing import Drawing, FrameInputs, Pose
from player.draw.plan import OUT_OF_VIEW, Absent, Addition, Attributes, Decision, Draft, Pass, PassState, Stage
from player.draw.posed_mesh import DrawnMesh, drawn_mesh, posed_mesh
from player.gl.blocks import LOOSE

if TYPE_CHECKING:
    from player.effects.loose_motion import LooseMotion

SMALLEST = 40  # pixels; of a smaller avatar it cannot be seen
VERTEX = np.dtype([("near", "u2", 4), ("follows", "f4", 4)])
SMALL = Decision(PassState.SKIPPED, f"the avatar is less than {SMALLEST} pixels tall")
AT_REST = Decision(PassState.SKIPPED, "at rest, as it is skinned")


@settings
class SecondaryMotion:
    """How loose parts move."""

    stage: ClassVar[Stage] = Stage.AVATARS

    frequency: Annotated[float, Above(0), AtMost(20),
        "swings a second of what hangs loosest; what is less loose swings faster"] = 1.6
    gravity: Annotated[float, AtLeast(0), AtMost(100), "metres a second, squared"] = 9.81

    def passes(self, draft: Draft) -> Sequence[Pass]:
        """For each avatar what moves it, or why nothing does."""
        out: list[Pass] = []
        for index in range(len(draft.avatars)):
            name, offsets = f"{draft.tag(index)}: secondary motion", offsets_of(draft, index)
            if offsets is None:
                out.append(Absent(name, "nothing of it is loose"))
            else:
                draft.moved.add(index)
                out.append(LoosePass(name, offsets.handles, offsets))
        return out


@dataclass(frozen=True)
class LooseOffsets(Addition):
    """One avatar's loose parts in a plan: how far they are off where they are skinned to."""

    avatar: int
    # particles are found when it is first moved: most of a second
    motion: "Callable[[], LooseMotion]"

    def shows(self, drawing: Drawing) -> bool:
        return self.motion().shows and drawing.height(self.avatar) >= SMALLEST

    def content(self, drawing: Drawing, block: str) -> bytes:
        """The offsets of this frame."""
        out, motion = np.zeros((), LOOSE), self.motion()
        # what is too small to be moved is drawn as it is skinned, by every pass
        if self.shows(drawing):
            turn = view_from_world(drawing.inputs.camera)[:3, :3]
            out["loose_offset"][: len(motion.offsets), :3] = motion.offsets @ turn.T
        return out.tobytes()


def is_loose(level: Level) -> bool:
    """Whether anything of a level can swing: what its file marks as loose."""
    return level.loose is not None and bool(level.loose.any())


def offsets_of(draft: Draft, avatar: int) -> LooseOffsets | None:
    """What moves an avatar's loose parts; None: nothing is asked for, or nothing is loose."""
    who, level, springs = draft.avatars[avatar], draft.levels[avatar], draft.asked(SecondaryMotion)
    if springs is None or not is_loose(level):
        return None

    def found() -> "LooseMotion":
        # only where it is asked for
        from player.effects.loose_motion import LooseMotion
        from player.effects.loose_parts import loose_parts

        parts = loose_parts(who, level)
        assert parts is not None, "planned for what is loose"
        return LooseMotion(parts, springs)

    motion = draft.keep(("secondary motion", avatar, draft.detail[avatar], springs), lambda: cache(found))

    def vertices() -> np.ndarray:
        out, parts = np.zeros(len(level.positions), VERTEX), motion().parts
        out["near"], out["follows"] = parts.near, parts.follows
        return out

    stored = draft.vertices("loose parts", avatar, VERTEX.itemsize, vertices)
    buffers = ((stored, "4u2 4f4", "near_particles", "follows"),)
    return LooseOffsets(buffers, (draft.block("Loose", avatar),), avatar, motion)


def loose_mesh(
    draft: Draft, avatar: int, vertex: str, fragment: str, *more: Attributes, level: int | None = None
) -> DrawnMesh:
    """An avatar for a program of these shaders, with further attributes of its vertices and its loose parts where they
    are; where nothing of it is loose, at another level of detail than the plan's."""
    loose = offsets_of(draft, avatar)
    # loose parts are bound to the vertices of the level that is drawn
    mesh = posed_mesh(draft, avatar, level=level if loose is None else None)
    program = draft.program(
        vertex, fragment, SKINNING=int(draft.dual), LOOSE=int(loose is not None), FACE=int(mesh.face is not None)
    )
    return drawn_mesh(draft, mesh, program, [loose], *more)


@dataclass(frozen=True)
class LoosePass(Pass):
    """Brings one avatar's offsets to the GPU."""

    offsets: LooseOffsets

    def move(self, poses: Sequence[Pose], seconds: float) -> None:
        motion, began = self.offsets.motion(), time.perf_counter()
        motion.move(poses[self.offsets.avatar], seconds)
        motion.ms = 1e3 * (time.perf_counter() - began)

    def reach(self, avatar: int, pose: Pose) -> float:
        return self.offsets.motion().reach if avatar == self.offsets.avatar else 0.0

    def cost(self, drawn: float, inputs: FrameInputs, frame: Callable[[], float]) -> float:
        """The offsets on their way to the GPU, and the simulation's last step."""
        return drawn + self.offsets.motion().ms

    def decide(self, drawing: Drawing) -> Decision:
        """It shows where anything is moved far enough to be seen, of an avatar that can be."""
        motion = self.offsets.motion()
        if not motion.shows:
            return AT_REST
        if not drawing.visible[self.offsets.avatar]:
            return OUT_OF_VIEW
        if not self.offsets.shows(drawing):
            return SMALL
        what = f"{len(motion.offsets)} particles, {1e3 * motion.reach:.0f} mm at most"
        return Decision(PassState.RUNS, what + motion.asleep * ", asleep")

    def draw(self, drawing: Drawing) -> None:
        self.offsets.bind(drawing)
