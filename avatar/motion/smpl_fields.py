"""Pose sequences under the names that SMPL's programs give, for archives (amass.py) and pickles (pickled.py) alike.

    pose      poses | pose | fullpose | pose_est_fullposes, or root and body apart:
              global_orient | root_orient, body_pose | pose_body, and hands where there are any
    place     trans | transl | pose_est_trans        (absent: the pelvis stays in place)
    shape     betas | shape_est_betas                rate: mocap_framerate | mocap_frame_rate | fps | ...
    our own   up_axis ("y" or "z"), pelvis (J0), pelvis_height, face (frames, 52) with or without gaze (frames, 2, 2),
              as avatar/face.py has them

The file's world is turned upright about the horizontal, applied to the root orientation and to the pelvis position
trans + J0, where J0 is the pelvis joint of the file's body:

    pelvis_y = R (trans + J0)        root_y = R root

J0 comes from the file's own `pelvis`, else from the body given by the caller, else it is the usual one of SMPL+H or
SMPL-X, and the notes say so. Betas are not used without a body: they mean SMPL's shape space only.
"""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from avatar.body import Body
from avatar.face import SHAPES
from avatar.motion.clip import Motion, checked_pelvis_height, checked_rate, spread_frames
from avatar.motion.pose_vector import (
    FULL_HANDS,
    LARGEST,
    NEEDS_MODEL,
    TURNS,
    PoseLayout,
    check_numbers,
    expanded,
    pose_layout,
    readable,
    rested_pelvis,
    up_axis,
    upright_of,
)
from avatar.rotation import matrix_from_quaternion, turned
from command.errors import AssetError
from files.npz import NpzMember

WHOLE = ("poses", "pose", "fullpose", "pose_est_fullposes")
ROOT = ("global_orient", "root_orient", "poses_root")
BODY = ("body_pose", "pose_body", "poses_body")
LEFT, RIGHT = ("left_hand_pose", "lhand_pose"), ("right_hand_pose", "rhand_pose")
BOTH = ("pose_hand", "hand_pose", "poses_hand")
# SMPL-X alone has these
JAW = ("jaw_pose", "pose_jaw", "poses_jaw")
PLACE = ("trans", "transl", "pose_est_trans")
SHAPE = ("betas", "shape_est_betas", "beta")
RATE = ("mocap_framerate", "mocap_frame_rate", "mosh_framerate", "framerate", "frame_rate", "fps")
FACE = {"face": (len(SHAPES),), "gaze": (2, 2)}
# looked at for the up axis
SAMPLED_FRAMES = 200
# coefficients of people lie within 5
LARGEST_BETA = 1e3
REFUSED_COLUMNS = {
    63: "63 is a body without its root: expected `root_orient` and `pose_body`",
    69: "69 is 23 joints without a root orientation, or a body with a part left out",
    75: "75 may be SMPL-X without hands or a body with hand PCA coefficients and without its root",
    78: f"78 is a body with 2 x 6 hand PCA coefficients (EasyMocap): {NEEDS_MODEL}",
    87: f"87 is EasyMocap's SMPL-X vector with 2 x 6 hand PCA coefficients: {NEEDS_MODEL}",
    153: "153 is 51 joints: the root orientation is missing",
}
# bytes of a field that is not a row a frame
MAX_SMALL = 1 << 20


class HeldRows:
    """An array that is held whole, read as an archive's is; a list of numbers is one row."""

    def __init__(self, value: Array):
        self.value = value[None] if value.ndim == 1 else value
        self.shape, self.dtype = self.value.shape, self.value.dtype
        self.row = int(np.prod(self.shape[1:]))

    def rows(self, start: int, stop: int) -> Float[Array, "rows columns"]:
        """Rows start .. stop - 1 as float64."""
        # a signalling NaN would print a warning; who reads the rows names it
        with np.errstate(invalid="ignore"):
            return self.value[start:stop].reshape(-1, self.row).astype(np.float64)

    def all(self, most: int) -> Array:
        """The whole array, which is held whatever it takes."""
        return self.value


Rows = NpzMember | HeldRows


