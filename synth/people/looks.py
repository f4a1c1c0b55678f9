"""Who a seed stands for: figure, skin, hair, clothes and shoes.

Consecutive seeds take turns at sexes, hair, clothes and heights, so that twelve of them hold every kind; all else is
drawn by chance. Lengths in metres, colors sRGB 0 to 255.
"""

from dataclasses import dataclass

import numpy as np

Color = tuple[int, int, int]

HAIR = {"female": ("long", "bun", "long front", "ponytail", "bob", "long"),
        "male": ("short", "bald", "curly", "short", "ponytail", "curly")}  # fmt: skip
WEAR = {"female": ("dress", "skirt", "coat", "tight", "dress", "wide"),
        "male": ("tight", "shorts", "coat", "wide", "shorts", "tight")}  # fmt: skip
SKINS = ((238, 200, 178), (224, 176, 148), (198, 146, 112), (164, 112, 80), (122, 80, 56), (92, 60, 44))
HAIRS = ((34, 26, 22), (58, 38, 26), (96, 60, 34), (146, 92, 48), (196, 156, 98), (128, 52, 28), (158, 156, 154))
IRISES = ((98, 62, 34), (70, 44, 28), (88, 128, 158), (92, 118, 72), (126, 98, 50))
CLOTHS = (
    (178, 44, 48), (36, 60, 112), (232, 226, 214), (44, 104, 84), (228, 178, 66), (92, 58, 112), (214, 122, 138),
    (52, 50, 54), (96, 146, 186), (30, 112, 124), (206, 198, 178), (122, 132, 92),
)  # fmt: skip
PATTERNS = ("flowers", "stripes", "check", "dots", "leaves", "plain")


@dataclass(frozen=True)
class Fabric:
    """A pattern in its colors, the ground first."""

    pattern: str
    colors: tuple[Color, Color, Color]


@dataclass(frozen=True)
class Looks:
    seed: int
    sex: str
    stature: float  # barefoot
    betas: tuple[float, ...]  # shape coefficients of the free body
    heavy: float  # 0 to 1: fat that they do not have
    skin: Color
    iris: Color
    hair: str  # see HAIR; of "long front" some hangs before the shoulders
    hair_color: Color
    hair_length: float  # how far long hair hangs below the neck's joint
    wear: str  # see WEAR; "tight" and "wide" are trousers
    sleeve: float  # 0: none; 1: to the elbow; 2: to the wrist
    hem: float  # where skirt, dress, coat, shorts end: share of the way from hip (0) over knee (1) to ankle (2)
    flare: float  # how far it stands off there
    heel: float  # angle of the foot, radians; 0: flat shoes
    top: Fabric
    bottom: Fabric
    shoe: Color


def draw(seed: int) -> Looks:
    """The person of a seed."""
    rng = np.random.default_rng([seed, 2026])
    turn, sex = seed // 2, ("male", "female")[seed % 2]
    woman, wear, weave = sex == "female", WEAR[sex][turn % 6], ("plain", "denim", "check")[int(rng.integers(3))]
    ancestry = (turn + 2 * woman) % 3
    weight = (turn * 0.382 + 0.25 * woman + rng.uniform(0, 0.1)) % 1
    heavy, betas = 2 * max(weight - 0.5, 0.0), rng.uniform(0, 1, 10)
    # height, weight, muscle, thinness, age, two ancestries, two of proportions, the other sex
    chosen = [0, heavy, 1, max(0.3 - weight, 0) / 0.3, turn % 3 == 0, ancestry == 1, ancestry == 2]
    chosen += [1 - 0.6 * (turn % 2), 1 - turn % 4 / 4, turn % 4 == 3]
    betas = np.array([0, 2, 2 * betas[2], 2.4, 0.9, 1.2 + 0.8 * betas[5], 1.2 + 0.8 * betas[6], 1.5, 1.2, 0.5]) * chosen
    fair = ancestry != 1
    return Looks(
        seed=seed, sex=sex, betas=tuple(betas.tolist()), heavy=heavy,
        stature=(1.5 if woman else 1.6) + (0.35 if woman else 0.4) * ((turn * 0.618 + 0.3) % 1),
        skin=SKINS[int(rng.integers(3)) + (0 if fair else 3)], iris=IRISES[int(rng.integers(2 if ancestry else 5))],
        hair=HAIR[sex][turn % 6], hair_color=HAIRS[int(rng.integers(2 if ancestry else 7))],
        hair_length=float(rng.uniform(0.12, 0.34)), wear=wear,
        sleeve=1.9 if wear == "coat" else (0.0, 0.55, 1.9, 1.5)[int(rng.integers(0 if woman else 1, 4))],
        hem={"dress": 1.1, "skirt": 0.8, "coat": 0.95, "shorts": 0.75}.get(wear, 2.0) + float(rng.uniform(-0.2, 0.2)),
        flare=float(rng.uniform(0.03, 0.14)), heel=float(woman and turn % 3 != 1) * float(rng.uniform(0.35, 0.6)),
        top=_cloth(rng, PATTERNS[(turn + 3 * (not woman)) % 6]),
        bottom=_cloth(rng, weave), shoe=CLOTHS[int(rng.integers(12))],
    )  # fmt: skip


def _cloth(rng: np.random.Generator, pattern: str) -> Fabric:
    first, second, third = rng.choice(len(CLOTHS), 3, replace=False)
    return Fabric(pattern, (CLOTHS[first], CLOTHS[second], CLOTHS[third]))
