"""Life without input: blinks, eyes that wander, lids that follow them, breath; a function of (seed, time) alone.

**Blinks.** Intervals are log-normal, 10 to 17 a minute by the seed (people at rest: 4 to 16, in company more). A lid
closes fully in 90 ms, stays for 30 and opens in 210 with a tail: measured blinks are as uneven, and even ones look
wrong (Trutoiu, Carter, Matthews and Hodgins 2011).

**Saccades** after Lee, Badler and Badler 2002: amplitudes A = -6.9 ln(P / 15.7) degrees with P even in (0, 15), eight
directions with the frequencies of their table, durations of 25 ms + 2.35 ms a degree. The way is half a cosine, whose
fastest moment, 1.57 A / D, is within a tenth of the law 473 (1 - exp(-A / 7.8)) degrees a second from 2 to 20 degrees.
Eyes dwell on what they look at, on one eye or the mouth of who is there, and now and then look away for a moment.

**Breath and weight.** Chest and spine turn by 1 to 2 degrees; the head stays nearly upright. Legs do not move.
"""

from functools import lru_cache

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from avatar.face import SHAPES, FaceFrame
from avatar.face_names import NUMBER
from avatar.gaze import with_looks, within_reach
from avatar.skeleton import JOINT_NUMBERS as J

# seconds that are drawn at once, so that any moment is as near as the first
BLOCK = 600.0
CLOSING, CLOSED, OPENING = 0.09, 0.03, 0.21  # seconds
BLINKS = (11.5, 15.5)  # a minute, in the long run
# deviation of the logarithm of an interval between blinks, and the shortest, seconds
SPREAD, SHORTEST = 0.6, 0.5
# frequencies of directions, from the person's left upwards by 45 degrees (Lee et al., table 1)
DIRECTIONS = np.array([15.54, 6.46, 17.69, 7.44, 16.80, 7.89, 20.38, 7.79])
FARTHEST = np.radians([22.0, 13.0])  # that eyes look away by, yaw and pitch
# share of fixations that are away from what is looked at
AWAY = 0.22
# where one looks at a face a step away: its eyes and its mouth, yaw and pitch in degrees; three of four times the eyes
PLACES, OFTEN = np.radians([[1.1, 0.0], [-1.1, 0.0], [0.0, -2.2]]), (0.375, 0.375, 0.25)
# seconds of a fixation on it, the median and the spread of its logarithm; of one away (27.8 frames of a 30th, +- 24)
DWELL, DWELL_SPREAD, DWELL_AWAY, AWAY_SPREAD = 0.85, 0.5, 0.7, 0.75
BREATHS = (12.0, 16.0)  # a minute


def life(seed: int, seconds: float | int, look: Float[Array, "2 2"] | None = None) -> FaceFrame:
    """The face at a moment. `look` is the gaze at what is looked at (avatar/gaze.py); None: straight ahead."""
    aim = np.zeros((2, 2)) if look is None else look
    gaze = within_reach(within_reach(aim) + wander(seed, seconds))
    weights = np.zeros(len(SHAPES))
    weights[[NUMBER["eyeBlinkLeft"], NUMBER["eyeBlinkRight"]]] = blink(seed, seconds)
    return FaceFrame(with_looks(weights, gaze), gaze)


def blink(seed: int, seconds: float | int) -> float:
    """How far the lids are closed, from 0 to 1."""
    block = int(np.floor(seconds / BLOCK))
    # a blink at a block's end goes on in the next
    since = [seconds - begun for begun in (*_blinks(seed, block - 1)[-1:], *_blinks(seed, block))]
    return max((lid(one) for one in since if 0 <= one < CLOSING + CLOSED + OPENING), default=0.0)


def lid(since: float | int) -> float:
    """How far a lid is closed so many seconds after a blink began."""
    if since < CLOSING:
        return float(0.5 - 0.5 * np.cos(np.pi * max(since, 0.0) / CLOSING))
    opened = np.clip((since - CLOSING - CLOSED) / OPENING, 0.0, 1.0)
    # most of the way at first, then a tail
    return float(0.5 + 0.5 * np.cos(np.pi * opened**0.7))


@lru_cache(64)
def _blinks(seed: int, block: int) -> tuple[float, ...]:
    """When the blinks of a block begin, seconds."""
    random = _random(seed, 1, block)
    rate = _own(seed, *BLINKS)
    mean = np.log(60.0 / rate) - SPREAD**2 / 2
    steps = np.maximum(random.lognormal(mean, SPREAD, int(BLOCK)), SHORTEST)
    steps[0] *= random.uniform()
    begun = np.cumsum(steps)
    return tuple((block * BLOCK + begun[begun < BLOCK - SHORTEST]).tolist())


