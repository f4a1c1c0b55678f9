"""The template's distance with open lids and eyeballs behind them, on the free body."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from painted_capture import FORWARD, filmed, free_subject
from scipy.spatial import KDTree

from avatar.camera import Camera
from avatar.rotation import matrix_from_axis_angle
from capture.folder import PartVideo
from capture.register.iris import FlatIris
from capture.template import eyes as template_eyes
from capture.template.eyes import body_sockets, eye_openings, eye_spheres, first_hits, hidden_lengths
from capture.template.parts import part_boxes
from capture.template.surface import neck_height, surface_cloud, visible_faces
from command.errors import AssetError
from train import run as run_folder
from train.eye_grid import FINER, LIDS, OTHER, OpenEyes, filmed_eyes, open_eyes
from train.fused import FusedField
from train.networks.triplane import TriPlaneNetworks
from train.preset import DEMO
from train.template_grid import template_grid


@pytest.fixture(scope="module")
def subject():
    return free_subject("male")


@pytest.fixture(scope="module")
def spheres(subject):
    found = eye_spheres(subject)
    assert found is not None
    return found


@pytest.fixture(scope="module")
def closed(subject):
    extent = part_boxes(subject)[1].extent
    cloud = surface_cloud(subject, 1, visible_faces(subject), 0.003)
    return template_grid(cloud, extent.low, extent.high, 0.003, (subject, neck_height(subject)))


@pytest.fixture(scope="module")
def eyes(subject, closed):
    found = open_eyes(subject, closed)
    assert found is not None
    return found


def asked(eyes, points, field=None):
    """The open template's distance, as a field that is far from everything lets it be seen."""
    points = torch.as_tensor(points, dtype=torch.float32)
    alone = OpenEyes(eyes.values, torch.ones_like(eyes.share), eyes.low, eyes.cell)
    return alone.distance(points, torch.full((len(points),), 1.0)).numpy()


@pytest.mark.parametrize("spread", [0.02, 0.5, 3.0])
def test_rays_meet_what_they_meet_without_a_cone_round_them(subject, spheres, monkeypatch, spread):
    origin, rng = spheres.centres[0] + [0, 0.02, 0.5], np.random.default_rng(4)
    directions = rng.normal(size=(300, 3)) * spread + [0, -0.04, -1]
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    corners = subject.vertices[subject.faces]
    found, kept = first_hits(origin, directions, corners), template_eyes._before(origin, directions, corners)
    assert np.isfinite(found).sum() > 20 and (kept.mean() < 0.2) == (spread == 0.02)
    monkeypatch.setattr(template_eyes, "_before", lambda *_: slice(None))
    np.testing.assert_array_equal(found, first_hits(origin, directions, corners))


def first_crossing(eyes, points, direction, far=0.03):
    """How far in front of `points`, going back against `direction`, the distance first falls under zero."""
    steps = np.linspace(far, -far, 601)
    along = asked(eyes, (points[:, None] + steps[:, None] * direction).reshape(-1, 3)).reshape(len(points), -1)
    return steps[(along <= 0).argmax(1)]


@pytest.mark.slow
def test_the_eyeball_is_seen_between_the_lids_and_an_iris_where_it_was_found(subject, eyes, spheres, closed):
    points = eye_openings(subject)
    # straight in front of the balls' middles
    middle = points[np.abs(points[:, None, :2] - spheres.centres[:, :2]).max(2).min(1) < 0.002]
    assert len(middle) > 4
    off = np.abs(first_crossing(eyes, middle, FORWARD))
    # beside a lid's edge the lid may be met first
    assert np.quantile(off, 0.8) < 0.0003 and off.max() < 0.002
    angle = np.radians(25)
    flat = open_eyes(subject, closed, FlatIris(FORWARD, float(angle)))
    depth = -first_crossing(flat, spheres.centres + spheres.radii[:, None] * FORWARD, FORWARD)
    np.testing.assert_allclose(depth, spheres.radii * (1 - np.cos(angle)), atol=3e-4)


