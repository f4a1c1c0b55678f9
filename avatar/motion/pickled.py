"""Pose sequences in pickles (.pkl): SMPL+H and MoSh files, 3DPW, and fits saved with SMPL's parameter names.

    pose      poses | pose | fullpose | pose_est_fullposes, or root and body apart:
              global_orient | root_orient, body_pose | pose_body, and hands where there are any
    place     trans | transl | pose_est_trans        (absent: the pelvis stays in place)
    shape     betas | shape_est_betas                rate: mocap_framerate | mocap_frame_rate | fps | ...

A file of several people (3DPW: a list for each key) gives the first. The pickle is never run
(files/unpickle.py). It is read whole: a sequence longer than memory belongs into an .npz.
"""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from avatar.body import Body
from avatar.motion.clip import Motion, checked_rate
from avatar.motion.pose_vector import (
    FULL_HANDS,
    LARGEST_BETA,
    NEEDS_MODEL,
    REFUSED_COLUMNS,
    TURNS,
    PoseLayout,
    check_numbers,
    expanded,
    given_pelvis,
    pose_layout,
    readable,
    up_axis,
    usual_pelvis,
)
from avatar.rotation import matrix_from_quaternion, turned
from command.errors import AssetError
from files.unpickle import Value, read_pickle

Array = np.ndarray

WHOLE = ("poses", "pose", "fullpose", "pose_est_fullposes")
ROOT = ("global_orient", "root_orient", "poses_root")
BODY = ("body_pose", "pose_body", "poses_body")
LEFT, RIGHT = ("left_hand_pose", "lhand_pose"), ("right_hand_pose", "rhand_pose")
BOTH = ("pose_hand", "hand_pose", "poses_hand")
PLACE = ("trans", "transl", "pose_est_trans")
SHAPE = ("betas", "shape_est_betas", "beta")
RATE = ("mocap_framerate", "mocap_frame_rate", "mosh_framerate", "framerate", "frame_rate", "fps")
# the most numbers in a field of lists: 300 MB as Python holds them
MAX_NUMBERS = 10_000_000
# looked at for the up axis
SAMPLED_FRAMES = 200


def read_pickled_motion(path: Path | str, *, body: Body | None = None) -> Motion:
    """Open a pickled pose sequence; `body` is the model it was made for.

    Raises:
        AssetError: damaged, or naming anything but data; no poses; a length that could mean several things;
            frames that disagree; a rate that is not positive. A number that is not finite is found when read.
    """
    path = Path(path)
    fields = _person(path, read_pickle(path, "a pose sequence"))
    notes: list[str] = []
    people = next((len(v) for k, v in fields.items() if k in WHOLE and type(v) is list and _arrays(v)), 0)
    if people:
        if people > 1:
            notes.append(f"people: {people} in the file, the first is read")
        fields = {k: v[0] if type(v) is list and len(v) == people else v for k, v in fields.items()}

    name, rows, layout = _rows(path, fields, notes)
    if not readable(layout, body):
        raise AssetError(f"{path}: {name} has 2 x {layout.components} hand coefficients: {NEEDS_MODEL}")
    frames = len(rows)
    if not frames:
        raise AssetError(f"{path}: {name} has 0 frames, expected at least 1")
    place_name = _present(fields, PLACE)
    place = None
    if place_name is None:
        notes.append("no trans: the pelvis stays in place")
    else:
        place = _numbers(path, fields, place_name)
        place = place[None] if frames == 1 and place.shape == (3,) else place
        if place.shape != (frames, 3):
            raise AssetError(f"{path}: {place_name} should be ({frames}, 3), is {place.shape}")
    rate = _rate(path, fields, notes)
    axis = _up(path, fields, rows, name, notes)
    betas = _betas(path, fields)
    given = given_pelvis(betas, body, notes)
    pelvis, height = given if given is not None else (usual_pelvis(notes), None)
    turn = np.array(TURNS[axis])
    R = matrix_from_quaternion(turn)

    def block(start: int, stop: int) -> tuple[Array, Array]:
        """Poses and roots of frames start .. stop - 1, as `Motion.block` gives them."""
        pose = expanded(rows[start:stop].astype(np.float64), layout, body)
        check_numbers(path, name, pose, start)
        root = np.zeros((stop - start, 3)) + pelvis
        if place is not None:
            at = place[start:stop].astype(np.float64)
            check_numbers(path, str(place_name), at[:, None], start)
            root = at + pelvis
        if axis != "+y":
            pose[:, 0] = turned(pose[:, 0], turn)
            root = root @ R.T
        return pose, root

    return Motion(path.name, frames, rate, tuple(notes), block, height)


