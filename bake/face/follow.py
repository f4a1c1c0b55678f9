"""A coarser level whose face follows the finest one's: each vertex moves as a mean of four of those does.

So the file has the shapes once: a vertex takes 14 bytes, where targets of its own would take as many for each of the
shapes that move it, a dozen on the mean.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float, Float32
from numpy import ndarray as Array
from scipy.optimize import nnls
from scipy.spatial import KDTree

from avatar.baked_avatar import Level
from avatar.face import FaceShapes, Follow, followed
from bake.skin import quantised

# vertices of the finest level, the nearest, of which four are taken; steps of the search for their weights
NEAREST, MOST = 24, 1000
# how much a sum of weights beside 1, and a whole weight of a vertex that lies a metre away or in the same place, count
# beside a metre of displacement
SUM, AWAY, ANY = 1.0, 0.02, 2e-5


def following(finest: Level, level: Level) -> Level:
    """The level, its shapes those that four vertices of the finest level make of them, as near as they come.

    Vertices in one place that move alike follow alike: what touched before touches at every shape.
    """
    face, own = finest.face, level.face
    assert face is not None and own is not None, "asked of levels with a face"
    still = np.setdiff1d(np.arange(int(face.balls[0, 0])), face.vertices)
    sources = np.r_[face.vertices, still].astype(np.int64)
    moves = np.pad(face.offsets, ((0, 0), (0, len(still)), (0, 0)))
    found = KDTree(finest.positions[sources]).query(level.positions[own.vertices], k=NEAREST)
    away, near = (np.asarray(value) for value in found)
    wanted = own.offsets.swapaxes(0, 1)
    weights = np.stack([shares(moves[:, rows], *pair) for rows, *pair in zip(near, wanted, away)])
    columns, whole = quantised(weights)
    chosen = sources[np.take_along_axis(near, columns.astype(np.int64), 1)].astype(np.uint32)
    follow = Follow(chosen, whole)
    offsets = followed(face, follow)
    moving = offsets.any((0, 2))
    follow = Follow(chosen[moving], whole[moving])
    return replace(level, face=FaceShapes(own.vertices[moving], offsets[:, moving], own.balls, follow))


def shares(
    moves: Float32[Array, "52 near 3"], wanted: Float32[Array, "52 3"], away: Float[Array, "near"]
) -> Float[Array, "near"]:
    """Weights of at most four of the candidates, so far `away`, whose sum of moves comes nearest to the wanted one."""
    count = len(away)
    system = np.r_[moves.transpose(0, 2, 1).reshape(-1, count), np.full((1, count), SUM), np.diag(AWAY * away + ANY)]
    target = np.r_[wanted.reshape(-1), SUM, np.zeros(count)].astype(np.float64)
    found = nnls(system, target, maxiter=MOST)[0]
    four = np.argsort(-found, kind="stable")[:4]
    out = np.zeros(len(found))
    out[four] = nnls(system[:, four], target, maxiter=MOST)[0]
    return out
