"""Eyeballs in the sockets of a template, and the opening between its lids."""

from dataclasses import replace

import numpy as np
import pytest
from painted_capture import free_subject

from avatar.rotation import fibonacci_sphere
from capture.folder import read_subject, write_subject
from capture.template.eyes import body_sockets, eye_openings, eye_spheres, fit_sphere
from command.errors import AssetError

STATED = np.array([[0.03, 0.65, 0.12, 0.016], [-0.03, 0.65, 0.12, 0.015]])


@pytest.fixture(scope="module")
def subject():
    return free_subject("male")


def spheres_of(subject):
    spheres = eye_spheres(subject)
    assert spheres is not None
    return spheres


def test_a_sphere_is_found_from_a_cap_of_it_and_points_of_a_plane_are_none():
    cap = fibonacci_sphere(2000)
    cap = cap[cap[:, 2] > 0.7]
    centre, radius = fit_sphere([1.0, 2.0, 3.0] + 0.012 * cap)
    assert np.abs(centre - [1, 2, 3]).max() < 1e-9 and abs(radius - 0.012) < 1e-9  # 64-bit least squares
    with pytest.raises(ValueError, match="not in a plane"):
        fit_sphere(np.random.default_rng(0).random((50, 3)) * [1, 1, 0])


def test_the_free_body_has_eyeballs_under_its_lids(subject):
    spheres = spheres_of(subject)
    for centre, radius, socket in zip(spheres.centres, spheres.radii, body_sockets()):
        rim = np.linalg.norm(subject.vertices[socket.rim] - centre, axis=1)
        # the lids' edges lie on the ball or up to 2.5 mm in front of it
        assert (rim - radius).min() > -0.0005 and (rim - radius).max() < 0.0025
        assert 0.011 < radius < 0.0135
    assert spheres.centres[0, 0] > 0 > spheres.centres[1, 0]


def test_stated_eyeballs_are_taken_and_follow_the_head_bone(subject):
    spheres = spheres_of(replace(subject, eyes=STATED))
    assert np.array_equal(spheres.radii, STATED[:, 3])
    # the big pose turns only the hips
    assert np.abs(spheres.centres - STATED[:, :3]).max() < 1e-9


def test_another_body_without_stated_eyeballs_has_none(subject):
    other = replace(subject, faces=subject.faces[:, [1, 2, 0]])
    assert eye_spheres(other) is None
    assert len(eye_openings(other)) == 0


def test_the_opening_is_what_the_lids_leave_free(subject):
    opening = eye_openings(subject)
    spheres = spheres_of(subject)
    assert np.abs(spheres.distance(opening)).max() < 1e-9
    for side, socket in zip((1, -1), body_sockets()):
        points, rim = opening[side * opening[:, 0] > 0], subject.vertices[socket.rim]
        low, high = rim.min(0), rim.max(0)
        # within the rim, and most of the way across it
        assert (points[:, :2] > low[:2] - 1e-3).all() and (points[:, :2] < high[:2] + 1e-3).all()
        assert (np.ptp(points[:, :2], axis=0) > 0.7 * (high - low)[:2]).all()


def test_stated_eyeballs_survive_the_file_and_one_outside_the_person_is_refused(tmp_path, subject):
    for eyes in (STATED, None):
        write_subject(tmp_path / "subject.npz", replace(subject, eyes=eyes))
        np.testing.assert_array_equal(read_subject(tmp_path / "subject.npz").eyes, eyes)
    write_subject(tmp_path / "subject.npz", replace(subject, eyes=STATED * [[1, 10, 1, 1], [1, 1, 1, 1]]))
    with pytest.raises(AssetError, match=r"eyes should hold a centre within the template.*left"):
        read_subject(tmp_path / "subject.npz")
