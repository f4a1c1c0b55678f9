"""Motion as data: clips of SMPL+H poses in our world, given in blocks, resampled, and fitted to a body."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from avatar.body import Body, builtin_body
from avatar.constant import constant
from avatar.face import FaceFrame
from avatar.rotation import between
from command.errors import AssetError

# frames per second, and metres from the soles to the pelvis, that a file may claim
RATES = (0.01, 10_000.0)
PELVIS_HEIGHTS = (0.01, 100.0)


@dataclass(frozen=True)
class Clip:
    """Some frames of motion in our world: +y up, metres, radians, flat-hand convention."""

    # parent_from_joint; joint 0 is world_from_pelvis
    axis_angle: Float[Array, "frames 52 3"]
    root: Float[Array, "frames 3"]  # pelvis joint in world
    rate: float | int  # frames per second
    # what the reader assumed, one line each, for printing
    notes: tuple[str, ...] = ()
    # rest height of the pelvis above the soles of the body that root fits
    pelvis_height: float | None = None
    # what the face does (avatar/face.py), both or neither: weights of its shapes, and yaw and pitch of each eye
    face: Float[Array, "frames 52"] | None = None
    gaze: Float[Array, "frames 2 2"] | None = None

    @property
    def frames(self) -> int:
        return len(self.root)

    def face_at(self, frame: int) -> FaceFrame | None:
        """What the face does in a frame; None: it stays at rest."""
        if self.face is None or self.gaze is None:
            return None
        return FaceFrame(self.face[frame], self.gaze[frame])

    def check(self) -> None:
        """Refuse a clip without frames, or with a number that is not finite, with a ValueError."""
        rows = (self.axis_angle, self.root, self.face, self.gaze)
        if not self.frames or not all(row is None or np.isfinite(row).all() for row in rows):
            raise ValueError(f"a clip of {self.frames} frames should have some, all finite")

    def read(self, start: int, stop: int) -> "Clip":
        """Frames start .. stop - 1, as `Motion.read` gives them."""
        return self.motion("").read(start, stop)

    def motion(self, name: str) -> "Motion":
        """The same as a motion, held whole."""
        face, gaze = self.face, self.gaze
        return Motion(
            name, self.frames, self.rate, self.notes,
            lambda start, stop: (self.axis_angle[start:stop], self.root[start:stop]), self.pelvis_height,
            faces=None if face is None or gaze is None else lambda start, stop: (face[start:stop], gaze[start:stop]),
        )  # fmt: skip


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
    # the file says that its ground is y = 0 (ours do); else avatar/motion/ground.py looks for it
    grounded: bool = False
    # (start, stop) -> weights and gaze of a Clip; None: the face stays at rest
    faces: Callable[[int, int], tuple[Array, Array]] | None = field(default=None, repr=False)

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
        faces = (None, None) if self.faces is None else self.faces(start, stop)
        return Clip(axis_angle, root, self.rate, self.notes, self.pelvis_height, *faces)

    def changed(self, note: str, change: Callable[[Array, Array], tuple[Array, Array]]) -> "Motion":
        """The motion with poses and roots of each stretch changed, and a note that says so."""
        return replace(self, notes=(*self.notes, note), block=lambda start, stop: change(*self.block(start, stop)))


def spread_frames(count: int, most: int) -> Int[Array, "chosen"]:
    """At most so many of `count` frames, spread evenly from the first to the last."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).astype(int))


def checked_rate(place: str, rate: float) -> float:
    """A frame rate that a file claims; `place` names file and field in the message of the AssetError."""
    if not RATES[0] <= rate <= RATES[1]:
        raise AssetError(f"{place} should be positive, {RATES[0]:g} to {RATES[1]:g} frames per second, is {rate:g}")
    return rate


def checked_pelvis_height(place: str, height: float) -> float:
    """A pelvis height that a file claims: what a root is scaled by has to leave it finite."""
    if not PELVIS_HEIGHTS[0] <= height <= PELVIS_HEIGHTS[1]:
        raise AssetError(f"{place} should be positive, {PELVIS_HEIGHTS[0]:g} to {PELVIS_HEIGHTS[1]:g} m, is {height:g}")
    return height


@dataclass(frozen=True)
class RestSkeleton:
    """The skeleton that a motion is read for: its bones in pose 0."""

    joints: Float[Array, "52 3"]  # pelvis at the origin, metres
    pelvis_height: float  # above the soles, metres


def rest_skeleton(body: Body) -> RestSkeleton:
    return RestSkeleton(body.joints, float(-body.vertices[:, 1].min()))


@constant
def builtin_skeleton() -> RestSkeleton:
    """The built-in man's."""
    return rest_skeleton(builtin_body("male"))


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
    joints = between(clip.axis_angle[before], clip.axis_angle[before + 1], np.repeat(part[:, None], 52, 1))
    face, gaze = (None if rows is None else _straight(rows, before, part) for rows in (clip.face, clip.gaze))
    root = _straight(clip.root, before, part)
    return replace(clip, axis_angle=joints, root=root, rate=rate, face=face, gaze=gaze)


def _straight(rows: Float[Array, "frames *row"], before: Int[Array, "new"], part: Float[Array, "new"]) -> Array:
    """Rows between those of frames and of the frames after them."""
    part = part.reshape(-1, *[1] * (rows.ndim - 1))
    return rows[before] + part * (rows[before + 1] - rows[before])


def fitted(motion: Motion, pelvis_height: float) -> Motion:
    """The motion for a body whose pelvis stands at another height: root scaled by the ratio of the heights.

    Where the motion does not know the height of its own body, its root stays as it is, with a note.
    """
    if not pelvis_height > 0:
        raise ValueError(f"pelvis_height should be positive metres, is {pelvis_height}")
    if motion.pelvis_height is None:
        note = "root: not scaled, the file's own body is unknown"
        return replace(motion, pelvis_height=pelvis_height, notes=(*motion.notes, note))
    ratio = pelvis_height / motion.pelvis_height
    note = f"root: scaled by {ratio:.3f}, the ratio of pelvis heights"
    return replace(motion.changed(note, lambda pose, root: (pose, root * ratio)), pelvis_height=pelvis_height)
