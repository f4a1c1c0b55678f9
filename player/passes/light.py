"""Avatars lit anew: by the light they were filmed in, which stays where it was as they turn, by none, or by lamps.

What an avatar's file tells apart (avatar/light.py): its base color shows albedo in the light it was seen in on
average. This draws no pass of its own; the passes that draw avatars take that light out and put this one in
(shaders/light.glsl). Where a file tells no light, its color is taken for albedo.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import moderngl
import numpy as np

from avatar.baked_avatar import Avatar, Level
from avatar.camera import Camera
from avatar.light import CaptureLight, lamps_of
from avatar.settings import AtLeast, AtMost, OneOf, check
from player.plan import Draft, Pass, Stage
from player.posed_mesh import vertex_order
from player.resources import Handle
from player.shader import uniform

# at most; shaders/light.glsl
LAMPS = 4
KINDS = ("capture", "albedo", "lamps")
ATTRIBUTES = ("3f4 2f4", "normal", "seen_light")
VERTEX = np.dtype([("normal", "f4", 3), ("seen_light", "f4", 2)])
# OpenGL looks down -z with +y up
VIEW_FROM_CAMERA = np.diag([1.0, -1.0, -1.0])


@dataclass(frozen=True)
class Light:
    """What lights the avatars.

    Raises:
        ValueError: a value that is not known, or lamps without a direction.
    """

    stage: ClassVar[Stage] = Stage.AVATARS

    by: Annotated[
        str, OneOf(KINDS),
        "capture: the light of the videos, which stays where it was; albedo: none; lamps: the numbers below",
    ] = "capture"  # fmt: skip
    ambient: Annotated[float, AtLeast(0), AtMost(10), "of lamps: light from everywhere"] = 0.5
    direction: Annotated[tuple[float, float, float], "of lamps: towards the first, world, any length"] = (
        0.45,
        0.65,
        0.6,
    )
    strength: Annotated[float, AtLeast(0), AtMost(10), "of lamps: the first"] = 0.8
    second_direction: Annotated[tuple[float, float, float], "of lamps: towards the second"] = (-0.7, 0.3, 0.5)
    second_strength: Annotated[float, AtLeast(0), AtMost(10), "of lamps: the second; 0: none"] = 0.0
    highlight: Annotated[float, AtLeast(0), AtMost(1), "of lamps: the highlight in their middle"] = 0.0

    def __post_init__(self):
        check(self)
        for name in ("direction", "second_direction"):
            if not np.linalg.norm(getattr(self, name)) > 1e-6:
                raise ValueError(f"{name}: expected a direction, found {getattr(self, name)}")
        if self.by == "lamps" and self.ambient + self.strength + self.second_strength == 0:
            raise ValueError("ambient: expected some light, found none")

    def passes(self, draft: Draft) -> Sequence[Pass]:
        draft.light_of = self.on
        return ()

    def on(self, avatar: Avatar) -> CaptureLight | None:
        """The light on an avatar, world; None: as its colors are, because its file tells no light."""
        if self.by != "lamps" and avatar.light is None:
            return None
        gamma = 1.0 if avatar.light is None else avatar.light.gamma
        if self.by == "albedo":
            return CaptureLight(1.0, gamma=gamma, frame="world")
        if self.by == "capture":
            return avatar.light
        lamps = lamps_of(
            np.array([self.direction, self.second_direction], np.float64),
            np.array([self.strength, self.second_strength]),
        )
        there = tuple(lamp for lamp in lamps if lamp.strength > 0)
        return CaptureLight(self.ambient, there, self.highlight, gamma=gamma, frame="world")


@dataclass(frozen=True)
class Lit:
    """One avatar's light in a plan."""

    light: CaptureLight
    vertices: Handle[moderngl.Buffer]

    @property
    def variant(self) -> int:
        """LIT of shaders/avatar.frag."""
        return 1 if self.light.gamma == 1 else 2

    @property
    def note(self) -> str:
        """For people: the end of a pass's reason."""
        return f", lit by ambient {self.light.ambient:.2f} and {len(self.light.lamps)} lamps"

    @property
    def buffer(self) -> tuple[Any, ...]:
        """What a vertex array gains."""
        return (self.vertices, *ATTRIBUTES)

    def apply(self, program: moderngl.Program, camera: Camera) -> None:
        """Put the light, which stands still in the world, before this camera."""
        light, lamps, shares = self.light, np.zeros((LAMPS, 4), np.float32), np.zeros(LAMPS)
        count = min(len(light.lamps), LAMPS)
        view_from_world = VIEW_FROM_CAMERA @ camera.camera_from_world[:3, :3]
        # a lamp that is not there still needs a direction
        lamps[:, 2] = 1
        lamps[:count, :3] = (light.directions @ view_from_world.T)[:count]
        lamps[:count, 3], shares[:count] = light.strengths[:count], light.shares[:count]
        uniform(program, "lamps").write(lamps.tobytes())
        uniform(program, "shares").value = tuple(shares.tolist())
        uniform(program, "ambience").value = (light.ambient, light.gloss, light.exponent)
        if self.variant == 2:
            uniform(program, "gamma").value = light.gamma


def lit(draft: Draft, avatar: int) -> Lit | None:
    """What lights an avatar of the plan anew; None: nothing does."""
    light, level = draft.light_of(draft.avatars[avatar]), draft.levels[avatar]
    if light is None:
        return None
    vertices = draft.buffer(
        f"{draft.tag(avatar)} light", VERTEX.itemsize * len(level.positions), avatar, draft.level,
        content=lambda made: lit_interleaved(level)[vertex_order(made, level)[0]].tobytes(),
    )  # fmt: skip
    return Lit(light, vertices)


def lit_interleaved(level: Level) -> np.ndarray:
    """Normal of each vertex and the light that its base color shows, 20 bytes."""
    out = np.zeros(len(level.positions), VERTEX)
    out["normal"] = level.normals
    out["seen_light"] = (1.0, 0.0) if level.light is None else level.light
    return out
