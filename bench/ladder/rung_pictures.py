"""Pictures of the rungs of accuracy against time: a few poses under their cameras, and a clip to see flicker in."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from avatar.baked_avatar import Avatar
from avatar.camera import Camera, orbit_camera
from avatar.motion.clip import Clip, fitted
from avatar.motion.read import builtin_motion
from avatar.skeleton import skin_transforms
from avatar.skinning import skin_points
from bench.report.contact import spread_poses
from capture.held_out import HeldOutView, read_held_out
from command.errors import AssetError
from player.budget.rung import Rung, shown
from player.gl.context import Context
from player.scene.renderer import Pose

FRAMES = 4
SIZE = (640, 640)
# the clip in which flicker is seen lasts so long, at so many frames a second
FLICKER_SECONDS, FLICKER_RATE = 2.0, 10.0


@dataclass(frozen=True)
class ComparedFrame:
    """A pose under a camera, with the true picture when there is one."""

    pose: Pose
    camera: Camera
    truth: HeldOutView | None


def held_out_frames(capture: Path, count: int = FRAMES) -> list[ComparedFrame]:
    """Body views of novel poses."""
    views = spread_poses(read_held_out(capture, "novel_pose"), "body", count)
    if not views:
        raise AssetError(f"{capture}: truth/novel_pose holds no body views")
    return [ComparedFrame((v.axis_angle, v.root), v.camera, v) for v in views]


def motion_frames(avatar: Avatar, count: int = FRAMES, size: tuple[int, int] = SIZE) -> list[ComparedFrame]:
    """Frames of the built-in counting clip from the front."""
    clip, target, height = counting(avatar)
    chosen = np.linspace(0.15, 0.85, count) * (len(clip.root) - 1)
    return [_seen(clip, i, target + clip.root[i], height, size) for i in chosen.round().astype(int).tolist()]


def flicker_frames(avatar: Avatar, size: tuple[int, int] = SIZE) -> list[ComparedFrame]:
    """Two seconds of the counting clip, one frame after the other, under a camera that stands still."""
    clip, target, height = counting(avatar)
    step = max(1, round(clip.rate / FLICKER_RATE))
    first = len(clip.root) // 3
    last = min(len(clip.root), first + round(FLICKER_SECONDS * clip.rate))
    return [_seen(clip, i, target + clip.root[first], height, size) for i in range(first, last, step)]


def counting(avatar: Avatar) -> tuple[Clip, Float[Array, "3"], float]:
    """The built-in counting clip on this avatar; the middle of its height above the pelvis' place; its height."""
    level = avatar.levels[0]
    rest = skin_transforms(np.zeros((52, 3)), avatar.joint_positions, rest=avatar.canonical_pose)
    standing = skin_points(level.positions, level.skin, rest)
    height = float(np.ptp(standing[:, 1]))
    clip = fitted(builtin_motion("counting"), -float(standing[:, 1].min())).read()
    return clip, np.array([0.0, 0.5 * height + float(standing[:, 1].min()), 0.0]), height


def _seen(clip: Clip, frame: int, target: Float[Array, "3"], height: float, size: tuple[int, int]) -> ComparedFrame:
    pose = clip.axis_angle[frame].astype(np.float64), clip.root[frame].astype(np.float64)
    return ComparedFrame(pose, orbit_camera(target, 1.9 * height, 0.25, 0.05, size), None)


def rung_pictures(
    context: Context, avatar: Avatar, rung: Rung, frames: Sequence[ComparedFrame]
) -> list[Float[Array, "height width 3"]]:
    """The frames as this rung shows them, brought to full resolution."""
    full = frames[0].camera.size
    renderer = rung.renderer(context, [avatar], full)
    try:
        drawn = []
        for frame in frames:
            pixels = renderer.draw([frame.pose], frame.camera)[..., :3]
            drawn.append(shown(pixels, full).astype(np.float32) / 255)
        return drawn
    finally:
        renderer.release()
