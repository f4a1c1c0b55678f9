"""What a mouth does to the sound of speech: loudness and formants to 15 visemes, visemes to shapes. No model, no text.

Every 10 ms a window of 25 ms is looked at. Linear prediction of the band below 5 kHz (Makhoul 1975, selective
prediction: its autocorrelation is the transform of that part of the power spectrum) has its poles at the formants; a
vowel is near its place in the plane of the logarithms of F1 and F2 (Peterson and Barney 1952, men; others' are scaled
by F3). Sound above 3.5 kHz is a fricative, a murmur below 900 Hz a closed mouth, a short gap a stop. What sounds alone
cannot tell (p, b and m from t and n) the burst or F2 decides, often wrongly.

The jaw rises to a new opening in 30 ms and falls in 80; visemes cross-fade over 40.
"""

from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from avatar.face import SHAPES
from avatar.face_names import NUMBER, shapes_of
from files.sound import Sound

STEP, WINDOW, FADE = 0.010, 0.025, 0.040  # seconds
ATTACK, RELEASE = 0.030, 0.080  # seconds
LONGEST_GAP = 0.15  # seconds; a longer one is a pause
MOST_JAW = 0.45  # 1 is a shout
AT_ONCE = 4096  # windows, for memory
# decibels below the loud parts from where all is silence, and above the quiet ones
QUIET, FLOOR = 34.0, 9.0
BAND, ORDER = 5000.0, 11
# men's F1 and F2, and the third formant that goes with them, hertz
VOWELS = {"aa": (730, 1150), "E": (560, 1800), "ih": (330, 2200), "oh": (520, 880), "ou": (320, 820)}
F3, NEAR = 2500.0, 0.2  # how near in logarithms a vowel is sure
# Meta's names of visemes; a name without its side means both. Judged by eye.
VISEMES: dict[str, dict[str, float]] = {
    "sil": {},
    "PP": {"mouthPress": 0.4, "mouthRollLower": 0.15, "mouthRollUpper": 0.15},
    "FF": {"mouthRollLower": 0.5, "mouthUpperUp": 0.2, "jawOpen": 0.06},
    "TH": {"tongueOut": 0.3, "jawOpen": 0.12, "mouthLowerDown": 0.1},
    "DD": {"jawOpen": 0.12, "mouthLowerDown": 0.2, "mouthStretch": 0.1},
    "kk": {"jawOpen": 0.18, "mouthStretch": 0.1, "mouthUpperUp": 0.05},
    "CH": {"mouthFunnel": 0.45, "mouthPucker": 0.2, "jawOpen": 0.08},
    "SS": {"mouthStretch": 0.3, "mouthSmile": 0.1, "mouthLowerDown": 0.15, "jawOpen": 0.05},
    "nn": {"jawOpen": 0.1, "mouthLowerDown": 0.12},
    "RR": {"mouthPucker": 0.35, "mouthFunnel": 0.2, "jawOpen": 0.12},
    "aa": {"jawOpen": 0.45, "mouthLowerDown": 0.2},
    "E": {"jawOpen": 0.28, "mouthStretch": 0.3, "mouthSmile": 0.1},
    "ih": {"jawOpen": 0.18, "mouthStretch": 0.35, "mouthSmile": 0.12},
    "oh": {"mouthFunnel": 0.5, "jawOpen": 0.34},
    "ou": {"mouthPucker": 0.6, "mouthFunnel": 0.25, "jawOpen": 0.14},
}
PLACE = {name: number for number, name in enumerate(VISEMES)}


class Speech:
    """The shapes of a mouth that speaks, at any moment of a sound."""

    def __init__(self, sound: Sound):
        self.seconds = sound.seconds
        self.frames = mouth_shapes(sound)

    def weights(self, seconds: float | int) -> Float[Array, "52"]:
        """At a moment; none before and after the sound."""
        at = seconds / STEP
        if not 0 <= at < len(self.frames):
            return np.zeros(len(SHAPES))
        low = int(at)
        after = self.frames[min(low + 1, len(self.frames) - 1)]
        return self.frames[low] + (at - low) * (after - self.frames[low])


