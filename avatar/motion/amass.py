"""Pose files with AMASS keys (.npz): the older SMPL+H ones, the newer SMPL-X-style ones, and our own.

AMASS's world is z-up, and every file is taken for z-up unless it carries our own key `up_axis` = "y" (the
capture folder's poses.npz does). Reading turns z-up into our y-up by a quarter turn about x, applied to the
root orientation and to the pelvis position trans + J0, where J0 is the pelvis joint of the file's body:

    pelvis_y = Rx(-90) (trans + J0)        root_y = Rx(-90) root_z

J0 comes from the file's own `pelvis` key (ours), else from the body given by the caller, else it is
USUAL_PELVIS, and the notes say so. Betas are not used without a body: they mean SMPL's shape space only.
Arrays are never unpickled and are read row by row out of the archive, deflated or not.
"""

import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from avatar.body import Body
from avatar.motion.clip import Clip, Motion, checked_pelvis_height, checked_rate
from avatar.motion.pose_vector import (
    FULL_HANDS,
    LARGEST,
    LARGEST_BETA,
    REFUSED_COLUMNS,
    USUAL_PELVIS,
    PoseLayout,
    check_numbers,
    expanded,
    given_pelvis,
    pose_layout,
    readable,
    usual_pelvis,
)
from avatar.rotation import quaternion_inverse, turned
from command.errors import AssetError
from files.npz import NpzFile, NpzMember
from files.whole import whole_file

Array = np.ndarray

RATE_KEYS = ("mocap_framerate", "mocap_frame_rate", "framerate", "fps")
WRITTEN_AT_ONCE = 1024  # frames
# quaternion, a quarter turn about -x
Y_FROM_Z = np.array([-np.sqrt(0.5), 0, 0, np.sqrt(0.5)])


@dataclass(frozen=True)
class _Part:
    rows: NpzMember
    joints: slice  # a range of the 52
    # the layout of whole pose vectors; None: three numbers a joint
    layout: PoseLayout | None = None


