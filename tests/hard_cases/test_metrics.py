"""Metrics: identical and constant images, empty masks, tiny images, meshes without faces, mixed units."""

import numpy as np
import pytest
import trimesh
from mesh_distance import mesh_distance
from refusals import refused

from avatar.psnr import PooledError, error_between, pooled
from bench.score.metrics import checked_error, flip, pooled_score, psnr_score, rectangle, ssim
from geometry.closest import closest_points, triangle_index
from geometry.icp import rigid_icp
from geometry.sample import stratified_samples

IMAGE = np.random.default_rng(0).random((32, 32, 3))


def psnr(*compared):
    return psnr_score(checked_error(*compared))


def test_identical_images_have_an_infinite_psnr_that_is_said():
    score = psnr(IMAGE, IMAGE.copy())
    assert score.value is None and "infinite" in score.reason
    assert ssim(IMAGE, IMAGE).value == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("a, b", [(0.0, 1.0), (0.0, 1e-9), (0.5, 0.5 + 1 / 255), (1.0, 0.25)])
def test_constant_images_score_by_the_closed_form(a, b, within):
    one, other = np.full((16, 16, 3), a), np.full((16, 16, 3), b)
    assert np.isfinite(flip(one, other).value) and (abs(a - b) < 1 or flip(one, other).value > 0.9)
    within(flip(other, other).value, 1e-6)
    within(ssim(other, other).value - 1, 1e-12)
    within(psnr(one, other).value + 20 * np.log10(abs(a - b)), 1e-6, "dB")
    C1 = 0.01**2  # without variance SSIM is its luminance term alone
    within(ssim(one, other).value - (2 * a * b + C1) / (a * a + b * b + C1), 1e-9)


def test_a_single_wrong_pixel_among_many_is_counted_exactly(within):
    other = IMAGE.copy()
    other[5, 7, 1] = 1 - other[5, 7, 1]
    error = (other - IMAGE)[5, 7, 1] ** 2 / IMAGE.size
    within(psnr(IMAGE, other).value + 10 * np.log10(error), 1e-9, "dB")
    elsewhere = np.ones((32, 32), bool)
    elsewhere[5, 7] = False
    assert "infinite" in psnr(IMAGE, other, elsewhere).reason
    alone = psnr(IMAGE, other, ~elsewhere).value
    within(alone + 10 * np.log10(error * IMAGE.size / 3), 1e-9, "dB")


def test_pooling_is_the_psnr_of_all_pixels_together(within):
    other = np.clip(IMAGE + 0.1, 0, 1)
    nothing = error_between(IMAGE, other, np.zeros((32, 32), bool))  # an empty mask adds nothing
    together = pooled([error_between(IMAGE[:3], other[:3]), error_between(IMAGE[3:], other[3:]), nothing])
    within(together.psnr() - psnr(IMAGE, other).value, 1e-9, "dB")


@pytest.mark.parametrize("shape", [(0, 8, 3), (8, 0, 3), (0, 0, 3)])
def test_images_without_pixels_have_no_score_and_say_so(shape):
    nothing = np.zeros(shape)
    for score in (psnr(nothing, nothing), ssim(nothing, nothing), flip(nothing, nothing)):
        assert score.value is None and score.reason


def test_an_empty_mask_has_no_score_and_says_so():
    score = psnr(IMAGE, 1 - IMAGE, np.zeros((32, 32), bool))
    assert score == (None, "no pixels to compare")
    assert np.isnan(PooledError().psnr()) and pooled_score([]).value is None
    mask = np.zeros((20, 30), bool)
    assert rectangle(mask) is None
    mask[3, 7] = mask[11, 25] = True
    assert rectangle(mask) == (slice(3, 12), slice(7, 26))


@pytest.mark.parametrize("side", [1, 2, 3, 4, 6, 7])
def test_images_smaller_than_the_ssim_window_use_a_smaller_one_or_say_why_not(side):
    small = IMAGE[:side, :9]
    score = ssim(small, np.clip(small + 0.1, 0, 1))
    if side < 3:
        assert score.value is None and "smaller than any SSIM window" in score.reason
    else:
        assert 0 < score.value < 1
    assert np.isfinite(flip(small, 1 - small).value)


