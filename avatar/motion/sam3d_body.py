"""Poses that SAM 3D Body found in photos: one .npz a photo, a folder of them, or their fields stacked, frames first.

    pred_joint_coords (127,3)   metres, in the camera's axes: x right, y down, z forward; counted from the body's ground
    pred_global_rots (127,3,3)  of the joints' axes, in axes with y up and z towards the camera
    pred_cam_t (3,)             what is added to the joints to place them before the camera

So joints and rotations are given in different axes: the joints are turned half round about x, which is also what
makes our world (y up) of the camera's. Which way the camera leaned is not known: its up is taken for the world's. A
photo has no frame rate.
"""

from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import numpy as np
from numpy import ndarray as Array

from avatar.motion.clip import Motion, RestSkeleton, builtin_skeleton, spread_frames
from avatar.motion.mhr_rig import MHR_JOINTS, NUMBERS, MhrRig, off_bones
from avatar.motion.read import frame_files
from avatar.motion.retarget import retarget
from command.errors import AssetError
from command.progress import plural
from files.npz import NpzFile, NpzMember

WHAT = "a result of SAM 3D Body"
JOINTS, TURNS, CAMERA = "pred_joint_coords", "pred_global_rots", "pred_cam_t"
SHAPES = {JOINTS: (MHR_JOINTS, 3), TURNS: (MHR_JOINTS, 3, 3), CAMERA: (3,)}
LARGEST = 1e6  # metres
# the largest difference of R^T R from the identity
NOT_A_ROTATION = 0.01
ASSUMED_RATE = 30.0
SAMPLED_FRAMES = 30
# from the camera's axes, y down, to ours
FLIP = np.array([1.0, -1, -1])
# degrees between bones and rotations: of arms and legs, above which the fields are not of one body; of hands,
# above which a note says so
MOST_OFF, HANDS_OFF = 15.0, 5.0
# metres, of a bone that has a direction
SHORTEST = 1e-5

Rows = Callable[[int, int], tuple[Array, Array, Array]]


def is_sam3d_body(path: Path | str) -> bool:
    """Whether an .npz holds joints and rotations of a SAM 3D Body result, going by the names of its arrays."""
    with closing(NpzFile(path, WHAT)) as npz:
        return {JOINTS, TURNS} <= npz.names


def read_sam3d_body(path: Path | str, skeleton: RestSkeleton | None = None) -> Motion:
    """Open a result of SAM 3D Body, or a folder of them in the order of their names (numbers in them count as numbers).

    Raises:
        AssetError: no .npz, a field that is absent, misshapen, not finite or no rotation, or joints and rotations
            that are not of one body. File, field, frame and joint are named.
    """
    path = Path(path)
    notes: list[str] = []
    frames, rows, placed = _opened(path, notes)
    skeleton = builtin_skeleton() if skeleton is None else skeleton
    seen = [rows(int(k), int(k) + 1) for k in spread_frames(frames, SAMPLED_FRAMES)]
    _check_bones(path, np.concatenate([s[1] for s in seen]), np.concatenate([s[0] for s in seen]), notes)

    def read(start: int, stop: int) -> tuple[Array, Array]:
        joints, R, camera = rows(start, stop)
        return R, (joints + camera[:, None]) * FLIP

    notes.append("up: the camera's, which is taken to be level")
    if placed:
        notes.append("root: the place before the camera (pred_cam_t), the camera at the origin")
    else:
        notes.append("no pred_cam_t: the body stays where its joints are counted from")
    if frames > 1:
        notes.append(f"no frame rate in the files: {ASSUMED_RATE:g} frames per second assumed")
    rig = MhrRig(path=path, frames=frames, rate=ASSUMED_RATE, read=read, joints=skeleton.joints.astype(np.float64))
    return retarget(rig, skeleton, up_known=True, assumed=tuple(notes), alignment=rig.alignment)


def _opened(path: Path, notes: list[str]) -> tuple[int, Rows, bool]:
    """How many frames there are, what reads a stretch of them, and whether they are placed before the camera."""
    if path.is_dir():
        files = frame_files(path, ".npz", "results of SAM 3D Body")
        notes.append(f"frames: {plural(len(files), 'file')} in the order of names, {files[0].name} to {files[-1].name}")
        with closing(NpzFile(files[0], WHAT)) as npz:
            placed = CAMERA in npz.names

        def one(file: Path) -> tuple[Array, Array, Array]:
            with closing(NpzFile(file, WHAT)) as npz:
                frames, rows = _fields(npz, file.name)
                if frames != 1:
                    raise AssetError(f"{file}: expected one frame a file in a folder, found {frames}")
                return rows(0, 1)

        def stretch(start: int, stop: int) -> tuple[Array, Array, Array]:
            parts = [one(file) for file in files[start:stop]]
            if not parts:
                return np.zeros((0, MHR_JOINTS, 3)), np.zeros((0, MHR_JOINTS, 3, 3)), np.zeros((0, 3))
            joints, R, camera = (np.concatenate(values) for values in zip(*parts, strict=True))
            return joints, R, camera

        return len(files), stretch, placed
    npz = NpzFile(path, WHAT)
    frames, rows = _fields(npz, "")
    return frames, rows, CAMERA in npz.names


