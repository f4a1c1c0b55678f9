"""Can these videos become a person? What is found is said so that it can be acted on: what, when, what to do."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import product

import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray as Array
from scipy import ndimage

from avatar.motion.clip import spread_frames
from capture.keypoints.record import SIDES, hand_points
from capture.raw.glance import SURE, Glance

# share of the frames with a person from which a problem is named, and from which the video is refused
SOME, MOST = 0.05, 0.35
# share of the picture's shorter side: a point nearer to the border is cut off
BORDER = 0.012
# times that much is near it
NEAR = 6.0
# pixels of 1080 that the camera may move
STILL = 3.0
# a jump of the camera is looked for in pictures four times smaller: over so many pixels, from so many at least
REACH, FEWEST_PIXELS = 8, 60
# seconds that the empty beginning or end has at least, and that are left out beside the person
EMPTY, BESIDE = 0.3, 0.35
# grey levels between frames of an empty room: noise of the sensor and of the encoder, averaged
SAME = 6.0
# grey levels beside the person, the median after exposure, from which it is another room; what is darker is none
OTHER = 20.0
# frames that the camera's stand is looked at in
STANDS = 24
# share of a video's usual sharpness: a frame below is blurred
BLURRED = 0.55
# sharp frames of a whole person, with which the fit begins
FEWEST_CLEAR = 6
# share of the points that lie where the picture changed: with fewer they belong to another video
ON_PERSON = 0.5
LIMBS = {
    "body": ("nose", "left_wrist", "right_wrist", "left_ankle", "right_ankle", "left_heel", "right_heel"),
    "head": ("nose", "left_eye", "right_eye", "left_ear", "right_ear"),
    "hand_left": hand_points("left"),
    "hand_right": hand_points("right"),
}  # fmt: skip
OTHER_HAND = "is it the other hand's, or mirrored, as by a front camera? exchange LEFT and RIGHT, or mirror it"
CALLED = {"body": "the body", "head": "the head", "hand_left": "the left hand", "hand_right": "the right hand"}


@dataclass(frozen=True)
class Finding:
    """Something to act on, of one video or part of a capture."""

    part: str
    fatal: bool
    what: str
    advice: str

    def line(self, name: str) -> str:
        """The finding as a sentence about a file."""
        return f"{name}: {self.what}; {self.advice}"


@dataclass(frozen=True)
class Verdict:
    """The findings, worst first, and what follows."""

    findings: tuple[Finding, ...]

    @property
    def usable(self) -> bool:
        return not any(finding.fatal for finding in self.findings)

    def line(self) -> str:
        """The verdict in one line."""
        if not self.findings:
            return "usable"
        reasons = [f for f in self.findings if f.fatal] or list(self.findings)
        said = "; ".join(f"{f.part}: {f.what}" for f in reasons[:3])
        more = f"; and {len(reasons) - 3} more" if len(reasons) > 3 else ""
        return ("usable, but " if self.usable else "not usable because ") + said + more

    def lines(self) -> list[str]:
        """The verdict in one line, then what to do about each finding."""
        return [self.line(), *(f"  {f.part}: {f.what}: {f.advice}" for f in self.findings)]


def verdict_of(findings: Iterable[Finding]) -> Verdict:
    """The verdict that findings give."""
    return Verdict(tuple(sorted(findings, key=lambda finding: not finding.fatal)))


@dataclass(frozen=True)
class Judged:
    """One video, judged."""

    glance: Glance
    # frames of the empty room; empty where there is none
    empty: Bool[Array, "frames"]
    # frames that can be fitted: one person is there, whole and sharp
    usable: Bool[Array, "frames"]
    problems: tuple[Finding, ...]

    def line(self) -> str:
        """The video in one line."""
        facts, video = self.facts(), self.glance.video
        width, height = video.size
        return (
            f"{video.name:<10} {width} x {height}, {video.rate:.0f} frames/s, {facts['seconds']:.1f} s; "
            f"empty room {facts['empty'] / video.rate:.1f} s; the person in {facts['with_person']} frames, "
            f"{facts['usable']} can be used"
        )

    def facts(self) -> dict:
        """For check.json."""
        video = self.glance.video
        return {
            "file": str(video.path), "size": list(video.size), "rate": round(video.rate, 3),
            "frames": len(self.glance.times), "seconds": round(float(self.glance.times[-1]), 2),
            "with_person": int(self.glance.found.sum()), "empty": int(self.empty.sum()),
            "usable": int(self.usable.sum()),
            "problems": [vars(problem) for problem in self.problems],
        }  # fmt: skip


def judge(at: Glance) -> Judged:
    """Everything that can be said of one video before it is fitted."""
    problems: list[Finding] = []

    def add(fatal: bool, what: str, advice: str) -> None:
        problems.append(Finding(at.part, fatal, what, advice))

    part, found = at.part, at.found
    empty = empty_frames(at)
    own = at.keypoints.confidence[:, _columns(at, LIMBS[at.part])] > SURE
    clear = found & (own.sum(1) >= 3)
    # from behind a head shows no face, but its outline
    whole = found if part == "head" else clear
    if not found.any():
        add(True, "no person is found in any frame", "are these keypoints of this video?")
        return Judged(at, empty, found, tuple(problems))
    turn = _turn(at)
    if turn is not None:
        # all else that could be said of it follows from that
        add(True, turn, "turn the video upright and detect keypoints again")
        return Judged(at, empty, found, tuple(problems))
    if clear.sum() < 0.2 * found.sum() or clear.sum() < FEWEST_CLEAR:
        advice = "film again with it in the middle"
        if part.startswith("hand"):
            other = at.keypoints.confidence[:, _columns(at, hand_points(SIDES[part.endswith("left")]))] > SURE
            if (other.sum(1) >= 3).sum() > 2 * clear.sum() + 8:
                advice = OTHER_HAND
        add(True, f"{CALLED[part]} is confidently found in {int(clear.sum())} of {int(found.sum())} frames", advice)
    others = at.keypoints.others
    several = np.zeros(len(at.times), bool) if others is None else others > 0.3
    if several.mean() > MOST:
        add(True, f"two people are in view {_when(at, several)}", "film one person alone")
    elif several.any() and several.mean() > SOME:
        add(False, f"another person seems to be in view {_when(at, several)}", "those frames are left out")
    cut = _cut_off(at, own)
    share = float(cut[int(whole.argmax()) :].mean())
    if share > SOME:
        what = f"{CALLED[part]} leaves the picture at the {_side_of_cut(at, cut)} {_when(at, cut)}"
        add(share > MOST, what, "film again with it in the middle and more room round it")
    moved = camera_moves(at, empty)
    limit = STILL * min(at.video.size) / 1080
    if moved is not None and moved.max() > limit:
        first = float(at.times[spread_frames(len(at.times), STANDS)[int(np.argmax(moved > limit))]])
        add(True, f"the camera moves, by {moved.max():.0f} pixels from {first:.1f} s on", "put the phone on a tripod")
    elif (other := other_room(at, empty)) is not None:
        what = "the empty room" if empty.any() else "the first frame"
        said = f"from {other:.1f} s on another room is seen than in {what}"
        # a close-up may be filled by the person's trunk, of which no point was found
        add(part == "body", said, "give a film without cuts or titles")
    if not empty.any():
        advice = "masks without it are rough: film a second of it before you step in, or bring masks of another tool"
        add(False, "the empty room is in no frame", advice)
    else:
        on = _on_changed(at, empty)
        if on is not None and on < ON_PERSON:
            what = f"only {on:.0%} of the keypoints lie where the picture differs from the empty room"
            add(True, what, "are these keypoints of this video, frame by frame?")
    blurred = whole & (at.sharpness < BLURRED * np.median(at.sharpness[whole])) if whole.any() else whole
    if blurred.sum() > 0.3 * whole.sum():
        add(False, f"{blurred.sum() / whole.sum():.0%} of the frames are blurred", "turn slower, or with more light")
    return Judged(at, empty, whole & ~several & ~cut & ~blurred, tuple(problems))


def empty_frames(at: Glance) -> Bool[Array, "frames"]:
    """The longest still run of frames without anybody, at the beginning or the end; none where it is too short."""
    seen = np.asarray((at.keypoints.confidence > SURE / 2).any(1))
    out = np.zeros(len(seen), bool)
    if not seen.any():
        return out
    first, last = int(seen.argmax()), len(seen) - 1 - int(seen[::-1].argmax())
    beside = round(BESIDE * at.video.rate)
    begin, end = slice(0, max(0, first - beside)), slice(min(len(seen), last + 1 + beside), len(seen))
    run = begin if begin.stop >= end.stop - end.start else end
    if run.stop - run.start < EMPTY * at.video.rate:
        return out
    frames = at.small[run].astype(np.float32)
    # a person whom the detector does not see yet changes a part of the picture
    room = np.median(frames[:: max(1, len(frames) // 15)], axis=0)
    # a title, or a lens that is covered
    if room.max() < OTHER:
        return out
    changed = np.abs(frames - room)
    changed -= np.median(changed, axis=(1, 2), keepdims=True)
    still = (changed > SAME).mean((1, 2)) < 0.004
    out[run] = still
    return out if still.sum() >= EMPTY * at.video.rate else np.zeros(len(seen), bool)


def camera_moves(at: Glance, empty: Bool[Array, "frames"]) -> Float[Array, "stands"] | None:
    """How far the room has shifted at some frames through the video, pixels; None: it shows too little.

    Least squares on brightness (Lucas and Kanade 1981), away from the person, with a gain for the exposure; they follow
    a few pixels, further jumps are looked for.
    """
    room = _room(at, empty)
    gx, gy = (ndimage.sobel(ndimage.gaussian_filter(room, 1.0), axis) / 8 for axis in (1, 0))
    shifts = np.zeros((STANDS, 2))
    for n, (i, free) in enumerate(_stands(at, empty)):
        if free.sum() < 800:
            continue
        a = np.stack([gx[free], gy[free], room[free], np.ones(int(free.sum()))], 1)
        # along a direction without detail no shift is seen
        if np.linalg.eigvalsh(a[:, :2].T @ a[:, :2] / len(a)).min() < 0.3:
            continue
        shifts[n] = _jump(room, at.small[i], free)
        if shifts[n].any():
            continue
        b = ndimage.gaussian_filter(at.small[i].astype(np.float32), 0.5)[free]
        weight = np.ones(len(a))
        solution = np.zeros(4)
        for _ in range(4):
            solution = np.linalg.lstsq(a * weight[:, None], b * weight, rcond=None)[0]
            off = np.abs(b - a @ solution)
            weight = 1 / (1 + (off / (2 * np.median(off) + 1e-3)) ** 2)
        shifts[n] = solution[:2]
    if not shifts.any():
        return None
    return np.linalg.norm(shifts, axis=1) * at.scale


def other_room(at: Glance, empty: Bool[Array, "frames"]) -> float | None:
    """The second of the first frame most of which, beside the person, is not the room; None: all show it."""
    room = _room(at, empty)
    for i, free in _stands(at, empty):
        off = at.small[i][free] - room[free]
        if len(off) and np.median(np.abs(off - np.median(off))) > OTHER:
            return float(at.times[i])
    return None


def _room(at: Glance, empty: Bool[Array, "frames"]) -> Float[Array, "height width"]:
    """The room, small: empty, else as in the first frame."""
    return np.median(at.small[empty][:15] if empty.any() else at.small[:1], axis=0).astype(np.float32)


def _stands(at: Glance, empty: Bool[Array, "frames"]) -> Iterator[tuple[int, Bool[Array, "height width"]]]:
    """Some frames through the video, and the pixels beside the person in them and in the room."""
    boxes = at.boxes / at.scale
    for i in spread_frames(len(at.times), STANDS):
        free = np.zeros(at.small.shape[1:], bool)
        free[2:-2, 2:-2] = True
        for box in (boxes[i], *([] if empty.any() else boxes[:1])):
            if np.isfinite(box).all():
                reach = 0.15 * float(max(box[2] - box[0], box[3] - box[1])) + 4
                left, top, right, bottom = np.clip([*(box[:2] - reach), *(box[2:] + reach)], 0, None).astype(int)
                free[top:bottom, left:right] = False
        yield int(i), free


def _jump(
    room: Float[Array, "height width"], picture: UInt8[Array, "height width"], free: Bool[Array, "height width"]
) -> Float[Array, "2"]:
    """The shift of a picture from the room, right and down, that leaves less than half of their difference where it is
    `free`; 0: none does."""
    height, width = (side // 4 for side in room.shape)
    a, b, seen = (
        values[: 4 * height, : 4 * width].reshape(height, 4, width, 4).mean((1, 3)) for values in (room, picture, free)
    )
    a = np.pad(a, REACH, constant_values=np.nan)
    left: dict[tuple[int, int], float] = {}
    for down, right in product(range(-REACH, REACH + 1), repeat=2):
        there = a[REACH - down :][:height, REACH - right :][:, :width]
        off = (b - there)[(seen == 1) & np.isfinite(there)]
        if len(off) >= FEWEST_PIXELS:
            left[right, down] = float(np.abs(off - np.median(off)).mean())
    best = min(left, key=lambda shift: left[shift], default=(0, 0))
    return 4.0 * np.array(best) * (left.get(best, 0.0) < 0.5 * left.get((0, 0), 0.0))


def _columns(at: Glance, wanted: tuple[str, ...]) -> list[int]:
    """Where those of the wanted points stand that the detector has."""
    return [at.keypoints.names.index(name) for name in wanted if name in at.keypoints.names]


def _turn(at: Glance) -> str | None:
    """How a film of body or head is turned, by where the head is from hips or shoulders; None: upright, or unknown."""
    if at.part not in ("body", "head"):
        return None

    def place(*names: str) -> Array | None:
        seen = np.concatenate([at.keypoints.seen(name) for name in names])
        sure = seen[seen[:, 2] > SURE]
        return np.median(sure[:, :2], axis=0) if len(sure) else None

    above = place("nose", "left_ear", "right_ear")
    below = place(*(f"{side}_{'hip' if at.part == 'body' else 'shoulder'}" for side in SIDES))
    if above is None or below is None:
        return None
    across, down = above - below
    if abs(across) > abs(down):
        return f"the film lies on its side, with the head to the {'right' if across > 0 else 'left'}"
    return "the person stands on the head" if down > 0 else None


def _cut_off(at: Glance, own: Bool[Array, "frames points"]) -> Bool[Array, "frames"]:
    """Frames in which a sure point of the part lies at the picture's border or beyond it, or where most points are lost
    after they came near it."""
    columns = _columns(at, LIMBS[at.part])
    pixels, sure = at.keypoints.pixels[:, columns], at.keypoints.confidence[:, columns] > SURE
    room = BORDER * min(at.video.size)
    with np.errstate(invalid="ignore"):
        out = (pixels < room).any(-1) | (pixels > np.array(at.video.size) - room).any(-1)
        near = (pixels < NEAR * room).any(-1) | (pixels > np.array(at.video.size) - NEAR * room).any(-1)
    at_border, close = np.asarray((out & sure).any(1)), np.asarray((near & sure).any(1))
    count = own.sum(1)
    lost = count < 0.34 * np.median(count[count >= 3]) if (count >= 3).any() else np.zeros(len(count), bool)
    # for every frame the last one in which the part was found
    last = np.maximum.accumulate(np.where(lost, -1, np.arange(len(count))))
    return at_border | (lost & (last >= 0) & close[last])


def _side_of_cut(at: Glance, frames: Bool[Array, "frames"]) -> str:
    """Where the person is nearest to the border in these frames."""
    columns = _columns(at, LIMBS[at.part])
    # a little longer: where nothing is found any more, the frames before decide
    rows = np.asarray(ndimage.binary_dilation(frames, iterations=6), bool)
    sure = at.keypoints.confidence[rows][:, columns] > SURE
    x, y = at.keypoints.pixels[rows][:, columns][sure].T
    width, height = at.video.size
    room = {"left": x, "top": y, "right": width - x, "bottom": height - y}
    return min(room, key=lambda side: float(np.quantile(room[side], 0.02)))


def _on_changed(at: Glance, empty: Bool[Array, "frames"]) -> float | None:
    """The share of sure points that lie where the picture differs from the empty room."""
    frames = at.small[empty].astype(np.float32)
    room, noise = np.median(frames, axis=0), frames.std(0).mean() + 1
    hits, points = 0, 0
    rows = np.flatnonzero(at.found)
    for i in rows[spread_frames(len(rows), 40)]:
        changed = np.abs(at.small[i] - room)
        changed = np.asarray(ndimage.binary_dilation(changed - np.median(changed) > 3 * noise, iterations=2), bool)
        x, y = (at.keypoints.pixels[i][at.keypoints.confidence[i] > SURE] / at.scale).T
        height, width = at.small.shape[1:]
        inside = (x >= 0) & (y >= 0) & (x < width) & (y < height)
        hits += int(changed[y[inside].astype(int), x[inside].astype(int)].sum())
        points += int(inside.sum())
    return hits / points if points else None


def _when(at: Glance, frames: Bool[Array, "frames"]) -> str:
    """The longest stretch of such frames, in words; gaps of a fifth of a second count as part of it."""
    joined = ndimage.binary_closing(frames, iterations=max(1, round(0.1 * at.video.rate))) | frames
    # where stretches begin and end
    edges = np.flatnonzero(np.diff(np.concatenate([[0], joined.astype(int), [0]])))
    longest = int(np.argmax(edges[1::2] - edges[::2]))
    rows = np.arange(edges[2 * longest], edges[2 * longest + 1])
    begin, end = at.times[rows[0]], at.times[rows[-1]]
    if rows[-1] >= len(at.times) - 3:
        return f"from {begin:.1f} s on"
    return f"from {begin:.1f} to {end:.1f} s" if end - begin > 0.15 else f"at {begin:.1f} s"


def refusal(judged: Mapping[str, Judged]) -> str | None:
    """The first reason, as one line, why videos cannot be fitted; None: they can."""
    fatal = [(at, problem) for at in judged.values() for problem in at.problems if problem.fatal]
    return fatal[0][1].line(str(fatal[0][0].glance.video.path)) if fatal else None
