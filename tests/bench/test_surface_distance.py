"""Surface distances against closed forms."""

import pytest
from icosphere import icosphere
from mesh_distance import mesh_distance


def test_a_moved_sphere_has_the_mean_distance_of_the_closed_form():
    # |x + s| - r averaged over the sphere, both directions: s/2 in the limit of a small shift s
    shift = 0.002
    measured = mesh_distance(icosphere(0.3, subdivisions=5), icosphere(0.3, (shift, 0, 0), 5), count=20_000)
    assert measured.chamfer == pytest.approx(100 * shift / 2, rel=0.02)


def test_half_a_sphere_is_exact_one_way_and_incomplete_the_other():
    vertices, faces = icosphere(0.3, subdivisions=5)
    upper = faces[(vertices[faces][:, :, 1] > 0).all(1)]
    measured = mesh_distance((vertices, faces), (vertices, upper))
    assert measured.p2s == pytest.approx(0, abs=1e-6)
    assert measured.back is not None and measured.back_95 is not None
    # the farthest true sample is the other pole, sqrt(2) r off the rim
    assert 5 < measured.back < measured.back_95 < 100 * 2**0.5 * 0.3
    # all of ours is on the truth, half of the truth is on ours
    assert measured.f_5mm is not None and measured.f_1cm is not None
    assert measured.f_5mm == pytest.approx(2 / 3, abs=0.02) and measured.f_5mm < measured.f_1cm < 1


def test_f_counts_what_is_nearer_than_its_distance():
    measured = mesh_distance(icosphere(0.3, subdivisions=5), icosphere(0.307, subdivisions=5))
    assert measured.f_5mm == 0 and measured.f_1cm == 1
