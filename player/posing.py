"""Where an avatar's bones are this frame, as the shaders take them, and which box of the image it can reach.

The GPU gets view_from_canonical = V B_k, multiplied in double precision: the large numbers of a body far from
the world's origin cancel before anything is rounded to float32.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from avatar.baked_avatar import Avatar, Level
from avatar.camera import Camera, view_from_world
from avatar.rotation import quaternion_from_matrix
from avatar.skeleton import joint_transforms, rigid_inverse


class PosedBones(NamedTuple):
    view_from_canonical: Float[np.ndarray, "52 4 4"]
    centers: Float[np.ndarray, "52 3"]  # joints in view space, metres
    radii: Float[
        np.ndarray, "52"
    ]  # of the sphere about each joint that holds all its bone moves; < 0: nothing


class Reach(NamedTuple):
    """What the bone spheres reach, a bound on every vertex: skinning stays inside the spheres' convex hull."""

    depth: Float[np.ndarray, "2"]  # nearest and farthest, metres along the optical axis
    box: Float[np.ndarray, "4"]  # left, top, right, bottom, pixels; infinite when the eye is inside a sphere

    def shows(self, camera: Camera) -> bool:
        """Whether any of it can be in front of the camera and inside the image."""
        left, top, right, bottom = self.box
        width, height = camera.size
        return bool(self.depth[1] > 0 and right > 0 and bottom > 0 and left < width and top < height)


class Poser:
    """Bones of one avatar; keeps what does not change from frame to frame."""

    def __init__(self, avatar: Avatar, level: Level):
        self.joints = avatar.joint_positions.astype(np.float64)
        canonical = joint_transforms(avatar.canonical_pose.astype(np.float64), self.joints)
        self.joint_from_canonical = rigid_inverse(canonical)
        self.radii = np.full(52, -1.0)
        for slot in range(4):
            moved = level.weights[:, slot] > 0
            joint = level.joints[moved, slot].astype(np.intp)
            distance = np.linalg.norm(level.positions[moved] - canonical[joint, :3, 3], axis=1)
            np.maximum.at(self.radii, joint, distance)

    def posed(
        self, axis_angle: Float[np.ndarray, "52 3"], root: Float[np.ndarray, "3"], camera: Camera
    ) -> PosedBones:
        """The bones in a pose, seen from the camera.

        Raises:
            ValueError: a number of the pose is not finite.
        """
        if not (np.isfinite(axis_angle).all() and np.isfinite(root).all()):
            raise ValueError("the pose holds a number that is not finite")
        view_from_joint = view_from_world(camera) @ joint_transforms(axis_angle, self.joints, root)
        return PosedBones(view_from_joint @ self.joint_from_canonical, view_from_joint[:, :3, 3], self.radii)


def quaternions(bones: PosedBones) -> Float[np.ndarray, "52 4"]:
    """view_from_canonical rotations, xyzw, for the direction rule (shaders/directions.glsl)."""
    return quaternion_from_matrix(bones.view_from_canonical[:, :3, :3])


def reach(bones: PosedBones, camera: Camera) -> Reach:
    """Depths and image box that the avatar cannot leave."""
    used = bones.radii >= 0
    centers, radii = bones.centers[used], bones.radii[used]
    depth = -centers[:, 2]
    bounds = np.array([(depth - radii).min(), (depth + radii).max()])
    if bounds[0] <= 0:
        return Reach(bounds, np.array([-np.inf, -np.inf, np.inf, np.inf]))
    # a sphere's image lies between the slopes (c -+ r) / depth taken at its nearer or farther end
    near, far = (depth - radii)[:, None], (depth + radii)[:, None]
    flat = np.stack([centers[:, 0], -centers[:, 1]], 1)
    low, high = flat - radii[:, None], flat + radii[:, None]
    low = np.where(low < 0, low / near, low / far).min(0)
    high = np.where(high > 0, high / near, high / far).max(0)
    (fx, skew, cx), (_, fy, cy), _ = camera.K
    slant = sorted((skew * low[1], skew * high[1]))
    box = [fx * low[0] + cx + slant[0], fy * low[1] + cy, fx * high[0] + cx + slant[1], fy * high[1] + cy]
    return Reach(bounds, np.array(box))
