"""The face's own shape, from its keypoints in the head's video.

In the fit a detector's point may lie off its place on the free body (`Estimate.bias`). In the body's video that is the
detector's habit; in a close-up from many sides most of it is how this face differs: features are moved to where they
were seen, and the skin between follows as smoothly as it can.

    d(x) = c + sum_i w_i |x - p_i|        d(p_i) close to the bias of point i, 0 at scalp, nape and neck

the biharmonic interpolation in space (Duchon 1977), each coordinate by itself.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array
from scipy.interpolate import RBFInterpolator
from scipy.spatial import KDTree

from avatar.similarity import similarity_from_landmarks
from capture.fit.footage import Estimate, Footage
from capture.keypoints.record import FACE

# features that are on the surface: inner points, chin and ears
FEATURES = ("face_08", *FACE[17:], "left_ear", "right_ear")
# an eye goes as a whole: its points' own errors would bend an opening that is 8 mm high (eyes.py)
EYES = tuple(tuple(f"face_{first + k}" for k in range(6)) for first in (36, 42))
# share of a bias that is the face's: deviations of some 5 mm between faces, of 3 mm between detectors and our points
OWN = 0.75
# metres: skin farther from all features stays, a point of it each; and no feature moves by more
STILL, APART, FARTHEST = 0.045, 0.03, 0.015
# what a feature may be off, relative to the distance of neighbours
SMOOTHING = 0.003


def same_size(estimate: Estimate, footage: Footage) -> Estimate:
    """The estimate from where the camera sees the same, the biases freed of what moves, turns and scales all of them.

    Of a rigid head a camera can be nearer where every bias draws inwards; keypoints alone never choose that, outlines
    that take hair for a skull do. With l + b = s R l + t + e, H (l + b) + r is s (H R (l + R^T e / s) + (H t + r) / s).
    """
    places, pelvis = estimate.person.vertices(estimate.g), estimate.person.joints(estimate.g)[0]
    at = np.stack([point.place(places, estimate.person.joints(estimate.g)) for point in footage.points]) - pelvis
    T = similarity_from_landmarks(at, at + estimate.bias).transform
    scale = float(np.cbrt(np.linalg.det(T[:3, :3])))
    R, t = T[:3, :3] / scale, T[:3, 3]
    off = at + estimate.bias - (at @ T[:3, :3].T + t)
    return replace(estimate, heading=estimate.heading @ R, root=(estimate.heading @ t + estimate.root) / scale,
                   bias=off @ R / scale)  # fmt: skip


def with_own_face(estimate: Estimate, footage: Footage, head: Bool[Array, "vertices"]) -> Estimate:
    """The estimate whose face has its features where the keypoints have them; points keep their places in space.

    `head` are the vertices that go with the head alone.
    """
    places, names = estimate.person.vertices(estimate.g), list(footage.names)
    chosen = [names.index(name) for name in FEATURES if name in names]
    at = np.stack([places[footage.points[k].vertices].mean(0) for k in chosen])
    moved = OWN * estimate.bias[chosen]
    for eye in EYES:
        own = [row for row, k in enumerate(chosen) if names[k] in eye]
        if own:
            moved[own] = moved[own].mean(0)
    moved *= np.minimum(1, FARTHEST / np.maximum(np.linalg.norm(moved, axis=1, keepdims=True), 1e-9))
    still = _still(places[head], at)
    # points that share a vertex would contradict each other
    at, first = np.unique(at.round(6), axis=0, return_index=True)
    field = RBFInterpolator(
        np.concatenate([at, still]), np.concatenate([moved[first], np.zeros_like(still)]), kernel="linear",
        smoothing=SMOOTHING,
    )  # fmt: skip
    offsets = np.zeros_like(places)
    offsets[head] = field(places[head])
    bias = estimate.bias.copy()
    for k, point in enumerate(footage.points):
        if len(point.vertices):
            bias[k] -= offsets[point.vertices].mean(0)
    person = replace(estimate.person, offsets=estimate.person.offsets + offsets)
    return replace(estimate, person=person, bias=bias)


def _still(head: Float[Array, "n 3"], features: Float[Array, "k 3"]) -> Float[Array, "m 3"]:
    """Vertices of the head that stay: far from all features, and evenly apart."""
    far = head[KDTree(features).query(head)[0] > STILL]
    _, one = np.unique((far / APART).round().astype(np.int64), axis=0, return_index=True)
    return far[one]
