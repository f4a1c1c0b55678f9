"""What senders and files call the shapes of a face: ARKit's names in their spellings, and VRM's expressions.

    eyeBlinkLeft   EyeBlinkLeft   eyeBlink_L   eye_blink_left     ARKit, by whom it is sent
    blinkLeft      Blink_L        aa   A       happy   Joy        VRM 1.0 and 0.x: a sum of shapes, PRESETS

Case and underscores do not matter. Left is the person's left in all of them.
"""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from avatar.face import SHAPES

NUMBER = {name: number for number, name in enumerate(SHAPES)}
# VRM 1.0's preset expressions, in its order; "both" sides where a shape has two. Judged by eye; not in the standard.
PRESETS: dict[str, dict[str, float]] = {
    "happy": {"mouthSmile": 0.7, "cheekSquint": 0.4},
    "angry": {"browDown": 0.8, "mouthPress": 0.3, "noseSneer": 0.4},
    "sad": {"browInnerUp": 0.75, "mouthFrown": 0.55},
    "relaxed": {"mouthSmile": 0.3, "eyeSquint": 0.3},
    "surprised": {"browInnerUp": 0.9, "browOuterUp": 0.9, "eyeWide": 0.6, "jawOpen": 0.25},
    "aa": {"jawOpen": 0.45, "mouthLowerDown": 0.2},
    "ih": {"jawOpen": 0.2, "mouthStretch": 0.35},
    "ou": {"mouthPucker": 0.6, "mouthFunnel": 0.2, "jawOpen": 0.15},
    "ee": {"mouthSmile": 0.3, "mouthStretch": 0.4, "jawOpen": 0.15},
    "oh": {"mouthFunnel": 0.55, "jawOpen": 0.35},
    "blink": {"eyeBlink": 1.0},
    "blinkLeft": {"eyeBlinkLeft": 1.0},
    "blinkRight": {"eyeBlinkRight": 1.0},
    "lookUp": {"eyeLookUp": 1.0},
    "lookDown": {"eyeLookDown": 1.0},
    "lookLeft": {"eyeLookOutLeft": 1.0, "eyeLookInRight": 1.0},
    "lookRight": {"eyeLookInLeft": 1.0, "eyeLookOutRight": 1.0},
    "neutral": {},
}
# VRM 0.x's names of the same, where they differ by more than a capital
EARLIER = {
    "Joy": "happy", "Sorrow": "sad", "Fun": "relaxed", "A": "aa", "I": "ih", "U": "ou", "E": "ee", "O": "oh",
    "Blink_L": "blinkLeft", "Blink_R": "blinkRight",
}  # fmt: skip


def shapes_of(recipe: Mapping[str, float]) -> dict[int, float]:
    """The numbers and weights of a recipe's shapes; a name without its side means both."""
    found: dict[int, float] = {}
    for name, weight in recipe.items():
        for one in (name,) if name in NUMBER else (f"{name}Left", f"{name}Right"):
            found[NUMBER[one]] = weight
    return found


def _plain(name: str) -> str:
    return name.lower().replace("_", "").replace(" ", "")


def _spellings() -> dict[str, dict[int, float]]:
    names = {_plain(name): shapes_of(recipe) for name, recipe in PRESETS.items()}
    names |= {name.lower(): shapes_of(PRESETS[now]) for name, now in EARLIER.items()}
    for name, number in NUMBER.items():
        for side in ("Left", "Right"):
            if name.endswith(side):
                names[f"{_plain(name.removesuffix(side))}_{side[0].lower()}"] = {number: 1.0}
        names[_plain(name)] = {number: 1.0}
    return names


_SPELLINGS = _spellings()


def shapes_called(name: str) -> dict[int, float] | None:
    """The shapes that a name stands for, by number, with their weights; None: no shape of a face."""
    lower = name.lower()
    side = lower[-2:] if lower.endswith(("_l", "_r")) else ""
    return _SPELLINGS.get(_plain(lower.removesuffix(side)) + side)


def weights_of(values: Mapping[str, float]) -> Float[Array, "52"]:
    """The weights of SHAPES from named values, which add up; from 0 to 1. Unknown names do nothing."""
    weights = np.zeros(len(SHAPES))
    for name, value in values.items():
        for number, weight in (shapes_called(name) or {}).items():
            weights[number] += weight * value
    return np.clip(weights, 0.0, 1.0)