def _person(path: Path, content: Value) -> dict[str, Value]:
    """The dict of fields, directly or as the first of a list or dict of people."""
    for _ in range(2):
        if type(content) is dict and _is_sequence(content):
            return {k: v for k, v in content.items() if isinstance(k, str)}
        inner = list(content.values()) if type(content) is dict else content
        if type(inner) is not list or not inner or type(inner[0]) is not dict:
            break
        content = inner[0]
    found = sorted(str(key)[:40] for key in content)[:12] if type(content) is dict else f"a {type(content).__name__}"
    raise AssetError(f"{path}: no poses; expected one of {', '.join(WHOLE + BODY)}; found {found}")


def _is_sequence(fields: dict) -> bool:
    return any(name in fields for name in WHOLE) or any(name in fields for name in BODY)


def _arrays(value: list) -> bool:
    return bool(value) and all(isinstance(v, Array) and v.ndim >= 2 for v in value)


def _present(fields: dict[str, Value], names: tuple[str, ...]) -> str | None:
    return next((name for name in names if fields.get(name) is not None), None)


def _numbers(path: Path, fields: dict[str, Value], name: str) -> Array:
    """A field as an array of numbers; lists of equally long lists count."""
    value = fields[name]
    if not isinstance(value, Array):
        try:
            if _numbers_within(value, {}) > MAX_NUMBERS:
                raise AssetError(f"{path}: {name} should be an array, is lists of more than {MAX_NUMBERS} numbers")
            value = np.array(value)
        except (ValueError, OverflowError):
            raise AssetError(f"{path}: {name} should be numbers, is no array or has lists of unequal lengths") from None
    if value.dtype.kind not in "fiu":
        raise AssetError(f"{path}: {name} should be numbers, is {value.dtype}")
    return value


def _numbers_within(value: Value, counted: dict[int, int]) -> int:
    """How many numbers lists of lists (or arrays) hold; one that is there twice counts twice, but is walked once."""
    if isinstance(value, Array) and value.dtype.kind in "biuf":
        return value.size
    if isinstance(value, (int, float, np.number)):
        return 1
    if not isinstance(value, (list, tuple)):
        raise ValueError(f"a {type(value).__name__}")
    if id(value) not in counted:
        counted[id(value)] = sum(_numbers_within(item, counted) for item in value)
    return counted[id(value)]


def _flat(path: Path, fields: dict[str, Value], name: str, frames: int | None = None) -> Array:
    """A field as rows, one a frame."""
    value = _numbers(path, fields, name)
    if value.ndim == 1:
        value = value[None]
    if value.ndim < 2 or (frames is not None and len(value) != frames):
        expected = f"({'frames' if frames is None else frames}, numbers)"
        raise AssetError(f"{path}: {name} should be {expected}, is {value.shape}")
    return value.reshape(len(value), int(np.prod(value.shape[1:])))


