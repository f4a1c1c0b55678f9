"""The preset that learns nothing: the template, painted as the videos show it."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from tiny import tiny_training

from avatar.skeleton import PARTS
from capture.folder import read_capture
from capture.light.seen_colors import seen_colors
from train.command import TrainOptions
from train.networks import ColorInputs
from train.networks.seen import SeenNetworks
from train.preset import PREVIEW
from train.run import read_run

SMALL = replace(
    PREVIEW,
    parts=tuple(replace(part, cell=max(part.cell, 0.006), spacing=max(part.spacing, 0.006)) for part in PREVIEW.parts),
    surface_cells=(0.03, 0.015, 0.008),
    light=False,
    hair=replace(PREVIEW.hair, reach=0.0),
)


@pytest.fixture(scope="module")
def painted(tiny_capture, tmp_path_factory):
    return read_run(tiny_training(tiny_capture, tmp_path_factory.mktemp("painted") / "run", preset=SMALL))


@pytest.mark.slow
def test_a_preview_is_a_run_like_any_other_whose_surface_is_the_template(painted, tiny_capture):
    subject = read_capture(tiny_capture, parts=()).subject
    assert painted.preset.name == "preview" and set(painted.provenance["parts"]) == set(painted.preset.names)
    assert all(part["steps"] == 0 for part in painted.provenance["parts"].values())
    body = subject.vertices[subject.part == 0]
    distance = painted.field.distance(torch.as_tensor(body, dtype=torch.float32))
    assert distance.abs().median() < 0.002


@pytest.mark.slow
def test_a_preview_shows_the_colors_of_the_videos(painted, tiny_capture):
    capture = read_capture(tiny_capture)
    colors = seen_colors(capture, {})
    assert np.isfinite(colors).all() and colors.min() >= 0 and colors.max() <= 1
    body = capture.subject.part == 0
    points = torch.as_tensor(capture.subject.vertices[body], dtype=torch.float32)
    shown = painted.field.color(points, torch.zeros_like(points) + torch.tensor([0.0, 0.0, -1.0]))
    video = capture.videos["body"]
    filmed = np.concatenate([image[mask] for image, mask in zip(video.images, video.masks)]) / 255
    assert np.abs(shown.mean(0).numpy() - filmed.mean(0)).max() < 0.1
    assert np.abs(shown.numpy() - colors[body]).mean() < 0.03


def test_vertices_that_no_video_shows_take_their_neighbours_color(tiny_capture):
    capture = read_capture(tiny_capture)
    for video in capture.videos.values():
        video.masks[:] = False
    assert (seen_colors(capture, {}) == 0.5).all()


def test_of_people_fitted_here_the_heads_video_paints_nothing_under_the_chin(tiny_capture):
    made = read_capture(tiny_capture)
    made.videos["head"].images[:] = [0, 204, 0]
    here = replace(made, facts={**made.facts, "source": "video"})
    subject, chin = made.subject, made.chin
    low = (subject.part == PARTS.index("head")) & (subject.vertices[:, 1] < chin - 0.005)
    green = np.linalg.norm(seen_colors(made, {}) - [0, 0.8, 0], axis=1) < 0.02
    painted = np.linalg.norm(seen_colors(here, {}) - [0, 0.8, 0], axis=1) < 0.02
    # what neither video shows is filled from its neighbours
    assert (low & green).sum() > 100 and (low & painted).sum() < 0.3 * (low & green).sum()
    high = subject.vertices[:, 1] > chin + 0.02
    assert (painted & high).sum() > 0.9 * (green & high).sum() > 500


def test_a_color_grid_gives_back_its_nodes_and_is_linear_between_them():
    color = SeenNetworks(cell=0.5).build(3, torch.tensor([1.0, 0.5, 0.5]), 0.01).color
    places = color.places()
    color.values.copy_(places.T.reshape(color.values.shape))
    points = torch.rand(50, 3, generator=torch.Generator().manual_seed(0)) * 2 - 1
    nothing = torch.zeros(50, 1)
    torch.testing.assert_close(color(ColorInputs(points, nothing, points, points, nothing)), points, rtol=0, atol=1e-6)


def test_steps_of_a_preset_that_learns_nothing_are_refused(tmp_path):
    with pytest.raises(ValueError, match="--iterations: the preset preview learns nothing"):
        TrainOptions(capture=tmp_path, out=tmp_path / "run", preset="preview", iterations=10)