class PoseFields(NamedTuple):
    """A file's arrays by name, and which of "y" and "z" is up where it does not say; None: that is looked for."""

    path: Path
    names: frozenset[str]
    member: Callable[[str], Rows]
    usual_up: str | None

    def first(self, names: tuple[str, ...]) -> str | None:
        """The first of these names that the file has."""
        return next((name for name in names if name in self.names), None)

    def rows(self, name: str, frames: int | None = None, row: tuple[int, ...] | None = None) -> Rows:
        """An array of numbers with a row a frame, of this shape."""
        member = self.member(name)
        if member.dtype.kind not in "fiu":
            raise AssetError(f"{self.path}: {name} should be numbers, is {member.dtype}")
        if len(member.shape) < 2 or frames not in (None, member.shape[0]) or row not in (None, member.shape[1:]):
            expected = ", ".join(map(str, (frames or "frames", *(row or ["numbers"]))))
            raise AssetError(f"{self.path}: {name} should be ({expected}), is {member.shape}")
        return member

    def numbers(self, name: str, most: float = LARGEST) -> Float[Array, "n"]:
        """A small field; of one with a row a frame the first row."""
        member = self.member(name)
        framed = member.dtype.kind in "fiu" and len(member.shape) > 1 and member.shape[0]
        value = member.rows(0, 1) if framed else member.all(MAX_SMALL)
        if value.dtype.kind not in "fiu" or not (np.abs(value.astype(np.float64)) < most).all():
            raise AssetError(f"{self.path}: {name} should be finite numbers below {most:g}, is {value.dtype}")
        return value.reshape(-1).astype(np.float64)

    def few(self, name: str, count: int) -> Float[Array, "n"]:
        """A small field of so many numbers."""
        value = self.numbers(name)
        if value.size != count:
            raise AssetError(f"{self.path}: {name} should be {count} finite numbers, is {value.size}")
        return value


class _Poses(NamedTuple):
    """Pose vectors in one or more arrays side by side, of each its first columns."""

    names: tuple[str, ...]
    parts: tuple[tuple[Rows, int], ...]
    layout: PoseLayout

    @property
    def frames(self) -> int:
        return self.parts[0][0].shape[0]

    def rows(self, start: int, stop: int) -> Float[Array, "frames columns"]:
        return np.concatenate([part.rows(start, stop)[:, :width] for part, width in self.parts], 1)


def read_pose_fields(fields: PoseFields, body: Body | None, notes: list[str]) -> Motion:
    """The motion of a file's fields; `body` is the model it was made for.

    Raises:
        AssetError: no poses; a length that could mean several things; frames that disagree; a rate that is not
            positive. A number that is not finite is found when its frame is read.
    """
    path = fields.path
    poses = _poses(fields, body, notes)
    if not poses.frames:
        raise AssetError(f"{path}: {poses.names[0]} has 0 frames, expected at least 1")
    place_name = fields.first(PLACE)
    if place_name is None:
        notes.append("no trans: the pelvis stays in place")
    place = None if place_name is None else fields.rows(place_name, poses.frames, (3,))
    rate = _rate(fields, notes)
    up = _up(fields, poses, notes)
    pelvis, height = _pelvis(fields, body, up, poses.layout.smplx, notes)
    turn = np.array(TURNS[up])
    R = np.round(matrix_from_quaternion(turn))

    def block(start: int, stop: int) -> tuple[Array, Array]:
        """Poses and roots of frames start .. stop - 1, as `Motion.block` gives them."""
        pose = expanded(poses.rows(start, stop), poses.layout, body)
        check_numbers(path, ", ".join(poses.names), pose, start)
        root = np.zeros((stop - start, 3))
        if place is not None:
            root = place.rows(start, stop)
            check_numbers(path, str(place_name), root, start)
        root = root + pelvis
        if up != "+y":
            pose[:, 0], root = turned(pose[:, 0], turn), root @ R.T
        return pose, root

    grounded = "pelvis_height" in fields.names
    faces = _faces(fields, poses.frames)
    return Motion(path.name, poses.frames, rate, tuple(notes), block, height, grounded=grounded, faces=faces)


def _faces(fields: PoseFields, frames: int) -> Callable[[int, int], tuple[Array, Array]] | None:
    """What the file says of the face, as `Motion.faces` gives it."""
    held = {name: fields.rows(name, frames, row) for name, row in FACE.items() if name in fields.names}

    def rows(name: str, start: int, stop: int) -> Array:
        """Rows of a field, 0 where the file lacks it."""
        if name not in held:
            return np.zeros((stop - start, *FACE[name]))
        values = held[name].rows(start, stop)
        check_numbers(fields.path, name, values, start)
        return values.reshape(-1, *FACE[name])

    return (lambda start, stop: (rows("face", start, stop), rows("gaze", start, stop))) if held else None


def _poses(fields: PoseFields, body: Body | None, notes: list[str]) -> _Poses:
    path = fields.path
    name, root, trunk = (fields.first(names) for names in (WHOLE, ROOT, BODY))
    if name == "pose" and "fullpose" in fields.names:
        # MoSh keeps the coefficients in `pose` and what they mean in `fullpose`
        name = "fullpose"
    if name is not None:
        rows = fields.rows(name)
        layout = pose_layout(rows.row)
        if layout is not None and readable(layout, body):
            notes.append(layout.note)
            return _Poses((name,), ((rows, rows.row),), layout)
        if root is None or trunk is None:
            why = REFUSED_COLUMNS.get(rows.row, "no known layout")
            if layout is not None:
                why = f"2 x {layout.components} hand coefficients: {NEEDS_MODEL}"
            raise AssetError(f"{path}: {name} should have 156, 165, 66 or 72 columns, has {rows.row}: {why}")
    if root is None or trunk is None:
        found = sorted(key[:40] for key in fields.names)[:20]
        if root is None and trunk is None:
            hint = " (a shape file?)" if "betas" in fields.names else ""
            raise AssetError(f"{path}: no poses{hint}; expected one of {', '.join(WHOLE + BODY)}; found {found}")
        absent = " or ".join((BODY if root else ROOT)[:2])
        raise AssetError(f"{path}: no {absent} beside {root or trunk}; it has {found}")
    return _apart(fields, root, trunk, body, notes)


