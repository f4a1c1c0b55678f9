"""Sections that are short where a ray meets the template, and rays that a bad normal does not lose."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from turning_capture import turning_capture

from capture.template import surface_cloud
from train.field import FieldSample
from train.objective import Batch, FieldFunctions, RayTensors, render_rays
from train.parts import part_boxes
from train.preset import DEMO, PAPER
from train.rays import BEHIND, Focus, focused_ends, part_rays
from train.template_grid import template_grid

STEP = 0.002
REACH = 0.003


def ends_of(distance, ends=14, reach=REACH):
    """Places of the ends on one ray, metres; `distance` at the beginning of each step and at the last end."""
    pairs = np.stack([distance[:-1], distance[1:]], 1)
    step, into = focused_ends(np.array([0]), pairs, reach, ends)
    return ((step + into) * STEP)[0]


def test_sections_are_as_long_as_they_are_far_from_the_surface():
    distance = 0.03 - STEP * np.arange(16)  # down to the surface
    at = ends_of(distance)
    assert at[0] == 0 and at[-1] == pytest.approx(0.03, abs=1e-9)
    # equal shares of log(1 + d / reach): each end's reach + d is a constant factor of the one before
    factor = np.diff(np.log(REACH + 0.03 - at))
    assert np.ptp(factor) < 1e-6 and (factor < 0).all()
    assert np.diff(at)[-1] < 0.0007 and np.diff(at)[0] > 0.004


def test_a_ray_along_the_surface_has_even_sections():
    at = ends_of(np.full(21, 0.002))
    assert np.abs(np.diff(at) - 20 * STEP / 13).max() < 1e-9


def test_behind_a_thin_part_sections_are_short_again_but_fewer():
    lid = np.abs(np.arange(31) * STEP - 0.02) - 0.005  # 1 cm thick, from 15 to 25 mm
    wall = 0.05 - np.arange(31) * STEP  # and a wall at 50 mm
    at = ends_of(np.minimum(lid, wall), ends=40)
    middle, length = 0.5 * (at[1:] + at[:-1]), np.diff(at)
    shortest = {place: length[np.abs(middle - place) < 0.003].min() for place in (0.015, 0.05)}
    far = length[np.abs(middle - 0.037) < 0.003].min()
    assert shortest[0.05] < far
    assert shortest[0.05] == pytest.approx(shortest[0.015] / BEHIND, rel=0.3)


def test_rays_do_not_share_their_sections():
    one, two = 0.03 - STEP * np.arange(16), 0.01 + STEP * np.arange(11)
    pairs = np.concatenate([np.stack([d[:-1], d[1:]], 1) for d in (one, two)])
    step, into = focused_ends(np.array([0, 15]), pairs, REACH, 14)
    assert np.abs((step + into)[0] * STEP - ends_of(one)).max() < 1e-9
    assert np.abs((step + into)[1] * STEP - 15 * STEP - ends_of(two)).max() < 1e-9


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    return turning_capture(tmp_path_factory.mktemp("focus") / "test")


@pytest.fixture(scope="module")
def cloud(capture):
    return surface_cloud(capture.subject, 2, np.ones(len(capture.subject.faces), bool), 0.006)


def rays_of(capture, cloud, focus):
    return part_rays(capture.videos["hand_left"], capture.subject, cloud, part_boxes(capture.subject)[2],
                     DEMO.parts[2].band, ends=14, per_frame=300, canonical_from_head=None,
                     rng=np.random.default_rng(0), background=0.2, focus=focus)  # fmt: skip


@pytest.fixture(scope="module")
def focus(capture, cloud):
    extent = part_boxes(capture.subject)[2].extent
    return Focus(template_grid(cloud, extent.low, extent.high, 0.003), 0.002)


def crossing_lengths(rays, focus):
    """Length of the section in which each ray first meets the template."""
    distance, _ = focus.distance(rays.ends.reshape(-1, 3).astype(np.float64))
    distance = distance.reshape(rays.ends.shape[:2])
    enters = (distance[:, :-1] > 0) & (distance[:, 1:] <= 0)
    meets = enters.any(1)
    length = np.linalg.norm(np.diff(rays.ends, axis=1), axis=2)
    return length[np.arange(len(length)), enters.argmax(1)][meets]


def test_focused_rays_are_the_same_rays_with_shorter_sections_where_they_meet_the_hand(capture, cloud, focus):
    even, dense = rays_of(capture, cloud, None), rays_of(capture, cloud, focus)
    # about the same rays: the closed distance judges a few at the rim otherwise
    assert abs(len(even.ends) - len(dense.ends)) < 0.02 * len(even.ends)
    assert even.ends.shape[1] == dense.ends.shape[1]
    assert np.median(crossing_lengths(dense, focus)) < 0.6 * np.median(crossing_lengths(even, focus))


def test_a_bad_normal_loses_rays_that_the_closed_distance_keeps(capture, cloud, focus):
    rng = np.random.default_rng(1)
    normals = cloud.normals.copy()
    # the march takes every fourth sample
    hand = np.flatnonzero((cloud.part == 2) & (np.arange(len(normals)) % 4 == 0))
    normals[rng.choice(hand, len(hand) // 20, replace=False)] *= -1
    bad = replace(cloud, normals=normals)
    whole, by_grid = rays_of(capture, cloud, focus), rays_of(capture, bad, focus)
    by_normal = rays_of(capture, bad, None)
    # of a hand of 64 pixels 2 % graze the template between its samples whatever its normals
    assert by_grid.lost == whole.lost < 0.03
    assert by_normal.lost > 2 * whole.lost
    assert len(by_grid.ends) == len(whole.ends) > 1.03 * len(by_normal.ends)


def test_the_papers_rays_are_even_its_sockets_closed_its_crossings_fixed():
    assert all(part.focus == 0 for part in PAPER.parts)
    assert not PAPER.attached


@pytest.mark.parametrize("attached", [False, True])
def test_color_moves_the_surface_within_its_section_only_where_attached(attached):
    """A wall at z = p, painted z: seen along z its colour is p, and the colour's derivative by p is 1."""
    preset = replace(DEMO, sections=12, shaded=1, attached=attached)
    p = torch.tensor(0.5, requires_grad=True)
    ends = torch.zeros(1, 14, 3)
    ends[0, :, 2] = torch.linspace(0.37, 0.63, 14)
    rays = RayTensors(ends, torch.zeros(1, 14, dtype=torch.long), torch.tensor([[0.0, 0, 1]]), torch.zeros(1).long(),
                      torch.zeros(1, 3), torch.ones(1), None, torch.zeros(1, 4).long(), torch.ones(1, 4))  # fmt: skip

    def gradient(points, *, create_graph, attached=False):
        return FieldSample(p - points[:, 2], torch.zeros(len(points), 1)), torch.tensor([[0.0, 0, -1]])

    field = FieldFunctions(
        displacement=lambda points, frame: torch.zeros_like(points),
        distance=lambda points: p - points[:, 2],
        gradient=gradient,
        color=lambda points, *_: points[:, 2:].expand(-1, 3),
    )
    drawn = render_rays(field, rays, Batch(torch.tensor([0]), torch.tensor([0.3]), 1e-4), preset)
    assert drawn.color[0, 0].item() == pytest.approx(0.5, abs=1e-5)
    (slope,) = torch.autograd.grad(drawn.color[0, 0], p)
    assert slope.item() == pytest.approx(1.0 if attached else 0.0, abs=1e-3)
