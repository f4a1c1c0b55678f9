"""Image alignment: pictures that lie elsewhere say by how much."""

import numpy as np
import pytest

from capture.fit.pixels import compare_pixels

ROWS, COLUMNS = np.mgrid[:40, :50]


def blob(x, y):
    return np.exp(-((COLUMNS + 0.5 - x) ** 2 / 50 + (ROWS + 0.5 - y) ** 2 / 80))


def solved(found):
    A = found.slope * found.weight[:, None]
    return np.linalg.solve(A.T @ found.slope, A.T @ found.residual)


@pytest.mark.parametrize("move", [(0.0, 0.0), (0.3, -0.2), (-0.1, 0.4)])
def test_a_small_move_is_found(move):
    found = compare_pixels(blob(25, 20), blob(25 + move[0], 20 + move[1]), (ROWS.ravel(), COLUMNS.ravel()), 10.0)
    np.testing.assert_allclose(solved(found), move, atol=0.02)
    assert (found.cost == 0) == (move == (0.0, 0.0))


def test_what_differs_for_another_reason_counts_little():
    seen = blob(25.3, 20)
    seen[:6, :6] += 5.0
    found = compare_pixels(blob(25, 20), seen, (ROWS.ravel(), COLUMNS.ravel()), 0.2)
    assert found.weight.reshape(ROWS.shape)[:6, :6].max() < 1e-5
    np.testing.assert_allclose(solved(found), (0.3, 0.0), atol=0.02)
