"""Where head and hands are in a picture: rectangles of pixels round what their bones move most."""

import numpy as np
from jaxtyping import Float

from avatar.baked_avatar import Avatar
from avatar.camera import Camera, project
from avatar.skeleton import skin_transforms
from avatar.skinning import skin_points

# joints: the head, wrists and fingers
PARTS = {"head": (15,), "hand_left": (20, *range(22, 37)), "hand_right": (21, *range(37, 52))}
# pixels round a part that what it does to its edge can reach
MARGIN = 3
# pixels; of a smaller part no score can be given
SMALLEST = 7


def part_boxes(
    avatar: Avatar, axis_angle: Float[np.ndarray, "52 3"], root: Float[np.ndarray, "3"], camera: Camera
) -> dict[str, tuple[slice, slice]]:
    """Rows and columns of each part that is in the picture."""
    level = avatar.levels[0]
    bones = skin_transforms(axis_angle, avatar.joint_positions, root, rest=avatar.canonical_pose)
    pixels, depth = project(camera, skin_points(level.positions, level.skin, bones).astype(np.float64))
    heaviest = np.take_along_axis(level.joints, level.weights.argmax(1)[:, None], 1)[:, 0]
    width, height = camera.size
    boxes = {}
    for name, joints in PARTS.items():
        points = pixels[np.isin(heaviest, joints) & (depth > 0)]
        if not len(points):
            continue
        left, top = np.clip(points.min(0) - MARGIN, 0, (width, height)).astype(int)
        right, bottom = np.clip(np.ceil(points.max(0)) + MARGIN, 0, (width, height)).astype(int)
        if min(right - left, bottom - top) >= SMALLEST:
            boxes[name] = slice(int(top), int(bottom)), slice(int(left), int(right))
    return boxes
