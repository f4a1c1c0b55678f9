"""RUN/fields.onnx says what the torch field says, and is asked without torch."""

import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from capsules import ball_mesh

from avatar.body import builtin_body
from avatar.camera import orbit_camera
from avatar.errors import AssetError
from avatar.rotation import matrix_from_axis_angle
from bake.bake import write_field_beside
from bake.field import numpy_field
from bake.measure import ScoredView
from bench.onnx_field import OnnxField, drawn_field, field_surface
from train.eye_grid import OpenEyes
from train.field import PartField
from train.field_onnx import is_exportable, write_field
from train.fused import FusedField
from train.networks import triplane
from train.networks.triplane import TriPlaneNetworks
from train.parts import Box, Part
from train.template_grid import TemplateGrid

SIZES = TriPlaneNetworks(plane_size=12, plane_channels=4, color_size=20, color_channels=4, width=24, feature=7)


def random_field(seed: int = 0) -> FusedField:
    """Two parts of random tri-planes over a ball's distance; the head turned, scaled and moved as Eq. 5 may."""
    torch.manual_seed(seed)
    boxes = [
        Box(np.full(3, -0.5), np.full(3, 0.5)),
        Box(np.array([-0.3, 0.0, -0.3]), np.array([0.3, 0.6, 0.3])),
    ]
    parts = [
        Part("body", boxes[0], None, 0.0),
        Part("head", boxes[1], Box(boxes[1].low, boxes[1].high), 0.05),
    ]
    fields = []
    axis = torch.linspace(-0.6, 0.6, 25)
    ball = torch.stack(torch.meshgrid(axis, axis, axis, indexing="ij"), -1).norm(dim=-1) - 0.3
    for part in parts:
        low, high = (torch.tensor(edge, dtype=torch.float32) for edge in (part.extent.low, part.extent.high))
        networks = triplane.build(SIZES, frames=3, half=0.5 * (high - low), displacement_reach=0.01)
        template = TemplateGrid(ball, torch.full((3,), -0.6), 0.05)
        field = PartField(template, low, high, networks)
        for name, weight in field.named_parameters():
            strong = 1.5 if name.startswith("color_network") else 0.2
            weight.data += strong * torch.randn_like(weight) / max(1, weight.shape[-1]) ** 0.5
        field.reference.copy_(torch.randn_like(field.reference))
        field.displacement.mean_grid.copy_(0.004 * torch.randn_like(field.displacement.mean_grid))
        fields.append(field)
    head = torch.eye(4)
    head[:3, :3] = torch.tensor(1.04 * matrix_from_axis_angle(np.array([0.1, -0.4, 0.2])))
    head[:3, 3] = torch.tensor([0.01, -0.02, 0.015])
    person = FusedField(fields, parts, head)
    # another surface in a smaller box with smaller cells
    share = torch.zeros(13, 13, 13)
    share[3:10, 3:10, 3:10] = 1
    values = ball[:13, :13, :13] + 0.02 * torch.randn(13, 13, 13)
    person.eyes = OpenEyes(values, share, torch.tensor([-0.15, 0.1, -0.15]), 0.025)
    return person.eval().requires_grad_(False)


@pytest.fixture(scope="module")
def field():
    return random_field()


@pytest.fixture(scope="module")
def path(field, tmp_path_factory):
    path = tmp_path_factory.mktemp("run") / "fields.onnx"
    write_field(path, field)
    return path


@pytest.fixture(scope="module")
def asked():
    """Points in both parts and in their overlap, the first 200 outside every box; unit directions."""
    rng = np.random.default_rng(1)
    points, directions = rng.uniform(-0.45, 0.55, (4000, 3)), rng.normal(size=(4000, 3))
    points[:200] *= 4
    return points, directions / np.linalg.norm(directions, axis=1, keepdims=True)


def torch_answers(field, points, directions):
    p, d = (torch.tensor(a, dtype=torch.float32) for a in (points, directions))
    return [a.numpy() for a in (field.distance(p), field.normal(p), field.color(p, d))]


def test_distance_equals_the_torch_field(field, path, asked):
    expected, _, _ = torch_answers(field, *asked)
    np.testing.assert_allclose(OnnxField(path).distance(asked[0]), expected, atol=2e-6)