def _apart(fields: PoseFields, root: str, trunk: str, body: Body | None, notes: list[str]) -> _Poses:
    """Root, body and hands, each in an array of its own."""
    path, rows = fields.path, fields.rows(trunk)
    frames = rows.shape[0]
    if rows.row not in (63, 69):
        raise AssetError(f"{path}: {trunk} should have 63 or 69 columns, has {rows.row}")
    turns = fields.rows(root)
    if turns.shape[0] != frames or turns.row != 3:
        raise AssetError(f"{path}: {root} should be ({frames}, 3), is {turns.shape}")
    left, right, both = (fields.first(names) for names in (LEFT, RIGHT, BOTH))
    hands = (left, right) if left and right else (both,) if both else ()
    held = [(hand, fields.rows(hand, frames)) for hand in hands]
    count = sum(hand.row for _, hand in held)
    if hands and (count % 2 or not 0 < count <= 90 or held[0][1].row != held[-1][1].row):
        raise AssetError(f"{path}: {' and '.join(hands)} should have 45 numbers a hand, have {count} in all")
    layout = PoseLayout(True, None, 0, "hands: none in the file, flat")
    if hands:
        each = 0 if count == 90 else count // 2
        note = f"hands: 2 x {each} PCA coefficients, expanded, mean added" if each else FULL_HANDS
        layout = PoseLayout(True, slice(66, 66 + count), each, note)
    if not readable(layout, body):
        raise AssetError(f"{path}: {' and '.join(hands)}: 2 x {layout.components} hand coefficients: {NEEDS_MODEL}")
    notes.append(layout.note)
    return _Poses((root, trunk, *hands), ((turns, 3), (rows, 63), *((hand, hand.row) for _, hand in held)), layout)


def _rate(fields: PoseFields, notes: list[str]) -> float:
    name = fields.first(RATE)
    if name is None:
        notes.append(f"no frame rate ({', '.join(RATE)}): 30 frames per second assumed")
        return 30.0
    place, value = f"{fields.path}: {name}", fields.member(name).all(MAX_SMALL)
    if value.size != 1 or value.dtype.kind not in "fiu":
        found = f"{value.shape} of {value.dtype}"
        raise AssetError(f"{place} should be positive frames per second, one number, is {found}")
    return checked_rate(place, float(value.reshape(())))


def _up(fields: PoseFields, poses: _Poses, notes: list[str]) -> str:
    """ "+y", "-z" ...: the axis of the file's world that is up."""
    if "up_axis" in fields.names:
        value = fields.member("up_axis").all(MAX_SMALL)
        item = value.reshape(-1)[0] if value.size else ""
        axis = item.decode("ascii", "replace") if isinstance(item, bytes) else str(item)
        if axis not in ("y", "z"):
            raise AssetError(f"{fields.path}: up_axis should be 'y' or 'z', is {axis[:40]!r}")
        notes.append(f"up: {axis}, as the file says{'; turned to y' if axis == 'z' else ''}")
        return f"+{axis}"
    if fields.usual_up is not None:
        notes.append(f"up: {fields.usual_up}, as AMASS files have it; turned to y")
        return f"+{fields.usual_up}"
    sample = spread_frames(poses.frames, SAMPLED_FRAMES)
    root = np.concatenate([poses.rows(int(k), int(k) + 1)[:, :3] for k in sample])
    for k, one in zip(sample, root, strict=True):
        check_numbers(fields.path, poses.names[0], one[None], int(k))
    return up_axis(upright_of(root), notes)


def _pelvis(
    fields: PoseFields, body: Body | None, up: str, smplx: bool, notes: list[str]
) -> tuple[Float[Array, "3"], float | None]:
    """J0 of the file's body, and the height of its pelvis above its soles where it is known."""
    height, smplx = None, smplx or fields.first(JAW) is not None
    if "pelvis_height" in fields.names:
        height = checked_pelvis_height(f"{fields.path}: pelvis_height", float(fields.few("pelvis_height", 1)[0]))
    if "pelvis" in fields.names:
        return fields.few("pelvis", 3), height
    if up == "+y" and "up_axis" in fields.names and (body is None or body.name.startswith("builtin")):
        notes.append("pelvis: at trans, as in our own y-up files")
        return np.zeros(3), height
    name = fields.first(SHAPE)
    betas = np.zeros(0) if name is None else fields.numbers(name, LARGEST_BETA)
    J0, own = rested_pelvis(betas, body, notes, smplx=smplx)
    return J0, height if own is None else own
