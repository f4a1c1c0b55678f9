"""Rays through the boxes of the bones: where they are cut, what they show, and how a picture refines."""

import numpy as np
import pytest
import torch
from posed_fields import NearField, view_of

from avatar.camera import orbit_camera
from bench.field_boxes import OFFSETS, Boxes, PosedVolume, box_spans, draw_boxes, progressive, spread
from bench.field_volume import crossing, draw_volume, section_weights
from player.context import open_context
from player.raster import Rasteriser
from train import render

BETA = 0.0015


def along_z(*ranges: tuple[float, float]) -> Boxes:
    """Boxes of unit width about the z axis."""
    low = np.array([[-0.5, -0.5, a] for a, _ in ranges])
    high = np.array([[0.5, 0.5, b] for _, b in ranges])
    return Boxes(low, high, np.tile(np.eye(4), (len(ranges), 1, 1)))


def test_a_ray_is_cut_evenly_inside_boxes_that_may_overlap_and_skips_what_lies_between():
    boxes = along_z((5, 6), (1, 2), (1.5, 3), (1.2, 1.4))
    begin, length = box_spans(boxes, np.zeros((1, 3)), np.array([[0.0, 0, 1]]))
    assert length.sum() == pytest.approx(3)
    found = spread(begin, length, 7)
    np.testing.assert_allclose(found[0], [1, 1.5, 2, 2.5, 3, 5.5, 6])


def test_boxes_behind_the_eye_or_beside_the_ray_are_none():
    boxes = along_z((-3, -2), (1, 2), (-1, 0.5))
    rays = np.array([[0.0, 0, 1], [0.0, 1, 0], [0, 0, -1]])
    begin, length = box_spans(boxes, np.array([[0.0, 0, 0], [0, 0, 4], [0, 0, 0]]), rays)
    np.testing.assert_allclose(length.sum(1), [1.5, 0, 2])
    # the eye stands in a box: its piece begins at the eye
    assert begin[0][length[0] > 0].min() == 0


def test_a_box_is_met_in_its_own_frame():
    boxes = along_z((0, 1))
    moved = np.eye(4)
    moved[:3, :3] = [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]
    moved[:3, 3] = [0, 0, 10]
    begin, length = box_spans(boxes._replace(box_from_world=moved[None]), np.zeros((1, 3)), np.array([[1.0, 0, 0]]))
    # box z = 10 - world x
    assert begin[0, 0] == pytest.approx(9) and length[0, 0] == pytest.approx(1)


def test_weights_and_crossings_are_those_of_training():
    rng = np.random.default_rng(0)
    distance, ends = rng.normal(0, 0.01, (50, 9)), rng.normal(size=(50, 9, 3))
    distance[0], distance[1] = 5.0, -5.0
    weights = render.section_weights(torch.tensor(distance), BETA).weights.numpy()
    np.testing.assert_allclose(section_weights(distance, BETA), weights, atol=1e-12)
    points = render.crossing(torch.tensor(distance), torch.tensor(ends)).numpy()
    np.testing.assert_allclose(crossing(distance, ends), points, atol=1e-12)


@pytest.fixture(scope="module")
def drawn():
    """A bent body by rays through boxes as they refine, and beside them the band round its surface."""
    field = view_of(NearField)
    pose = np.zeros((52, 3))
    pose[0], pose[18, 1] = (0, 0.8, 0.1), -1.0
    camera = orbit_camera((0, 0, 0), 3.2, 0.4, 0.1, (48, 48))
    context = open_context()
    raster = Rasteriser(context)
    try:
        band = draw_volume(field, raster, pose, np.zeros(3), camera, beta=BETA, sections=32)
    finally:
        raster.release()
        context.release()
    volume = PosedVolume(field, pose, np.zeros(3))
    whole = draw_boxes(volume, camera, beta=BETA, sections=64)
    return band, whole, list(progressive(volume, camera, beta=BETA, sections=64, samples=3))


def test_rays_through_boxes_show_what_the_band_round_the_surface_shows(drawn):
    band, whole, _ = drawn
    assert band.mask.sum() > 100
    assert (whole.mask & band.mask).sum() > 0.93 * band.mask.sum()
    assert (whole.mask & ~band.mask).sum() < 0.1 * band.mask.sum()
    inside = whole.mask & band.mask
    assert np.median(np.abs(whole.color - band.color)[inside]) < 0.01


def test_a_picture_refines_from_a_quarter_of_the_resolution_to_accumulated_samples(drawn):
    _, whole, stages = drawn
    assert len(stages) == 5
    np.testing.assert_array_equal(stages[2], whole.color)
    errors = [np.square(stage - stages[-1]).mean() for stage in stages[:-1]]
    assert errors[0] > errors[1] > errors[2] > errors[3]
    np.testing.assert_allclose(np.sum(OFFSETS, axis=0), 0, atol=1e-12)
