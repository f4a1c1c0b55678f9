"""The template's distance with open lids and eyeballs behind them, on the free body."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from avatar.body import builtin_body
from avatar.skeleton import BIG_POSE, skin_transforms
from avatar.skinning import skin_points
from capture.eyes import body_sockets, eye_covers, eye_openings, eye_spheres
from capture.folder import CaptureSubject
from capture.imports.template import part_of
from capture.template import neck_height, surface_cloud, visible_faces
from train import run as run_folder
from train.eye_grid import FINER, with_open_eyes
from train.networks.triplane import TriPlaneNetworks
from train.parts import part_boxes
from train.preset import DEMO
from train.template_grid import HELD, LEAST, FineGrid, TemplateGrid, template_grid


@pytest.fixture(scope="module")
def subject():
    body = builtin_body("male")
    canonical = skin_points(body.vertices, body.skin, skin_transforms(BIG_POSE, body.joints, rest=np.zeros((52, 3))))
    part = part_of(body.skin).astype(np.int64)
    hair = np.zeros(len(part), bool)
    return CaptureSubject("man", body.vertices, canonical, body.faces, body.skin, body.joints, part, hair)


@pytest.fixture(scope="module")
def closed(subject):
    extent = part_boxes(subject)[1].extent
    cloud = surface_cloud(subject, 1, visible_faces(subject), 0.003)
    return template_grid(cloud, extent.low, extent.high, 0.003, (subject, neck_height(subject)))


@pytest.fixture(scope="module")
def opened(subject, closed):
    return with_open_eyes(closed, subject)


def asked(grid, points):
    return grid(torch.as_tensor(points, dtype=torch.float32)).numpy()


def first_crossing(grid, points, direction, far=0.03):
    """How far in front of `points`, going back against `direction`, the distance first falls under zero."""
    steps = np.linspace(far, -far, 601)
    along = asked(grid, (points[:, None] + steps[:, None] * direction).reshape(-1, 3)).reshape(len(points), -1)
    return steps[(along <= 0).argmax(1)]


def test_what_is_seen_between_the_lids_is_the_eyeball(subject, opened):
    points = eye_openings(subject)
    spheres = eye_spheres(subject)
    assert spheres is not None
    # straight in front of the balls' middles
    middle = points[np.abs(points[:, None, :2] - spheres.centres[:, :2]).max(2).min(1) < 0.002]
    assert len(middle) > 4
    forward = np.array([0, 0, 1.0])
    off = np.abs(first_crossing(opened, middle, forward))
    # beside a lid's edge the lid may be met first
    assert np.quantile(off, 0.8) < 0.0003 and off.max() < 0.002


def test_lids_stay_where_the_template_has_them(subject, closed, opened):
    spheres = eye_spheres(subject)
    assert spheres is not None
    sockets = body_sockets()
    skin = np.setdiff1d(np.arange(len(subject.vertices)), np.concatenate([socket.inside for socket in sockets]))
    ball = spheres.distance(subject.vertices[skin])
    lids = subject.vertices[skin[(ball > 0.0015) & (ball < 0.0045)]]
    assert len(lids) > 50
    off = np.abs(asked(opened, lids))
    assert off.mean() < 0.0005 and np.quantile(off, 0.9) < 0.001
    assert off.mean() < 0.6 * np.abs(asked(closed, lids)).mean()


def test_nothing_is_hollow_behind_the_lids(subject, opened):
    spheres = eye_spheres(subject)
    assert spheres is not None
    for centre, radius, cover in zip(spheres.centres, spheres.radii, eye_covers(subject, spheres)):
        held = np.isfinite(cover.length)
        shares = np.linspace(0, 1, 30)[:, None]
        reach = np.minimum(cover.length[held], radius + 0.004)[:, None, None] - 0.0005
        inside = asked(opened, (centre + reach * shares * cover.directions[held][:, None]).reshape(-1, 3))
        # rays that pass a lid's edge within a cell may see past it
        assert (inside > 0.0005).mean() < 0.01


def test_the_fine_box_joins_the_coarse_grid_without_a_step(opened):
    fine = opened.fine
    assert fine is not None and fine.cell == pytest.approx(opened.cell / FINER) and fine.cell <= 0.0015
    rng = np.random.default_rng(0)
    low = fine.low.numpy().astype(np.float64)
    size = fine.cell * (np.array(fine.values.shape) - 1)
    for axis in range(3):
        for side in (0.0, 1.0):
            place = rng.random((200, 3))
            place[:, axis] = side
            step = np.zeros(3)
            step[axis] = 1e-6 if side else -1e-6
            face = low + size * place
            # micrometres of slope over 2e-6 m, and float32
            assert np.abs(asked(opened, face + step) - asked(opened, face - step)).max() < 2e-5


def test_value_and_gradient_are_of_one_interpolant_inside_the_fine_box(opened):
    fine = opened.fine
    assert fine is not None
    size = fine.cell * (torch.tensor(fine.values.shape) - 1)
    points = (fine.low + size * torch.rand(500, 3, generator=torch.Generator().manual_seed(0))).requires_grad_()
    value, slope = opened.sample(points.detach())
    same = opened(points)
    torch.testing.assert_close(value, same.detach(), rtol=0, atol=1e-6)
    (gradient,) = torch.autograd.grad(same.sum(), points)
    assert (slope - gradient).abs().quantile(0.99) < 1e-2  # beside a plane of nodes either side's is right


def test_a_field_may_change_little_on_the_eyeballs_and_all_beside_them(subject, closed, opened):
    spheres = eye_spheres(subject)
    assert spheres is not None
    off = np.array([-0.002, 0.0, 0.5 * HELD, HELD, 0.05])
    points = spheres.centres[0] + (spheres.radii[0] + off)[:, None] * [0, 0, 1]
    points = torch.tensor(points, dtype=torch.float32)
    expected = torch.tensor([LEAST, LEAST, 0.5 + 0.5 * LEAST, 1, 1])
    torch.testing.assert_close(opened.freedom(points), expected, rtol=0, atol=1e-3)
    assert (closed.freedom(points) == 1).all()


def test_value_and_gradient_of_a_field_agree_where_its_correction_fades(subject, opened):
    settings = replace(DEMO.parts[1], networks=TriPlaneNetworks(plane_size=8, color_size=8))
    torch.manual_seed(0)
    field = run_folder.build_field(subject, 1, settings, opened, 3)
    for parameter in field.geometry.parameters():
        parameter.data += 0.3 * torch.randn_like(parameter)
    spheres = eye_spheres(subject)
    assert spheres is not None
    about = torch.tensor(spheres.centres[0], dtype=torch.float32)
    points = about + 0.02 * torch.randn(200, 3, generator=torch.Generator().manual_seed(1))
    sample, gradient = field.with_gradient(points, create_graph=False)
    at = points.clone().requires_grad_()
    distance = field(at).distance
    torch.testing.assert_close(sample.distance.detach(), distance.detach(), rtol=0, atol=1e-5)
    (expected,) = torch.autograd.grad(distance.sum(), at)
    assert (gradient - expected).abs().quantile(0.95) < 2e-2  # beside a plane of nodes either side's is right


def test_a_body_without_known_eyes_keeps_its_grid(subject, closed):
    assert with_open_eyes(closed, replace(subject, faces=subject.faces[:, [1, 2, 0]])) is closed


def test_a_part_is_read_back_with_its_fine_grid_and_one_without_has_none(tmp_path, subject, opened):
    settings = replace(DEMO.parts[1], networks=TriPlaneNetworks(plane_size=8, color_size=8))
    coarse = TemplateGrid(opened.values, opened.low, opened.cell)
    for template in (opened, coarse):
        field = run_folder.build_field(subject, 1, settings, template, 3)
        run_folder.write_part(tmp_path / "head.pt", field)
        found = run_folder.read_part(tmp_path / "head.pt", subject, 1, settings).template
        if template.fine is None:
            assert found.fine is None
        else:
            assert isinstance(found.fine, FineGrid)
            assert torch.equal(found.fine.eyes, template.fine.eyes)
            assert torch.equal(found.fine.values, template.fine.values) and found.fine.cell == template.fine.cell
