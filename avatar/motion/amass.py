"""Pose files with AMASS keys (.npz): the older SMPL+H ones, the newer SMPL-X-style ones, and our own.

AMASS's world is z-up, and every file with its names is taken for z-up unless it carries our own key `up_axis` = "y"
(the capture folder's poses.npz does). Arrays are never unpickled and are read row by row out of the archive, deflated
or not.
"""

import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy import ndarray as Array

from avatar.body import Body
from avatar.motion.clip import Clip, Motion, checked_rate
from avatar.motion.pose_vector import TURNS, USUAL_PELVIS
from avatar.motion.smpl_fields import PoseFields, read_pose_fields
from avatar.rotation import quaternion_inverse, turned
from command.errors import AssetError
from files.npz import NpzFile, field, read_npz
from files.whole import whole_file

WRITTEN_AT_ONCE = 1024  # frames


def read_amass(path: Path | str, *, body: Body | None = None) -> Motion:
    """Open an AMASS pose file; avatar/motion/smpl_fields.py has the names, the frames and what is assumed.

    `poses` may have the columns that avatar/motion/pose_vector.py lists, those with hand coefficients where `body` has
    their components; or `root_orient`, `pose_body` and perhaps `pose_hand` are there.

    Raises:
        AssetError: absent or damaged archive, no poses, no frames, a column count that could mean several
            things, a rate that is not positive. A number that is not finite is found when its frame is read.
    """
    npz = NpzFile(path, "a pose file")
    # smplx' own name, in whose worlds people stand along any axis
    usual_up = None if "global_orient" in npz.names else "z"
    return read_pose_fields(PoseFields(npz.path, npz.names, npz.member, usual_up), body, [])


def read_video_poses(path: Path, frames: int) -> Clip:
    """poses.npz of a capture's video: a pose for each of its frames, our world.

    Raises:
        AssetError: a field is absent, misshapen or not finite, or the rate is none.
    """
    fields = read_npz(path, "poses", ("poses", "trans"), ("mocap_framerate",))
    for name, columns in (("poses", 156), ("trans", 3)):
        found = fields[name]
        if found.ndim == 2 and len(found) != frames:
            raise AssetError(f"{path}: {name} should hold one row for each of {frames} frames, holds {len(found)}")
        if found.shape == (frames, columns) and found.dtype.kind == "f" and not np.isfinite(found).all():
            frame, column = np.argwhere(~np.isfinite(found))[0]
            joint = f", joint {column // 3}" if name == "poses" else ""
            raise AssetError(f"{path}: {name} should be finite, is not in frame {frame}{joint}")
    poses = field(path, fields, "poses", (frames, 156)).astype(np.float64).reshape(frames, 52, 3)
    fields.setdefault("mocap_framerate", np.array(30.0))
    rate = checked_rate(f"{path}: mocap_framerate", float(field(path, fields, "mocap_framerate", ())))
    return Clip(poses, field(path, fields, "trans", (frames, 3)).astype(np.float64), rate)


def write_amass(path: Path | str, clip: Clip | Motion, *, up: str = "z", dtype: type = np.float64) -> None:
    """Write a clip, or a motion of any length in constant memory, with AMASS keys, whole or not at all.

    up="z" is what AMASS and its tools expect: the clip is turned and trans = pelvis_z - J0, with J0 the usual one
    of SMPL+H. up="y" keeps our world, with trans = pelvis (J0 = 0). J0 and the up axis are stored beside (`pelvis`,
    `up_axis`), so that reading back is exact.

    Raises:
        ValueError: `up` is neither, or the clip is empty or not finite.
    """
    if up not in ("y", "z"):
        raise ValueError(f"up should be 'y' or 'z', is {up!r}")
    clip.read(0, min(1, clip.frames)).check()
    J0 = np.asarray(USUAL_PELVIS if up == "z" else np.zeros(3), np.float64)

    def rows(start: int, stop: int) -> dict[str, Array]:
        """Poses and trans of some frames."""
        part = clip.read(start, stop)
        part.check()
        pose, root = np.array(part.axis_angle, np.float64), np.asarray(part.root, np.float64)
        if up == "z":
            pose[:, 0] = turned(pose[:, 0], quaternion_inverse(np.array(TURNS["+z"])))
            root = np.stack([root[:, 0], -root[:, 2], root[:, 1]], -1)
        out = {"poses": pose.reshape(len(pose), 156).astype(dtype), "trans": (root - J0).astype(dtype)}
        if part.face is not None and part.gaze is not None:
            out |= {"face": part.face.astype(dtype), "gaze": part.gaze.astype(dtype)}
        return out

    fields = {
        "betas": np.zeros(16),
        "gender": np.array("neutral"),
        "mocap_framerate": np.array(float(clip.rate)),
        "up_axis": np.array(up),
        "pelvis": J0,
    }
    if clip.pelvis_height is not None:
        fields["pelvis_height"] = np.array(float(clip.pelvis_height))
    _write_members(path, clip.frames, rows, fields)


def _write_members(
    path: Path | str, frames: int, rows: Callable[[int, int], dict[str, Array]], fields: dict[str, Array]
) -> None:
    """The archive's members as NumPy writes them, those of `rows` a stretch at a time; whole or not at all."""
    with whole_file(path) as file, zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, first in rows(0, 1).items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                descr = np.lib.format.dtype_to_descr(first.dtype)
                header = {"descr": descr, "fortran_order": False, "shape": (frames, *first.shape[1:])}
                np.lib.format.write_array_header_1_0(member, header)
                for start in range(0, frames, WRITTEN_AT_ONCE):
                    member.write(rows(start, min(start + WRITTEN_AT_ONCE, frames))[name].tobytes())
        for name, value in fields.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, np.asanyarray(value), allow_pickle=False)
