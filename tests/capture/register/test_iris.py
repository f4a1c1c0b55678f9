"""The eyeball's flat front, from pictures of painted eyes."""

import numpy as np
import pytest
from painted_eyes import FORWARD, filmed

from avatar.rotation import fibonacci_sphere
from capture.register.iris import ANGLES, FlatIris, disagreement, eye_front
from capture.template.eyes import EyeSpheres

CENTRE, RADIUS = np.array([0.03, 0.01, 0.02]), 0.012


def best_angle(views: list) -> float:
    directions = fibonacci_sphere(3000)
    directions = directions[directions @ FORWARD > np.cos(np.radians(40))]
    nothing = np.zeros((0, 3, 3))
    sums = [disagreement(CENTRE, RADIUS, eye_front(directions, FORWARD, a), nothing, views) for a in ANGLES]
    return float(np.degrees(ANGLES[np.argmin([total / weight for total, weight in sums])]))


@pytest.mark.parametrize("angle", [20, 25, 30])
def test_the_disc_of_an_iris_is_found_where_it_lies(angle):
    assert best_angle(filmed([CENTRE], [RADIUS], np.radians(angle))) == pytest.approx(angle, abs=2)


def test_a_round_eye_stays_round():
    assert best_angle(filmed([CENTRE], [RADIUS], 0.0)) == 0


def test_a_hidden_eye_tells_nothing():
    lid = CENTRE + np.array([[[-1.0, -1, 0.05], [1, -1, 0.05], [0, 1, 0.05]]])
    surface = eye_front(np.array([FORWARD]), FORWARD, 0.0)
    assert disagreement(CENTRE, RADIUS, surface, lid, filmed([CENTRE], [RADIUS], 0.0))[1] == 0
    assert disagreement(CENTRE, RADIUS, surface, np.zeros((0, 3, 3)), filmed([CENTRE], [RADIUS], 0.0))[1] > 0


def test_a_cut_ball_is_a_ball_with_a_flat_front():
    spheres = EyeSpheres(np.array([CENTRE, -CENTRE]), np.array([RADIUS, RADIUS]))
    angle = np.radians(25)
    cut = FlatIris(FORWARD, float(angle))
    directions = fibonacci_sphere(500)
    for middle in spheres.centres:
        surface = eye_front(directions, FORWARD, float(angle))
        np.testing.assert_allclose(cut.distance(spheres, middle + RADIUS * surface.points), 0, atol=1e-12)
    front = CENTRE + RADIUS * FORWARD
    assert spheres.distance(front[None])[0] == pytest.approx(0, abs=1e-12)
    assert cut.distance(spheres, front[None])[0] == pytest.approx(RADIUS * (1 - np.cos(angle)))
