"""Rows of pose numbers: the layout that follows from their length, and expansion to 52 x 3 axis-angle vectors.

    66   root and 21 body joints (SMPL+H, SMPL-X bodies)      hands: none
    72   SMPL: the same and two hand joints, which are left out
    78   the body and 2 x 6 hand coefficients (EasyMocap)     hands = coefficients @ components + mean
    87   the same, then jaw and eyes (EasyMocap's SMPL-X)
    156  SMPL+H, hands in full: the mean is already in them, and is not added again
    165  SMPL-X, hands in full after jaw and eyes, which are left out

Where the root is given apart (EasyMocap's Rh, root_orient) the vector may lack it: 63, 69, 75, 84, 153, 162.
Coefficients need the components and the mean of the MANO hand, which are licensed: the user's own model has them.

Also what such files leave open: which way is up, and J0, where the pelvis of the file's own body rests (trans + J0 =
pelvis). Bodies stand along the vertical most of the time: the axis that the pelvis's own up direction is nearest to, on
average, is up. z-up files (AMASS, calibrated rooms) turn about x, and so do y-down ones (fits in an OpenCV camera's
frame), so that a person who faced the camera faces +z.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from avatar.body import Body, shaped
from avatar.rotation import axis_name, matrix_from_axis_angle
from avatar.skeleton import JOINTS
from command.errors import AssetError

LARGEST = 1e9  # radians or metres

FULL_HANDS = "hands: as stored (flat-hand convention; the file's hands already contain the MANO mean)"
NEEDS_MODEL = (
    "hand PCA coefficients need the components and the mean of the MANO hands: give your SMPL+H model that has "
    "hands_componentsl/r and hands_meanl/r with --body, or export 156 columns"
)
REFUSED_COLUMNS = {
    63: "63 is a body without its root: expected `root_orient` and `pose_body`",
    69: "69 is 23 joints without a root orientation, or a body with a part left out",
    75: "75 may be SMPL-X without hands or a body with hand PCA coefficients and without its root",
    78: f"78 is a body with 2 x 6 hand PCA coefficients (EasyMocap): {NEEDS_MODEL}",
    87: f"87 is EasyMocap's SMPL-X vector with 2 x 6 hand PCA coefficients: {NEEDS_MODEL}",
    153: "153 is 51 joints: the root orientation is missing",
}


class PoseLayout(NamedTuple):
    columns: int
    # the first three numbers are the root
    rooted: bool
    hands: slice | None  # both hands, left first
    # coefficients a hand; 0: axis-angle
    components: int
    note: str


def pose_layout(columns: int, *, root_apart: bool = False) -> PoseLayout | None:
    """The layout of rows of this length, None where there is none that is certain."""
    rooted = not (root_apart and columns + 3 in (66, 72, 78, 87, 156, 165))
    full = columns if rooted else columns + 3
    start = 66 if rooted else 63
    if full in (66, 72):
        extra = "; SMPL's two hand joints left out" if full == 72 else ""
        return PoseLayout(columns, rooted, None, 0, f"hands: none in the file ({columns} columns), flat{extra}")
    if full in (78, 87):
        face = ", jaw and eyes left out" if full == 87 else ""
        note = f"hands: 2 x 6 PCA coefficients ({columns} columns), expanded, mean added{face}"
        return PoseLayout(columns, rooted, slice(start, start + 12), 6, note)
    if full == 156:
        return PoseLayout(columns, rooted, slice(start, start + 90), 0, FULL_HANDS)
    if full == 165:
        note = f"{FULL_HANDS}; {columns} columns are SMPL-X: jaw and eyes left out"
        return PoseLayout(columns, rooted, slice(start + 9, start + 99), 0, note)
    return None


def readable(layout: PoseLayout, body: Body | None) -> bool:
    """Whether the body has what the layout's hands need."""
    return layout.components == 0 or (
        body is not None and body.hands is not None and body.hands.components.shape[1] >= layout.components
    )


