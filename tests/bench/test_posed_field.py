"""Which direction the field is asked at for a pixel: the global one, the pixel's own, or that inside the cone."""

from pathlib import Path

import numpy as np
import pytest
import torch
from painted_capture import free_subject
from scipy import ndimage
from scipy.spatial import KDTree

from avatar.camera import orbit_camera, pixel_rays
from avatar.rotation import matrix_from_axis_angle
from avatar.skeleton import BIG_POSE
from bench.field.posed_field import PosedField
from bench.field.rungs import draw_volume, field_rungs
from bench.ladder.rung_pictures import ComparedFrame
from train.fused import FusedField
from train.preset import DEMO
from train.run import Run
from train.surface import Surface

TURN = np.array([0.0, 0.8, 0.1])
SIZE = (96, 96)


class DirectionField(FusedField):
    """A field whose color is the direction it is asked at; every point is on its surface."""

    def __init__(self):
        torch.nn.Module.__init__(self)

    def distance(self, points):
        return torch.zeros(len(points))

    def color(self, points, directions):
        return 0.5 + 0.5 * directions


@pytest.fixture(scope="module")
def view():
    return view_of(lambda vertices, faces: DirectionField())


def test_volume_rendering_shows_the_surface_and_converges(rasteriser):
    """Many thin sections of a thin surface show its color where the rays hit it; few are near, in this order."""
    view = view_of(NearField)
    pose = np.zeros((52, 3))
    pose[0], pose[18, 1] = TURN, -1.0
    camera = orbit_camera((0, 0, 0), 3.2, 0.4, 0.1, SIZE)
    surface = view.draw(rasteriser, pose, np.zeros(3), camera, directions="cone")
    pictures = [
        draw_volume(view, rasteriser, (pose, np.zeros(3)), camera, beta=0.0008, sections=count)
        for count in (2, 8, 32, 64)
    ]
    best = pictures[-1]
    assert (best.mask & surface.mask).sum() > 0.9 * surface.mask.sum()
    inside = ndimage.binary_erosion(surface.mask & best.mask, iterations=2)
    assert np.abs(best.color - surface.color)[inside].mean() < 0.01
    errors = [np.square(picture.color - best.color).mean() for picture in pictures[:-1]]
    assert errors[0] > errors[1] > errors[2] and errors[2] < 1e-5


def test_the_rungs_of_a_run_are_its_surface_and_its_volume(context):
    run = run_of(NearField)
    pose = np.zeros((52, 3)), np.zeros(3)
    camera = orbit_camera((0, 0, 0), 3.2, 0.4, 0.1, (48, 48))
    volume, surface = field_rungs(run, context, [ComparedFrame(pose, camera, None)], 1.0)
    assert (surface.row["name"], volume.row["name"]) == ("field, surface", "field, volume of 64")
    for rung in (surface, volume):
        assert rung.row["times_faster"] == pytest.approx(1 / rung.row["ms_median"], rel=1e-2, abs=2e-5)
    assert surface.row["bytes"] == volume.row["bytes"] == 4000
    both = (surface.pictures[0].max(-1) > 0) & (volume.pictures[0].max(-1) > 0)
    assert both.sum() > 100
    assert np.median(np.abs(surface.pictures[0] - volume.pictures[0])[both]) < 0.02


@pytest.fixture(scope="module")
def drawn(view, rasteriser):
    """Directions asked for at covered pixels, by mode, and the pixels' rays; the whole person turned by TURN."""
    pose = np.zeros((52, 3))
    pose[0] = TURN
    pose[[1, 2]] = BIG_POSE[[1, 2]]  # the canonical pose but for the turn: every bone turns alike
    camera = orbit_camera((0, 0, 0), 3.2, 0.4, 0.1, SIZE)
    pictures = {
        mode: view.draw(rasteriser, pose, np.zeros(3), camera, directions=mode) for mode in ("global", "own", "cone")
    }
    mask = pictures["own"].mask
    rays = pixel_rays(camera)[1].reshape(*SIZE, 3)[mask]
    return {mode: 2 * picture.color[mask] - 1 for mode, picture in pictures.items()}, rays


def test_pixels_ask_along_the_axis_their_own_ray_or_a_cone_between_the_two(drawn):
    asked, rays = drawn
    assert len(asked["global"]) > 300
    np.testing.assert_allclose(asked["global"], np.tile([0, 0, -1], (len(asked["global"]), 1)), atol=1e-6)
    canonical = rays @ matrix_from_axis_angle(TURN)  # R^T d, row by row
    np.testing.assert_allclose(asked["own"], canonical, atol=1e-5)
    to_axis = {mode: np.arccos(np.clip(-d[:, 2], -1, 1)) for mode, d in asked.items()}
    assert to_axis["own"].max() > 0.5 and to_axis["own"].min() > 0.02
    assert (to_axis["cone"] < to_axis["own"]).all() and (to_axis["cone"] > 0.01).all()
    assert to_axis["cone"].max() < 0.2  # 1.6 deviations of .1: nowhere beyond what was seen


def run_of(make_field):
    """The built-in body as a run's surface, over a field made for its canonical vertices."""
    subject = free_subject("male")
    count = len(subject.vertices)
    surface = Surface(
        vertices=subject.vertices,
        faces=subject.faces,
        normals=np.tile([0.0, 0, 1], (count, 1)),
        part=np.zeros(count, np.int64),
        skin=subject.skin,
        view_count=np.full(count, 40.0),
        view_mean=np.tile([0.0, 0, -0.9], (count, 1)),
        view_covariance=np.tile([0.01, 0, 0, 0.01, 0, 0], (count, 1)),
        layer=np.zeros(count, np.int64),
    )
    return Run(Path("run"), make_field(subject.vertices, subject.faces), surface, subject, DEMO, {})


def view_of(make_field):
    """The same ready for drawing."""
    return PosedField(run_of(make_field))


class NearField(FusedField):
    """The signed distance to the tangent plane of the nearest vertex, in smooth stripes."""

    def __init__(self, vertices, faces):
        torch.nn.Module.__init__(self)
        corners = vertices[faces]
        normals = np.zeros_like(vertices)
        np.add.at(normals, faces, np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, None])
        self.tree, self.at = KDTree(vertices), vertices
        self.register_buffer("weights", torch.zeros(1000))
        self.normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)

    def distance(self, points):
        points = points.double().numpy()
        near = self.tree.query(points)[1]
        return torch.as_tensor(((points - self.at[near]) * self.normals[near]).sum(1)).float()

    def normal(self, points):
        return torch.as_tensor(self.normals[self.tree.query(points.double().numpy())[1]]).float()

    def color(self, points, directions):
        return 0.5 + 0.3 * torch.sin(20 * points)
