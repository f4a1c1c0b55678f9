"""Motion: clips of SMPL+H poses in our world, read from files in blocks, resampled, and the built-in ones."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from importlib.resources import files
from pathlib import Path

import numpy as np
from jaxtyping import Float

from avatar.body import Body
from avatar.errors import AssetError
from avatar.rotation import axis_angle_from_quaternion, quaternion_from_axis_angle, slerp

Array = np.ndarray

BUILTIN_MOTIONS = ("counting", "walking")
MOTION_FILES = "a motion (.npz AMASS, .pkl, .bvh, .glb .gltf .vrm .vrma, EasyMocap .json or folder)"


@dataclass(frozen=True)
class Clip:
    """Some frames of motion in our world: +y up, metres, radians, flat-hand convention."""

    axis_angle: Float[Array, "frames 52 3"]  # parent_from_joint; joint 0 is world_from_pelvis
    root: Float[Array, "frames 3"]  # pelvis joint in world
    rate: float | int  # frames per second
    notes: tuple[str, ...] = ()  # what the reader assumed, one line each, for printing
    pelvis_height: float | None = None  # rest height of the pelvis above the soles of the body that root fits


@dataclass(frozen=True)
class Motion:
    """A motion that may be longer than memory: it knows its length and gives any stretch as a Clip.

    Reading forward is fast; a step back starts the file again. Memory depends on the stretch, not the file.
    """

    name: str
    frames: int
    rate: float | int
    notes: tuple[str, ...]
    block: Callable[[int, int], tuple[Array, Array]] = field(repr=False)  # (start, stop) -> axis_angle, root
    pelvis_height: float | None = None

    def read(self, start: int = 0, stop: int | None = None) -> Clip:
        """Frames start .. stop - 1.

        Raises:
            ValueError: the stretch is not inside the motion.
            AssetError: a number in it is not finite or cannot be read; file, field, frame and joint are named.
        """
        stop = self.frames if stop is None else stop
        if not 0 <= start <= stop <= self.frames:
            raise ValueError(f"frames {start}:{stop} are not inside {self.name}, which has {self.frames}")
        axis_angle, root = self.block(start, stop)
        return Clip(axis_angle, root, self.rate, self.notes, self.pelvis_height)


def read_motion(source: Path | str, *, body: Body | None = None) -> Motion:
    """Open a motion: a pose file, a folder of them, or the name of a built-in one.

    .npz (AMASS), .pkl (SMPL+H, MoSh, 3DPW), .bvh, .glb .gltf .vrm .vrma (animation), .json or a folder of them
    (EasyMocap). `body` is the body the file was made for; it settles where `trans` puts the pelvis and what hand
    coefficients mean. What had to be assumed is in `notes`.

    Raises:
        AssetError: the file is absent, of an unknown kind, or holds what cannot be explained.
    """
    if str(source) in BUILTIN_MOTIONS:
        return builtin_motion(str(source))
    path = Path(source)
    if not path.exists():
        raise AssetError(
            f"{path}: no such file; expected {MOTION_FILES}, or one of {', '.join(BUILTIN_MOTIONS)}"
        )
    suffix = path.suffix.lower()
    if path.is_dir() or suffix == ".json":
        # the readers are imported when asked for: they import Clip and Motion from here
        from avatar.easymocap import read_easymocap

        return read_easymocap(path, body=body)
    if suffix == ".npz":
        from avatar.amass import read_amass

        return read_amass(path, body=body)
    if suffix == ".pkl":
        from avatar.pickled_motion import read_pickled_motion

        return read_pickled_motion(path, body=body)
    if suffix == ".bvh":
        from avatar.bvh import read_bvh

        return read_bvh(path)
    if suffix in (".glb", ".gltf", ".vrm", ".vrma"):
        from avatar.gltf_motion import read_gltf_motion

        return read_gltf_motion(path)
    raise AssetError(f"{path}: expected {MOTION_FILES}, found '{path.suffix}'")


def builtin_motion(name: str) -> Motion:
    """A clip that ships with the project (`avatar/clips.py` authors them): "counting" or "walking"."""
    from avatar.amass import read_amass

    if name not in BUILTIN_MOTIONS:
        raise ValueError(f"no built-in motion {name!r}; there are {', '.join(BUILTIN_MOTIONS)}")
    return read_amass(Path(str(files("avatar") / "data" / "motions" / f"{name}.npz")))


def resample(clip: Clip, rate: float | int) -> Clip:
    """The clip at another frame rate: joints by slerp on the shorter arc, the root linearly.

    First frame stays first; the last new frame is the last that is not after the old last one. At the same
    rate the clip comes back as it is.
    """
    if not (np.isfinite(rate) and rate > 0):
        raise ValueError(f"rate should be positive frames per second, is {rate}")
    count = len(clip.root)
    if rate == clip.rate or count == 1:
        return replace(clip, rate=rate)
    new = int(np.floor((count - 1) / clip.rate * rate * (1 + 1e-12))) + 1
    time = np.minimum(np.arange(new) * (clip.rate / rate), count - 1)
    before = np.minimum(time.astype(np.int64), count - 2)
    part = time - before
    q = quaternion_from_axis_angle(clip.axis_angle)
    joints = axis_angle_from_quaternion(slerp(q[before], q[before + 1], np.repeat(part[:, None], 52, 1)))
    root = clip.root[before] + part[:, None] * (clip.root[before + 1] - clip.root[before])
    return replace(clip, axis_angle=joints, root=root, rate=rate)


def fitted(clip: Clip, pelvis_height: float | int) -> Clip:
    """The clip for a body whose pelvis stands at another height: root scaled by the ratio of the heights.

    Unchanged, with a note, where the clip does not know the height of its own body.
    """
    if not pelvis_height > 0:
        raise ValueError(f"pelvis_height should be positive metres, is {pelvis_height}")
    if clip.pelvis_height is None:
        note = "root: not scaled, the file's own body is unknown"
        return replace(clip, notes=(*clip.notes, note))
    ratio = pelvis_height / clip.pelvis_height
    note = f"root: scaled by {ratio:.3f}, the ratio of pelvis heights"
    return replace(clip, root=clip.root * ratio, pelvis_height=pelvis_height, notes=(*clip.notes, note))
