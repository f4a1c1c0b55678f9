"""What a film of a face says of this person beside the built-in one: face.json of a capture folder (docs/formats.md).

Gains and offsets are in units of a built-in shape: gain, how far this person's own goes from rest; offset, how much of
it the person's rest has that the template has not. Colors are factors of the color of the cheeks, sRGB.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from avatar.face import SHAPES
from command.errors import AssetError
from files.input_file import one_line, read_json_object

# the shapes that the 68 points of a face determine, in the order in which a film shows them
FITTED = (
    "jawOpen", "mouthSmileLeft", "mouthSmileRight", "browInnerUp", "browOuterUpLeft", "browOuterUpRight",
    "browDownLeft", "browDownRight", "eyeBlinkLeft", "eyeBlinkRight",
)  # fmt: skip
NUMBERS = [SHAPES.index(name) for name in FITTED]
OWN_FACE, FORMAT = "face.json", "selfscan-face"
# what is believed
GAINS, OFFSETS, COLORS = (0.3, 2.0), (-1.0, 1.0), (0.05, 15.0)


@dataclass(frozen=True)
class OwnFace:
    gains: Float[Array, "10"]  # one for each of FITTED; 1: as built in
    offsets: Float[Array, "10"]
    # colors behind the lips over the skin's; None: no frame shows them
    teeth: Float[Array, "3"] | None = None
    red: Float[Array, "3"] | None = None

    def json(self) -> dict[str, Any]:
        """The content of face.json."""
        shapes = {name: {"gain": round(float(gain), 4), "offset": round(float(offset), 4)}
                  for name, gain, offset in zip(FITTED, self.gains, self.offsets)}  # fmt: skip
        colors = {"teeth": self.teeth, "red": self.red}
        found = {name: color.round(4).tolist() for name, color in colors.items() if color is not None}
        return {"format": FORMAT, "version": 1, "shapes": shapes, "colors": found}


def believed(gains: Float[Array, "10"], offsets: Float[Array, "10"], *colors: Float[Array, "3"] | None) -> OwnFace:
    """What a film says, as far as `read_own_face` believes it; a color that is not counts as not seen."""
    known = [c if c is not None and (np.clip(c, *COLORS) == c).all() else None for c in colors]
    return OwnFace(np.clip(gains, *GAINS), np.clip(offsets, *OFFSETS), *known)


def read_own_face(path: Path) -> OwnFace:
    """face.json of a capture folder.

    Raises:
        AssetError: a field is absent, no number, or none that is believed; file and field are named.
    """
    content = read_json_object(path, "what a film of a face says")
    if content.get("format") != FORMAT or content.get("version") != 1:
        found = one_line(f"{content.get('format')!r} version {content.get('version')!r}")
        raise AssetError(f"{path}: expected format '{FORMAT}' version 1, found {found}")
    shapes, colors = (_object(path, content, name) for name in ("shapes", "colors"))
    strange = sorted({*shapes} - {*FITTED} | {*colors} - {"teeth", "red"})
    if strange:
        raise AssetError(f"{path}: expected shapes {', '.join(FITTED)}, colors teeth, red; found {one_line(strange)}")
    rows = [_object(path, shapes, name) for name in FITTED]
    read = lambda key, limits: np.array(
        [_number(path, f"shapes.{name}.{key}", row.get(key), limits) for name, row in zip(FITTED, rows)]
    )
    tints = [_color(path, name, colors[name]) if name in colors else None for name in ("teeth", "red")]
    return OwnFace(read("gain", GAINS), read("offset", OFFSETS), *tints)


def _object(path: Path, content: dict[str, Any], name: str) -> dict[str, Any]:
    found = content.get(name)
    if not isinstance(found, dict):
        raise AssetError(f"{path}: {name} should be an object, is {one_line(repr(found))}")
    return found


def _number(path: Path, name: str, value: Any, limits: tuple[float, float]) -> float:
    if type(value) not in (int, float) or not limits[0] <= value <= limits[1]:
        raise AssetError(f"{path}: {name} should be {limits[0]:g} to {limits[1]:g}, is {one_line(repr(value))}")
    return float(value)


def _color(path: Path, name: str, value: Any) -> Float[Array, "3"]:
    if not isinstance(value, list) or len(value) != 3:
        raise AssetError(f"{path}: colors.{name} should be three numbers, is {one_line(repr(value))}")
    return np.array([_number(path, f"colors.{name}", one, COLORS) for one in value])
