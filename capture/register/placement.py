"""The head's place as one solve: a similarity S, moved by Gauss-Newton until all terms together cost least.

    min over S of  sum over terms of cost(S)        S <- small_similarity(delta) S,  H delta = b

A term adds its normal equations for the seven increments delta (avatar/similarity.py): Eq. 6's landmarks here, the
colors of the head's own video (head_consistency.py), the pixels of the body's (photometric.py).
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from avatar.similarity import similarity_rows, small_similarity
from geometry.icp import Anchors

# metres: a head's size, at which turn and scale are counted
ARM = 0.1
# metres: a step as small is the last
SETTLED = 2e-5


class PlaceEquations:
    """H delta = b of all terms at one place, and what the place costs; terms add to it in place."""

    def __init__(self, transform: Float[Array, "4 4"], centre: Float[Array, "3"]):
        self.transform, self.centre = transform, centre
        self.H, self.b = np.zeros((7, 7)), np.zeros(7)
        # sum of rho, and the number of residuals in it; landmarks only hold
        self.cost, self.count = 0.0, 0

    def rows(self, points: Float[Array, "n 3"]) -> Float[Array, "n 3 7"]:
        """Derivative of placed points to the increments."""
        return similarity_rows(points, self.centre, ARM)

    def add(self, J: Float[Array, "n 7"], residual: Float[Array, "n"], weight: Float[Array, "n"]) -> None:
        """Add sum of weight (residual - J delta)^2."""
        weighted = J * weight[:, None]
        self.H += weighted.T @ J
        self.b += weighted.T @ residual

    def add_landmarks(self, anchors: Anchors) -> None:
        """Eq. 6's landmarks, each coordinate over its variance."""
        placed = anchors.source @ self.transform[:3, :3].T + self.transform[:3, 3]
        K = self.rows(placed).reshape(-1, 7)
        self.add(K, (anchors.target - placed).ravel(), np.full(len(K), anchors.spread**-2))


class TriedPlace(NamedTuple):
    transform: Float[Array, "4 4"]
    residual: float  # root of the mean rho


def refine(
    start: Float[Array, "4 4"], equations_at: Callable[[Float[Array, "4 4"]], PlaceEquations], rounds: int
) -> tuple[list[TriedPlace], Float[Array, "4 4"]]:
    """The places tried, the first being the start, and the one after the last step."""
    S, tried = start, []
    for _ in range(rounds):
        at = equations_at(S)
        tried.append(TriedPlace(S, float(np.sqrt(at.cost / at.count))))
        delta = np.linalg.solve(at.H, at.b)
        S = small_similarity(delta, at.centre, ARM) @ S
        if np.abs(delta).max() < SETTLED:
            break
    return tried, S