def read_amass(path: Path | str, *, body: Body | None = None) -> Motion:
    """Open an AMASS pose file; see the module for frames and for what is assumed.

    `poses` may have the columns that avatar/motion/pose_vector.py lists, those with hand coefficients where `body` has
    their components; or `root_orient`, `pose_body` and perhaps `pose_hand` are there.

    Raises:
        AssetError: absent or damaged archive, no poses, no frames, a column count that could mean several
            things, a rate that is not positive. A number that is not finite is found when its frame is read.
    """
    path = Path(path)
    npz = NpzFile(path, "a pose file")
    notes: list[str] = []

    parts, frames = _pose_parts(npz, body, notes)
    if frames == 0:
        raise AssetError(f"{path}: {parts[0].rows.name} has 0 frames, expected at least 1")
    for part in parts:
        if part.rows.shape[0] != frames:
            raise AssetError(
                f"{path}: {part.rows.name} has {part.rows.shape[0]} frames, {parts[0].rows.name} has {frames}"
            )
    trans = None
    if "trans" in npz.names:
        trans = npz.member("trans")
        if trans.shape != (frames, 3):
            raise AssetError(f"{path}: trans should be ({frames}, 3), is {trans.shape}")
    else:
        notes.append("no trans: the pelvis stays in place")
    rate = _rate(npz, notes)
    turn = _up_axis(npz, notes) == "z"
    pelvis, height = _pelvis(npz, body, turn, notes)

    def block(start: int, stop: int) -> tuple[Array, Array]:
        """Poses and roots of frames start .. stop - 1, as `Motion.block` gives them."""
        pose = np.zeros((stop - start, 52, 3))
        for part in parts:
            values = part.rows.rows(start, stop)
            if part.layout is not None:
                values = expanded(values, part.layout, body)
            else:
                values = values.reshape(stop - start, values.shape[1] // 3, 3)
            check_numbers(path, part.rows.name, values, start, part.joints.start)
            pose[:, part.joints] = values
        root = np.zeros((stop - start, 3))
        if trans is not None:
            root = trans.rows(start, stop)
            check_numbers(path, "trans", root[:, None], start, 0)
        root = root + pelvis
        if turn:
            root = np.stack([root[:, 0], root[:, 2], -root[:, 1]], -1)
            pose[:, 0] = turned(pose[:, 0], Y_FROM_Z)
        return pose, root

    own = "pelvis_height" in npz.names
    return Motion(path.name, frames, rate, tuple(notes), block, height, grounded=own)


def _pose_parts(npz: NpzFile, body: Body | None, notes: list[str]) -> tuple[list[_Part], int]:
    if "poses" in npz.names:
        poses = npz.member("poses")
        if len(poses.shape) < 2 or poses.dtype.kind not in "fiu":
            raise AssetError(f"{npz.path}: poses should be (frames, 156), is {poses.shape} of {poses.dtype}")
        layout = pose_layout(poses.row)
        if layout and readable(layout, body):
            notes.append(layout.note)
            return [_Part(poses, slice(0, 52), layout)], poses.shape[0]
        if not {"root_orient", "pose_body"} <= npz.names:
            why = REFUSED_COLUMNS.get(poses.row, "no known layout")
            raise AssetError(f"{npz.path}: poses should have 156, 165, 66 or 72 columns, has {poses.row}: {why}")
    if not {"root_orient", "pose_body"} <= npz.names:
        hint = " (a shape file?)" if "betas" in npz.names else ""
        raise AssetError(
            f"{npz.path}: no poses{hint}; expected `poses`, or `root_orient` and `pose_body`; "
            f"has {sorted(npz.names)[:20]}"
        )
    parts = []
    for name, first, joints in (("root_orient", 0, 1), ("pose_body", 1, 21), ("pose_hand", 22, 30)):
        if name not in npz.names:
            notes.append("hands: none in the file, flat")
            continue
        rows = npz.member(name)
        if len(rows.shape) < 2 or rows.row != 3 * joints or rows.dtype.kind not in "fiu":
            raise AssetError(f"{npz.path}: {name} should be (frames, {3 * joints}), is {rows.shape} of {rows.dtype}")
        parts.append(_Part(rows, slice(first, first + joints)))
    if "pose_hand" in npz.names:
        notes.append(FULL_HANDS)
    return parts, parts[0].rows.shape[0]


def _small(npz: NpzFile, name: str) -> Array:
    return npz.member(name).all(most=1 << 20)


def _rate(npz: NpzFile, notes: list[str]) -> float:
    for key in RATE_KEYS:
        if key in npz.names:
            value = _small(npz, key)
            if value.size != 1 or value.dtype.kind not in "fiu":
                raise AssetError(f"{npz.path}: {key} should be one number, is {value.shape} of {value.dtype}")
            return checked_rate(f"{npz.path}: {key}", float(value.reshape(())))
    notes.append(f"no frame rate ({', '.join(RATE_KEYS)}): 30 frames per second assumed")
    return 30.0


def _text(value: Array) -> str:
    item = value.reshape(-1)[0] if value.size else ""
    return item.decode("ascii", "replace") if isinstance(item, bytes) else str(item)


def _up_axis(npz: NpzFile, notes: list[str]) -> str:
    if "up_axis" not in npz.names:
        notes.append("up: z, as AMASS files have it; turned to y")
        return "z"
    axis = _text(_small(npz, "up_axis"))
    if axis not in ("y", "z"):
        raise AssetError(f"{npz.path}: up_axis should be 'y' or 'z', is {axis!r}")
    notes.append("up: y, as the file says" if axis == "y" else "up: z, as the file says; turned to y")
    return axis


def _pelvis(npz: NpzFile, body: Body | None, turn: bool, notes: list[str]) -> tuple[Array, float | None]:
    """J0 of the file's body, and the height of its pelvis above its soles where it is known."""
    height = None
    if "pelvis_height" in npz.names:
        height = checked_pelvis_height(f"{npz.path}: pelvis_height", float(_numbers(npz, "pelvis_height", 1)[0]))
    if "pelvis" in npz.names:
        return _numbers(npz, "pelvis", 3), height
    betas = np.zeros(0)
    if "betas" in npz.names:
        betas = _small(npz, "betas")
        if betas.dtype.kind not in "fiu" or not (np.abs(betas.astype(np.float64)) < LARGEST_BETA).all():
            raise AssetError(
                f"{npz.path}: betas should be numbers below {LARGEST_BETA:g}, is {betas.dtype} {betas.shape}"
            )
        betas = betas.reshape(-1).astype(np.float64)
    given = given_pelvis(betas, body, notes)
    if given is not None:
        return given
    if not turn:
        notes.append("pelvis: at trans, as in our own y-up files")
        return np.zeros(3), height
    return usual_pelvis(notes), height


def _numbers(npz: NpzFile, name: str, count: int) -> Array:
    value = _small(npz, name)
    if value.size != count or value.dtype.kind not in "fiu" or not (np.abs(value.astype(np.float64)) < LARGEST).all():
        raise AssetError(
            f"{npz.path}: {name} should be {count} finite numbers below {LARGEST:g}, is {value.dtype} {value.shape}"
        )
    return value.reshape(count).astype(np.float64)


def write_amass(
    path: Path | str,
    clip: Clip | Motion,
    *,
    up: str = "z",
    pelvis: Float[Array, "3"] | None = None,
    dtype: type = np.float64,
    beside: Mapping[str, Array] | None = None,
) -> None:
    """Write a clip, or a motion of any length in constant memory, with AMASS keys, whole or not at all.

    up="z" is what AMASS and its tools expect: the clip is turned and trans = pelvis_z - J0, with J0 the usual
    one of SMPL+H unless `pelvis` gives another. up="y" keeps our world, with trans = pelvis (J0 = 0) unless
    given. J0 and the up axis are stored beside (`pelvis`, `up_axis`), so that reading back is exact. Arrays in
    `beside` go into the file under their own names; readers of AMASS files pass over them.

    Raises:
        ValueError: `up` is neither, the clip is empty or not finite, or `beside` names a key that AMASS has.
    """
    if up not in ("y", "z"):
        raise ValueError(f"up should be 'y' or 'z', is {up!r}")
    frames = clip.frames if isinstance(clip, Motion) else len(clip.root)
    if not frames:
        raise ValueError("a clip of 0 frames should have some, all finite")
    J0 = np.asarray(pelvis if pelvis is not None else USUAL_PELVIS if up == "z" else np.zeros(3), np.float64)

    def rows(start: int, stop: int) -> dict[str, Array]:
        """Poses and trans of some frames."""
        if isinstance(clip, Motion):
            part = clip.read(start, stop)
            pose, root = np.array(part.axis_angle, np.float64), np.asarray(part.root, np.float64)
        else:
            pose = np.array(clip.axis_angle[start:stop], np.float64)
            root = np.asarray(clip.root[start:stop], np.float64)
        if not (np.isfinite(pose).all() and np.isfinite(root).all()):
            raise ValueError(f"a clip of {frames} frames should have some, all finite")
        if up == "z":
            pose[:, 0] = turned(pose[:, 0], quaternion_inverse(Y_FROM_Z))
            root = np.stack([root[:, 0], -root[:, 2], root[:, 1]], -1)
        return {"poses": pose.reshape(len(pose), 156).astype(dtype), "trans": (root - J0).astype(dtype)}

    fields = {
        "betas": np.zeros(16),
        "gender": np.array("neutral"),
        "mocap_framerate": np.array(float(clip.rate)),
        "up_axis": np.array(up),
        "pelvis": J0,
    }
    if clip.pelvis_height is not None:
        fields["pelvis_height"] = np.array(float(clip.pelvis_height))
    if beside is not None:
        taken = {"poses", "trans", *fields} & beside.keys()
        if taken:
            raise ValueError(f"{sorted(taken)} beside a clip are names of its own")
        fields |= beside
    _write_members(path, frames, rows, np.dtype(dtype), fields)


def _write_members(
    path: Path | str,
    frames: int,
    rows: Callable[[int, int], dict[str, Array]],
    dtype: np.dtype,
    fields: Mapping[str, Array],
) -> None:
    """The archive's members as NumPy writes them, poses and trans by rows; whole or not at all."""
    with whole_file(path) as file, zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, width in (("poses", 156), ("trans", 3)):
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                descr = np.lib.format.dtype_to_descr(dtype)
                header = {"descr": descr, "fortran_order": False, "shape": (frames, width)}
                np.lib.format.write_array_header_1_0(member, header)
                for start in range(0, frames, WRITTEN_AT_ONCE):
                    member.write(rows(start, min(start + WRITTEN_AT_ONCE, frames))[name].tobytes())
        for name, value in fields.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, np.asanyarray(value), allow_pickle=False)
