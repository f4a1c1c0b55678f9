"""Hair carved from masks; what masks that are off do to it stands in tests/hard_cases/test_hair.py."""

import numpy as np
import pytest
from haired_ball import CELL, GRID, HIGH, LOW, SCALP, ball, filmed, grown, standing

from capture.template.grid import closed_surface
from capture.template.hull import ESTIMATED, GIVEN, background_share, carve, hanging
from geometry.mesh import TriangleMesh, enclosed_volume
from geometry.repair import find_faults


@pytest.mark.parametrize("pixels", [-2, 0, 2])
def test_masks_two_pixels_off_and_exact_ones_add_nothing_to_a_bald_head(pixels):
    assert standing([grown(view, pixels) if pixels else view for view in filmed(hair=False)]) is None


def test_a_scalp_that_outlines_drew_out_has_hair_all_over_where_some_stands_off_and_else_none():
    skull = ball()
    skull = skull._replace(values=skull.values + np.float32(0.013))  # hair 1.3 cm thick, the hull's margin of .6 too
    crown = (GRID[..., 1] > 0.085) & (skull.values > 0) & (skull.values < 0.004)

    def share(trust, hair=True):
        found = carve(filmed(hair), skull, SCALP, trust=trust)
        return None if found is None else (found.share[crown] > 0.5).mean()

    assert share(ESTIMATED) > 0.9 and share(ESTIMATED._replace(drawn_out=False, joined=np.inf)) < 0.1
    assert share(ESTIMATED, hair=False) is None


def test_locks_thinner_than_what_stands_off_are_hair_beside_face_and_neck_where_they_hang_together_with_it(monkeypatch):
    x, y, z = np.moveaxis(GRID, -1, 0)
    beside, cheek = ((np.abs(x) > 0.06) & (np.abs(y) < 0.03) & where for where in ((z > 0.01) & (z < 0.04), z > 0.056))
    before = (np.abs(x) < 0.04) & (z > 0) & (np.abs(y) < 0.03)
    under = (y < SCALP.neck - CELL) & (y > SCALP.neck - 0.03) & (z < 0) & (z > -0.03)

    def share(cells, thick, trust, hair=True):
        """Of a layer so thick that the template lacks, the hull's margin of .6 cm too."""
        skull = ball()
        skull = skull._replace(values=skull.values + np.float32(thick))
        found = carve(filmed(hair), skull, SCALP, trust=trust)
        layer = cells & (skull.values > 0.004) & (skull.values < thick - 0.009)
        return None if found is None else (found.share[layer] > 0.5).mean()

    apart = ESTIMATED._replace(joined=np.inf)
    assert share(beside, 0.018, ESTIMATED) > 0.9 and share(beside, 0.018, apart) < 0.05
    assert share(under, 0.026, ESTIMATED) > 0.7 and share(under, 0.026, apart) < 0.05
    assert share(before, 0.018, ESTIMATED) < 0.05
    assert share(beside, 0.018, ESTIMATED, hair=False) is None
    sinking = share(cheek, 0.018, ESTIMATED)
    monkeypatch.setattr("capture.template.hull.CHEEK", 1.0)
    assert sinking < 0.7 < 0.9 < share(cheek, 0.018, ESTIMATED)


def test_hair_under_the_neck_hangs_from_what_is_above_it_and_never_before_the_face():
    axes = [np.arange(LOW[i], HIGH[i], CELL) for i in range(3)]
    x, y, z = np.meshgrid(*axes, indexing="ij")
    plait = (np.abs(x) < 0.02) & (z < -0.08)
    free = hanging(plait | (y < SCALP.neck), axes, SCALP)
    under = free[:, np.searchsorted(axes[1], SCALP.neck) - 9]
    assert 0.02 + 2 * CELL <= np.abs(x[:, 0][under]).max() <= 0.02 + 4 * CELL
    everything = hanging(np.ones(x.shape, bool), axes, SCALP)
    assert not everything[(np.abs(x) < 0.05) & (z > 0.01) & (y < SCALP.brow - 0.01) & (y > SCALP.neck)].any()
    assert everything[y > SCALP.brow].all() and everything[(z < -0.01) & (y > SCALP.neck)].all()


def test_where_poses_are_estimated_hair_before_the_nape_has_a_narrow_edge_on_the_shoulder():
    """Cells within 1.5 cm of the skin under the neck, beside what stands off: behind the nape they stay."""
    _, y, z = np.moveaxis(GRID, -1, 0)
    close, views = (ball().values > 0) & (ball().values < 0.015) & (y < SCALP.neck), filmed(hair=True)
    near = {}
    for trust in (GIVEN, ESTIMATED):
        hair = carve(views, ball(), SCALP, trust=trust)
        assert hair is not None
        found = (hair.share > 0.5) & close
        near[trust] = int((found & (z > -0.05)).sum()), int((found & (z < -0.065)).sum())
    assert near[ESTIMATED][0] < 0.4 * near[GIVEN][0] and near[ESTIMATED][1] > 0.8 * near[GIVEN][1] > 50


def test_background_counts_pictures_that_hold_the_point_and_the_mesh_of_hair_is_closed():
    views = filmed(hair=False)
    share, seen = background_share(np.array([[0.0, 0.0, 0.0], [0.0, 0.14, 0.0], [0.0, 0.0, 5.0]]), views)
    assert seen[0] == 30 and share[0] == 0.0
    assert seen[1] == 30 and share[1] == 1.0
    assert seen[2] < 30
    hair = carve(filmed(hair=True), ball(), SCALP)
    assert hair is not None
    vertices, faces = closed_surface(0.5 - hair.share, hair.low, hair.cell, 0.5)
    assert not find_faults(faces, len(vertices))
    assert enclosed_volume(TriangleMesh(vertices, faces)) == pytest.approx(hair.share.sum() * CELL**3, rel=0.03)
