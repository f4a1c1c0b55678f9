"""The built-in face: its openings, its shapes, and a damaged file."""

import numpy as np
import pytest

from avatar.body import builtin_body
from avatar.face import SHAPES
from avatar.face_template import BODY, FIELDS, builtin_face, read_face
from command.errors import AssetError

FACE = builtin_face()


@pytest.mark.parametrize("opening", [FACE.seam, *FACE.lids])
def test_both_edges_of_an_opening_run_from_one_corner_to_the_other(opening):
    upper, lower = opening
    vertices = builtin_body("male").vertices
    assert upper[0] == lower[0] and upper[-1] == lower[-1]
    assert vertices[upper[0], 0] < vertices[upper[-1], 0]
    assert vertices[upper, 1].mean() > vertices[lower, 1].mean()


@pytest.mark.parametrize("sex", ["male", "female"])
@pytest.mark.parametrize("side, lids", [("Left", FACE.lids[0]), ("Right", FACE.lids[1])])
def test_a_blink_takes_the_upper_lid_down_to_the_lower_one_of_the_same_eye(sex, side, lids):
    vertices = builtin_body(sex).vertices
    closed = vertices + FACE.offsets[SHAPES.index(f"eyeBlink{side}"), :BODY]
    gap = lambda at: at[lids[0], 1].max() - at[lids[1], 1].min()
    assert gap(closed) < 0.6 * gap(vertices)
    assert (vertices[lids[0], 0].mean() > 0) == (side == "Left")


def test_a_jaw_that_opens_moves_lower_lip_teeth_and_tongue_and_not_the_upper_ones():
    down = -FACE.offsets[SHAPES.index("jawOpen"), :, 1]
    starts = BODY + np.cumsum([0, *FACE.part_counts])
    upper, lower, tongue = (down[a:b] for a, b in zip(starts, starts[1:]))
    assert np.abs(upper).max() == 0
    assert lower.min() > 0.007 and min(lower.max(), tongue.max()) > 0.02
    assert down[FACE.seam[1][1:-1]].mean() > down[FACE.seam[0]].max()


def test_a_count_that_does_not_fit_is_refused(tmp_path):
    fields = {name: np.zeros(3, np.uint16) for name in FIELDS}
    np.savez(tmp_path / "face.npz", allow_pickle=False, **fields)
    with pytest.raises(AssetError, match="counts should be 52 that sum to the rows"):
        read_face(tmp_path / "face.npz")
