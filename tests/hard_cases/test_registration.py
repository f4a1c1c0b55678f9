"""Registration: a proper rotation that is right, or a refusal with its reason; never a reflection."""

import numpy as np
import pytest
from capsules import EGG, egg
from refusals import refused

from avatar.rotation import matrix_from_axis_angle
from avatar.similarity import similarity_from_landmarks
from geometry.icp import refine_by_surfaces

R0 = matrix_from_axis_angle(np.array([0.4, -1.1, 2.0]))
T0 = np.array([1.0, -2.0, 3.0])


def _points(kind: str) -> np.ndarray:
    points = np.random.default_rng(7).normal(0, 0.08, (9, 3))
    if kind == "coplanar":
        return points * [1, 1, 0]
    if kind == "nearly coplanar":
        return points * [1, 1, 1e-6]
    if kind == "three":
        return points[:3]
    if kind == "far from the origin":
        return points + 1e4
    if kind == "a symmetric cross":
        return 0.1 * np.concatenate([np.eye(3), -np.eye(3)])
    assert kind == "in space"
    return points


KINDS = ["in space", "coplanar", "nearly coplanar", "three", "far from the origin", "a symmetric cross"]


@pytest.mark.parametrize("angle", [0.0, 1e-8, 1.0, np.pi - 1e-9, np.pi])
@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("kind", KINDS)
def test_procrustes_recovers_a_known_motion(kind, scale, angle, within):
    source = _points(kind)
    R = matrix_from_axis_angle(angle * np.array([0.6, 0.0, 0.8]))
    target = scale * source @ R.T + T0
    found = similarity_from_landmarks(source, target).transform
    again = source @ found[:3, :3].T + found[:3, 3]
    within((again - target) / scale, 1e-6 if kind == "far from the origin" else 1e-9, "m")
    A = found[:3, :3] / scale
    within(A @ A.T - np.eye(3), 1e-6, "from orthonormal")
    assert np.linalg.det(A) > 0.999


@pytest.mark.parametrize("noise", [1e-6, 1e-4, 2e-3])
@pytest.mark.parametrize("kind", ["coplanar", "nearly coplanar", "three"])
def test_noise_on_flat_landmarks_never_makes_a_reflection(kind, noise, within):
    source = _points(kind)
    target = source @ R0.T + T0 + np.random.default_rng(1).normal(0, noise, source.shape)
    found = similarity_from_landmarks(source, target)
    A = found.transform[:3, :3]
    assert np.linalg.det(A) > 0
    within(found.residual / noise, 2.0, "of the noise")


@pytest.mark.parametrize("flip", [[-1, 1, 1], [1, -1, 1], [-1, -1, -1]])
def test_mirrored_landmarks_are_refused(flip):
    source = _points("in space")
    with pytest.raises(ValueError, match="mirror images; left and right may be exchanged"):
        similarity_from_landmarks(source, source * flip @ R0.T + T0)


@pytest.mark.parametrize("flip", [[-1, 1, 1], [1, -1, 1]])
def test_a_flat_set_and_its_mirror_image_are_the_same_set_turned_over(flip, within):
    source = _points("coplanar")
    found = similarity_from_landmarks(source, source * flip).transform
    within(source @ found[:3, :3].T + found[:3, 3] - source * flip, 1e-12, "m")
    assert np.linalg.det(found[:3, :3]) == pytest.approx(1)


@pytest.mark.parametrize(
    "source, reason",
    [
        (_points("in space")[:0], "at least 3"),
        (_points("in space")[:1], "at least 3"),
        (_points("in space")[:2], "at least 3"),
        (np.outer(np.linspace(0, 1, 6), [1.0, 2, 3]), "on a line"),
        (np.outer(np.linspace(0, 1, 6), [1.0, 2, 3]) + 1e-6 * _points("in space")[:6], "on a line"),
        (np.ones((5, 3)), "on a line"),
        (np.full((5, 3), np.inf), "not finite"),
    ],
)
def test_landmarks_that_determine_no_rotation_are_refused(source, reason):
    target = _points("in space")[: len(source)]
    with np.errstate(invalid="ignore"):
        for a, b in ((source, target), (target, source)):
            refused(ValueError, reason, similarity_from_landmarks, a, b)


