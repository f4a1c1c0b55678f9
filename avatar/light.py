"""The light that a capture was taken in, as its own factor: ambient, a few lamps and one highlight.

    S(n) = ambient + sum_k strength_k max(n . l_k, 0)                                Lambert, lamps far away
    H(n, v) = gloss sum_k share_k max(n . h_k, 0)^exponent,  h_k = |l_k + v|          Blinn (1977)
    shown = clip((albedo^gamma S + H)^(1 / gamma), 0, 1)

n is the posed unit normal, v the unit direction from the surface towards the eye, both in the frame in which the
light stands still (`frame`); share_k is the lamp's part of the lamps' strength. The light is grey. `gamma` is the
space in which it multiplies: 1, display values themselves; 2.2, about linear light. Mean S over what the videos saw
is 1, so albedo is about as bright as the person was. A lamp that no surface facing the camera shows (behind the
person) is not known. Cast shadows are not part of it.
"""

import math
from dataclasses import replace
from typing import Annotated, Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from command.settings import AtLeast, AtMost, SettingsSource, record_of, settings
from files.input_file import Json

Frame = Literal["camera", "world"]
# at most; as many as shaders/light.glsl has room for
LAMPS = 4
EXPONENT = 20.0
STRONGEST = 100.0


@settings
class Lamp:
    """A lamp so far away that its direction and strength are the same everywhere on the person."""

    direction: Annotated[tuple[float, float, float], "unit, towards the lamp"]
    strength: Annotated[float, AtLeast(0), AtMost(STRONGEST)]

    def __post_init__(self):
        if not abs(math.hypot(*self.direction) - 1) < 1e-4:
            raise ValueError(f"direction: expected three numbers of length 1, found {self.direction}")


@settings
class CaptureLight:
    """Light of a capture; see the module. Frozen once it is fitted, before anything is trained."""

    ambient: Annotated[float, AtLeast(0), AtMost(STRONGEST)]
    lamps: tuple[Lamp, ...] = ()
    # strength of the highlight, in the space of gamma; 0: none
    gloss: Annotated[float, AtLeast(0), AtMost(STRONGEST)] = 0.0
    exponent: Annotated[float, AtLeast(1), AtMost(1000)] = EXPONENT
    gamma: Annotated[float, AtLeast(1), AtMost(4)] = 1.0
    # where it stands still: camera, every video's own (a phone on a tripod; OpenCV, +y down); world, +y up
    frame: Frame = "camera"

    def __post_init__(self):
        if len(self.lamps) > LAMPS:
            raise ValueError(f"lamps: expected at most {LAMPS}, found {len(self.lamps)}")
        if self.ambient + sum(lamp.strength for lamp in self.lamps) <= 0:
            raise ValueError("ambient: expected light, with that of the lamps, found none")

    @property
    def directions(self) -> Float[Array, "lamps 3"]:
        """Towards the lamps, unit."""
        return np.array([lamp.direction for lamp in self.lamps], np.float64).reshape(-1, 3)

    @property
    def strengths(self) -> Float[Array, "lamps"]:
        return np.array([lamp.strength for lamp in self.lamps], np.float64)

    @property
    def shares(self) -> Float[Array, "lamps"]:
        total = self.strengths.sum()
        return self.strengths / total if total > 0 else self.strengths

    def shading(self, normals: Float[Array, "n 3"]) -> Float[Array, "n"]:
        """S at unit normals."""
        return self.ambient + np.maximum(normals @ self.directions.T, 0) @ self.strengths

    def highlight(self, normals: Float[Array, "n 3"], towards_eye: Float[Array, "n 3"]) -> Float[Array, "n"]:
        """H at unit normals, seen from unit directions."""
        total = np.zeros(len(normals))
        if self.gloss == 0:
            return total
        for direction, share in zip(self.directions, self.shares, strict=True):
            half = towards_eye + direction
            # an eye straight behind the lamp has no half direction: no highlight
            half = half / np.maximum(np.linalg.norm(half, axis=1, keepdims=True), 1e-9)
            total += share * np.maximum((normals * half).sum(1), 0) ** self.exponent
        return self.gloss * total

    def shown(
        self, albedo: Float[Array, "n 3"], shading: Float[Array, "n"], highlight: Float[Array, "n"]
    ) -> Float[Array, "n 3"]:
        """Display colour in [0, 1] of an albedo under shading S and highlight H."""
        linear = np.clip(albedo, 0, None) ** self.gamma * shading[:, None] + highlight[:, None]
        return np.clip(linear, 0, 1) ** (1 / self.gamma)

    def albedo(
        self, shown: Float[Array, "n 3"], shading: Float[Array, "n"], highlight: Float[Array, "n"]
    ) -> Float[Array, "n 3"]:
        """Albedo of a display colour in [0, 1] seen under shading S and highlight H: `shown` backwards.

        Not clipped above; 0 where the highlight alone is brighter than what is shown, or nothing lights the surface.
        """
        linear = np.maximum(np.clip(shown, 0, 1) ** self.gamma - highlight[:, None], 0)
        shade = np.maximum(shading, 1e-3)[:, None]
        return (linear / shade) ** (1 / self.gamma)

    def turned(self, rotation: Float[Array, "3 3"], frame: Frame) -> "CaptureLight":
        """The same light in `frame`; `rotation` is target_from_source."""
        directions = self.directions @ np.asarray(rotation, np.float64).T
        return replace(self, lamps=lamps_of(directions, self.strengths), frame=frame)

    def scaled(self, factor: float) -> "CaptureLight":
        """Shading times a factor; the highlight stays. Albedos divide by factor^(1 / gamma) to show the same."""
        lamps = lamps_of(self.directions, self.strengths * factor)
        return replace(self, ambient=self.ambient * factor, lamps=lamps)


def lamps_of(directions: Float[Array, "lamps 3"], strengths: Float[Array, "lamps"]) -> tuple[Lamp, ...]:
    """Lamps from directions of any length but 0."""
    unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    return tuple(Lamp((float(x), float(y), float(z)), float(s)) for (x, y, z), s in zip(unit, strengths, strict=True))


def light_from_json(content: Json) -> CaptureLight:
    """A light as `settings_json` gives it to JSON.

    Raises:
        ValueError: a field is absent, unknown or out of its range; the message names it, what was expected and found.
    """
    return record_of(CaptureLight, content, SettingsSource(whole=True), shown="a light")
