"""Avatars lit anew: by the light they were filmed in, which stays as they turn, by none, by lamps, or by a panorama.

An avatar's file keeps two things apart (avatar/light.py): its base color shows albedo in the light it was seen in on
average. This draws no pass of its own; the passes that draw avatars take that light out and put this one in
(shaders/light.glsl), vertex by vertex. Where a file holds no light, its color is taken for albedo.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar

import moderngl
import numpy as np

from avatar.baked_avatar import Avatar
from avatar.camera import view_from_world
from avatar.light import LAMPS, CaptureLight, lamps_of
from command.progress import plural
from command.settings import AtLeast, AtMost, FilePlace, OneOf, settings
from player.draw.drawing import Drawing
from player.draw.plan import Addition, Draft, Pass, Stage
from player.draw.posed_mesh import normals_of
from player.effects.background import Background
from player.effects.background_source import read_panorama
from player.effects.panorama_light import fitted_light
from player.gl.shader import set_uniforms

KINDS = ("capture", "albedo", "lamps", "panorama")
FIRST_LAMP = (0.45, 0.65, 0.6)


@settings
class Light:
    """What lights the avatars.

    Raises:
        ValueError: a value that is not known, or lamps without a direction.
    """

    stage: ClassVar[Stage] = Stage.AVATARS

    by: Annotated[str, OneOf(KINDS),
        "capture: the light of the videos, which stays where it was; albedo: none; lamps: the numbers below; panorama: "
        "that of `path`, or of a background of kind hdr"] = "capture"
    path: Annotated[str | None, FilePlace(),
        "of panorama (Radiance .hdr, twice as wide as high); none: the background"] = None
    ambient: Annotated[float, AtLeast(0), AtMost(10), "of lamps: light from everywhere"] = 0.5
    direction: Annotated[tuple[float, float, float], "of lamps: towards the first, world, any length"] = FIRST_LAMP
    strength: Annotated[float, AtLeast(0), AtMost(10), "of lamps: the first"] = 0.8
    second_direction: Annotated[tuple[float, float, float], "of lamps: towards the second"] = (-0.7, 0.3, 0.5)
    second_strength: Annotated[float, AtLeast(0), AtMost(10), "of lamps: the second; 0: none"] = 0.0
    highlight: Annotated[float, AtLeast(0), AtMost(1), "of lamps: the highlight in their middle"] = 0.0

    def __post_init__(self):
        for name, direction in (("direction", self.direction), ("second_direction", self.second_direction)):
            if not np.linalg.norm(direction) > 1e-6:
                raise ValueError(f"{name}: expected a direction, found {direction}")
        if self.path is not None and self.by != "panorama":
            raise ValueError(f"path: of panorama, not of {self.by}")
        if self.by == "lamps" and self.ambient + self.strength + self.second_strength == 0:
            raise ValueError("ambient: expected some light, found none")

    def passes(self, draft: Draft) -> Sequence[Pass]:
        return ()

    def on(self, avatar: Avatar, draft: Draft) -> CaptureLight | None:
        """The light on an avatar, world; None: as its colors are, because its file has no light."""
        if self.by in ("capture", "albedo") and avatar.light is None:
            return None
        gamma = 1.0 if avatar.light is None else avatar.light.gamma
        if self.by == "albedo":
            return CaptureLight(1.0, gamma=gamma, frame="world")
        if self.by == "capture":
            return avatar.light
        if self.by == "panorama":
            path, turn = self._panorama(draft.asked(Background))
            key = ("light of a panorama", path, turn, gamma)
            return draft.keep(key, lambda: fitted_light(read_panorama(path), turn, gamma=gamma, most=LAMPS))
        towards = np.array([self.direction, self.second_direction], np.float64)
        lamps = lamps_of(towards, np.array([self.strength, self.second_strength]))
        there = tuple(lamp for lamp in lamps if lamp.strength > 0)
        if avatar.light is None and not there and self.ambient == 1:
            return None
        return CaptureLight(self.ambient, there, self.highlight, gamma=gamma, frame="world")

    def _panorama(self, behind: Background | None) -> tuple[str, float]:
        """The panorama's file and how it is turned, radians; ValueError: none is named, here or as the background."""
        if self.path is not None:
            return self.path, 0.0
        if behind is not None and behind.kind == "hdr" and behind.path is not None:
            return behind.path, float(np.radians(behind.turn_deg))
        raise ValueError("light by panorama: expected its path, or a background of kind hdr, found neither")


@dataclass(frozen=True)
class AvatarLight(Addition):
    light: CaptureLight
    # whether there is a highlight in it, or in the base color that is lit
    gleams: bool

    @property
    def variant(self) -> int:
        """LIT of shaders/avatar.vert."""
        return 1 if not self.gleams else 2 if self.light.gamma == 1 else 3

    def apply(self, drawing: Drawing, program: moderngl.Program) -> None:
        """Put the light, which stands still in the world, before this camera."""
        light, lamps, shares = self.light, np.zeros((LAMPS, 4), np.float32), np.zeros(LAMPS)
        count = len(light.lamps)
        # a lamp that is not there still needs a direction
        lamps[:, 2] = 1
        lamps[:count, :3] = light.directions @ view_from_world(drawing.inputs.camera)[:3, :3].T
        lamps[:count, 3], shares[:count] = light.strengths[:count], light.shares[:count]
        set_uniforms(program, lamps=lamps, ambience=(light.ambient, light.gloss, light.exponent))
        if self.gleams:
            set_uniforms(program, shares=tuple(shares.tolist()))
        if self.variant != 2:
            set_uniforms(program, gamma=light.gamma)


def light_on(draft: Draft, avatar: int) -> CaptureLight | None:
    """What lights an avatar of the plan anew, world; None: nothing does."""
    asked = draft.asked(Light)
    return None if asked is None else asked.on(draft.avatars[avatar], draft)


def light_of(draft: Draft, avatar: int) -> tuple[AvatarLight | None, str]:
    """The same as the passes that draw the avatar need it, and for people the end of their reason."""
    level, light, own = draft.levels[avatar], light_on(draft, avatar), draft.avatars[avatar].light is not None
    if light is None:
        ignored = draft.asked(Light) is not None and not own
        return None, ", not lit anew: its file has no light" if ignored else ""
    seen = np.array((1.0, 0.0) if level.light is None else level.light, np.float32)
    vertices = draft.vertices("light", avatar, 8, lambda: np.broadcast_to(seen, (len(level.positions), 2)))
    gleams = light.gloss > 0 or (level.light is not None and bool(np.any(level.light[:, 1])))
    buffers = (vertices, "2f4", "seen_light"), normals_of(draft, avatar)
    note = f", lit by ambient {light.ambient:.2f} and {plural(len(light.lamps), 'lamp')}"
    note += "" if own else "; its file has no light, its colors are taken for albedo"
    return AvatarLight(buffers, (), light, gleams), note
