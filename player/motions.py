"""The motion of each avatar on screen: opened, fitted to its legs, in stretches of constant memory."""

from collections.abc import Callable, Sequence
from typing import Protocol, runtime_checkable

import numpy as np

from avatar.baked_avatar import Avatar
from avatar.body import read_body
from avatar.errors import AssetError
from avatar.motion.clip import Clip, Motion, fitted
from avatar.motion.hands import with_hands
from avatar.motion.read import read_motion
from player.framing import pelvis_height

# frames read at once: memory does not grow with the film
BLOCK = 256
SPACING = 1.0  # metres between several avatars, side by side


def opened_motion(source: str | None, body: str | None, hands: str = "file") -> Motion:
    """The motion with the hands asked for, or one frame of T-pose."""
    model = read_body(body) if body else None
    if source is None:
        note = "no --motion: one frame, T-pose"

        def block(start: int, stop: int) -> tuple[np.ndarray, np.ndarray]:
            return np.zeros((stop - start, 52, 3)), np.zeros((stop - start, 3))

        return with_hands(Motion("T-pose", 1, 30.0, (note,), block), hands, model)
    motion = read_motion(source, body=model)
    if motion.frames < 1:
        raise AssetError(f"{source}: expected at least one frame, found none")
    return with_hands(motion, hands, model)


@runtime_checkable
class Framed(Protocol):
    """What has frames to choose from: a motion, a stage."""

    @property
    def name(self) -> str: ...
    @property
    def frames(self) -> int: ...


def frame_range(
    motion: Framed, frame: int | None, frames: tuple[int | None, int | None] | None, *, single: bool
) -> tuple[int, int]:
    """First frame and end, checked against the motion."""
    if frame is None and frames is None:
        return (0, 1) if single else (0, motion.frames)
    start, stop = (frame, frame + 1) if frame is not None else frames or (None, None)
    start, stop = start or 0, motion.frames if stop is None else stop
    if stop > motion.frames or start >= stop:
        asked = f"frame {start}" if stop == start + 1 else f"frames {start}:{stop}"
        raise AssetError(f"{motion.name}: {asked} asked for, it has {motion.frames} (0 to {motion.frames - 1})")
    return start, stop


def retargeted(motion: Motion, avatar: Avatar) -> Callable[[int, int], Clip]:
    """Stretches of the motion with the root scaled to this avatar's legs."""
    height = pelvis_height(avatar)

    def read(start: int, stop: int) -> Clip:
        return fitted(motion.read(start, stop), height)

    return read


def notes(clips: Sequence[Callable[[int, int], Clip]], start: int) -> list[str]:
    """What was assumed in reading the motion and fitting it to each avatar, each said once."""
    return list(dict.fromkeys(note for clip in clips for note in clip(start, start + 1).notes))


def beside(index: int, count: int) -> np.ndarray:
    """Where avatar `index` of `count` stands, metres."""
    return np.array([(index - 0.5 * (count - 1)) * SPACING, 0.0, 0.0])


def standing(avatar: Avatar) -> Callable[[int, int], Clip]:
    """Frames of T-pose with the soles on the ground."""
    height = pelvis_height(avatar)

    def read(start: int, stop: int) -> Clip:
        count = stop - start
        return Clip(np.zeros((count, 52, 3)), np.tile([0.0, height, 0.0], (count, 1)), 30.0)

    return read
