"""Left and right that a detector exchanged, put back where the fit says so."""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool
from numpy import ndarray as Array

from avatar.rotation import axis_angle_from_matrix, matrix_from_axis_angle
from capture.fit.directions import opposite
from capture.fit.footage import Estimate, Footage
from capture.fit.keypoint_term import projected
from capture.fit.solve import posed_frames

# standard deviations beyond which a point says no more
FAR = 10.0
# by how much of that, for each exchanged pair, the exchange has to be better
MARGIN = 4.0
GROUPS = {
    "arms": ("shoulder", "elbow", "wrist", "hand", "thumb", "index", "middle", "ring", "pinky"),
    "legs": ("hip", "knee", "ankle", "heel", "big", "small"),
    "head": ("eye", "ear"),
}


def group_of(name: str) -> str:
    """Points that a detector exchanges together; "" where there is but one side."""
    side, _, rest = name.partition("_")
    if side not in ("left", "right"):
        return ""
    part = rest.split("_")[0].rstrip("123")
    return next((group for group, parts in GROUPS.items() if part in parts), "")


def exchanged_back(footage: Footage, frames: Bool[Array, "frames"]) -> Footage:
    """The footage with left and right of all points exchanged in some frames."""
    other = opposite(footage.names)
    pixels, sure = footage.pixels.copy(), footage.sure.copy()
    pixels[frames], sure[frames] = pixels[frames][:, other], sure[frames][:, other]
    return replace(footage, pixels=pixels, sure=sure)


def sides_restored(estimate: Estimate, footage: Footage) -> Footage:
    """The footage with points of arms, legs or head exchanged in frames where they lie nearer to the other side.

    Nearer as the frame is posed, or as it would be between the frames beside it: exchanged points bend their own
    frame until they lie well.
    """
    other = opposite(footage.names)
    groups = np.array([group_of(name) for name in footage.names])
    pixels, sure = footage.pixels.copy(), footage.sure.copy()
    drawn = (projected(estimate, footage, posed_frames(e)) for e in (estimate, between_neighbours(estimate)))
    for f, places in enumerate(zip(*drawn)):
        misfits = [
            [
                np.minimum(((at - footage.pixels[f, order]) ** 2).sum(1) * footage.sure[f, order] ** 2, FAR**2)
                for order in (np.arange(len(other)), other)
            ]
            for at in places
        ]
        for group in GROUPS:
            mine = np.flatnonzero(groups == group)
            pairs = (mine[:, None] == other[mine]).any() and (footage.sure[f, mine] > 0).sum() / 2
            gains = [as_named[mine].sum() - exchanged[mine].sum() for as_named, exchanged in misfits]
            if pairs and max(gains) > MARGIN * pairs:
                pixels[f, mine], sure[f, mine] = footage.pixels[f, other[mine]], footage.sure[f, other[mine]]
    return replace(footage, pixels=pixels, sure=sure)


def between_neighbours(estimate: Estimate) -> Estimate:
    """Every frame but the first and last halfway between the poses of the ones beside it."""
    root, heading, angles = estimate.root.copy(), estimate.heading.copy(), estimate.angles.copy()
    root[1:-1] = (estimate.root[:-2] + estimate.root[2:]) / 2
    angles[1:-1] = (estimate.angles[:-2] + estimate.angles[2:]) / 2
    turn = axis_angle_from_matrix(np.swapaxes(estimate.heading[:-2], 1, 2) @ estimate.heading[2:])
    heading[1:-1] = estimate.heading[:-2] @ matrix_from_axis_angle(turn / 2)
    return replace(estimate, root=root, heading=heading, angles=angles)
