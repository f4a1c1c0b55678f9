"""A blink that fits one person: the upper lid's edge comes down to the lower one's, and lids stay outside of the ball.

Seen from the ball's center a lid turns: from where its edge is to where the lower edge is. The template's blink, whose
opening is another, is scaled so that it does, by a factor of where along the lid a vertex lies.
"""

import numpy as np
from jaxtyping import Bool, Float, Integer
from numpy import ndarray as Array

from bake.face.lips import by_x
from bake.face.template import FaceRefused

# metres off the ball at which lids lie at rest, at least, and at which they end when they close
AT_REST, CLOSED = 0.0003, 0.0004
# metres that the upper edge ends below the lower one, and by how much more for a metre that it stands off farther, at
# most FARTHER: from 25 degrees below no view goes between them
OVER, BELOW, FARTHER = 0.0003, 0.47, 0.003
# metres round the ball's middle in which lids are kept outside of it
LIDS = 0.02
# by how much less or more than the template's a lid moves, and metres along it over which that is smoothed
FACTORS, ALONG = (0.05, 1.8), 0.0025
# metres over the lower lid up to which skin is of the upper one; from twice as far on nothing of it moves: brows stay
BROWS = 0.012
# metres of skin above the upper edge that make up for what it lacks
ABOVE = 0.004
STEPS = np.linspace(0, 1, 9)


def edges_of_lids(loop: Float[Array, "n 3"]) -> Bool[Array, "n"]:
    """Which vertices of the edge round a ball are of the upper lid: between the corners, the half that lies higher."""
    first, last = int(loop[:, 0].argmin()), int(loop[:, 0].argmax())
    upper = np.zeros(len(loop), bool)
    a, b = sorted((first, last))
    upper[a + 1 : b] = True
    rest = ~upper
    rest[[a, b]] = False
    if loop[upper, 1].mean() < loop[rest, 1].mean():
        upper = rest
    return upper


def fitted_blink(
    points: Float[Array, "n 3"], blink: Float[Array, "n 3"], loop: Integer[Array, "loop"], center: Float[Array, "3"],
) -> Float[Array, "n 3"]:  # fmt: skip
    """The offsets of a blink with which the upper edge of `loop` ends on the lower one.

    Raises:
        FaceRefused: the template's blink does not close this eye.
    """
    edge, moved = points[loop] - center, blink[loop]
    upper = edges_of_lids(edge)
    closed = edge + moved
    away = np.linalg.norm(closed, axis=1)
    low = by_x(np.c_[closed[:, :2], away][~upper])
    top = edge[upper]
    if not -moved[upper, 1].min() > 0.002:
        raise FaceRefused("its template's lids do not close over its eyes")
    end, deep = (np.interp(closed[upper, 0], low[:, 0], low[:, k]) for k in (1, 2))
    wanted = top[:, 1] - end + OVER + BELOW * np.clip(away[upper] - deep, 0, FARTHER)
    down = np.maximum(-moved[upper, 1], 1e-4)
    # corners hardly move: their factor says nothing
    corner = np.minimum(top[:, 0] - top[:, 0].min(), top[:, 0].max() - top[:, 0])
    weight = down * np.clip(corner / ALONG, 0.01, 1)
    x, height = points[:, 0] - center[0], points[:, 1] - center[1]
    within = np.clip(x, top[:, 0].min(), top[:, 0].max())
    kernel = np.exp(-0.5 * np.square((within[:, None] - top[:, 0]) / ALONG)) * weight + 1e-12
    scale = (kernel * np.clip(wanted / down, *FACTORS)).sum(1) / kernel.sum(1)
    scale = np.minimum(scale, 1 + (FACTORS[1] - 1) * np.clip(1 - np.abs(x - within) / ALONG, 0, 1))
    over_lower = height - np.interp(x, low[:, 0], low[:, 1])
    below_brow = np.clip(2 - over_lower / BROWS, 0, 1)
    of_upper = np.clip(over_lower / 0.002, 0, 1) * below_brow
    fitted = blink * (below_brow * (1 + of_upper * (scale - 1)))[:, None]
    # what the edge still lacks, it gets with the skin just above it
    lacks = by_x(np.c_[top[:, 0], wanted + fitted[loop[upper], 1], top[:, 1]])
    above = np.clip(1 - (height - np.interp(x, lacks[:, 0], lacks[:, 2])) / ABOVE, 0, 1) * of_upper
    inwards = np.clip(np.minimum(x - lacks[0, 0], lacks[-1, 0] - x) / (0.5 * ALONG), 0, 1)
    fitted[:, 1] -= above * inwards * np.interp(x, lacks[:, 0], lacks[:, 1])
    return fitted


def outside(
    points: Float[Array, "n 3"], offsets: Float[Array, "n 3"], center: Float[Array, "3"], radius: float
) -> Float[Array, "n 3"]:
    """The offsets, with which no vertex comes nearer to the ball than CLOSED on its straight way."""
    offsets = offsets.copy()
    for _ in range(4):
        for step in STEPS[1:]:
            at = points + step * offsets - center
            length = np.linalg.norm(at, axis=1)
            short = np.maximum(radius + CLOSED - length, 0)
            offsets += (short / step / np.maximum(length, 1e-9))[:, None] * at
    return offsets


def pushed_out(points: Float[Array, "n 3"], center: Float[Array, "3"], radius: float) -> Float[Array, "n 3"]:
    """Lids at rest, none nearer to the ball than AT_REST."""
    offset = points - center
    length = np.linalg.norm(offset, axis=1, keepdims=True)
    return center + offset * np.maximum(1, (radius + AT_REST) / length)
