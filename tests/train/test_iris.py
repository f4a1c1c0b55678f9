"""The eyeball's flat front, from pictures of a painted eye that are traced without any of the code under test."""

import numpy as np
import pytest

from avatar.camera import Camera, look_at, pixel_rays
from capture.eyes import EyeSpheres, sphere_directions
from train.iris import ANGLES, FlatIris, disagreement, eye_front

FORWARD = np.array([0.0, 0.0, 1.0])
CENTRE, RADIUS = np.array([0.03, 0.01, 0.02]), 0.012
SIZE = 96


def paint(points: np.ndarray) -> np.ndarray:
    """A dark iris with spokes and a white round it, by place on the eye."""
    x, y = (points[..., :2] - CENTRE[:2]).T / RADIUS
    iris = np.hypot(x, y) < np.sin(np.radians(25))
    spokes = 0.35 + 0.3 * np.sin(5 * np.arctan2(y, x))
    white = 0.85 + 0.1 * np.sin(25 * x)
    return np.where(iris, spokes, white).T[..., None] * np.array([1.0, 0.8, 0.9])


def filmed(angle: float) -> list[tuple[Camera, np.ndarray]]:
    """The eye, cut at `angle` (0: a ball), from eleven sides."""
    K = np.array([[8.0 * SIZE, 0, SIZE / 2], [0, 8.0 * SIZE, SIZE / 2], [0, 0, 1]])
    views = []
    for side in np.radians(np.linspace(-50, 50, 11)):
        eye = CENTRE + 0.25 * np.array([np.sin(side), 0.1, np.cos(side)])
        camera = Camera(K, look_at(eye, CENTRE), (SIZE, SIZE))
        origins, directions = pixel_rays(camera)
        away = origins - CENTRE
        b = (away * directions).sum(1)
        root = b**2 - (away**2).sum(1) + RADIUS**2
        ball = -b - np.sqrt(np.maximum(root, 0))
        plane = (RADIUS * np.cos(angle) - away @ FORWARD) / (directions @ FORWARD)
        # the cut ball is where both are: a ray enters it where it has entered both
        enters = np.maximum(ball, plane) if angle else ball
        color = paint(origins + enters[:, None] * directions) * (root > 0)[:, None]
        views.append((camera, np.round(255 * color.reshape(SIZE, SIZE, 3)).astype(np.uint8)))
    return views


def best_angle(views: list) -> float:
    directions = sphere_directions(3000)
    directions = directions[directions @ FORWARD > np.cos(np.radians(40))]
    nothing = np.zeros((0, 3, 3))
    sums = [disagreement(CENTRE, RADIUS, eye_front(directions, FORWARD, a), nothing, views) for a in ANGLES]
    return float(np.degrees(ANGLES[np.argmin([total / weight for total, weight in sums])]))


@pytest.mark.parametrize("angle", [20, 25, 30])
def test_the_disc_of_an_iris_is_found_where_it_lies(angle):
    assert best_angle(filmed(np.radians(angle))) == pytest.approx(angle, abs=2)


def test_a_round_eye_stays_round():
    assert best_angle(filmed(0.0)) == 0


def test_a_hidden_eye_tells_nothing():
    lid = CENTRE + np.array([[[-1.0, -1, 0.05], [1, -1, 0.05], [0, 1, 0.05]]])
    surface = eye_front(np.array([FORWARD]), FORWARD, 0.0)
    assert disagreement(CENTRE, RADIUS, surface, lid, filmed(0.0))[1] == 0
    assert disagreement(CENTRE, RADIUS, surface, np.zeros((0, 3, 3)), filmed(0.0))[1] > 0


def test_a_cut_ball_is_a_ball_with_a_flat_front():
    spheres = EyeSpheres(np.array([CENTRE, -CENTRE]), np.array([RADIUS, RADIUS]))
    angle = np.radians(25)
    cut = FlatIris(FORWARD, float(angle))
    directions = sphere_directions(500)
    for middle in spheres.centres:
        surface = eye_front(directions, FORWARD, float(angle))
        np.testing.assert_allclose(cut.distance(spheres, middle + RADIUS * surface.points), 0, atol=1e-12)
    front = CENTRE + RADIUS * FORWARD
    assert spheres.distance(front[None])[0] == pytest.approx(0, abs=1e-12)
    assert cut.distance(spheres, front[None])[0] == pytest.approx(RADIUS * (1 - np.cos(angle)))
