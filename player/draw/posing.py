"""Where an avatar's bones are this frame, as the shaders take them, and which box of the image it can reach.

The GPU gets view_from_canonical = V B_k, multiplied in double precision: the large numbers of a body far from
the world's origin cancel before anything is rounded to float32.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from avatar.baked_avatar import Avatar, Level
from avatar.camera import Camera, view_from_world
from avatar.helper_joints import HelperJoints
from avatar.skeleton import joint_transforms, rigid_inverse, skin_transforms
from avatar.skinning import skin_points
from player.draw import kinematics
from player.gl.tiles import ball_boxes


class PosedBones(NamedTuple):
    """The 52 joints, then the helper joints of an avatar that has them."""

    view_from_canonical: Float[np.ndarray, "bones 4 4"]
    centers: Float[np.ndarray, "bones 3"]  # joints in view space, metres
    radii: Float[np.ndarray, "bones"]  # a sphere about each joint holds all that its bone moves; < 0: nothing


class ScreenBounds(NamedTuple):
    """Depths and box of the image that the bone spheres reach: a bound on every vertex, since skinning stays inside the
    spheres' convex hull."""

    # nearest and farthest, metres along the optical axis
    depth: Float[np.ndarray, "2"]
    # left, top, right, bottom, pixels; infinite when the eye is inside a sphere
    box: Float[np.ndarray, "4"]

    def shows(self, camera: Camera) -> bool:
        """Whether any of it can be in front of the camera and inside the image."""
        left, top, right, bottom = self.box
        width, height = camera.size
        return bool(self.depth[1] > 0 and right > 0 and bottom > 0 and left < width and top < height)


class Poser:
    """Bones of one avatar; keeps what no frame changes. Its spheres hold the surface at all these levels of detail."""

    def __init__(self, avatar: Avatar, *levels: Level):
        self.joints = avatar.joint_positions.astype(np.float64)
        # whether it has a face that can move
        self.faced = avatar.eyes is not None
        pose = avatar.canonical_pose.astype(np.float64)
        canonical = joint_transforms(pose, self.joints)
        self.helpers = None if levels[0].twist is None else HelperJoints(self.joints, avatar.bend)
        canonical = self._with_helpers(pose, canonical)
        self.joint_from_canonical = rigid_inverse(canonical)
        self.chain = kinematics.Chain(self.joints)
        self.radii = np.full(len(canonical), -1.0)
        for level in levels:
            joints, weights = level.drawn_skin
            for slot in range(4):
                moved = weights[:, slot] > 0
                joint = joints[moved, slot].astype(np.intp)
                distance = np.linalg.norm(level.positions[moved] - canonical[joint, :3, 3], axis=1)
                np.maximum.at(self.radii, joint, distance)

    def posed(self, axis_angle: Float[np.ndarray, "52 3"], root: Float[np.ndarray, "3"], camera: Camera) -> PosedBones:
        """The bones in a pose, seen from the camera.

        Raises:
            ValueError: a number of the pose is not finite.
        """
        if not (np.isfinite(axis_angle).all() and np.isfinite(root).all()):
            raise ValueError("the pose holds a number that is not finite")
        view_from_joint = self.chain.transforms(axis_angle, root, view_from_world(camera))
        view_from_joint = self._with_helpers(axis_angle, view_from_joint)
        return PosedBones(view_from_joint @ self.joint_from_canonical, view_from_joint[:, :3, 3], self.radii)

    def _with_helpers(
        self, axis_angle: Float[np.ndarray, "52 3"], outer_from_joint: Float[np.ndarray, "52 4 4"]
    ) -> Float[np.ndarray, "bones 4 4"]:
        """The joints' transforms, and behind them those of the helper joints, if there are any."""
        return outer_from_joint if self.helpers is None else self.helpers.with_helpers(axis_angle, outer_from_joint)


def quaternions(bones: PosedBones) -> Float[np.ndarray, "bones 4"]:
    """view_from_canonical rotations, xyzw, for the direction rule (shaders/directions.glsl)."""
    return kinematics.quaternions(bones.view_from_canonical[:, :3, :3])


def dual_parts(bones: PosedBones, real: Float[np.ndarray, "bones 4"]) -> Float[np.ndarray, "bones 4"]:
    """t q / 2 of each bone, t its translation and q its rotation `real`, for shaders/skinning_dual.glsl."""
    t, u, w = bones.view_from_canonical[:, :3, 3], real[:, :3], real[:, 3:]
    out = np.empty((len(real), 4))
    out[:, :3] = 0.5 * (w * t + np.cross(t, u))
    out[:, 3] = -0.5 * np.einsum("ni,ni->n", t, u)
    return out


def screen_bounds(bones: PosedBones, camera: Camera) -> ScreenBounds:
    """Depths and image box that the avatar cannot leave."""
    used = np.flatnonzero(bones.radii >= 0)
    centers, radii = bones.centers[used], bones.radii[used]
    depth = np.array([(-centers[:, 2] - radii).min(), (radii - centers[:, 2]).max()])
    boxes = ball_boxes(centers, radii, camera)
    return ScreenBounds(depth, np.concatenate([boxes[:, :2].min(0), boxes[:, 2:].max(0)]))


def posed_vertices(avatar: Avatar, level: Level, pose: Sequence[np.ndarray]) -> Float[np.ndarray, "vertices 3"]:
    """The avatar's vertices in the world, by linear blend skinning."""
    joints, canonical = avatar.joint_positions.astype(np.float64), avatar.canonical_pose.astype(np.float64)
    transforms = skin_transforms(pose[0], joints, pose[1], canonical)
    return skin_points(level.positions.astype(np.float64), level.skin, transforms)


def grounded(
    avatar: Avatar, axis_angle: Float[np.ndarray, "52 3"], root: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "3"]:
    """The root moved up or down so that the lowest point touches the ground; metres.

    Taken from a coarse level, of 3,000 triangles in a baked avatar: soles of 1,000 lie 3 mm higher.
    """
    lowest = float(posed_vertices(avatar, avatar.level(2), (axis_angle, np.zeros(3)))[:, 1].min())
    return np.array([root[0], -lowest, root[2]])
