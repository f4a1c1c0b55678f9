"""Sections that our own renderer draws: the avatar as it looks, standing, in strained poses."""

import numpy as np
from jaxtyping import UInt8

from avatar.baked_avatar import Avatar
from avatar.camera import Camera
from avatar.motion.clip import Clip
from avatar.skeleton import JOINTS
from bench.inspect.inspection import Inspector
from bench.inspect.page import PageSection, picture
from bench.inspect.views import face_views, strip
from player.draw.drawing import BarePose
from player.scene.framing import extent, facing, fitted_camera
from player.scene.motions import motion_for
from player.scene.renderer import Renderer

BACKGROUND = (0.965, 0.965, 0.957, 1.0)
J = {name: index for index, name in enumerate(JOINTS)}
# pixels of a side
FACE = 512
# times that view dependence is shown
CHANGE = 8


def looks(inspector: Inspector) -> PageSection:
    """As drawn, in the canonical pose."""
    plain = strip(standing(inspector, inspector.views, "off"))
    pictures = [picture("look_off", plain, "the paper's colors")]
    mode = inspector.avatar.default_view
    if mode != "off":
        image = strip(standing(inspector, inspector.views, mode))
        pictures.append(picture(f"look_{mode}", image, f"with view dependence ({mode})"))
        change = np.clip(128 + CHANGE * (image.astype(float) - plain), 0, 255).astype(np.uint8)
        pictures.append(picture("look_change", change, f"what view dependence adds, {CHANGE} times, on grey"))
    return PageSection("look", pictures)


def face(inspector: Inspector) -> PageSection:
    """Three views of the face, filling the picture, as a person would look at it."""
    image = np.hstack(standing(inspector, face_views(inspector.avatar, FACE), "off"))
    return PageSection("face", [picture("face", image, "the face, in the paper's colors")])


def posed(inspector: Inspector) -> PageSection:
    """Poses that strain the skin, a little from the side."""
    avatar, side = inspector.avatar, max(inspector.size * 3 // 4, 64)
    renderer = Renderer(inspector.context, [avatar], (side, side), view="off", background=BACKGROUND)
    pictures = []
    for name, (axis_angle, root) in strained_poses(avatar).items():
        points = extent(avatar, Clip(axis_angle[None], root[None], 30.0))
        azimuth = facing(axis_angle, avatar.joint_positions.astype(np.float64)) + 0.45
        image = renderer.draw([(axis_angle, root)], fitted_camera(points, azimuth, (side, side)))[..., :3]
        pictures.append(picture(f"pose_{name.replace(' ', '_')}", image, name, width=380))
    renderer.release()
    return PageSection("poses", pictures)


def strained_poses(avatar: Avatar) -> dict[str, BarePose]:
    """Poses that show what skinning does at shoulders, elbows, hips, knees and fingers."""

    def pose(**turns: tuple[float | int, ...]) -> BarePose:
        axis_angle = np.zeros((52, 3))
        for name, turn in turns.items():
            axis_angle[J[name]] = turn
        return axis_angle, np.zeros(3)

    counting = motion_for(avatar, "counting").read(205, 206)
    walking = motion_for(avatar, "walking").read(12, 13)
    arms = {"left_shoulder": (0, -0.9, -0.4), "right_shoulder": (0, 0.9, 0.4)}
    fists = pose(**arms, left_elbow=(0, -2.0, 0), right_elbow=(0, 2.0, 0))
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


def standing(inspector: Inspector, views: dict[str, Camera], mode: str) -> list[UInt8[np.ndarray, "_ _ 3"]]:
    """These views in the canonical pose, in one view mode."""
    avatar, pictures = inspector.avatar, {}
    pose = np.asarray(avatar.canonical_pose, np.float64), np.asarray(avatar.joint_positions[0], np.float64)
    for size in {camera.size for camera in views.values()}:
        renderer = Renderer(inspector.context, [avatar], size, view=mode, background=BACKGROUND)
        for name, camera in views.items():
            if camera.size == size:
                pictures[name] = renderer.draw([pose], camera)[..., :3]
        renderer.release()
    return [pictures[name] for name in views]