def expanded(
    values: Float[Array, "frames columns"], layout: PoseLayout, body: Body | None = None
) -> Float[Array, "frames 52 3"]:
    """Axis-angle vectors of rows in a layout; coefficients are expanded with the body's hands."""
    pose = np.zeros((len(values), 52, 3))
    first = 0 if layout.rooted else 1
    pose[:, first:22] = values[:, : 3 * (22 - first)].reshape(len(values), 22 - first, 3)
    if layout.hands is not None:
        hands = values[:, layout.hands]
        if layout.components:
            n = layout.components
            hands = np.concatenate([hand_from_coefficients(hands[:, k * n : (k + 1) * n], k, body) for k in (0, 1)], 1)
        pose[:, 22:] = hands.reshape(len(values), 30, 3)
    return pose


def hand_from_coefficients(
    coefficients: Float[Array, "frames n"], side: int, body: Body | None
) -> Float[Array, "frames 45"]:
    """One hand (0 left, 1 right) from PCA coefficients: c @ components[:n] + mean (Romero et al. 2017).

    Raises:
        ValueError: no model with hands is given, or it has fewer components.
    """
    if body is None or body.hands is None:
        raise ValueError(NEEDS_MODEL)
    count = coefficients.shape[1]
    if count > body.hands.components.shape[1]:
        raise ValueError(f"{count} hand coefficients, {body.name} has {body.hands.components.shape[1]}")
    return coefficients @ body.hands.components[side, :count] + body.hands.mean[side]


def check_numbers(path: Path, name: str, values: Float[Array, "frames joints 3"], start: int) -> None:
    """Refuse frames with a number that is not finite, or so large that its square may not be.

    Raises:
        AssetError: names file, field, frame (counted from `start`) and joint.
    """
    with np.errstate(invalid="ignore"):
        good = np.abs(values) < LARGEST
    if not good.all():
        frame, joint, axis = (int(i) for i in np.argwhere(~good)[0])
        value = values[frame, joint, axis]
        found = f"{value:.3g}, expected below {LARGEST:g}," if np.isfinite(value) else "not finite"
        raise AssetError(f"{path}: {name} is {found} at frame {start + frame}, joint {JOINTS[joint]}")


H = np.sqrt(0.5)
TURNS = {  # quaternion xyzw that takes the axis to +y
    "+y": (0.0, 0, 0, 1), "-y": (1.0, 0, 0, 0), "+z": (-H, 0, 0, H), "-z": (H, 0, 0, H),
    "+x": (0, 0, H, H), "-x": (0, 0, -H, H),
}  # fmt: skip


def upright_of(root: Float[Array, "frames 3"]) -> Float[Array, "3"]:
    """The direction that bodies with these pelvis rotations stand along, on average."""
    return matrix_from_axis_angle(root)[:, :, 1].mean(0)


def up_axis(upright: Float[Array, "3"], notes: list[str]) -> str:
    """ "+y", "-y", "+z" ...: the axis that a direction which bodies stand along is nearest to."""
    name = axis_name(upright)
    turned = "" if name == "+y" else ", turned to y"
    notes.append(f"up: {name}, the axis the body mostly stands along (the file does not say){turned}")
    return name


# J0 of SMPL(+H) bodies of mean shape, good to about 2 cm
USUAL_PELVIS = np.array([-0.002, -0.233, 0.028])
# coefficients of people lie within 5
LARGEST_BETA = 1e3


def given_pelvis(
    betas: Float[Array, "n"], body: Body | None, notes: list[str], *, what: str = "trans + J0"
) -> tuple[Float[Array, "3"], float] | None:
    """J0 and pelvis height of the user's model in the file's shape; None where no model of the user's is given."""
    if body is not None and not body.name.startswith("builtin"):
        used = min(len(betas), body.shape_directions.shape[2])
        own = shaped(body, betas[:used])
        notes.append(f"pelvis: {what} of {body.name} with {used} of the file's {len(betas)} betas")
        return own.origin, float(-own.vertices[:, 1].min())
    if np.any(betas):
        notes.append("betas ignored: they belong to SMPL's shape space, not to the built-in body's")
    return None


def usual_pelvis(notes: list[str], *, what: str = "trans +") -> Float[Array, "3"]:
    """The usual J0, for a file without `--body`."""
    notes.append(
        f"pelvis: {what} {tuple(USUAL_PELVIS.tolist())}, the usual J0 of SMPL+H (2 cm; --body gives it exactly)"
    )
    return USUAL_PELVIS
