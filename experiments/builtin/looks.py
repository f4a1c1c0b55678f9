"""What the two built-in people wear: sizes and colors, no shapes."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Looks:
    """What one person wears; lengths in metres, colors sRGB 0-255."""

    sex: str
    seed: int
    # shirt inside the trousers, with a belt; else its hem hangs over them
    tucked: bool
    # hem of the sleeve, as a fraction of the way from shoulder to elbow (over 1: to the wrist)
    sleeve: float
    # height of the collar over the collar bones' joints
    collar: float
    # slope of the collar towards the front
    neckline: float
    shirt_ease: float
    trouser_ease: tuple[float, float, float]  # hip, knee, ankle
    hair_top: float
    hair_side: float
    bun: float
    pattern: str  # "stripes" or "plaid"
    skin: tuple[int, int, int]
    hair: tuple[int, int, int]
    iris: tuple[int, int, int]
    lips: tuple[int, int, int]
    shirt: tuple[tuple[int, int, int], tuple[int, int, int]]
    trousers: tuple[int, int, int]
    shoes: tuple[int, int, int]
    # over the legs, which wear tights in the trousers' place
    skirt: tuple[int, int, int] | None = None


MALE = Looks(
    sex="male",
    seed=11,
    tucked=False,
    sleeve=0.62,
    collar=0.012,
    neckline=0.55,
    shirt_ease=0.010,
    trouser_ease=(0.010, 0.014, 0.0235),
    hair_top=0.016,
    hair_side=0.0075,
    bun=0.0,
    pattern="stripes",
    skin=(222, 172, 143),
    hair=(62, 42, 28),
    iris=(92, 122, 140),
    lips=(186, 112, 102),
    shirt=((238, 234, 224), (38, 62, 104)),
    trousers=(52, 66, 96),
    shoes=(232, 230, 226),
)
FEMALE = Looks(
    sex="female",
    seed=23,
    tucked=True,
    sleeve=1.45,
    collar=0.004,
    neckline=0.5,
    shirt_ease=0.011,
    trouser_ease=(0.006, 0.006, 0.006),
    hair_top=0.012,
    hair_side=0.008,
    bun=0.019,
    pattern="plaid",
    skin=(232, 188, 164),
    hair=(110, 62, 34),
    iris=(96, 108, 62),
    lips=(196, 98, 98),
    shirt=((150, 42, 44), (34, 40, 60)),
    trousers=(58, 54, 62),
    shoes=(60, 44, 38),
    skirt=(42, 78, 92),
)