def test_distance_shows_the_eyes(field, path):
    rng = np.random.default_rng(2)
    points = rng.uniform([-0.1, 0.15, -0.1], [0.1, 0.4, 0.1], (500, 3))
    eyes, field.eyes = field.eyes, None
    try:
        without = torch_answers(field, points, points)[0]
    finally:
        field.eyes = eyes
    assert np.abs(OnnxField(path).distance(points) - without).mean() > 0.01


def test_normals_by_central_differences_equal_autograd(field, path, asked):
    """In the boxes, where something was learnt. Where a sample 20 micrometres away lies beyond a kink of the planes
    both slopes are right; elsewhere they agree."""
    inside = [values[200:] for values in asked]
    _, expected, _ = torch_answers(field, *inside)
    normals = OnnxField(path).normal(inside[0])
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-4)
    angle = np.degrees(np.arccos(np.clip((normals * expected).sum(1), -1, 1)))
    assert np.median(angle) < 0.1 and np.quantile(angle, 0.98) < 0.5


def test_color_at_a_direction_equals_the_torch_field(field, path, asked):
    points, directions = (values[200:] for values in asked)
    _, _, expected = torch_answers(field, points, directions)
    color = OnnxField(path).color(points, directions)
    assert color.min() >= 0 and color.max() <= 1 and np.ptp(color) > 0.3
    assert np.quantile(np.abs(color - expected), 0.98) < 1e-3
    other = OnnxField(path).color(points, -directions)
    assert np.abs(other - color).mean() > 0.01  # the direction matters


def test_no_points_and_one_point(path):
    field = OnnxField(path)
    nothing = np.zeros((0, 3))
    assert field.distance(nothing).shape == (0,) and field.color(nothing, nothing).shape == (0, 3)
    far = np.array([[9.0, 9.0, 9.0]])  # in no part's box but the body's word
    assert field.distance(far) > 10 and np.isfinite(field.normal(far)).all()


def test_the_same_field_gives_the_same_bytes(field, path, tmp_path):
    write_field(tmp_path / "again.onnx", field)
    assert (tmp_path / "again.onnx").read_bytes() == path.read_bytes()


def write_run(folder, field):
    """surface.npz and subject.npz of a ball around the field's, half of it seen, that follows the pelvis."""
    ball = ball_mesh(0.3, step=0.03)
    normals = ball.vertices / np.linalg.norm(ball.vertices, axis=1, keepdims=True)
    count = len(normals)
    np.savez(
        folder / "surface.npz",
        vertices=ball.vertices.astype(np.float32),
        faces=ball.faces,
        normals=normals.astype(np.float32),
        skin_joints=np.zeros((count, 4), np.uint8) + np.arange(4, dtype=np.uint8),
        skin_weights=np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1)),
        view_count=np.where(normals[:, 2] > 0, 50, 0),
        view_mean=-0.9 * normals,
        view_covariance=np.tile(np.array([0.05, 0, 0, 0.05, 0, 0.05]), (count, 1)),
    )
    np.savez(folder / "subject.npz", joints=builtin_body("male").joints)
    write_field(folder / "fields.onnx", field)


def test_a_run_is_drawn_without_torch_as_with_it(field, tmp_path):
    write_run(tmp_path, field)
    code = f"""
import sys
import numpy as np
from pathlib import Path
from avatar.camera import orbit_camera
from bake.measure import ScoredView
from bench.onnx_field import drawn_field, field_surface
view = ScoredView("ball", np.zeros((52, 3)), np.zeros(3), orbit_camera((0, 0, 0), 1.2, 0.3, 0.2, (48, 48)))
(image,) = drawn_field(field_surface(Path({str(tmp_path)!r})), [view])
assert "torch" not in sys.modules and "onnx" not in sys.modules
np.savez({str(tmp_path / "drawn.npz")!r}, paper=image.paper, cone=image.cone, mask=image.mask)
"""
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)
    with np.load(tmp_path / "drawn.npz") as file:
        drawn = dict(file)
    asked = numpy_field(field)
    surface = field_surface(tmp_path)._replace(distance=asked.distance, color=asked.color)
    view = ScoredView("ball", np.zeros((52, 3)), np.zeros(3), orbit_camera((0, 0, 0), 1.2, 0.3, 0.2, (48, 48)))
    (image,) = drawn_field(surface, [view])
    assert 200 < image.mask.sum() < 48 * 48 and np.array_equal(image.mask, drawn["mask"])
    for found, expected in ((drawn["paper"], image.paper), (drawn["cone"], image.cone)):
        assert np.quantile(np.abs(found - expected), 0.99) < 2e-3
    assert np.abs(drawn["cone"] - drawn["paper"])[image.mask].max() > 0.02  # the directions differ