def _motion(degrees: float, metres: float) -> np.ndarray:
    out = np.eye(4)
    out[:3, :3] = matrix_from_axis_angle(np.radians(degrees) * np.array([0.48, -0.8, 0.36]))
    out[:3, 3] = metres * np.array([0.8, -0.36, 0.48])
    return out


@pytest.mark.parametrize("outliers", [0.0, 0.1, 0.3])
@pytest.mark.parametrize("degrees, metres", [(0, 0.0), (1, 0.001), (3, 0.005), (6, 0.01)])
def test_icp_recovers_a_known_motion_to_a_micrometre_despite_outliers(degrees, metres, outliers, within):
    target, normals = egg(8000)
    known, source = _motion(degrees, metres), target[:2500].copy()
    rng = np.random.default_rng(3)
    bad = rng.random(len(source)) < outliers
    source[bad] += rng.normal(0, 0.01, (bad.sum(), 3)) + 0.004 * normals[:2500][bad]
    R, t = known[:3, :3], known[:3, 3]
    found = refine_by_surfaces((source - t) @ R, target, normals)
    within(found.transform[:3, :3] - R, 1e-6, "rotation")
    within(found.transform[:3, 3] - t, 1e-6, "m")


def test_icp_on_a_sphere_finds_the_centre_and_leaves_the_rotation(within):
    d = egg(8000)[0] / EGG
    found = refine_by_surfaces(0.1 * d[:3000] + [0.003, -0.002, 0.001], 0.1 * d, d)
    centre = found.transform[:3, :3] @ [0.003, -0.002, 0.001] + found.transform[:3, 3]
    within(centre, 3e-4, "m")
    within(found.transform[:3, :3] - np.eye(3), 0.05, "rotation nobody asked for")
    assert np.linalg.det(found.transform[:3, :3]) == pytest.approx(1)


def test_icp_on_a_plane_settles_on_it_and_slides_nowhere(within):
    rng = np.random.default_rng(0)
    plane = np.c_[rng.uniform(-0.1, 0.1, (6000, 2)), np.zeros(6000)]
    normals = np.tile([0.0, 0, 1], (6000, 1))
    known = np.eye(4)
    known[:3, :3] = matrix_from_axis_angle(np.array([0.03, -0.02, 0.0]))
    known[2, 3] = 0.004
    source = plane[:2000] @ known[:3, :3].T + known[:3, 3]
    found = refine_by_surfaces(source, plane, normals).transform
    moved = source @ found[:3, :3].T + found[:3, 3]
    within(moved[:, 2], 1e-9, "m off the plane")
    within(moved.mean(0)[:2] - source.mean(0)[:2], 1e-3, "m slid along it")
    within(np.degrees(np.arctan2(found[1, 0], found[0, 0])), 0.1, "degrees turned in it")


@pytest.mark.parametrize("gap", [0.3, 1.0, 1e6])
def test_icp_without_overlap_is_refused(gap):
    target, normals = egg(2000)
    refused(ValueError, "under 10 %", refine_by_surfaces, target + gap, target, normals)


@pytest.mark.parametrize("scale", [1e-3, 1e-2, 1e2, 1e3])
def test_icp_between_units_is_refused(scale):
    target, normals = egg(2000)
    offset = np.array([0.0, 1.6, 0.0])  # a head stands that high
    refused(ValueError, "under 10 %", refine_by_surfaces, scale * (target + offset), target + offset, normals)


@pytest.mark.parametrize("which", ["source", "target", "normal"])
def test_icp_of_numbers_that_are_not_finite_is_refused(which):
    arrays = {"source": egg(500)[0], "target": egg(500)[0], "normal": egg(500)[1]}
    arrays[which][17, 1] = np.nan
    with pytest.raises(ValueError, match=f"a {which} is not finite"):
        refine_by_surfaces(arrays["source"], arrays["target"], arrays["normal"])


def test_a_start_too_far_off_is_refused_and_not_returned():
    target, normals = egg(8000)
    with pytest.raises(ValueError, match=r"moves the head by|under 10 %|still moves"):
        refine_by_surfaces(target[:2000] + [0.035, 0, 0], target, normals, reach=0.05)
