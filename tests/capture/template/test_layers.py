"""Hair as a layer of its own: a ball of skin with a block of hair at its side."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from avatar.skeleton import JOINTS, PARTS
from capture.folder import CaptureSubject
from capture.template.grid import DistanceGrid
from capture.template.layers import BODY, GAP, HAIR, OVERLAP, HairLayers, carved_faces, hair_layers, without_hair
from capture.template.parts import rigid_weights

RADIUS = 0.12
LOW, HIGH = np.array([0.09, -0.10, -0.05]), np.array([0.17, 0.08, 0.05])
ABOVE = 0.03  # the ball follows the head above this height, the neck below


def ball(points):
    return np.linalg.norm(points, axis=1) - RADIUS


def block(points):
    middle, half = (LOW + HIGH) / 2, (HIGH - LOW) / 2
    q = np.abs(points - middle) - half
    return np.linalg.norm(np.maximum(q, 0), axis=1) + np.minimum(q.max(1), 0)


def whole(points):
    return np.minimum(ball(points), block(points))


def person() -> CaptureSubject:
    skin = trimesh.creation.icosphere(subdivisions=4, radius=RADIUS)
    hair = trimesh.creation.box(HIGH - LOW).subdivide().subdivide().subdivide()
    hair.apply_translation((LOW + HIGH) / 2)
    first = len(skin.vertices)
    covered = block(skin.vertices[skin.faces].mean(1)) < 0
    outside = ball(hair.vertices[hair.faces].mean(1)) > 0
    vertices = np.concatenate([skin.vertices, hair.vertices])
    faces = np.concatenate([skin.faces[~covered], hair.faces[outside] + first])
    weights = rigid_weights(len(vertices))
    weights.joints[:first, 0][skin.vertices[:, 1] < ABOVE] = JOINTS.index("neck")
    part = np.full(len(vertices), PARTS.index("head"))
    return CaptureSubject("ball", vertices, vertices, faces, weights, np.zeros((52, 3)), part,
                          np.arange(len(vertices)) >= first, under_hair=skin.faces[covered],
                          carved=(first, len(vertices)))  # fmt: skip


def layers_of(distance) -> HairLayers:
    found = hair_layers(person(), distance)
    assert found is not None
    return found


@pytest.fixture(scope="module")
def layers() -> HairLayers:
    return layers_of(whole)


@pytest.fixture(scope="module")
def points() -> np.ndarray:
    axis = np.arange(-0.2, 0.2, 0.008)
    return np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)


def test_nothing_is_lost_and_nothing_added(layers, points):
    body, hair = layers.divide(points, whole(points))
    either = np.minimum(body, hair)
    inside = whole(points) < -0.003
    assert (either[inside] < 0).all()
    # a wedge between skin and hair is closed where it is narrower than a cell
    assert (either[whole(points) > 0.003] > 0).all()


@pytest.mark.parametrize(("lowest", "highest"), [(-1.0, ABOVE - 0.01), (ABOVE + 0.01, 1.0)])
def test_hair_is_hair_at_every_height_and_skin_goes_on_under_it(layers, points, lowest, highest):
    body, hair = layers.divide(points, whole(points))
    here = (points[:, 1] > lowest) & (points[:, 1] < highest)
    hanging = here & (block(points) < -0.004) & (ball(points) > 0.008)
    assert hanging.sum() > 100
    assert (hair[hanging] < 0).all() and (body[hanging] > 0).all()
    covered = here & (block(points) < 0) & (ball(points) < -0.004)
    assert covered.any()
    assert (body[covered] < 0).all() and (hair[covered] > 0).all()


def fringe(points):
    """Skin and hair as `whole` has them, and a fringe that was learned and not carved: 12 mm off the ball's top."""
    lock = np.maximum(ball(points) - 0.012, np.abs(points[:, 2]) - 0.03)
    return np.minimum(whole(points), np.maximum(lock, -points[:, 0] - 0.06))


def test_learned_hair_is_hair_where_it_joins_what_was_carved_and_bumps_apart_stay_the_bodys():
    layers = layers_of(fringe)
    up = np.radians(np.linspace(50, 100, 11))
    line = np.stack([np.cos(up), np.sin(up), 0 * up], 1)
    for radius, in_body, in_hair in ((RADIUS + 0.007, False, True), (RADIUS - 0.004, True, False)):
        body, hair = layers.divide(radius * line, fringe(radius * line))
        assert ((body < 0) == in_body).all() and ((hair < 0) == in_hair).all()
    nose = lambda points: np.minimum(whole(points), np.linalg.norm(points - [-RADIUS, 0.05, 0], axis=1) - 0.02)
    layers = layers_of(nose)
    tip = np.array([[-RADIUS - 0.012, 0.05, 0.0]])
    body, hair = layers.divide(tip, nose(tip))
    assert body[0] < 0 < hair[0]


def test_under_hair_the_surface_is_the_balls_and_normals_of_a_cut_are_the_cuts(layers):
    """Found along rays from the middle through the covered side: harmonic between what is seen round it."""
    for height in (-0.04, 0.0, 0.02):
        direction = np.array([np.sqrt(RADIUS**2 - height**2), height, 0]) / RADIUS
        line = np.outer(np.linspace(0.09, 0.15, 200), direction)
        body, _ = layers.divide(line, whole(line))
        crossing = np.linalg.norm(line[np.flatnonzero(body > 0)[0]])
        assert abs(crossing - RADIUS) < GAP
    at = np.array([[RADIUS, -0.01, 0.0]])
    forward = lambda points: np.tile([0.0, 0, 1], (len(points), 1))
    assert layers.normal(BODY, whole, forward)(at)[0, 0] > 0.95
    assert layers.normal(HAIR, whole, forward)(at - [[OVERLAP, 0, 0]])[0, 0] < -0.95


def test_sheets_deep_inside_are_closed():
    hollow = lambda points: np.maximum(whole(points), 0.02 - np.abs(ball(points) + 0.05))
    layers = layers_of(hollow)
    at = np.array([[0.05, -0.04, 0.0]])  # in the hollow, under the hair's side
    assert hollow(at)[0] > 0
    assert layers.divide(at, hollow(at))[BODY][0] < 0


def test_far_from_hair_and_in_a_bald_person_all_is_of_the_body(layers):
    far = np.array([[0.5, 0.5, 0.5], [-0.4, 0, 0]])
    grid = DistanceGrid(np.ones((4, 4, 4), np.float32), np.zeros(3, np.float32), 0.01)
    alone = HairLayers(grid, grid, grid)
    for one, points, given in ((layers, far, [0.3, -0.1]), (alone, np.full((1, 3), 0.015), [-1.0])):
        body, hair = one.divide(points, np.array(given))
        assert body.tolist() == given and (hair > 0).all()
    bare = without_hair(person())
    assert not carved_faces(bare).any()
    assert ball(bare.vertices[np.unique(bare.faces)]) == pytest.approx(0, abs=1e-6)
    assert hair_layers(replace(person(), under_hair=np.zeros((0, 3), int)), whole) is None
