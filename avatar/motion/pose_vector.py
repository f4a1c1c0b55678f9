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


class PoseLayout(NamedTuple):
    # the first three numbers are the root
    rooted: bool
    hands: slice | None  # both hands, left first
    # coefficients a hand; 0: axis-angle
    components: int
    note: str
    # axis-angle that lacks the mean
    offsets: bool = False
    # with jaw and eyes: of SMPL-X, whose pelvis rests elsewhere
    smplx: bool = False


def pose_layout(columns: int, *, root_apart: bool = False) -> PoseLayout | None:
    """The layout of rows of this length, None where there is none that is certain."""
    rooted = not (root_apart and columns + 3 in (66, 72, 78, 87, 156, 165))
    full = columns if rooted else columns + 3
    start = 66 if rooted else 63
    if full in (66, 72):
        note = f"hands: none in the file ({columns} columns), flat"
        return PoseLayout(rooted, None, 0, note + "; SMPL's two hand joints left out" * (full == 72))
    if full in (78, 87):
        note = f"hands: 2 x 6 PCA coefficients ({columns} columns), expanded, mean added"
        note += ", jaw and eyes left out" * (full == 87)
        return PoseLayout(rooted, slice(start, start + 12), 6, note, smplx=full == 87)
    if full == 156:
        return PoseLayout(rooted, slice(start, start + 90), 0, FULL_HANDS)
    if full == 165:
        note = f"{FULL_HANDS}; {columns} columns are SMPL-X: jaw and eyes left out"
        return PoseLayout(rooted, slice(start + 9, start + 99), 0, note, smplx=True)
    return None


def readable(layout: PoseLayout, body: Body | None) -> bool:
    """Whether the body has what the layout's hands need."""
    if not layout.components and not layout.offsets:
        return True
    return body is not None and body.hands is not None and body.hands.components.shape[1] >= layout.components


def expanded(
    values: Float[Array, "frames columns"], layout: PoseLayout, body: Body | None = None
) -> Float[Array, "frames 52 3"]:
    """Axis-angle vectors of rows in a layout that is `readable`.

    Hands from PCA coefficients c are c @ components[:n] + mean, each side's (Romero et al. 2017).
    """
    pose = np.zeros((len(values), 52, 3))
    first = 0 if layout.rooted else 1
    pose[:, first:22] = values[:, : 3 * (22 - first)].reshape(len(values), 22 - first, 3)
    if layout.hands is not None:
        hands, n = np.split(values[:, layout.hands], 2, axis=1), layout.components
        if n or layout.offsets:
            assert body is not None and body.hands is not None
            if n:
                hands = [hand @ components[:n] for hand, components in zip(hands, body.hands.components, strict=True)]
            hands = [hand + mean for hand, mean in zip(hands, body.hands.mean, strict=True)]
        pose[:, 22:] = np.concatenate(hands, 1).reshape(len(values), 30, 3)
    return pose


def check_numbers(path: Path, name: str, values: Float[Array, "frames *row"], start: int, most: float = LARGEST):
    """Refuse frames with a number that is not finite, or so large that its square may not be.

    Raises:
        AssetError: names file, field, frame (counted from `start`) and, of vectors or matrices a joint, the joint.
    """
    with np.errstate(invalid="ignore"):
        good = np.abs(values) < most
    if not good.all():
        at = tuple(np.argwhere(~good)[0].tolist())
        found = f"{values[at]:.3g}, expected below {most:g}," if np.isfinite(values[at]) else "not finite"
        joint = f", joint {JOINTS[at[1]] if values.shape[1] == len(JOINTS) else at[1]}" if values.ndim > 2 else ""
        raise AssetError(f"{path}: {name} is {found} at frame {start + at[0]}{joint}")


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


# J0 of SMPL(+H) and of SMPL-X bodies of mean shape, good to about 2 cm
USUAL_PELVIS, SMPLX_PELVIS = np.array([-0.002, -0.233, 0.028]), np.array([0.003, -0.351, 0.012])


def rested_pelvis(
    betas: Float[Array, "n"], body: Body | None, notes: list[str], *, what: str = "trans + J0", smplx: bool = False
) -> tuple[Float[Array, "3"], float | None]:
    """J0 and pelvis height of the user's model in the file's shape; without one the usual J0.

    The model is SMPL+H's: of a file of SMPL-X it has neither the shape space nor J0.
    """
    model = None if body is None or body.name.startswith("builtin") else body
    if model is not None and not smplx:
        used = min(len(betas), model.shape_directions.shape[2])
        own = shaped(model, betas[:used])
        notes.append(f"pelvis: {what} of {model.name} with {used} of the file's {len(betas)} betas")
        return own.origin, float(-own.vertices[:, 1].min())
    if model is None and np.any(betas):
        notes.append("betas ignored: they belong to SMPL's shape space, not to the built-in body's")
    J0, name, better = (SMPLX_PELVIS, "SMPL-X", "") if smplx else (USUAL_PELVIS, "SMPL+H", "; --body gives it exactly")
    notes.append(f"pelvis: {what} = {tuple(J0.tolist())}, the usual one of {name} (2 cm{better})")
    return J0, None if model is None else float(-model.vertices[:, 1].min())
