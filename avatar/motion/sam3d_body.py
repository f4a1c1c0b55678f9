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
from avatar.motion.pose_vector import check_numbers
from avatar.motion.read import frame_files
from avatar.motion.retarget import retarget
from avatar.motion.smpl_fields import HeldRows
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
    frames, rows, placed = _folder(path, notes) if path.is_dir() else _file(NpzFile(path, WHAT))
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


def _folder(path: Path, notes: list[str]) -> tuple[int, Rows, bool]:
    """As `_file`, of a folder with a frame a file."""
    files = frame_files(path, ".npz", "results of SAM 3D Body")
    notes.append(f"frames: {plural(len(files), 'file')} in the order of names, {files[0].name} to {files[-1].name}")
    with closing(NpzFile(files[0], WHAT)) as npz:
        placed = CAMERA in npz.names

    def rows(start: int, stop: int) -> tuple[Array, Array, Array]:
        """Joints, rotations and places before the camera, a file a frame."""
        joints, R, camera = (np.zeros((stop - start, *tail)) for tail in SHAPES.values())
        for k, file in enumerate(files[start:stop]):
            with closing(NpzFile(file, WHAT)) as npz:
                frames, of_file, _ = _file(npz)
                if frames != 1:
                    raise AssetError(f"{file}: expected one frame a file in a folder, found {frames}")
                joints[k : k + 1], R[k : k + 1], camera[k : k + 1] = of_file(0, 1)
        return joints, R, camera

    return len(files), rows, placed


def _file(npz: NpzFile) -> tuple[int, Rows, bool]:
    """How many frames, what reads their joints, rotations and places before the camera, and whether it has those."""
    path, frames, fields = npz.path, -1, dict[str, NpzMember | HeldRows]()
    for key, tail in SHAPES.items():
        if key not in npz.names and key == CAMERA:
            continue
        member = npz.member(key)
        if member.dtype.kind not in "fiu" or tail not in (member.shape, member.shape[1:]):
            raise AssetError(
                f"{path}: {key} should be {tail} numbers, or frames of them, is {member.shape} {member.dtype}"
            )
        fields[key] = HeldRows(member.all()[None]) if member.shape == tail else member
        count = fields[key].shape[0]
        if count == 0 or frames not in (-1, count):
            expected = "at least 1" if count == 0 else f"{frames} as in {JOINTS}"
            raise AssetError(f"{path}: {key} has {count} frames, expected {expected}")
        frames = count

    def rows(start: int, stop: int) -> tuple[Array, Array, Array]:
        joints, R, camera = (np.zeros((stop - start, *tail)) for tail in SHAPES.values())
        for key, out in zip(SHAPES, (joints, R, camera), strict=True):
            if key in fields:
                out[:] = fields[key].rows(start, stop).reshape(out.shape)
                check_numbers(path, key, out, start, LARGEST)
        _check(path, joints, R, start)
        return joints, R, camera

    return frames, rows, CAMERA in fields


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
    off_hands = zip(("left", "right"), fingers, strict=True)
    older = [f"{side} ({angle:.0f} degrees)" for side, angle in off_hands if angle > HANDS_OFF]
    if older:
        notes.append(f"hands: rotations are off the joints, which are kept: {', '.join(older)}")