def wander(seed: int, seconds: float | int) -> Float[Array, "2"]:
    """Yaw and pitch by which both eyes are off what they look at, radians."""
    block = int(np.floor(seconds / BLOCK))
    begun, places = _fixations(seed, block)
    now = int(np.searchsorted(begun, seconds - block * BLOCK, "right")) - 1
    # blocks begin and end on what is looked at
    before, after = (places[now - 1] if now else np.zeros(2)), places[now]
    shift = np.degrees(np.linalg.norm(after - before))
    passed = np.clip((seconds - block * BLOCK - begun[now]) / (0.025 + 0.00235 * shift), 0.0, 1.0)
    return before + (0.5 - 0.5 * np.cos(np.pi * passed)) * (after - before)


@lru_cache(64)
def _fixations(seed: int, block: int) -> tuple[Float[Array, "n"], Float[Array, "n 2"]]:
    """When the eyes of a block move, seconds from its beginning, and where to."""
    random = _random(seed, 2, block)
    count = int(BLOCK / 0.25)
    away = random.uniform(size=count) < AWAY
    # never twice in a row, nor at the beginning
    away[0], away[1:] = False, away[1:] & ~away[:-1]
    amplitude = np.radians(-6.9 * np.log(random.uniform(1e-6, 15.0, count) / 15.7))
    angle = np.radians(45.0) * random.choice(8, count, p=DIRECTIONS / DIRECTIONS.sum())
    far = np.clip(amplitude[:, None] * np.stack([np.cos(angle), np.sin(angle)], 1), -FARTHEST, FARTHEST)
    places = np.where(away[:, None], far, PLACES[random.choice(len(PLACES), count, p=OFTEN)])
    median, spread = np.where(away, DWELL_AWAY, DWELL), np.where(away, AWAY_SPREAD, DWELL_SPREAD)
    dwell = np.clip(median * np.exp(spread * random.standard_normal(count)), 0.2, 6.0)
    begun = np.append(0.0, np.cumsum(dwell)[:-1])
    last = int(np.searchsorted(begun, BLOCK - 0.2))
    begun, places = begun[:last], places[:last]
    places[0] = places[-1] = 0.0
    return begun, places


def sway(seed: int, seconds: float | int) -> Float[Array, "52 3"]:
    """What breath and a shifting weight add to the axis-angles of a body that stands still, radians."""
    breath = 2 * np.pi * (_own(seed, *BREATHS) / 60 * seconds + _own(seed + 1, 0.0, 1.0))
    # breathing out takes longer
    breath = np.sin(breath + 0.4 * np.sin(breath))
    lean, twist, nod, turn = (_drift(seed, stream, seconds) for stream in (3, 4, 5, 6))
    turns = np.zeros((52, 3))
    for joint, degrees in {
        "spine1": (0.4 * nod, 0.6 * twist, 1.2 * lean),
        "spine3": (-0.5 - 0.5 * breath, 0.0, -0.4 * lean),
        "left_collar": (0.0, 0.0, 0.4 + 0.4 * breath),
        "right_collar": (0.0, 0.0, -0.4 - 0.4 * breath),
        "neck": (0.4 + 0.4 * breath, -0.3 * twist, -0.5 * lean),
        "head": (0.5 * nod, 0.8 * turn, -0.2 * lean),
    }.items():
        turns[J[joint]] = np.radians(degrees)
    return turns


def _drift(seed: int, stream: int, seconds: float | int) -> float:
    """A slow wander of order 1: sines of .05 to .35 Hz, the slow ones the larger."""
    hertz, phase = _waves(seed, stream)
    return float([0.6, 0.4, 0.25, 0.15] @ np.sin(2 * np.pi * hertz * seconds + phase))


@lru_cache(256)
def _waves(seed: int, stream: int) -> tuple[Float[Array, "4"], Float[Array, "4"]]:
    random = _random(seed, stream, 0)
    return random.uniform(0.8, 1.2, 4) * [0.05, 0.11, 0.19, 0.33], random.uniform(0, 2 * np.pi, 4)


@lru_cache(256)
def _own(seed: int, least: float, most: float) -> float:
    """A trait of a person."""
    return _random(seed, 0, 0).uniform(least, most)


def _random(seed: int, stream: int, block: int) -> np.random.Generator:
    """Numbers of a seed: others for each stream and block, which may be before time 0."""
    return np.random.default_rng([seed % (1 << 32), stream, block % (1 << 32)])
