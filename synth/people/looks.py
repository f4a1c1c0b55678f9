"""Who a seed stands for: figure, skin, hair, clothes and shoes.

Consecutive seeds take turns at sexes, hair, clothes and heights, so that twelve of them hold every kind; all else is
drawn by chance. Lengths in metres, colors sRGB 0 to 255.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

Color = tuple[int, int, int]

WOMEN_HAIR = ("long", "bun", "long front", "ponytail", "bob", "long")
MEN_HAIR = ("short", "bald", "curly", "short", "ponytail", "curly")
WOMEN_WEAR = ("dress", "skirt", "coat", "tight", "dress", "wide")
MEN_WEAR = ("tight", "shorts", "coat", "wide", "shorts", "tight")
SKINS: tuple[Color, ...] = ((238, 200, 178), (224, 176, 148), (198, 146, 112), (164, 112, 80), (122, 80, 56), (92, 60, 44))
HAIRS: tuple[Color, ...] = ((34, 26, 22), (58, 38, 26), (96, 60, 34), (146, 92, 48), (196, 156, 98), (128, 52, 28), (158, 156, 154))
IRISES: tuple[Color, ...] = ((88, 128, 158), (98, 62, 34), (92, 118, 72), (70, 44, 28), (126, 98, 50))
CLOTHS: tuple[Color, ...] = (
    (178, 44, 48), (36, 60, 112), (232, 226, 214), (44, 104, 84), (228, 178, 66), (92, 58, 112), (214, 122, 138),
    (52, 50, 54), (96, 146, 186), (166, 102, 62), (206, 198, 178), (122, 132, 92),
)  # fmt: skip
PATTERNS = ("flowers", "stripes", "check", "dots", "leaves", "plain", "zigzag")


@dataclass(frozen=True)
class Cloth:
    """A pattern in its colors, the ground first."""

    pattern: str
    colors: tuple[Color, Color, Color]


@dataclass(frozen=True)
class Looks:
    """One person."""

    seed: int
    sex: str
    stature: float  # barefoot
    betas: tuple[float, ...]  # shape coefficients of the free body
    heavy: float  # 0 to 1: fat that they do not have
    skin: Color
    iris: Color
    # "bald", "short", "curly", "bob", "bun", "ponytail", "long", "long front" (some of it before the shoulders)
    hair: str
    hair_color: Color
    hair_length: float  # below the neck's joint, of what hangs
    # "dress", "skirt", "coat", "tight", "wide" (trousers), "shorts"
    wear: str
    sleeve: float  # 0: none; 1: to the elbow; 2: to the wrist
    hem: float  # of skirt, dress, coat, shorts: share of the way from hip (0) over knee (1) to ankle (2)
    flare: float  # how far it stands off there
    heel: float  # angle of the foot, radians; 0: flat shoes
    top: Cloth
    bottom: Cloth
    shoe: Color


def draw(seed: int) -> Looks:
    """The person of a seed."""
    rng = np.random.default_rng([seed, 2026])
    turn, sex = seed // 2, ("male", "female")[seed % 2]
    woman = sex == "female"
    wear = (WOMEN_WEAR if woman else MEN_WEAR)[turn % 6]
    ancestry, heavy = rng.integers(3), (turn * 0.382 + 0.25 * woman + rng.uniform(0, 0.1)) % 1
    betas = np.zeros(10)
    betas[1], betas[3] = 2 * max(heavy - 0.5, 0) * 2, 2.4 * max(0.3 - heavy, 0) / 0.3  # heavier, thinner
    betas[2] = rng.uniform(-1, 2)  # muscle
    betas[4] = rng.uniform(0, 0.9) * (rng.random() < 0.4)  # age
    betas[5], betas[6] = 2 * (ancestry == 1) * rng.uniform(0.6, 1), 2 * (ancestry == 2) * rng.uniform(0.6, 1)
    betas[7], betas[8] = rng.uniform(0, 1.5), rng.uniform(0, 1.2)  # proportions
    skin = SKINS[(int(rng.integers(0, 3)), int(rng.integers(3, 6)), int(rng.integers(0, 3)))[ancestry]]
    hair = HAIRS[int(rng.integers(0, 7 if ancestry == 0 else 2))]
    stature = (1.5, 1.6)[not woman] + (0.35 if woman else 0.4) * ((turn * 0.618 + 0.3) % 1)
    pattern = int(rng.integers(7)) if wear == "coat" else (turn * 3 + 4 * (not woman)) % 7
    top, bottom = _cloth(rng, PATTERNS[pattern]), _cloth(rng, ("plain", "denim", "plain", "check")[turn % 4])
    return Looks(
        seed=seed, sex=sex, stature=float(stature), betas=tuple(betas.tolist()), heavy=2 * max(heavy - 0.5, 0),
        skin=skin,
        iris=IRISES[int(rng.integers(5)) if ancestry == 0 else (1, 3)[int(rng.integers(2))]],
        hair=(WOMEN_HAIR if woman else MEN_HAIR)[turn % 6], hair_color=hair,
        hair_length=float(rng.uniform(0.12, 0.34)), wear=wear,
        sleeve=float((0.0, 0.55, 1.9, 1.5)[int(rng.integers(0 if woman else 1, 4))]) if wear != "coat" else 1.9,
        hem={"dress": 1.1, "skirt": 0.8, "coat": 0.95, "shorts": 0.75}.get(wear, 2.0) + float(rng.uniform(-0.2, 0.2)),
        flare=float(rng.uniform(0.03, 0.14)), heel=float(woman and turn % 3 != 1) * float(rng.uniform(0.35, 0.6)),
        top=top, bottom=bottom, shoe=CLOTHS[int(rng.integers(12))],
    )  # fmt: skip


def _cloth(rng: np.random.Generator, pattern: str) -> Cloth:
    chosen = rng.choice(len(CLOTHS), 3, replace=False)
    return Cloth(pattern, tuple(CLOTHS[i] for i in chosen))  # type: ignore[arg-type]


def rgb(color: Color) -> Float[np.ndarray, "3"]:
    """A color as an array."""
    return np.array(color, np.float32)
