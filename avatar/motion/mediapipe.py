"""MediaPipe's landmarks as a motion (avatar/motion/landmark_file.py has the files).

World landmarks move the body. Their y goes down and z away from the camera: a half turn about x makes our axes of it.
Where the person is comes from the landmarks in the picture, where the file has its size: sideways and up, never in
depth; else the lower foot stays on the ground. Gaps are filled, and noted. Scores of a face move the face; without a
body its matrix turns the head.
"""

from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from avatar.gaze import NECK_AND_HEAD, gaze_of, pose_of_head
from avatar.motion.clip import Clip, Motion, RestSkeleton, builtin_skeleton, checked_rate
from avatar.motion.landmark_file import WHAT, FilmFacts, Frame, is_mediapipe, read_landmarks
from avatar.motion.landmark_pose import BODY_POINTS, HAND_POINTS, PAIRS, Points, pose_from_points
from avatar.motion.smplh_rig import leg_length
from avatar.rotation import matrix_from_axis_angle
from avatar.skeleton import JOINT_NUMBERS as J
from command.errors import AssetError
from command.progress import plural
from files.input_file import read_json

ASSUMED_RATE = 30.0
# frames that a gap may have to be filled from both of its ends
LONGEST_GAP = 15
UNSEEN = 0.3  # median visibility below which a point is not used
# the least length of a limb that has a direction, in lengths of the trunk
SHORTEST = 1e-3
FLIP = np.array([1.0, -1, -1])


def is_mediapipe_file(path: Path) -> bool:
    """Whether a JSON file holds landmarks; AssetError where it is no JSON."""
    return is_mediapipe(read_json(path, f"a frame of EasyMocap, or {WHAT}"))


def read_mediapipe(path: Path | str, skeleton: RestSkeleton | None = None) -> Motion:
    """Open landmarks of MediaPipe.

    Raises:
        AssetError: no world landmarks, lists of other lengths than 33 or 21, numbers that are not finite, a body or a
            hand whose points fall together. File, frame and field are named.
    """
    path = Path(path)
    notes: list[str] = []
    frames, facts = read_landmarks(path, notes)
    skeleton = builtin_skeleton() if skeleton is None else skeleton
    ours = skeleton.joints.astype(np.float64)
    rate = checked_rate(f"{path}: fps", facts.fps) if facts.fps is not None else ASSUMED_RATE
    weights = _faces(frames, notes)
    if weights is None and not any(frame.pose_world is not None or frame.hands_world for frame in frames):
        raise AssetError(f"{path}: no world landmarks of a body or a hand; those in the picture are no motion")
    body, seen = _bodies(path, frames, notes)
    left, right = (_hand(path, frames, side, notes) for side in ("left", "right"))
    pose = pose_from_points(Points(body, left, right, seen), ours)
    if weights is not None and not np.isfinite(body).any():
        pose = _heads(frames, pose)
    root = _root(body, _hips(frames, facts), ours, pose, notes)
    if len(frames) > 1 and facts.fps is None:
        notes.append(f"no frame rate in the file: {ASSUMED_RATE:g} frames per second assumed")

    gaze = None if weights is None else gaze_of(weights)
    clip = Clip(pose, root, rate, tuple(dict.fromkeys(notes)), skeleton.pelvis_height, weights, gaze)
    return clip.motion(path.name)


def _faces(frames: list[Frame], notes: list[str]) -> Float[Array, "frames 52"] | None:
    """Weights of frames; those without a face are filled from those around them. None: there is no face."""
    have = [k for k, frame in enumerate(frames) if frame.shapes is not None]
    if not have:
        return None
    known, every = np.array([frames[k].shapes for k in have]), np.arange(len(frames))
    if len(have) < len(frames):
        notes.append(f"face: not found in {len(frames) - len(have)} of {plural(len(frames), 'frame')}, filled")
    return np.stack([np.interp(every, have, column) for column in known.T], 1)


def _heads(frames: list[Frame], pose: Float[Array, "frames 52 3"]) -> Float[Array, "frames 52 3"]:
    """The poses with the head turned as the faces' matrices say; where one lacks, as in the frame before."""
    out, head = pose.copy(), np.eye(3)
    for k, frame in enumerate(frames):
        head = head if frame.head is None else frame.head
        out[k, NECK_AND_HEAD] = pose_of_head(head)[NECK_AND_HEAD]
    return out