@pytest.mark.parametrize("bad, message", [(np.nan, "not finite"), (255.0, r"\[0, 1\]"), (-1.0, r"\[0, 1\]")])
def test_pixels_that_are_no_colours_are_refused(bad, message):
    broken = IMAGE.copy()
    broken[3, 4, 1] = bad
    refused(ValueError, message, psnr, IMAGE, broken)


def test_images_of_other_shapes_are_refused():
    refused(ValueError, "differ in shape", ssim, IMAGE, IMAGE[:-1])


def box(scale=1.0):
    mesh = trimesh.creation.box((0.4, 1.7, 0.3))
    return np.asarray(mesh.vertices) * scale, np.asarray(mesh.faces)


def test_a_mesh_without_faces_is_refused():
    vertices, faces = box()
    nothing = np.zeros((0, 3), np.int64)
    refused(ValueError, "no faces", mesh_distance, (vertices, faces), (vertices, nothing))
    refused(ValueError, "no faces", triangle_index, vertices, nothing)
    with pytest.raises(ValueError, match="has any area"):
        stratified_samples(vertices, faces, 10, seed=0, weight=np.zeros(len(faces), bool))


@pytest.mark.parametrize(
    "truth, other",
    [(1.0, 100.0), (100.0, 1.0), (100.0, 100.0), (0.01, 0.01), (1.0, 1000.0), (1000.0, 1.0), (1000.0, 1000.0)],
)
def test_centimetres_and_millimetres_against_metres_are_refused(truth, other):
    refused(ValueError, "metres", lambda: mesh_distance(box(truth), box(other)))


def test_faces_beyond_the_vertices_and_vertices_that_are_not_finite_are_refused():
    vertices, faces = box()
    refused(ValueError, "faces name vertices", triangle_index, vertices, faces + 1)
    broken = vertices.copy()
    broken[2, 1] = np.nan
    refused(ValueError, "not finite", mesh_distance, (vertices, faces), (broken, faces))


def test_a_mesh_of_points_and_needles_still_has_a_distance():
    vertices = np.array([[0.0, 0, 0], [0, 1, 0], [0, 0.5, 0]])
    faces = np.array([[0, 0, 0], [0, 1, 2], [0, 1, 1]])
    found = closest_points(np.array([[0.3, 0.5, 0.4], [0, 2.0, 0]]), triangle_index(vertices, faces))
    np.testing.assert_allclose(found.distance, [0.5, 1.0], atol=1e-12)


@pytest.mark.parametrize("r, R", [(0.5, 0.5), (0.5, 0.503), (0.6, 0.5)])
def test_two_spheres_are_as_far_apart_as_their_radii(r, R, within):
    inner, outer = (trimesh.creation.icosphere(5, radius) for radius in (r, R))
    found = mesh_distance((np.asarray(outer.vertices), np.asarray(outer.faces)),
                          (np.asarray(inner.vertices), np.asarray(inner.faces)), count=4000)  # fmt: skip
    flat = 100 * max(r, R) * 2.5e-4  # the triangles' middles lie under the sphere
    for value in (found.p2s, found.back, found.back_95, found.chamfer):
        within(value - 100 * abs(R - r), flat, "cm")


@pytest.mark.parametrize("turn", [0.0, 0.05, 0.2])
def test_alignment_finds_a_known_motion_and_never_a_mirror(turn, within):
    vertices, faces = box()
    middle = trimesh.Trimesh(vertices, faces).subdivide().subdivide().subdivide()
    known = trimesh.transformations.rotation_matrix(turn, [0.2, 1.0, -0.3])
    known[:3, 3] = [0.01, -0.02, 0.015]
    source = (np.asarray(middle.vertices) - known[:3, 3]) @ known[:3, :3]
    found = rigid_icp(source, triangle_index(vertices, faces), rounds=200)
    moved = source @ found[:3, :3].T + found[:3, 3]
    within(moved - np.asarray(middle.vertices), 2e-3, "m")
    assert np.linalg.det(found[:3, :3]) == pytest.approx(1)
    mirrored = rigid_icp(source * [-1, 1, 1] + [0.01, 0, 0], triangle_index(vertices, faces))
    assert np.linalg.det(mirrored[:3, :3]) == pytest.approx(1)
