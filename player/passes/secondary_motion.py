"""Secondary motion: hair, skirts and sleeves follow the body, and swing on when it stops (player/loose_motion.py).

What is loose is told by an avatar's file. The simulation goes on when the renderer is told of a moment
(`Renderer.move`); here its offsets are brought to the GPU, and the passes that draw the avatar add them in the vertex
stage, in a variant of their program (shaders/loose.glsl).
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import moderngl
import numpy as np

from avatar.baked_avatar import Avatar, Level
from avatar.camera import view_from_world
from avatar.settings import Above, AtLeast, AtMost, check
from player.blocks import BINDING, LOOSE
from player.drawing import Drawing, Pose, Warming
from player.plan import Absent, Decision, Draft, Pass, Stage, State
from player.posed_mesh import vertex_order
from player.resources import Handle, PlanResources

if TYPE_CHECKING:
    from player.loose_motion import LooseMotion

# pixels; of a smaller avatar it cannot be seen
SMALLEST = 40
ATTRIBUTES = ("4u2 4f4", "near_particles", "follows")
VERTEX = np.dtype([("near", "u2", 4), ("follows", "f4", 4)])
OUT_OF_VIEW = Decision(State.SKIPPED, "out of view")
SMALL = Decision(State.SKIPPED, f"the avatar is less than {SMALLEST} pixels tall")
AT_REST = Decision(State.SKIPPED, "at rest, as it is skinned")


@dataclass(frozen=True)
class SecondaryMotion:
    """How loose parts move.

    Raises:
        ValueError: a value that is out of its range.
    """

    stage: ClassVar[Stage] = Stage.AVATARS

    frequency: Annotated[
        float, Above(0), AtMost(20), "swings a second of what hangs loosest; what is less loose swings faster"
    ] = 1.6
    gravity: Annotated[float, AtLeast(0), AtMost(100), "metres a second, squared"] = 9.81

    def __post_init__(self):
        check(self)

    def prepare(self, draft: Draft) -> None:
        """Before any pass is planned: those that draw avatars add the offsets."""
        draft.springs = self

    def passes(self, draft: Draft) -> Sequence[Pass]:
        out: list[Pass] = []
        for index in range(len(draft.avatars)):
            name, moved = f"{draft.tag(index)}: secondary motion", loosened(draft, index)
            out.append(Absent(name, "nothing of it is loose") if moved is None else LoosePass(name, moved))
        return out


class LazyMotion:
    """The motion of an avatar's loose parts; particles are found when it is first moved: most of a second."""

    def __init__(self, avatar: Avatar, level: Level, springs: SecondaryMotion):
        self._of = avatar, level
        self._springs = springs
        self._found: "LooseMotion | None" = None
        # milliseconds of the last step
        self.ms = 0.0

    @property
    def found(self) -> "LooseMotion":
        if self._found is None:
            # only where it is asked for
            from player.loose_motion import LooseMotion
            from player.loose_parts import loose_parts
            from player.spring_chains import spring_parts

            parts = spring_parts(*self._of) or loose_parts(*self._of)
            assert parts is not None, "planned for what is loose"
            self._found = LooseMotion(parts, self._springs)
        return self._found

    def move(self, pose: Pose, seconds: float) -> None:
        motion, began = self.found, time.perf_counter()
        motion.move(pose, seconds)
        self.ms = 1e3 * (time.perf_counter() - began)


@dataclass(frozen=True)
class Loosened:
    """One avatar's loose parts in a plan."""

    avatar: int
    motion: LazyMotion
    # the offsets of this frame
    block: Handle[moderngl.Buffer]
    # of each vertex
    vertices: Handle[moderngl.Buffer]

    @property
    def handles(self) -> tuple[Handle[Any], ...]:
        return self.block, self.vertices

    @property
    def buffer(self) -> tuple[Any, ...]:
        """What a vertex array gains."""
        return (self.vertices, *ATTRIBUTES)

    def shows(self, drawing: Drawing) -> bool:
        return self.motion.found.shows and drawing.height(self.avatar) >= SMALLEST

    def bind(self, drawing: Drawing) -> None:
        """Bring the offsets of this frame to the GPU, unless another pass has, and bind them."""
        buffer = drawing.write(self.block, lambda: self._content(drawing))
        buffer.bind_to_uniform_block(BINDING["Loose"][1])

    def warm(self, resources: PlanResources) -> None:
        buffer = resources[self.block]
        buffer.write(bytes(buffer.size))
        buffer.bind_to_uniform_block(BINDING["Loose"][1])

    def _content(self, drawing: Drawing) -> bytes:
        block, motion = np.zeros((), LOOSE), self.motion.found
        # what is too small to be moved is drawn as it is skinned, by every pass
        if self.shows(drawing):
            turn = view_from_world(drawing.inputs.camera)[:3, :3]
            block["loose_offset"][: len(motion.offsets), :3] = motion.offsets @ turn.T
        return block.tobytes()


def is_loose(level: Level) -> bool:
    """Whether anything of a level can swing: what its file marks as loose, or spring bones."""
    return level.springs is not None or (level.loose is not None and bool(level.loose.any()))


def loosened(draft: Draft, avatar: int) -> Loosened | None:
    """What moves an avatar's loose parts; None: nothing is asked for, or nothing is loose."""
    level, tag, springs = draft.levels[avatar], draft.tag(avatar), draft.springs
    if springs is None or not is_loose(level):
        return None
    motion = draft.keep(
        ("secondary motion", avatar, draft.detail[avatar], springs),
        lambda: LazyMotion(draft.avatars[avatar], level, springs),
    )

    def vertices(made: PlanResources) -> bytes:
        out, parts = np.zeros(len(level.positions), VERTEX), motion.found.parts
        out["near"], out["follows"] = parts.near, parts.follows
        return out[vertex_order(made, level)[0]].tobytes()

    size = VERTEX.itemsize * len(level.positions)
    return Loosened(
        avatar, motion, draft.buffer(f"{tag} loose offsets", LOOSE.itemsize, avatar),
        draft.buffer(f"{tag} loose parts", size, avatar, draft.detail[avatar], content=vertices),
    )  # fmt: skip


@dataclass(frozen=True)
class LoosePass:
    """Brings one avatar's offsets to the GPU."""

    name: str
    loosened: Loosened

    @property
    def uses(self) -> tuple[Handle[Any], ...]:
        return self.loosened.handles

    def move(self, poses: Sequence[Pose], seconds: float) -> None:
        self.loosened.motion.move(poses[self.loosened.avatar], seconds)

    @property
    def ms(self) -> float:
        """Of the simulation's last step."""
        return self.loosened.motion.ms

    @property
    def motion(self) -> "LooseMotion":
        return self.loosened.motion.found

    def decide(self, drawing: Drawing) -> Decision:
        if not self.motion.shows:
            return AT_REST
        if not drawing.visible[self.loosened.avatar]:
            return OUT_OF_VIEW
        if not self.loosened.shows(drawing):
            return SMALL
        what = f"{len(self.motion.offsets)} particles, {1e3 * self.motion.reach:.0f} mm at most"
        return Decision(State.RUNS, what + self.motion.asleep * ", asleep")

    def draw(self, drawing: Drawing) -> None:
        self.loosened.bind(drawing)

    def warm(self, warming: Warming) -> None:
        """It draws nothing of its own."""