def test_rungs_of_the_field_are_drawn_without_torch(field, tmp_path):
    """Every way of drawing shows the same ball, and the finer the volume the nearer it is to the finest."""
    write_run(tmp_path, field)
    (tmp_path / "run.json").write_text('{"settings": {"parts": [{"beta": [0.008, 0.0015]}]}}')
    code = f"""
import sys
from pathlib import Path
from types import SimpleNamespace
import numpy as np
from avatar.camera import orbit_camera
from bench.field_rungs import field_rungs
from player.context import open_context
pose = np.zeros((52, 3)), np.zeros(3)
frame = SimpleNamespace(pose=pose, camera=orbit_camera((0, 0, 0), 1.2, 0.3, 0.2, (24, 24)))
rungs = field_rungs(open_context(), Path({str(tmp_path)!r}), [frame], samples=4)
assert "torch" not in sys.modules
np.savez({str(tmp_path / "rungs.npz")!r}, **{{rung.name: rung.pictures[0] for rung in rungs}})
assert all(rung.ms.min() > 0 and rung.bytes > 1000 for rung in rungs)
"""
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)
    with np.load(tmp_path / "rungs.npz") as file:
        drawn = dict(file)
    assert len(drawn) == 16
    names = list(drawn)
    assert names[2:4] == ["field, boxes of 64", "field, boxes of 64, 2 samples a pixel"]
    best = drawn[names[-1]]
    assert (best.max(-1) > 0).sum() > 100
    errors = {name: np.square(picture - best).mean() for name, picture in drawn.items()}
    assert errors["field, volume of 12"] < errors["field, volume of 3"]
    assert errors["field, boxes of 64"] < errors["field, boxes of 64, quarter resolution"]


def test_a_run_with_a_misshapen_surface_is_refused(field, tmp_path):
    write_run(tmp_path, field)
    with np.load(tmp_path / "surface.npz") as file:
        fields = dict(file)
    for name, value in (("view_mean", fields["view_mean"][:-1]), ("faces", fields["faces"] + 10**6)):
        np.savez(tmp_path / "surface.npz", **(fields | {name: value}))
        with pytest.raises(AssetError, match=rf"surface.npz: .*{name}"):
            field_surface(tmp_path)


def test_the_bake_writes_it_once_beside_the_run_and_says_why_not(field, tmp_path):
    lines = []
    run = SimpleNamespace(path=tmp_path, field=field)
    write_field_beside(run, lines.append)
    first = (tmp_path / "fields.onnx").read_bytes()
    (tmp_path / "fields.onnx").write_bytes(b"kept")
    write_field_beside(run, lines.append)
    assert (tmp_path / "fields.onnx").read_bytes() == b"kept" and len(first) > 10_000
    assert not is_exportable(object())
    write_field_beside(SimpleNamespace(path=tmp_path / "other", field=object()), lines.append)
    assert len(lines) == 2 and "fields.onnx" in lines[0] and "only" in lines[1]


def test_another_field_is_refused(tmp_path):
    other = random_field()
    other.switch = True  # the ablation of Eq. 9
    with pytest.raises(ValueError, match="tri-plane"):
        write_field(tmp_path / "f.onnx", other)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("content", [None, b"", b"no graph", b"\x08\x09\x12\x00"])
def test_a_file_that_is_no_field_is_named(tmp_path, content):
    path = tmp_path / "fields.onnx"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(AssetError, match=str(path)):
        OnnxField(path)


def test_a_graph_with_other_inputs_is_refused(tmp_path):
    from avatar.baked_avatar import ViewNetwork
    from bake.network import write_onnx

    z = np.zeros
    network = ViewNetwork(z((16, 8), "f4"), z(16, "f4"), z((3, 16), "f4"), z(3, "f4"))
    write_onnx(tmp_path / "view.onnx", network)
    with pytest.raises(AssetError, match="inputs should be"):
        OnnxField(tmp_path / "view.onnx")