def _fields(npz: NpzFile, place: str) -> tuple[int, Rows]:
    """Frames of one file and what reads them: joints, rotations, places before the camera."""
    path, frames = npz.path, -1
    fields: list[tuple[NpzMember, tuple[int, ...]]] = []
    for key, tail in SHAPES.items():
        if key not in npz.names and key == CAMERA:
            continue
        if key not in npz.names:
            raise AssetError(f"{path}: no {key}; expected {WHAT}, the file has {', '.join(sorted(npz.names)[:12])}")
        member = npz.member(key)
        stacked = member.shape[1:] == tail
        if (not stacked and member.shape != tail) or member.dtype.kind not in "fiu":
            raise AssetError(
                f"{path}: {key} should be {tail} numbers, or frames of them, is {member.shape} {member.dtype}"
            )
        count = member.shape[0] if stacked else 1
        if count == 0 or frames not in (-1, count):
            expected = "at least 1" if count == 0 else f"{frames} as in {fields[0][0].name}"
            raise AssetError(f"{path}: {key} has {count} frames, expected {expected}")
        frames = count
        fields.append((member, tail))

    def values(member: NpzMember, tail: tuple[int, ...], start: int, stop: int) -> Array:
        """A field in frames start .. stop - 1, checked."""
        if member.shape == tail:
            with np.errstate(invalid="ignore"):
                found = member.all().astype(np.float64)[None][start:stop]
        else:
            found = member.rows(start, stop).reshape(stop - start, *tail)
        bad = ~(np.abs(found) < LARGEST)
        if bad.any():
            where = np.argwhere(bad)[0]
            joint = f", joint {int(where[1])}" if len(tail) > 1 else ""
            place = f"first in frame {start + int(where[0])}{joint}"
            raise AssetError(f"{path}: {member.name} is not finite, or beyond {LARGEST:g}, {place}")
        return found

    def rows(start: int, stop: int) -> tuple[Array, Array, Array]:
        joints, R, *camera = (values(*field, start, stop) for field in fields)
        _check(path, joints, R, start)
        return joints, R, camera[0] if camera else np.zeros((stop - start, 3))

    return frames, rows


def _check(path: Path, joints: Array, R: Array, start: int) -> None:
    """Refuse what is no rotation, and joints that fall together."""
    used = sorted({k for pair in NUMBERS.values() for k in pair})
    error = np.abs(np.swapaxes(R, -1, -2) @ R - np.eye(3)).max((-1, -2))
    error = np.where(np.linalg.det(R) > 0, error, 2.0)[:, used]
    if (error > NOT_A_ROTATION).any():
        frame, k = (int(v) for v in np.argwhere(error > NOT_A_ROTATION)[0])
        raise AssetError(
            f"{path}: {TURNS} should be rotations, joint {used[k]} of frame {start + frame} is none "
            f"({R[frame, used[k]].round(3).tolist()})"
        )
    places = {name: joints[:, place] for name, (_, place) in NUMBERS.items()}
    pairs = [(f"{side}_{a}", f"{side}_{b}") for side in ("left", "right") for a, b in (
        ("hip", "knee"), ("knee", "ankle"), ("ankle", "foot"), ("shoulder", "elbow"), ("elbow", "wrist"),
        ("wrist", "middle1"), ("pinky1", "index1"))] + [("left_hip", "right_hip"), ("pelvis", "head")]  # fmt: skip
    for a, b in pairs:
        length = np.linalg.norm(places[b] - places[a], axis=-1)
        if (length < SHORTEST).any():
            frame = start + int(np.argmax(length < SHORTEST))
            raise AssetError(f"{path}: {JOINTS}: {a} and {b} of frame {frame} are at one place")


def _check_bones(path: Path, R: Array, joints: Array, notes: list[str]) -> None:
    """Notes hands that are older than their joints.

    Raises:
        AssetError: the rotations do not lie along arms and legs.
    """
    off = np.degrees(np.median(off_bones(R, joints * FLIP, fingers=False)))
    if off > MOST_OFF:
        raise AssetError(
            f"{path}: joints and rotations should be of one body, the bones of arms and legs lie {off:.0f} "
            f"degrees (median) off the axes that should run along them (at most {MOST_OFF:g})"
        )
    fingers = np.degrees(off_bones(R, joints * FLIP, fingers=True)).reshape(len(R), 2, -1).mean((0, 2))
    older = [
        f"{side} ({angle:.0f} degrees)"
        for side, angle in zip(("left", "right"), fingers, strict=True)
        if angle > HANDS_OFF
    ]
    if older:
        notes.append(f"hands: rotations are off the joints, which are kept: {', '.join(older)}")
