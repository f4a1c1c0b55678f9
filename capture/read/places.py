"""Places of a head that a person can point at in a picture, and their vertices on a body."""

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

# metres from the tip of the nose; +x is the person's left, +z forward
SPOTS = {
    "nose_tip": (0, 0, 0), "brow": (0, 0.055, -0.02), "forehead": (0, 0.085, -0.02), "chin": (0, -0.075, -0.02),
    "left_eye": (0.036, 0.036, -0.025), "right_eye": (-0.036, 0.036, -0.025),
    "left_mouth": (0.027, -0.037, -0.02), "right_mouth": (-0.027, -0.037, -0.02),
    "left_ear": (0.085, 0.005, -0.11), "right_ear": (-0.085, 0.005, -0.11),
    "left_jaw": (0.06, -0.05, -0.07), "right_jaw": (-0.06, -0.05, -0.07),
    "crown": (0, 0.14, -0.11), "nape": (0, -0.02, -0.21),
}  # fmt: skip
# vertices of SMPL+H's mesh that its public loaders name (smplx, vertex_ids.py)
SMPLH_COUNT = 6890
SMPLH_VERTICES = {"nose_tip": 332, "left_eye": 2800, "right_eye": 6260, "left_ear": 583, "right_ear": 4071}


def landmark_vertices(rest: Float[Array, "vertices 3"], head: Bool[Array, "vertices"]) -> dict[str, int]:
    """Vertices of a dozen named places, found from the tip of the nose among the vertices marked `head`.

    On a mesh of SMPL+H's 6890 vertices the five that are published are taken as they are. A place without a
    vertex within 3.5 cm of where it is expected (hair, another face) is left out.
    """
    candidates = np.flatnonzero(head)
    points = rest[candidates]
    if not len(points):
        return {}
    frontal = points[np.abs(points[:, 0] - np.median(points[:, 0])) < 0.015]
    if not len(frontal):
        return {}
    nose = frontal[frontal[:, 2].argmax()]
    # the plane that mirrors left and right
    axis = (points[:, 0].min() + points[:, 0].max()) / 2
    middle = nose - [0, 0, 0.1]
    found = {}
    for name, offset in SPOTS.items():
        if name.startswith("right_"):
            continue
        spot = nose + offset
        # the outermost of the vertices round the spot, so that no landmark lies inside the mouth or an eye
        nearest = np.argsort(np.linalg.norm(points - spot, axis=1))[:8]
        outermost = nearest[np.linalg.norm(points[nearest] - middle, axis=1).argmax()]
        if np.linalg.norm(points[outermost] - spot) > 0.035:
            continue
        found[name] = int(candidates[outermost])
        # the other side is its mirror image
        if name.startswith("left_"):
            other = np.linalg.norm(points - (points[outermost] * [-1, 1, 1] + [2 * axis, 0, 0]), axis=1)
            if other.min() < 0.01:
                found[name.replace("left_", "right_")] = int(candidates[other.argmin()])
    return found | (SMPLH_VERTICES if len(rest) == SMPLH_COUNT else {})
