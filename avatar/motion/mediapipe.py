"""MediaPipe's landmarks as a motion (avatar/motion/landmark_file.py has the files).

In the picture y goes down and z away from the camera: a half turn about x makes our axes of it. Points in parts of the
picture are stretched by its size, or, where that is not known, by the one of the usual shapes in which the limbs keep a
body's proportions best. Where the person is comes from the picture, as far as it shows: sideways and up, never in
depth; without pictures' points the lower foot stays on the ground. Gaps are filled, and noted.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from avatar.motion.clip import Motion, RestSkeleton, builtin_skeleton, checked_rate
from avatar.motion.landmark_file import WHAT, FilmFacts, Frame, is_mediapipe, read_landmarks
from avatar.motion.landmark_pose import BODY_POINTS, HAND_POINTS, PAIRS, Points, pose_from_points
from avatar.motion.smplh_rig import leg_length
from avatar.rotation import matrix_from_axis_angle
from avatar.skeleton import JOINT_NUMBERS as J
from command.errors import AssetError
from command.progress import plural
from files.input_file import read_json

ASSUMED_RATE = 30.0
# width over height that pictures have
SHAPES = (9 / 16, 2 / 3, 3 / 4, 4 / 5, 1.0, 5 / 4, 4 / 3, 3 / 2, 16 / 9)
# what depths may have to be multiplied by, and the part of the misfit that must be left for it
DEPTHS = (1.0, 0.85, 0.7, 0.55, 0.4)
DEPTH_GAIN = 0.9
# frames that a gap may have to be filled from both of its ends
LONGEST_GAP = 15
UNSEEN = 0.3  # median visibility below which a point is not used
PIXELS = 5.0  # parts of a picture are never so large
# the least length of a limb that has a direction, in lengths of the trunk
SHORTEST = 1e-3
FLIP = np.array([1.0, -1, -1])


def is_mediapipe_file(path: Path) -> bool:
    """Whether a JSON file holds landmarks; AssetError where it is no JSON."""
    return is_mediapipe(read_json(path, f"a frame of EasyMocap, or {WHAT}"))


def read_mediapipe(path: Path | str, skeleton: RestSkeleton | None = None) -> Motion:
    """Open landmarks of MediaPipe.

    Raises:
        AssetError: no landmarks, lists of other lengths than 33 or 21, numbers that are not finite, a body or a hand
            whose points fall together. File, frame and field are named.
    """
    path = Path(path)
    notes: list[str] = []
    frames, facts = read_landmarks(path, notes)
    skeleton = builtin_skeleton() if skeleton is None else skeleton
    ours = skeleton.joints.astype(np.float64)
    rate = checked_rate(f"{path}: fps", facts.fps) if facts.fps is not None else ASSUMED_RATE
    picture = _picture(frames, facts, ours, notes)
    body, seen, hips = _bodies(path, frames, picture, notes)
    left, right = _hand_points(path, frames, picture, notes)
    points = Points(body, left, right, seen)
    pose = pose_from_points(points, ours)
    root = _root(body, hips, ours, pose, notes)
    if len(frames) > 1 and facts.fps is None:
        notes.append(f"no frame rate in the file: {ASSUMED_RATE:g} frames per second assumed")

    def block(start: int, stop: int) -> tuple[Array, Array]:
        return pose[start:stop], root[start:stop]

    return Motion(path.name, len(frames), rate, tuple(dict.fromkeys(notes)), block, skeleton.pelvis_height)


class Picture(NamedTuple):
    """What parts of a picture are in one unit: its width over its height, and what depths are multiplied by."""

    aspect: float
    depth: float


def _picture(frames: list[Frame], facts: FilmFacts, ours: Array, notes: list[str]) -> Picture:
    """The shape of the picture and the scale of depth, from the file or as a body's proportions have it."""
    poses = [f.pose[:, :3] for f in frames if f.pose is not None]
    flat = [points for f in frames for points in f.hands.values()]
    if not poses and not flat:
        return Picture(1.0, 1.0)
    shapes, known = SHAPES, False
    if any(np.abs(points[:, :2]).max() > PIXELS for points in [*poses, *(points[:, :3] for points in flat)]):
        notes.append("landmarks: in pixels, z taken as pixels too")
        shapes, known = (1.0,), True
    elif facts.width is not None and facts.height is not None:
        shapes, known = (facts.width / facts.height,), True
    if not poses:
        if not known:
            notes.append("picture: its size is not known, taken as square")
        return Picture(shapes[0] if known else 1.0, 1.0)
    sample = np.stack(poses[:: max(1, len(poses) // 100)])
    off = {(a, z): _off_proportions(sample, Picture(a, z), ours) for a in shapes for z in DEPTHS}
    best = min(off, key=lambda pair: off[pair])
    plain = min(((a, 1.0) for a in shapes), key=lambda pair: off[pair])
    # depth is a guess of the detector's; it is only corrected where that matters
    chosen = Picture(*(best if off[best] < DEPTH_GAIN * off[plain] else plain))
    if not known:
        notes.append(f"picture: size not known, width / height {chosen.aspect:.2f} fits a body's proportions best")
    if chosen.depth != 1:
        notes.append(f"depth: multiplied by {chosen.depth:g}, which fits a body's proportions best")
    return chosen


def _off_proportions(P: Float[Array, "frames 33 3"], picture: Picture, ours: Array) -> float:
    """How far lengths are from a body's proportions: spread of the logarithms of their ratios to ours."""
    at = _upright(P, picture)
    ratios = []
    for a, b in (("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"), ("elbow", "wrist")):
        for n, side in enumerate(("left", "right")):
            found = np.median(np.linalg.norm(at[:, PAIRS[b][n]] - at[:, PAIRS[a][n]], axis=-1))
            ratios.append(found / np.linalg.norm(ours[J[f"{side}_{b}"]] - ours[J[f"{side}_{a}"]]))
    trunk = at[:, list(PAIRS["shoulder"])].mean(1) - at[:, list(PAIRS["hip"])].mean(1)
    shoulders = (ours[J["left_shoulder"]] + ours[J["right_shoulder"]] - ours[J["left_hip"]] - ours[J["right_hip"]]) / 2
    ratios.append(np.median(np.linalg.norm(trunk, axis=-1)) / np.linalg.norm(shoulders))
    across = np.median(np.linalg.norm(at[:, 11] - at[:, 12], axis=-1))
    ratios.append(across / np.linalg.norm(ours[J["left_shoulder"]] - ours[J["right_shoulder"]]))
    return float(np.std(np.log(np.maximum(ratios, 1e-9))))


def _upright(points: Array, picture: Picture | None = None) -> Array:
    """Points in our axes: metres as they are, or parts of a picture in parts of its width."""
    scale = np.ones(3) if picture is None else np.array([1.0, 1 / picture.aspect, picture.depth])
    return points[..., :3] * FLIP * scale


def _bodies(
    path: Path, frames: list[Frame], picture: Picture, notes: list[str]
) -> tuple[Float[Array, "frames 33 3"], Bool[Array, "33"], Float[Array, "frames 3"]]:
    """Bodies in our axes, which points are seen, and hips (x, y) and leg length in the picture.

    Frames without a body are filled between those with one; all are NaN where there is none at all.
    """
    count = len(frames)
    metric = any(f.pose_world is not None for f in frames)
    body, hips = np.full((count, BODY_POINTS, 3), np.nan), np.full((count, 3), np.nan)
    visible: list[Array] = []
    for k, f in enumerate(frames):
        source = f.pose_world if metric else f.pose
        if source is not None:
            body[k] = _upright(source, None if metric else picture)
            visible.append(source[:, 3])
            _check_body(path, k, body[k])
        if f.pose is not None:
            flat = _upright(f.pose, picture)
            hips[k] = [*flat[list(PAIRS["hip"]), :2].mean(0), _leg(flat[None])[0]]
    seen = np.ones(BODY_POINTS, bool)
    have = np.isfinite(body[:, 0, 0])
    if not have.any():
        notes.append("body: not in the file, in T-pose")
        return body, seen, hips
    known = [v for v in visible if np.isfinite(v).all()]
    if known:
        values = np.stack(known)
        if values.min() < 0 or values.max() > 1:
            # MediaPipe's own files have them before the logistic function
            values = 1 / (1 + np.exp(-np.clip(values, -50, 50)))
        seen = np.median(values, 0) >= UNSEEN
        hidden = [name for name, pair in PAIRS.items() if not seen[list(pair)].all()]
        if hidden:
            notes.append(f"body: hardly ever visible, so left as in T-pose: {', '.join(hidden)}")
    missing = int((~have).sum())
    if missing:
        notes.append(f"body: not found in {missing} of {plural(count, 'frame')}, filled from the frames around them")
    body = _filled(body, len(body))
    kind = "metres (pose_world_landmarks)" if metric else "parts of the picture, whose depth is a guess"
    notes.append(f"body: 33 landmarks in {kind}; turns about bones follow the bends of knees and elbows")
    return body, seen, hips


def _check_body(path: Path, frame: int, body: Float[Array, "33 3"]) -> None:
    """Refuse a body whose points fall together."""
    middle = {name: body[list(pair)].mean(0) for name, pair in PAIRS.items()}
    trunk = np.linalg.norm(middle["shoulder"] - middle["hip"])
    lengths = {"hips and shoulders": trunk}
    lengths |= {
        f"both {name}s": np.linalg.norm(body[PAIRS[name][0]] - body[PAIRS[name][1]]) for name in ("hip", "shoulder")
    }
    for a, b in (("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"), ("elbow", "wrist"), ("heel", "toe")):
        for n, side in enumerate(("left", "right")):
            lengths[f"{side} {a} and {b}"] = np.linalg.norm(body[PAIRS[b][n]] - body[PAIRS[a][n]])
    for name, length in lengths.items():
        if not length > SHORTEST * max(trunk, 1e-6):
            raise AssetError(f"{path}: frame {frame}: {name} are at one place")


def _hand_points(
    path: Path, frames: list[Frame], picture: Picture, notes: list[str]
) -> tuple[Float[Array, "frames 21 3"], Float[Array, "frames 21 3"]]:
    """Left and right hand in our axes; short gaps are filled, elsewhere NaN."""
    out = []
    for side in ("left", "right"):
        hand = np.full((len(frames), HAND_POINTS, 3), np.nan)
        for k, f in enumerate(frames):
            if side in f.hands_world:
                hand[k] = _upright(f.hands_world[side])
            elif side in f.hands:
                hand[k] = _upright(f.hands[side], picture._replace(depth=1.0))
            else:
                continue
            _check_hand(path, k, side, hand[k])
        found = np.isfinite(hand[:, 0, 0])
        hand = _filled(hand, LONGEST_GAP)
        missing = int((~np.isfinite(hand[:, 0, 0])).sum())
        if not found.any():
            notes.append(f"hands: no {side} hand in the file, flat")
        elif missing:
            notes.append(f"hands: no {side} hand in {missing} of {plural(len(frames), 'frame')}, flat there")
        out.append(hand)
    return out[0], out[1]


def _check_hand(path: Path, frame: int, side: str, hand: Float[Array, "21 3"]) -> None:
    """Refuse a hand without a palm."""
    along, across = hand[9] - hand[0], hand[5] - hand[17]
    area = np.linalg.norm(np.cross(along, across))
    if not area > 1e-3 * max(np.linalg.norm(along), np.linalg.norm(across), 1e-9) ** 2:
        raise AssetError(f"{path}: frame {frame}: the {side} hand's palm has no area")


def _filled(points: Float[Array, "frames n 3"], longest: int) -> Float[Array, "frames n 3"]:
    """Frames without points, between the nearest with them; before the first and after the last those hold."""
    have = np.flatnonzero(np.isfinite(points[:, 0, 0]))
    if len(have) in (0, len(points)):
        return points
    every = np.arange(len(points))
    after = np.minimum(np.searchsorted(have, every), len(have) - 1)
    before = np.maximum(after - (have[after] > every), 0)
    a, b = have[before], have[after]
    part = np.where(b > a, (every - a) / np.maximum(b - a, 1), 0.0)
    out = points[a] + part[:, None, None] * (points[b] - points[a])
    gap = np.where(b > a, b - a - 1, np.abs(every - a))
    out[gap > longest] = np.nan
    return out


def _leg(body: Float[Array, "frames 33 3"]) -> Float[Array, "frames"]:
    """Length of thigh and shin, mean of both sides."""
    total = np.zeros(len(body))
    for a, b in (("hip", "knee"), ("knee", "ankle")):
        for n in range(2):
            total += np.linalg.norm(body[:, PAIRS[b][n]] - body[:, PAIRS[a][n]], axis=-1) / 2
    return total


def _root(
    body: Float[Array, "frames 33 3"], seen_hips: Float[Array, "frames 3"], ours: Array, pose: Array, notes: list[str]
) -> Float[Array, "frames 3"]:
    """The pelvis joint in our world, its first frame over the origin."""
    root = np.zeros((len(body), 3))
    if not np.isfinite(body).any():
        return root
    leg = leg_length(ours, J)
    hips = (ours[J["left_hip"]] + ours[J["right_hip"]]) / 2
    if np.isfinite(seen_hips).all(1).any():
        places = _filled(seen_hips[:, None], len(seen_hips))[:, 0]
        # one scale for all frames: a person who bends the knees in depth does not shrink
        scale = leg / float(np.percentile(places[:, 2], 90))
        root[:, :2] = scale * places[:, :2]
        notes.append("root: from the hips in the picture, sideways and up; depth is not seen")
    else:
        scale = leg / float(np.median(_leg(body)))
        middle = body[:, list(PAIRS["hip"])].mean(1)
        feet = body[:, [*PAIRS["heel"], *PAIRS["toe"], *PAIRS["ankle"]], 1].min(1)
        root[:, 1] = scale * (middle[:, 1] - feet)
        notes.append("root: the hips stay over one place, the lower foot on the ground (world landmarks have no place)")
    root = root - (matrix_from_axis_angle(pose[:, 0]) @ hips)
    return root - [root[0, 0], 0.0, root[0, 2]]
