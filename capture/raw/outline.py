"""The outline that a person stands in before the camera: the free body's, of each part as its film wants it."""

from functools import cache

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from PIL import Image, ImageDraw, ImageFilter

from avatar.body import builtin_body
from avatar.skeleton import JOINT_NUMBERS, skin_transforms
from avatar.skinning import skin_points

# metres of the picture's height, and of them above the part
HEIGHTS = {"body": (2.1, 0.17), "head": (0.42, 0.06), "hand_left": (0.38, 0.05), "hand_right": (0.38, 0.05)}
# radians that the arms hang below the T-pose in the head's film
HANGING = 1.2
# drawn so many times as large, then made smaller
FINER = 2
COLOR = (255, 214, 92)


@cache
def outline(part: str, size: tuple[int, int]) -> Image.Image:
    """A line round the part, transparent elsewhere, for a mirrored picture of `size`: the person's left is left."""
    wide, high = (FINER * side for side in size)
    tall, above = HEIGHTS[part]
    across, up = _seen(part).T
    x = wide / 2 + (across - (across.max() + across.min()) / 2) * high / tall
    y = (up.max() + above - up) * high / tall
    mask = Image.new("L", (wide, high))
    draw = ImageDraw.Draw(mask)
    corners = np.stack([x, y], -1)[builtin_body("male").faces].reshape(-1, 6)
    for triangle in corners.tolist():
        draw.polygon(triangle, fill=255)
    width = high // 200
    # what is thinner than the line, at ears and between toes, is smoothed away
    smooth = mask.filter(ImageFilter.GaussianBlur(width)).point([0] * 128 + [255] * 128)
    outer = smooth.filter(ImageFilter.MaxFilter(2 * width + 1))
    line = np.asarray(outer).astype(int) - np.asarray(smooth)
    out = Image.new("RGBA", (wide, high), COLOR)
    out.putalpha(Image.fromarray(line.astype(np.uint8)))
    return out.resize(size, Image.Resampling.BOX)


def _seen(part: str) -> Float[Array, "vertices 2"]:
    """The free body's vertices as a mirror shows them, metres: to the right and up."""
    body, pose = builtin_body("male"), np.zeros((52, 3))
    if part == "head":
        for side, sign in (("left", -1), ("right", 1)):
            pose[JOINT_NUMBERS[f"{side}_shoulder"], 2] = sign * HANGING
    x, y, z = skin_points(body.vertices, body.skin, skin_transforms(pose, body.joints, rest=np.zeros((52, 3)))).T
    # hands point along x, palms down: they are held up with the palm to the camera
    return np.stack({"hand_left": (z, x), "hand_right": (-z, -x)}.get(part, (-x, y)), -1)
