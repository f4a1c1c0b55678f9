"""The motion of each avatar on screen: opened for its skeleton, fitted to its legs, its ground found."""

from collections.abc import Sequence

import numpy as np

from avatar.baked_avatar import Avatar
from avatar.body import read_body
from avatar.hull import hull_of
from avatar.motion.clip import Motion, RestSkeleton, fitted
from avatar.motion.ground import on_ground
from avatar.motion.hands import with_hands
from avatar.motion.read import read_motion
from command.errors import AssetError
from command.progress import plural
from player.scene.framing import pelvis_height
from player.scene.scene import SceneCamera

BLOCK = 256  # frames read at once: memory does not grow with the film


def motion_for(
    avatar: Avatar, source: str | None, *, body: str | None = None, hands: str = "file", ground: str = "find"
) -> Motion:
    """The motion on this avatar: its bones, its legs, its soles on the ground; without a source one frame of T-pose.

    `body` is the model that the file was made for. What was assumed and done is in the notes.
    """
    model = read_body(body) if body else None
    height = pelvis_height(avatar)
    if source is None:
        # where the ground is kept, the pelvis is the origin
        at = 0.0 if ground == "keep" else height
        return with_hands(standing(at, "no --motion: one frame, T-pose"), hands, model)
    skeleton = RestSkeleton(avatar.joint_positions.astype(np.float64), height)
    motion = read_motion(source, body=model, skeleton=skeleton)
    if motion.frames < 1:
        raise AssetError(f"{source}: expected at least one frame, found none")
    own = motion.grounded and motion.pelvis_height is not None and abs(motion.pelvis_height / height - 1) < 1e-6
    motion = with_hands(fitted(motion, height), hands, model)
    # a motion made for this very avatar: a pose in the air is meant
    return motion if own or ground == "keep" else on_ground(motion, hull_of(avatar))


def ground_for(asked: str, cameras: Sequence[SceneCamera]) -> str:
    """What "auto" means: a camera that was measured with the motion shows it where it was, any other on the ground."""
    measured = any(camera.kind in ("file", "capture") for camera in cameras)
    return asked if asked != "auto" else "keep" if measured else "find"


def standing(height: float, *notes: str) -> Motion:
    """One frame of T-pose, the pelvis at this height."""

    def block(start: int, stop: int) -> tuple[np.ndarray, np.ndarray]:
        return np.zeros((stop - start, 52, 3)), np.tile([0.0, height, 0.0], (stop - start, 1))

    return Motion("T-pose", 1, 30.0, notes, block)


def frame_range(
    name: str, count: int, frames: tuple[int | None, int | None] | None, frame: int | None = None, single: bool = False
) -> tuple[int, int]:
    """First frame and end, checked against a motion or a stage of so many frames."""
    if frame is None and frames is None:
        return (0, 1) if single else (0, count)
    start, stop = (frame, frame + 1) if frame is not None else frames or (None, None)
    start, stop = start or 0, count if stop is None else stop
    if stop > count or start >= stop:
        asked = f"frame {start}" if stop == start + 1 else f"frames {start}:{stop}"
        raise AssetError(f"{name}: {asked} asked for, it has {plural(count, 'frame')}, the first is 0")
    return start, stop