def _rows(path: Path, fields: dict[str, Value], notes: list[str]) -> tuple[str, Array, PoseLayout]:
    """Pose vectors with the root in front, their name, and their layout."""
    name, root_name, body_name = (_present(fields, names) for names in (WHOLE, ROOT, BODY))
    apart = root_name is not None and body_name is not None
    if name is not None and "fullpose" in fields and name == "pose":
        # MoSh keeps the coefficients in `pose` and what they mean in `fullpose`
        name = "fullpose"
    if name is not None:
        rows = _flat(path, fields, name)
        layout = pose_layout(rows.shape[1])
        if layout is not None:
            notes.append(layout.note)
            return name, rows, layout
        if not apart:
            why = REFUSED_COLUMNS.get(rows.shape[1], "no known layout")
            expected = "156, 165, 66, 72, 78 or 87"
            raise AssetError(f"{path}: {name} should have {expected} columns, has {rows.shape[1]}: {why}")
    if not apart:
        absent = " or ".join((ROOT if root_name is None else BODY)[:2])
        raise AssetError(
            f"{path}: no {absent} beside {body_name or root_name}; it has {sorted(key[:40] for key in fields)[:20]}"
        )
    root, rows = _flat(path, fields, str(root_name)), _flat(path, fields, str(body_name))
    if root.shape != (len(rows), 3):
        raise AssetError(f"{path}: {root_name} should be ({len(rows)}, 3), is {root.shape}")
    if rows.shape[1] not in (63, 69):
        raise AssetError(f"{path}: {body_name} should have 63 or 69 columns, has {rows.shape[1]}")
    parts = [root, rows[:, :63]]
    left, right, both = (_present(fields, names) for names in (LEFT, RIGHT, BOTH))
    hands = [hand for hand in (left, right) if hand] if left and right else [both] if both else []
    if hands:
        coefficients = [_flat(path, fields, hand, len(rows)) for hand in hands]
        both_hands = np.concatenate(coefficients, 1)
        n = both_hands.shape[1]
        if n % 2 or not 0 < n <= 90 or (len(hands) == 2 and coefficients[0].shape != coefficients[1].shape):
            raise AssetError(f"{path}: {' and '.join(hands)} should have 45 numbers a hand, have {n} in all")
        parts.append(both_hands)
        count = 0 if n == 90 else n // 2
        note = f"hands: 2 x {count} PCA coefficients, expanded, mean added" if count else FULL_HANDS
        layout = PoseLayout(66 + n, True, slice(66, 66 + n), count, note)
    else:
        layout = PoseLayout(66, True, None, 0, "hands: none in the file, flat")
    notes.append(layout.note)
    return str(body_name), np.concatenate(parts, 1), layout


def _rate(path: Path, fields: dict[str, Value], notes: list[str]) -> float:
    name = _present(fields, RATE)
    if name is None:
        notes.append(f"no frame rate ({', '.join(RATE)}): 30 frames per second assumed")
        return 30.0
    value = _numbers(path, fields, name)
    if value.size != 1:
        raise AssetError(f"{path}: {name} should be positive frames per second, one number, is {value.shape}")
    return checked_rate(f"{path}: {name}", float(value.reshape(())))


def _betas(path: Path, fields: dict[str, Value]) -> Float[Array, "n"]:
    """One body's shape; a row a frame counts as its first row."""
    name = _present(fields, SHAPE)
    if name is None:
        return np.zeros(0)
    value = _numbers(path, fields, name)
    value = (value[0] if value.ndim > 1 and len(value) else value).reshape(-1).astype(np.float64)
    if not (np.abs(value) < LARGEST_BETA).all():
        raise AssetError(f"{path}: {name} should be finite, below {LARGEST_BETA:g}")
    return value


def _up(path: Path, fields: dict[str, Value], rows: Array, name: str, notes: list[str]) -> str:
    if "up_axis" in fields:
        axis = fields["up_axis"]
        if not isinstance(axis, str) or axis not in ("y", "z"):
            found = repr(axis[:40]) if isinstance(axis, str) else f"a {type(axis).__name__}"
            raise AssetError(f"{path}: up_axis should be 'y' or 'z', is {found}")
        notes.append(f"up: {axis}, as the file says" + ("; turned to y" if axis == "z" else ""))
        return f"+{axis}"
    sample = np.unique(np.linspace(0, len(rows) - 1, min(len(rows), SAMPLED_FRAMES)).astype(int))
    root = rows[sample, :3].astype(np.float64)
    for k, one in zip(sample, root, strict=True):
        check_numbers(path, name, one[None, None], int(k))
    return up_axis(root, notes)
