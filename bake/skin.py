"""Skin weights of the baked vertices: four influences, 8 bits, each row summing to exactly 255."""

import numpy as np
from jaxtyping import Bool, Float, Integer, UInt8
from numpy import ndarray as Array

from geometry.closest import Match
from geometry.harmonic import fill_reached
from geometry.mesh import blended, component_labels, connected, half_edges

# metres from a mesh to the surface that its weights are taken from, beyond which they are filled
LIMIT = 0.03
# the limb a joint moves: torso and head, each leg, each arm, each finger
LIMBS = np.array([0, 1, 2, 0, 1, 2, 0, 1, 2, 0, 1, 2, 0, 3, 4, 0, 3, 4, 3, 4, 3, 4, *np.repeat(np.arange(5, 15), 3)])


def detached_vertices(weights: Float[Array, "n joints"], faces: Integer[Array, "faces 3"]) -> Bool[Array, "n"]:
    """Vertices that follow a limb from which they are cut off: each limb moves one piece of the mesh, its largest,
    and an islet of it on another finger or across an armpit came from the wrong side."""
    limb = np.stack([weights[:, k == LIMBS].sum(1) for k in range(LIMBS.max() + 1)], 1).argmax(1)
    pair = half_edges(faces)
    pair = pair[limb[pair[:, 0]] == limb[pair[:, 1]]]
    piece = connected(pair, len(weights))
    size = np.bincount(piece)
    _, owner = np.unique(limb + (LIMBS.max() + 1) * component_labels(faces, len(weights)), return_inverse=True)
    largest = np.zeros(owner.max() + 1, np.int64)
    np.maximum.at(largest, owner, size[piece])
    return size[piece] < largest[owner]


def transferred_weights(
    match: Match, faces: Integer[Array, "faces 3"], source_faces: Integer[Array, "source_faces 3"],
    source: Float[Array, "vertices joints"],
) -> tuple[Float[Array, "n joints"], int]:  # fmt: skip
    """Dense weights at the closest source point that faces the same way, within LIMIT, and that belongs
    to the limb that lies there; the rest is filled harmonically over the mesh `faces` (Abdrashitov et al. 2023,
    Robust Skin Weights Transfer). A piece without any such point keeps the closest weights.

    Returns:
        rows that sum to one, and how many have no such point.
    """
    weights = blended(source, source_faces[match.face], match.barycentric)
    good = match.agrees & (match.distance < LIMIT)
    if weights.shape[1] == len(LIMBS):
        good &= ~detached_vertices(weights, faces)
    weights = np.maximum(fill_reached(weights, good, faces), 0)
    return weights / weights.sum(1, keepdims=True), int((~good).sum())


def quantised(weights: Float[Array, "n joints"]) -> tuple[UInt8[Array, "n 4"], UInt8[Array, "n 4"]]:
    """The four largest weights as bytes that sum to exactly 255, by largest remainder.

    Influences are sorted by weight; an influence of weight 0 names joint 0, as glTF asks, and no joint is
    named twice with weight.
    """
    if not np.isfinite(weights).all() or (weights < 0).any() or (weights.sum(1) <= 0).any():
        raise ValueError("skin weights must be finite, not negative, and not all zero in a row")
    joints = np.argsort(-weights, axis=1, kind="stable")[:, :4]
    four = np.take_along_axis(weights, joints, 1).astype(np.float64)
    exact = 255.0 * four / four.sum(1, keepdims=True)
    whole = np.floor(exact)
    missing = np.rint(255 - whole.sum(1)).astype(np.int64)
    order = np.argsort(-(exact - whole), axis=1, kind="stable")
    rank = np.argsort(order, axis=1, kind="stable")
    whole += rank < missing[:, None]
    joints = np.where(whole > 0, joints, 0)
    return joints.astype(np.uint8), whole.astype(np.uint8)
