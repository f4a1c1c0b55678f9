"""What is made solid inside a template, never the air in front of it, and what follows the head bone alone (Eq. 4)."""

import numpy as np
import pytest
import torch
import trimesh
from painted_ball import rigid_subject

from avatar.skeleton import PARTS
from avatar.skinning import dense_weights
from capture.folder import CaptureSubject, read_capture
from capture.template.parts import HEAD, part_boxes, with_rigid_head
from capture.template.solid import outer_air, solid_inside
from geometry.mesh import TriangleMesh, concatenated
from train.fused import part_weight


def lined_shoe() -> CaptureSubject:
    """A coarse ball, and in it the fine lining of its front, which faces inwards as a shoe's does; a head above
    and something below: what is lowest is searched for folds."""
    ball = trimesh.creation.icosphere(subdivisions=0, radius=0.1)
    lining = trimesh.creation.icosphere(subdivisions=4, radius=0.075)
    front = lining.triangles_center[:, 2] > 0.04
    balls = [TriangleMesh(ball.vertices + [0, y, 0], ball.faces) for y in (0, 1, -1)]
    vertices, faces = concatenated([*balls, TriangleMesh(lining.vertices, lining.faces[front][:, ::-1])])
    return rigid_subject(vertices, faces, np.where(vertices[:, 1] > 0.5, PARTS.index("head"), PARTS.index("body")))


def test_air_before_a_lining_stays_air_and_what_is_inside_becomes_solid():
    shoe = lined_shoe()
    # between the ball's corners the nearest four vertices are the lining's
    rays = trimesh.creation.icosphere(subdivisions=3).vertices
    solid = solid_inside(lambda points: np.full(len(points), 0.03), shoe)
    for distance in (0.14, 0.16):
        assert (solid(distance * rays) == 0.03).all()
    assert (solid(0.05 * rays[rays[:, 2] < -0.8]) < 0).mean() > 0.8


def test_outer_air_is_outside_and_not_near_the_surface_and_a_hole_three_centimetres_wide_lets_none_in():
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.1)
    rays = trimesh.creation.icosphere(subdivisions=2).vertices
    # the hole is 2.8 cm wide
    for faces in (ball.faces, ball.faces[ball.triangles_center[:, 2] < 0.099]):
        air = outer_air(ball.vertices, faces)
        assert air(0.15 * rays).all() and air(9.0 * rays).all()
        assert not air(0.05 * rays).any() and not air(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.07]])).any()
        if faces is ball.faces:
            assert not air(0.1 * rays).any()


@pytest.fixture(scope="module")
def subject(tiny_capture):
    return read_capture(tiny_capture).subject


def test_the_head_is_rigid_where_only_it_has_a_weight_and_nothing_changes_below_the_overlap(subject):
    share = part_weight(torch.as_tensor(subject.vertices), part_boxes(subject)[1]).numpy()
    before, after = dense_weights(subject.skin), dense_weights(with_rigid_head(subject).skin)
    alone, below = share == 1, share <= 0.5
    assert alone.sum() > 100 and below.sum() > 100
    assert np.abs(after[alone, HEAD] - 1).max() < 1e-6
    np.testing.assert_allclose(after[below], before[below], atol=1e-6)
    np.testing.assert_allclose(after.sum(1), 1, atol=1e-6)
    assert (before[alone, HEAD] < 0.99).any()  # the body model's own weights bend it