@pytest.mark.slow
@pytest.mark.parametrize("angle", [0, 25])
def test_irises_are_as_flat_as_the_heads_video_has_them(subject, closed, spheres, angle):
    """Filmed in a frame of its own, turned and shifted."""
    canonical_from_head = np.eye(4)
    canonical_from_head[:3, :3] = matrix_from_axis_angle(np.array([0.1, 0.7, -0.2]))
    canonical_from_head[:3, 3] = 0.3, -0.1, 0.2
    views = filmed(spheres.centres, spheres.radii, np.radians(angle), size=192, focal=2.6)
    cameras = tuple(Camera(c.K, c.camera_from_world @ canonical_from_head, c.size) for c, _ in views)
    images = np.stack([image for _, image in views])
    video = PartVideo("head", images, np.ones(images.shape[:3], bool), cameras, None, None, None, None)
    found = filmed_eyes(subject, closed, video, canonical_from_head)
    assert found.eyes is not None and found.fit is not None
    depth = -first_crossing(found.eyes, spheres.centres + spheres.radii[:, None] * FORWARD, FORWARD)
    np.testing.assert_allclose(depth, spheres.radii * (1 - np.cos(np.radians(angle))), atol=3e-4)
    assert ("irises" in found.in_words()) == (angle > 0)


def test_lids_stay_where_the_template_has_them(subject, closed, eyes, spheres):
    sockets = body_sockets()
    skin = np.setdiff1d(np.arange(len(subject.vertices)), np.concatenate([socket.inside for socket in sockets]))
    ball = spheres.distance(subject.vertices[skin])
    lids = subject.vertices[skin[(ball > 0.0015) & (ball < 0.0045)]]
    assert len(lids) > 50
    off = np.abs(asked(eyes, lids))
    assert off.mean() < 0.0005 and np.quantile(off, 0.9) < 0.001
    before = closed(torch.as_tensor(lids, dtype=torch.float32)).numpy()
    assert off.mean() < 0.6 * np.abs(before).mean()


def test_nothing_is_hollow_behind_the_lids(subject, eyes, spheres):
    for centre, radius, hidden in zip(spheres.centres, spheres.radii, hidden_lengths(subject, spheres)):
        held = np.isfinite(hidden.length)
        shares = np.linspace(0, 1, 30)[:, None]
        ends = hidden.origin + (hidden.length[held, None] - 0.0005) * hidden.directions[held]
        ends = ends[np.linalg.norm(ends - centre, axis=1) < radius + LIDS - 0.001]
        assert len(ends) > 500
        # from the plane through the ball's middle
        begin = ends - ((ends - centre) @ FORWARD)[:, None] * FORWARD
        near = np.linalg.norm(begin - centre, axis=1) < radius
        points = begin[near] + shares[:, None] * (ends - begin)[near]
        inside = asked(eyes, points.reshape(-1, 3))
        # rays that pass a lid's edge within a cell may see past it
        assert (inside > 0.0005).mean() < 0.01


def test_the_opening_is_as_wide_as_between_the_template_s_lids(subject, eyes, spheres):
    centre, radius = spheres.centres[0], spheres.radii[0]
    # up and down from the ball's middle, seen from the front
    y = np.arange(-0.006, 0.006, 0.0002)
    front = centre + np.stack([0 * y, y, np.sqrt(radius**2 - y**2)], 1)
    shown = np.abs(first_crossing(eyes, front, FORWARD)) < 0.001
    rim = subject.vertices[body_sockets()[0].rim]
    middle = rim[np.abs(rim[:, 0] - centre[0]) < 0.003]
    assert len(middle) >= 2
    apart = np.ptp(middle[:, 1])
    assert 0.0002 * shown.sum() > apart - 0.001


def test_the_share_is_whole_on_the_opening_and_nothing_beyond(subject, eyes, closed):
    opening = eye_openings(subject)
    points = torch.as_tensor(opening, dtype=torch.float32)
    field = closed(points)
    np.testing.assert_allclose(eyes.distance(points, field), asked(eyes, opening), atol=1e-6)
    assert (field - eyes.distance(points, field)).abs().max() > 0.001  # closed sockets are another surface
    away = np.random.default_rng(0).uniform(opening.min(0) - 0.03, opening.max(0) + 0.03, (20000, 3))
    away = away[KDTree(opening).query(away)[0] > OTHER + 2 * eyes.cell]
    away = torch.as_tensor(away, dtype=torch.float32)
    assert len(away) > 1000 and torch.equal(eyes.distance(away, closed(away)), closed(away))


