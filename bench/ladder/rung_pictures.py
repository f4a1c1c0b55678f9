"""Pictures of the rungs of accuracy against time: a few poses under their cameras."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from avatar.baked_avatar import Avatar
from avatar.camera import Camera
from bench.report.writer import Json
from capture.held_out import HeldOutView, read_held_out
from command.errors import AssetError
from player.budget.rung import Rung, shown
from player.draw.drawing import BarePose
from player.gl.context import Context
from player.scene.framing import extent, fitted_camera
from player.scene.motions import motion_for

FRAMES = 4
SIZE = (640, 640)
# radians: from a little to the side
SIDE = 0.25


@dataclass(frozen=True)
class ComparedFrame:
    """A pose under a camera, with the true picture when there is one."""

    pose: BarePose
    camera: Camera
    truth: HeldOutView | None


def spread_poses(views: Sequence[HeldOutView], view: str, count: int) -> list[HeldOutView]:
    """`count` pictures of one kind, evenly spread over the set."""
    those = [v for v in views if v.view == view]
    chosen = np.unique(np.linspace(0, len(those) - 1, count).round().astype(int)) if those else []
    return [those[i] for i in chosen]


def held_out_frames(capture: Path, count: int = FRAMES) -> list[ComparedFrame]:
    """Body views of novel poses."""
    views = spread_poses(read_held_out(capture, "novel_pose"), "body", count)
    if not views:
        raise AssetError(f"{capture}: truth/novel_pose holds no body views")
    return [ComparedFrame((v.axis_angle, v.root), v.camera, v) for v in views]


def motion_frames(avatar: Avatar, count: int = FRAMES, size: tuple[int, int] = SIZE) -> list[ComparedFrame]:
    """Frames of the built-in counting clip from the front."""
    clip = motion_for(avatar, "counting").read()
    chosen = (np.linspace(0.15, 0.85, count) * (len(clip.root) - 1)).round().astype(int)
    camera = fitted_camera(extent(avatar, clip), SIDE, size)
    return [ComparedFrame((clip.axis_angle[i], clip.root[i]), camera, None) for i in chosen.tolist()]


class MeasuredRung(NamedTuple):
    """A row of the result, milliseconds of each round where the rung took turns with the others, and its pictures."""

    row: Json
    ms: Float[Array, "rounds"] | None
    pictures: list[Float[Array, "height width 3"]]


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