def _bodies(path: Path, frames: list[Frame], notes: list[str]) -> tuple[Float[Array, "frames 33 3"], Bool[Array, "33"]]:
    """Bodies in our axes, metres, and which points are seen.

    Frames without a body are filled between those with one; all are NaN where there is none at all.
    """
    count = len(frames)
    body = np.full((count, BODY_POINTS, 3), np.nan)
    visible: list[Array] = []
    for k, f in enumerate(frames):
        if f.pose_world is not None:
            body[k] = f.pose_world[:, :3] * FLIP
            visible.append(f.pose_world[:, 3])
            _check_body(path, k, body[k])
    seen = np.ones(BODY_POINTS, bool)
    if not visible:
        notes.append("body: not in the file, in T-pose")
        return body, seen
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
    missing = count - len(visible)
    if missing:
        notes.append(f"body: not found in {missing} of {plural(count, 'frame')}, filled from the frames around them")
    notes.append("body: 33 landmarks in metres; turns about bones follow the bends of knees and elbows")
    return _filled(body, len(body)), seen


def _hips(frames: list[Frame], facts: FilmFacts) -> Float[Array, "frames 3"]:
    """Hips (x, y) and leg length in the picture, in parts of its width; NaN where they or its size are not known."""
    hips = np.full((len(frames), 3), np.nan)
    if facts.width is not None and facts.height is not None:
        unit = FLIP * [1.0, facts.height / facts.width, 1.0]
        for k, f in enumerate(frames):
            if f.pose is not None:
                flat = f.pose[:, :3] * unit
                hips[k] = [*flat[list(PAIRS["hip"]), :2].mean(0), _leg(flat[None])[0]]
    return hips


def _check_body(path: Path, frame: int, body: Float[Array, "33 3"]) -> None:
    """Refuse a body whose points fall together."""
    at = {name: body[list(pair)] for name, pair in PAIRS.items()}
    ways = {"hips and shoulders": at["shoulder"].mean(0) - at["hip"].mean(0)}
    ways |= {f"both {name}s": at[name][1] - at[name][0] for name in ("hip", "shoulder")}
    for a, b in (("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"), ("elbow", "wrist"), ("heel", "toe")):
        ways |= {f"{side} {a} and {b}": at[b][n] - at[a][n] for n, side in enumerate(("left", "right"))}
    shortest = SHORTEST * max(float(np.linalg.norm(ways["hips and shoulders"])), 1e-6)
    for name, way in ways.items():
        if not np.linalg.norm(way) > shortest:
            raise AssetError(f"{path}: frame {frame}: {name} are at one place")


def _hand(path: Path, frames: list[Frame], side: str, notes: list[str]) -> Float[Array, "frames 21 3"]:
    """One hand in our axes; short gaps are filled, elsewhere NaN."""
    hand = np.full((len(frames), HAND_POINTS, 3), np.nan)
    for k, f in enumerate(frames):
        if side in f.hands_world:
            hand[k] = f.hands_world[side][:, :3] * FLIP
            along, across = hand[k, 9] - hand[k, 0], hand[k, 5] - hand[k, 17]
            area = np.linalg.norm(np.cross(along, across))
            if not area > 1e-3 * max(np.linalg.norm(along), np.linalg.norm(across), 1e-9) ** 2:
                raise AssetError(f"{path}: frame {k}: the {side} hand's palm has no area")
    hand = _filled(hand, LONGEST_GAP)
    missing = int((~np.isfinite(hand[:, 0, 0])).sum())
    if missing == len(frames):
        notes.append(f"hands: no {side} hand in the file, flat")
    elif missing:
        notes.append(f"hands: no {side} hand in {missing} of {plural(len(frames), 'frame')}, flat there")
    return hand


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
    chain = body[:, [PAIRS[name] for name in ("hip", "knee", "ankle")]]
    return np.linalg.norm(np.diff(chain, axis=1), axis=-1).sum((1, 2)) / 2


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