def test_the_field_has_no_step_at_the_box(eyes, closed):
    rng = np.random.default_rng(0)
    low = eyes.low.numpy().astype(np.float64)
    size = eyes.cell * (np.array(eyes.values.shape) - 1)
    assert eyes.cell == pytest.approx(closed.cell / FINER) and eyes.cell <= 0.0015
    for axis in range(3):
        for side in (0.0, 1.0):
            place = rng.random((200, 3))
            place[:, axis] = side
            step = np.zeros(3)
            step[axis] = 1e-6 if side else -1e-6
            ends = [torch.as_tensor(low + size * place + s, dtype=torch.float32) for s in (step, -step)]
            outside, inside = (eyes.distance(points, closed(points)) for points in ends)
            # micrometres of slope over 2e-6 m, and float32
            assert (outside - inside).abs().max() < 2e-5


def test_details_lie_round_each_opening_and_values_agree_with_gradients_round_the_eyes(subject, eyes, fused):
    opening = eye_openings(subject)
    boxes = sorted(eyes.details(), key=lambda box: -box.low[0])  # left first
    assert len(boxes) == 2
    for box, side in zip(boxes, (1, -1)):
        own = opening[side * opening[:, 0] > 0]
        assert (own > box.low).all() and (own < box.high).all()
        assert (box.high - box.low).max() < 0.05
    opening = torch.as_tensor(eye_openings(subject)[::7], dtype=torch.float32)
    points = opening + 0.006 * torch.randn(len(opening), 3, generator=torch.Generator().manual_seed(1))
    sample, gradient = fused.part_gradient(1, points)
    torch.testing.assert_close(sample.distance, fused.part_distance(1, points), rtol=0, atol=2e-6)
    at = points.clone().requires_grad_()
    (expected,) = torch.autograd.grad(fused.part_distance(1, at).sum(), at)
    assert (gradient - expected).abs().quantile(0.95) < 2e-2  # beside a plane of nodes either side's is right


@pytest.fixture(scope="module")
def fused(subject, closed, eyes):
    settings = replace(DEMO.parts[1], networks=TriPlaneNetworks(plane_size=8, color_size=8))
    torch.manual_seed(0)
    fields = []
    for index in (0, 1):
        field = run_folder.build_field(subject, index, settings, closed, 3)
        for parameter in field.geometry.parameters():
            parameter.data += 0.3 * torch.randn_like(parameter)
        fields.append(field)
    # Eq. 5 moves the head's field; the eyes stay where the template has them, on which its video was placed
    place = torch.eye(4)
    place[:3, :3] *= 1.01
    place[:3, 3] = torch.tensor([0.002, -0.001, 0.001])
    person = FusedField(fields, part_boxes(subject), place).eval().requires_grad_(False)
    person.eyes = eyes
    return person


def test_the_fused_field_shows_the_eyes_where_the_template_has_them(subject, fused, eyes):
    opening = eye_openings(subject)
    points = torch.as_tensor(opening, dtype=torch.float32)
    np.testing.assert_allclose(fused.distance(points), asked(eyes, opening), atol=2e-6)
    (left, right) = fused.functions().details
    assert left.step == eyes.cell
    inside = [((opening > box.low) & (opening < box.high)).all(1) for box in (left, right)]
    assert (inside[0] | inside[1]).all()
    shown, fused.eyes = fused.eyes, None
    try:
        assert np.abs(fused.distance(points).numpy() - asked(eyes, opening)).mean() > 0.001
        assert fused.functions().details == ()
    finally:
        fused.eyes = shown


def test_eyes_are_read_back_from_a_run_older_runs_have_none_and_broken_ones_are_refused(tmp_path, eyes):
    path = tmp_path / "eyes.npz"
    assert run_folder.read_eyes(path) is None
    run_folder.write_eyes(path, eyes)
    again = run_folder.read_eyes(path)
    assert again is not None and again.cell == eyes.cell
    for name in ("values", "share", "low"):
        assert torch.equal(getattr(again, name), getattr(eyes, name))
    run_folder.write_eyes(path, eyes)
    arrays = dict(np.load(path))
    np.savez(path, **{**arrays, "share": arrays["share"][1:]})
    with pytest.raises(AssetError, match=r"eyes.npz: share should be \("):
        run_folder.read_eyes(path)
    np.savez(path, **{**arrays, "cell": np.float64(0)})
    with pytest.raises(AssetError, match="cell should be a length"):
        run_folder.read_eyes(path)
