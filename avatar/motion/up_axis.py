"""Which way is up in a pose file that does not say, and the turn that makes it +y.

Bodies stand along the vertical most of the time: the axis that the pelvis's own up direction is nearest to, on
average, is taken, and the notes say which. z-up files (AMASS, calibrated rooms) turn about x, and so do
y-down ones (fits in an OpenCV camera's frame), so that a person who faced the camera faces +z.
"""

import numpy as np
from jaxtyping import Float

from avatar.rotation import matrix_from_axis_angle

Array = np.ndarray

H = np.sqrt(0.5)
TURNS = {  # quaternion xyzw that takes the axis to +y
    "+y": (0.0, 0, 0, 1), "-y": (1.0, 0, 0, 0), "+z": (-H, 0, 0, H), "-z": (H, 0, 0, H),
    "+x": (0, 0, H, H), "-x": (0, 0, -H, H),
}  # fmt: skip


def up_axis(root: Float[Array, "frames 3"], notes: list[str]) -> str:
    """ "+y", "-y", "+z" ...: the axis that the bodies with these pelvis rotations mostly stand along."""
    up = matrix_from_axis_angle(root)[:, :, 1].mean(0)
    axis = int(np.argmax(np.abs(up)))
    name = "+-"[int(up[axis] < 0)] + "xyz"[axis]
    turned = "" if name == "+y" else ", turned to y"
    notes.append(f"up: {name}, the axis the body mostly stands along (the file does not say){turned}")
    return name