def mouth_shapes(sound: Sound) -> Float[Array, "frames 52"]:
    """The weights of SHAPES every STEP seconds."""
    heard = features(sound)
    visemes, loud = classified(heard)
    rounds = max(round(FADE / STEP), 1)
    box = np.ones(rounds + 1)
    box[[0, -1]] = 0.5
    middle = slice(rounds // 2, rounds // 2 + len(visemes))
    visemes = np.stack([np.convolve(one, box / rounds)[middle] for one in visemes.T], 1)
    weights = visemes @ _shapes_of_visemes()
    # quiet speech opens the mouth less
    jaw = _followed(np.minimum(weights[:, NUMBER["jawOpen"]] * (0.6 + 0.5 * loud), MOST_JAW))
    weights[:, NUMBER["jawOpen"]] = jaw
    # lips meet over a jaw that is still on its way
    weights[:, NUMBER["mouthClose"]] = visemes[:, PLACE["PP"]] * jaw
    return weights


@lru_cache(1)
def _shapes_of_visemes() -> Float[Array, "15 52"]:
    table = np.zeros((len(VISEMES), len(SHAPES)))
    for row, recipe in zip(table, VISEMES.values(), strict=True):
        for number, weight in shapes_of(recipe).items():
            row[number] = weight
    return table


def _followed(wanted: Float[Array, "frames"]) -> Float[Array, "frames"]:
    """A low pass that is quick upwards and slow downwards."""
    up, down = (1 - np.exp(-STEP / (seconds / 2)) for seconds in (ATTACK, RELEASE))
    out, now = np.empty_like(wanted), 0.0
    for k, goal in enumerate(wanted.tolist()):
        now += (up if goal > now else down) * (goal - now)
        out[k] = now
    return out


def features(sound: Sound) -> Float[Array, "frames 7"]:
    """Every STEP: decibels, shares of power below 900 Hz and above 3.5 kHz, the high band's middle, F1, F2, F3 (Hz)."""
    hop, size = round(STEP * sound.rate), round(WINDOW * sound.rate)
    count = -(-len(sound.samples) // hop)
    # a constant part, of many sound cards, is no voice
    padded = np.pad(sound.samples - sound.samples.mean(), (size // 2, count * hop + size - len(sound.samples)))
    windows = np.lib.stride_tricks.sliding_window_view(padded, size)[::hop][:count]
    hertz = np.fft.rfftfreq(2 * size, 1 / sound.rate)
    parts = [_heard(windows[k : k + AT_ONCE] * np.hanning(size), hertz) for k in range(0, count, AT_ONCE)]
    return np.concatenate(parts)


def _heard(windows: Float[Array, "frames size"], hertz: Float[Array, "bins"]) -> Float[Array, "frames 7"]:
    power = np.abs(np.fft.rfft(windows, 2 * windows.shape[1])) ** 2 * ((hertz > 60) & (hertz < 9000))
    total = power.sum(1) + 1e-20
    high = power * (hertz > 2000)
    middle = high @ hertz / (high.sum(1) + 1e-20)
    shares = [power[:, hertz < 900].sum(1) / total, power[:, hertz > 3500].sum(1) / total]
    return np.column_stack([10 * np.log10(total / len(hertz)), *shares, middle, formants(power, hertz)])


def formants(power: Float[Array, "frames bins"], hertz: Float[Array, "bins"]) -> Float[Array, "frames 3"]:
    """The first three poles of the spectrum below BAND, hertz; NaN where there is none."""
    below = hertz <= BAND
    # a voice falls by 6 dB an octave: lifted, its formants stand out
    lifted = power[:, below] * hertz[below] ** 2 + 1e-9 * power.max() + 1e-30
    r = lifted @ np.cos(np.pi / BAND * hertz[below][:, None] * np.arange(ORDER + 1))
    r[:, 0] *= 1 + 1e-6
    lags = np.abs(np.subtract.outer(np.arange(ORDER), np.arange(ORDER)))
    coefficients = np.linalg.solve(r[:, lags], r[:, 1:, None])[..., 0]
    companion = np.zeros((len(power), ORDER, ORDER))
    companion[:, 0] = coefficients
    companion[:, np.arange(1, ORDER), np.arange(ORDER - 1)] = 1
    poles = np.linalg.eigvals(companion)
    frequency = np.angle(poles) * BAND / np.pi
    wide = -2 * np.log(np.abs(poles) + 1e-12) * BAND / np.pi
    good = (frequency > 180) & (frequency < BAND - 200) & (wide < 600)
    found = np.sort(np.where(good, frequency, np.inf), 1)[:, :3]
    return np.where(np.isfinite(found), found, np.nan)


def classified(heard: Float[Array, "frames 7"]) -> tuple[Float[Array, "frames 15"], Float[Array, "frames"]]:
    """Shares of the visemes, and how loud it is between the quiet and the loud parts, 0 to 1."""
    decibels, low, high, middle, f1, f2, f3 = heard.T
    loudest = np.percentile(decibels, 95)
    threshold = max(loudest - QUIET, min(np.percentile(decibels, 5) + FLOOR, loudest - 12.0))
    sounds = (decibels > threshold) & (loudest > -90)
    loud = np.clip((decibels - threshold) / max(loudest - threshold, 1.0), 0.0, 1.0)
    out = np.zeros((len(heard), len(VISEMES)))
    hiss = sounds & (high > 0.35)
    for name, chosen in {
        "SS": hiss & (middle >= 4800), "CH": hiss & (middle < 4800) & (loud > 0.35),
        "FF": hiss & (middle < 4800) & (loud <= 0.35),
    }.items():  # fmt: skip
        out[chosen, PLACE[name]] = 1
    voiced = sounds & ~hiss
    scale = _scale(f3[voiced])
    murmur = voiced & (low > 0.985) & (loud < 0.8) & (np.nan_to_num(f1, nan=250.0) < 400)
    out[murmur & (np.nan_to_num(f2, nan=1000.0) < 1300 * scale), PLACE["PP"]] = 1
    out[murmur & (np.nan_to_num(f2, nan=1000.0) >= 1300 * scale), PLACE["nn"]] = 1
    vowel = voiced & ~murmur
    rhotic = vowel & (f3 < 1950 * scale) & (f2 > 1000 * scale)
    out[rhotic, PLACE["RR"]] = 1
    vowel &= ~rhotic
    out[np.ix_(vowel, [PLACE[name] for name in VOWELS])] = _vowels(f1[vowel] / scale, f2[vowel] / scale)
    _stops(out, sounds, middle, high)
    out[out.sum(1) == 0, PLACE["sil"]] = 1
    return out, loud


def _scale(f3: Float[Array, "frames"]) -> float:
    """Formants of this voice against a man's; 1 where too little is heard."""
    f3 = f3[np.isfinite(f3)]
    return float(np.clip(np.median(f3) / F3, 0.9, 1.3)) if len(f3) > 10 else 1.0


def _vowels(f1: Float[Array, "frames"], f2: Float[Array, "frames"]) -> Float[Array, "frames 5"]:
    """Shares of VOWELS by how near they are."""
    places = np.log(np.array(list(VOWELS.values())))
    heard = np.log(np.stack([np.nan_to_num(f1, nan=550.0), np.nan_to_num(f2, nan=1500.0)], 1))
    distance = ((heard[:, None] - places) ** 2).sum(-1)
    near = np.exp(-(distance - distance.min(1, keepdims=True, initial=np.inf)) / (2 * NEAR**2))
    return near / near.sum(1, keepdims=True)


def _stops(
    visemes: Float[Array, "frames 15"], sounds: Bool[Array, "frames"], middle: Float[Array, "frames"],
    high: Float[Array, "frames"],
) -> None:  # fmt: skip
    """Fill short gaps between sounds with the stop that the burst at their end is of."""
    edges = np.flatnonzero(np.diff(sounds.astype(int)))
    for begin, end in zip(edges[:-1], edges[1:], strict=True):
        if not sounds[begin] or (end - begin) * STEP > LONGEST_GAP or end - begin < 3:
            continue
        burst = slice(end + 1, end + 3)
        name = "PP" if high[burst].mean() < 0.03 else "DD" if middle[burst].mean() > 3800 else "kk"
        visemes[begin + 1 : end + 1] = 0
        visemes[begin + 1 : end + 1, PLACE[name]] = 1
