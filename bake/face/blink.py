"""A blink that fits one person: the upper lid's edge comes down to the lower one's, and lids stay outside of the ball.

Seen from the ball's center a lid turns: from where its edge is to where the lower edge is. The template's blink, whose
opening is another, is scaled so that it does, by a factor of where along the lid a vertex lies.
"""

import numpy as np
from jaxtyping import Bool, Float, Integer
from numpy import ndarray as Array

from bake.face.template import FaceRefused

# metres off the ball at which lids lie at rest, at least, and at which they end when they close
AT_REST, CLOSED = 0.0003, 0.0004
# metres that the upper edge ends below the lower one
OVER = 0.0003
# metres round the ball's middle in which lids are kept outside of it
LIDS = 0.02
# by how much less or more than the template's a lid moves, and metres along it over which that is smoothed
FACTORS, ALONG = (0.05, 1.8), 0.0025
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
    edge = points[loop] - center
    upper = edges_of_lids(edge)
    low = edge[~upper] + blink[loop[~upper]]
    order = np.argsort(low[:, 0])
    across, height = low[order, 0], low[order, 1]
    top, moved = edge[upper], blink[loop[upper]]
    wanted = top[:, 1] - np.interp(top[:, 0] + moved[:, 0], across, height) + OVER
    factor = np.clip(wanted / np.maximum(-moved[:, 1], 1e-4), *FACTORS)
    # corners hardly move: their factor says nothing
    weight = np.maximum(-moved[:, 1], 0)
    if not weight.max() > 0.002:
        raise FaceRefused("its template's lids do not close over its eyes")
    x, order = points[:, 0] - center[0], np.argsort(top[:, 0])
    near = np.clip(x, top[:, 0].min(), top[:, 0].max())
    kernel = np.exp(-0.5 * np.square((near[:, None] - top[None, order, 0]) / ALONG)) * weight[order] + 1e-12
    scale = (kernel * factor[order]).sum(1) / kernel.sum(1)
    beside = np.maximum(np.maximum(top[:, 0].min() - x, x - top[:, 0].max()), 0) / ALONG
    scale = np.minimum(scale, 1 + (FACTORS[1] - 1) * np.clip(1 - beside, 0, 1))
    of_upper = np.clip((points[:, 1] - center[1] - np.interp(x, across, height)) / 0.002, 0, 1)
    return blink * (1 + of_upper * (scale - 1))[:, None]


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
