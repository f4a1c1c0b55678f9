"""What a fit refuses, in one line each, before and after it was tried."""

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array
from scipy import ndimage

from avatar.skeleton import JOINTS, PARTS
from capture.fit.footage import Estimate, Footage
from capture.fit.keypoint_term import projected
from capture.fit.solve import posed_frames
from command.errors import AssetError

# frames that have to show enough points, and how many those are: many detectors see nose, eyes and ears of a head
FRAMES, POINTS = 3, {"body": 6, "head": 4, "hand_left": 6, "hand_right": 6}
# the joint whose depth is a part's: below a hand near the lens a stiff body may hang behind it
MIDDLES = {part: JOINTS.index(joint) for part, joint in zip(PARTS, ("pelvis", "head", "left_wrist", "right_wrist"))}
# share of the points that lie on the person, or nearly
ON_PERSON = 0.6
# share of the picture's shorter side, that a point may lie beside the mask
BESIDE = 0.03
# metres: median distance of points from the fit, of a part
FAR = {"body": 0.06, "head": 0.025, "hand_left": 0.025, "hand_right": 0.025}
# standard deviations, median of a frame: beyond it the frame is not believed
MISFIT = 5.0


def check_footage(part: str, footage: Footage) -> None:
    """Refuse points that nothing can be found from.

    Raises:
        AssetError: too few frames show the part, or the points lie beside the person that the masks show.
    """
    points = POINTS[part]
    enough = (footage.sure > 0).sum(1) >= points
    if enough.sum() < FRAMES:
        raise AssetError(
            f"{part} video: keypoints should show {points} points of the {part.replace('_', ' ')} or more in {FRAMES} "
            f"frames or more, do in {int(enough.sum())} of {len(enough)}"
        )
    reach = max(round(BESIDE * min(footage.size)), 1)
    on, count = 0, 0
    for mask, pixels, sure in zip(footage.masks, footage.pixels, footage.sure):
        near = ndimage.maximum_filter(mask[::4, ::4], size=2 * (reach // 4) + 1) > 127
        at = np.floor(pixels[sure > 0] / 4).astype(int)
        inside = ((at >= 0) & (at < near.shape[::-1])).all(1)
        on += int(near[at[inside, 1], at[inside, 0]].sum())
        count += int(inside.sum())
    if on < ON_PERSON * count:
        raise AssetError(
            f"{part} video: keypoints should lie on the person of the masks, {on / max(count, 1):.0%} do: are they of "
            f"this video, frame by frame?"
        )


def check_upright(footage: Footage) -> None:
    """Refuse a body's video whose ankles are above its shoulders (AssetError)."""

    def height(part: str) -> float:
        rows = [k for k, name in enumerate(footage.names) if name.endswith(part)]
        seen = footage.sure[:, rows] > 0
        return float(np.median(footage.pixels[:, rows, 1][seen])) if seen.any() else np.nan

    if height("ankle") < height("shoulder"):
        raise AssetError("body video: feet should be below the shoulders, are above: is the video upside down?")


def misfits(estimate: Estimate, footage: Footage) -> Float[Array, "frames points"]:
    """Distance of each point from the fit, pixels; NaN where not seen."""
    away = np.linalg.norm(projected(estimate, footage, posed_frames(estimate)) - footage.pixels, axis=-1)
    return np.where(footage.sure > 0, away, np.nan)


def check_fit(part: str, estimate: Estimate, footage: Footage) -> Bool[Array, "frames"]:
    """Which frames the fit explains.

    Raises:
        AssetError: the points are too far from everything that a person can do, or the fit is no number.
    """
    if not (np.isfinite(estimate.g).all() and np.isfinite(estimate.root).all()):
        raise AssetError(f"{part} video: no person fits its keypoints: the equations have no finite solution")
    away = misfits(estimate, footage)
    depth = -posed_frames(estimate).place[:, MIDDLES[part], 2]
    far = float(np.nanmedian(away * depth[:, None])) / estimate.camera(footage).K[0, 0]
    if not far <= FAR[part]:
        raise AssetError(
            f"{part} video: keypoints should lie within {100 * FAR[part]:g} cm of a person's (median), lie "
            f"{100 * far:.0f} cm off: are they of this video, and of one person?"
        )
    weighed = away * footage.sure
    middle = np.array([np.nanmedian(row) if np.isfinite(row).any() else 0.0 for row in weighed])
    return middle <= MISFIT
