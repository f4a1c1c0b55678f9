"""The avatar as the player draws it: standing, in poses that strain the skin, on a turntable."""

from collections.abc import Iterator

import numpy as np
from jaxtyping import UInt8

from avatar.baked_avatar import Avatar
from avatar.motion.clip import Clip
from avatar.skeleton import JOINTS
from bench.inspect.views import InspectView
from player.context import Context
from player.framing import extent, facing, fitted_camera, orbit
from player.motions import motion_for
from player.renderer import Pose, Renderer

BACKGROUND = (0.965, 0.965, 0.957, 1.0)
J = {name: index for index, name in enumerate(JOINTS)}


def strained_poses(avatar: Avatar) -> dict[str, Pose]:
    """Poses that show what skinning does at shoulders, elbows, hips, knees and fingers."""

    def pose(**turns: tuple[float | int, ...]) -> Pose:
        axis_angle = np.zeros((52, 3))
        for name, turn in turns.items():
            axis_angle[J[name]] = turn
        return axis_angle, np.zeros(3)

    counting = motion_for(avatar, "counting").read(205, 206)
    walking = motion_for(avatar, "walking").read(12, 13)
    fists = pose(
        left_shoulder=(0, -0.9, -0.4),
        right_shoulder=(0, 0.9, 0.4),
        left_elbow=(0, -2.0, 0),
        right_elbow=(0, 2.0, 0),
    )
    fists[0][22:37, 2], fists[0][37:52, 2] = -1.2, 1.2
    fists[0][[34, 35, 36, 49, 50, 51]] = 0
    return {
        "arms up": pose(left_shoulder=(0, 0, 1.0), right_shoulder=(0, 0, -1.0), left_collar=(0, 0, 0.3),
                        right_collar=(0, 0, -0.3)),
        "arms down": pose(left_shoulder=(0, 0, -1.25), right_shoulder=(0, 0, 1.25)),
        "fists": fists,
        "squat": pose(left_hip=(-1.5, 0, 0.2), right_hip=(-1.5, 0, -0.2), left_knee=(2.0, 0, 0), right_knee=(2.0, 0, 0),
                      spine1=(0.5, 0, 0)),
        "walking": (walking.axis_angle[0], np.zeros(3)),
        "counting": (counting.axis_angle[0], np.zeros(3)),
    }  # fmt: skip


def standing(
    context: Context, avatar: Avatar, views: list[InspectView], mode: str, level: int = 0
) -> list[UInt8[np.ndarray, "_ _ 3"]]:
    """These views in the canonical pose, at one level and view mode."""
    pose = np.asarray(avatar.canonical_pose, np.float64), np.asarray(avatar.joint_positions[0], np.float64)
    pictures: list[np.ndarray] = []
    renderer: Renderer | None = None
    for view in views:
        if renderer is None or renderer.target is None or renderer.target.size != view.camera.size:
            if renderer is not None:
                renderer.release()
            renderer = Renderer(context, [avatar], view.camera.size, view=mode, level=level, background=BACKGROUND)
        pictures.append(renderer.draw([pose], view.camera)[..., :3])
    assert renderer is not None
    renderer.release()
    return pictures


def posed(context: Context, avatar: Avatar, size: int) -> dict[str, UInt8[np.ndarray, "height width 3"]]:
    """Each strained pose, a little from the side."""
    renderer = Renderer(context, [avatar], (size, size), view="off", background=BACKGROUND)
    pictures = {}
    for name, (axis_angle, root) in strained_poses(avatar).items():
        points = extent(avatar, Clip(axis_angle[None], root[None], 30.0))
        side = facing(axis_angle, avatar.joint_positions.astype(np.float64)) + 0.45
        camera = fitted_camera(points, side, (size, size))
        pictures[name] = renderer.draw([(axis_angle, root)], camera)[..., :3]
    renderer.release()
    return pictures


def turntable(
    context: Context, avatar: Avatar, size: tuple[int, int], frames: int
) -> Iterator[UInt8[np.ndarray, "height width 3"]]:
    """One turn round the avatar at ease, as its file asks to be drawn."""
    clip = motion_for(avatar, "counting").read(0, 1)
    camera_at = orbit(extent(avatar, clip, following=True), 0.0, size)
    renderer = Renderer(context, [avatar], size, view=avatar.default_view, background=BACKGROUND)
    for frame in range(frames):
        camera = camera_at(frame / frames, clip.root[0])
        yield renderer.draw([(clip.axis_angle[0], clip.root[0])], camera)[..., :3]
    renderer.release()
