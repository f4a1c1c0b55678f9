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

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
from jaxtyping import Float

from files.input_file import Json, JsonObject

Array = np.ndarray
Frame = Literal["camera", "world"]
# at most; as many as shaders/light.glsl has room for
LAMPS = 4
EXPONENT = 20.0
GAMMA = (1.0, 4.0)
STRONGEST = 100.0


@dataclass(frozen=True)
class Lamp:
    """A lamp so far away that its direction and strength are the same everywhere on the person."""

    direction: tuple[float, float, float]  # unit, towards the lamp
    strength: float

    def __post_init__(self):
        _check_number("lamp strength", self.strength, 0.0, STRONGEST)
        length = float(np.linalg.norm(np.array(self.direction, np.float64)))
        if len(self.direction) != 3 or not abs(length - 1) < 1e-4:
            raise ValueError(f"lamp direction should be three numbers of length 1, is {self.direction}")


@dataclass(frozen=True)
class CaptureLight:
    """Light of a capture; see the module. Frozen once it is fitted, before anything is trained."""

    ambient: float
    lamps: tuple[Lamp, ...] = ()
    # strength of the highlight, in the space of gamma; 0: none
    gloss: float = 0.0
    exponent: float = EXPONENT
    gamma: float = 1.0
    # where it stands still: camera, every video's own (a phone on a tripod; OpenCV, +y down); world, +y up
    frame: Frame = "camera"

    def __post_init__(self):
        _check_number("ambient", self.ambient, 0.0, STRONGEST)
        _check_number("gloss", self.gloss, 0.0, STRONGEST)
        _check_number("exponent", self.exponent, 1.0, 1000.0)
        _check_number("gamma", self.gamma, *GAMMA)
        if len(self.lamps) > LAMPS:
            raise ValueError(f"lamps should be at most {LAMPS}, are {len(self.lamps)}")
        if self.ambient + sum(lamp.strength for lamp in self.lamps) <= 0:
            raise ValueError("ambient and the lamps together should be brighter than 0")

    @property
    def directions(self) -> Float[Array, "lamps 3"]:
        """Towards the lamps, unit."""
        return np.array([lamp.direction for lamp in self.lamps], np.float64).reshape(-1, 3)

    @property
    def strengths(self) -> Float[Array, "lamps"]:
        return np.array([lamp.strength for lamp in self.lamps], np.float64)

    @property
    def shares(self) -> Float[Array, "lamps"]:
        """Each lamp's share of the highlight."""
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

    def json(self) -> JsonObject:
        """What JSON holds of it; `light_from_json` gives it back exactly."""
        return {
            "ambient": self.ambient,
            "lamps": [{"direction": list(lamp.direction), "strength": lamp.strength} for lamp in self.lamps],
            "gloss": self.gloss,
            "exponent": self.exponent,
            "gamma": self.gamma,
            "frame": self.frame,
        }


def lamps_of(directions: Float[Array, "lamps 3"], strengths: Float[Array, "lamps"]) -> tuple[Lamp, ...]:
    """Lamps from directions of any length but 0."""
    unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    return tuple(Lamp((float(x), float(y), float(z)), float(s)) for (x, y, z), s in zip(unit, strengths, strict=True))


def light_from_json(content: Json) -> CaptureLight:
    """Read what `CaptureLight.json` wrote.

    Raises:
        ValueError: a field is absent, unknown or out of its range; the message names it, what was expected and found.
    """
    names = ("ambient", "lamps", "gloss", "exponent", "gamma", "frame")
    _check_keys("light", content, names)
    lamps = content["lamps"]
    if not isinstance(lamps, list):
        raise ValueError(f"lamps should be a list, is {_short(lamps)}")
    if content["frame"] not in get_args(Frame):
        raise ValueError(f"frame should be one of {get_args(Frame)}, is {_short(content['frame'])}")
    return CaptureLight(
        _number("ambient", content["ambient"]), tuple(_lamp_from_json(lamp) for lamp in lamps),
        _number("gloss", content["gloss"]), _number("exponent", content["exponent"]),
        _number("gamma", content["gamma"]), content["frame"],
    )  # fmt: skip


def _lamp_from_json(content: Json) -> Lamp:
    _check_keys("a lamp", content, ("direction", "strength"))
    direction = content["direction"]
    if not isinstance(direction, Sequence) or isinstance(direction, str) or len(direction) != 3:
        raise ValueError(f"lamp direction should be three numbers, is {_short(direction)}")
    x, y, z = (_number("lamp direction", value) for value in direction)
    return Lamp((x, y, z), _number("lamp strength", content["strength"]))


def _check_keys(what: str, content: Json, names: Sequence[str]) -> None:
    if not isinstance(content, Mapping) or set(content) != set(names):
        found = sorted(map(str, content)) if isinstance(content, Mapping) else _short(content)
        raise ValueError(f"{what} should hold {', '.join(names)}, is {found}")


def _number(name: str, value: Json) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"{name} should be a number, is {_short(value)}")
    try:
        return float(value)
    except OverflowError:
        raise ValueError(f"{name} should be a number that a float holds, is {_short(value)}") from None


def _check_number(name: str, value: float, least: float, most: float) -> None:
    # not a number compares false with everything
    if not least <= value <= most:
        raise ValueError(f"{name} should be from {least:g} to {most:g}, is {value}")


def _short(value: Json) -> str:
    return repr(value)[:80]
