"""Metrics: identical and constant images, empty masks, tiny images, meshes without faces, mixed units."""

import numpy as np
import pytest
import trimesh

from bench.geometry import closest_points, mesh_distance, sample_surface, triangle_index
from bench.metrics import PooledError, flip, lpips, psnr, rectangle, ssim

IMAGE = np.random.default_rng(0).random((32, 32, 3))


def test_identical_images_have_an_infinite_psnr_that_is_said():
    score = psnr(IMAGE, IMAGE.copy())
    assert score.value is None and "infinite" in score.reason
    assert score.text() == "inf"
    assert ssim(IMAGE, IMAGE).value == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("level", [0.0, 0.5, 1.0])
def test_constant_images_score_finite_numbers(level):
    constant = np.full((16, 16, 3), level)
    assert ssim(constant, constant).value == pytest.approx(1.0, abs=1e-12)
    assert flip(constant, constant).value == pytest.approx(0.0, abs=1e-6)
    other = np.full((16, 16, 3), 0.25)
    for score in (psnr(constant, other), ssim(constant, other), flip(constant, other)):
        assert np.isfinite(score.value)


def test_an_empty_mask_has_no_score_and_says_so():
    score = psnr(IMAGE, 1 - IMAGE, np.zeros((32, 32), bool))
    assert score == (None, "no pixels to compare")
    assert PooledError().psnr().value is None
    assert rectangle(np.zeros((32, 32), bool)) is None


@pytest.mark.parametrize("side", [1, 2, 3, 4, 6, 7])
def test_images_smaller_than_the_ssim_window_use_a_smaller_one_or_say_why_not(side):
    small = IMAGE[:side, :9]
    score = ssim(small, np.clip(small + 0.1, 0, 1))
    if side < 3:
        assert score.value is None and "smaller than any SSIM window" in score.reason
    else:
        assert 0 < score.value < 1
    assert np.isfinite(flip(small, 1 - small).value)


def test_lpips_is_absent_with_its_reason():
    score = lpips(IMAGE, IMAGE)
    assert score.value is None and "weights" in score.reason


@pytest.mark.parametrize("bad, message", [(np.nan, "not finite"), (255.0, r"\[0, 1\]"), (-1.0, r"\[0, 1\]")])
def test_pixels_that_are_no_colours_are_refused(bad, message):
    broken = IMAGE.copy()
    broken[3, 4, 1] = bad
    with pytest.raises(ValueError, match=message):
        psnr(IMAGE, broken)


def test_images_of_other_shapes_are_refused():
    with pytest.raises(ValueError, match="differ in shape"):
        ssim(IMAGE, IMAGE[:-1])


def box(scale=1.0):
    mesh = trimesh.creation.box((0.4, 1.7, 0.3))
    return np.asarray(mesh.vertices) * scale, np.asarray(mesh.faces)


def test_a_mesh_without_faces_is_refused():
    vertices, faces = box()
    nothing = np.zeros((0, 3), np.int64)
    with pytest.raises(ValueError, match="no faces"):
        mesh_distance((vertices, faces), (vertices, nothing))
    with pytest.raises(ValueError, match="no faces"):
        triangle_index(vertices, nothing)
    with pytest.raises(ValueError, match="has any area"):
        sample_surface(vertices, faces, 10, seed=0, keep=np.zeros(len(faces), bool))


@pytest.mark.parametrize("truth, other", [(1.0, 100.0), (100.0, 1.0), (100.0, 100.0), (0.01, 0.01)])
def test_centimetres_against_metres_are_refused(truth, other):
    with pytest.raises(ValueError, match="metres"):
        mesh_distance(box(truth), box(other))


def test_faces_beyond_the_vertices_and_vertices_that_are_not_finite_are_refused():
    vertices, faces = box()
    with pytest.raises(ValueError, match="faces name vertices"):
        triangle_index(vertices, faces + 1)
    broken = vertices.copy()
    broken[2, 1] = np.nan
    with pytest.raises(ValueError, match="not finite"):
        mesh_distance((vertices, faces), (broken, faces))


def test_a_mesh_of_points_and_needles_still_has_a_distance():
    vertices = np.array([[0.0, 0, 0], [0, 1, 0], [0, 0.5, 0]])
    faces = np.array([[0, 0, 0], [0, 1, 2], [0, 1, 1]])
    found = closest_points(np.array([[0.3, 0.5, 0.4], [0, 2.0, 0]]), triangle_index(vertices, faces))
    np.testing.assert_allclose(found.distance, [0.5, 1.0], atol=1e-12)
