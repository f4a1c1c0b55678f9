"""Poses and keyframes as AMASS files: one frame, or every frame of a timeline with the key frames' numbers beside.

Two flavours, both whole or not at all. up="z" is what AMASS and its tools expect, and is as exact as a quarter turn
in double precision; up="y" keeps our world and comes back to the last bit (the library uses it).
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from avatar.motion.amass import read_amass, write_amass
from avatar.motion.clip import Clip, fitted
from avatar.motion.read import read_motion
from command.errors import AssetError
from files.npz import read_npz
from player.pose.keyframes import Easing, Keys, Pose

# frames that may become keys, one each, where a file has no key frames of its own
LONGEST = 20_000
KEY_FRAMES, EASING = "key_frames", "key_easing"


@dataclass(frozen=True)
class KeyedTimeline:
    """What a file of keyframes holds."""

    keys: Keys
    rate: float | int
    easing: Easing
    notes: tuple[str, ...]


def write_pose(path: Path | str, pose: Pose, *, pelvis_height: float | None, up: str = "z") -> None:
    """One pose as a motion of one frame."""
    clip = Clip(pose.axis_angle[None], pose.root[None], 30.0, (), pelvis_height)
    write_amass(path, clip, up=up)


def read_pose(path: Path | str, *, pelvis_height: float | None = None) -> Pose:
    """The first frame of any pose file, the root scaled to a body whose pelvis stands at `pelvis_height`.

    Raises:
        AssetError: the file is no motion, is damaged, or has no frame.
    """
    motion = read_motion(path)
    if not motion.frames:
        raise AssetError(f"{path}: expected a pose, found no frame")
    if pelvis_height is not None:
        motion = fitted(motion, pelvis_height)
    clip = motion.read(0, 1)
    return Pose(clip.axis_angle[0], clip.root[0])


def write_keys(path: Path | str, clip: Clip, keys: Keys, easing: Easing, *, up: str = "z") -> None:
    """Every frame of the timeline; the keys' own numbers go beside, so that reading gives the same keys."""
    beside = {KEY_FRAMES: np.array([frame for frame, _ in keys]), EASING: np.array(easing)}
    write_amass(path, clip, up=up, beside=beside)


def read_keys(path: Path | str, *, pelvis_height: float | None = None) -> KeyedTimeline:
    """The keys of a file that `write_keys` wrote; of another AMASS file every frame as a key.

    Raises:
        AssetError: not an AMASS file, damaged, longer than LONGEST without key frames, or key frames that do not
            grow or lie outside it.
    """
    motion = read_amass(path)
    fields = read_npz(path, "poses", (), (KEY_FRAMES, EASING), most=1 << 24) if motion.frames <= LONGEST else {}
    frames = np.arange(motion.frames)
    easing: Easing = "linear"
    if KEY_FRAMES in fields:
        frames = fields[KEY_FRAMES]
        whole = frames.ndim == 1 and frames.dtype.kind in "iu" and frames.size > 0
        if not whole or (np.diff(frames) <= 0).any() or frames[0] < 0 or frames[-1] >= motion.frames:
            raise AssetError(
                f"{path}: {KEY_FRAMES} should be growing frame numbers below {motion.frames}, "
                f"is {frames.dtype} {frames.shape} {frames.reshape(-1)[:5].tolist()}"
            )
        easing = _easing(path, fields)
    elif motion.frames > LONGEST:
        raise AssetError(f"{path}: {motion.frames} frames are too many to edit, at most {LONGEST}; take one of them")
    if pelvis_height is not None:
        motion = fitted(motion, pelvis_height)
    clip = motion.read()
    keys = tuple((int(f), Pose(clip.axis_angle[f], clip.root[f])) for f in frames)
    return KeyedTimeline(keys, float(clip.rate), easing, clip.notes)


def _easing(path: Path | str, fields: dict[str, np.ndarray]) -> Easing:
    found = fields.get(EASING, np.array("linear")).reshape(-1)[:1].astype(str).tolist()
    if found in (["linear"], ["smooth"]):
        return "smooth" if found == ["smooth"] else "linear"
    raise AssetError(f"{path}: {EASING} should be 'linear' or 'smooth', is {found}")
