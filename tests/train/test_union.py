"""L_g (Eq. 7, 13), Eq. 8 and Eq. 9, and the variants of a run, on spheres and a small capture."""

import copy
import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from filmed_part import rays_of
from sphere_field import SMALL, assert_same_bits, sphere_field, turned_head
from tiny import TINY

from avatar.skeleton import PARTS
from capture.template.parts import Box, Part, part_boxes
from capture.template.surface import surface_cloud, visible_faces
from command.errors import AssetError
from experiments.variants import VARIANTS, SwitchedField, seam_steps, variant
from train.appearance import match_appearance, overlap_rays
from train.field import unit_normals
from train.fused import FusedField
from train.preset import DEMO
from train.rays import FilmedPart
from train.run import build_field, read_run
from train.template_grid import template_grid
from train.trainer import Checkpoints, Watch
from train.union import geometry_loss, in_overlap, overlap_surface, train_union, zero_level

WIDE = Box(np.full(3, -0.2), np.full(3, 0.2))
# Eq. 9's overlap is the slab |x| < 5 cm, across both spheres
SPHERES = (
    Part("body", WIDE, None, 0.0),
    Part("head", WIDE, Box(np.array([-0.05, -1, -1]), np.array([1.0, 1, 1])), 0.1),
)


def _spheres() -> FusedField:
    """A body sphere and a head sphere 5 mm larger, which Eq. 5 has moved by 2 mm along y."""
    torch.manual_seed(0)
    head_from_canonical = torch.eye(4)
    head_from_canonical[1, 3] = -0.002
    fields = [sphere_field(0.1, (0.001, 0.0, 0.0)), sphere_field(0.105, (0.0, 0.0, 0.003))]
    return FusedField(fields, SPHERES, head_from_canonical).eval().requires_grad_(False)


def _surface(fused: FusedField, index: int) -> torch.Tensor:
    """Points of a part's displayed surface in the overlap."""
    d = torch.nn.functional.normalize(torch.randn(2000, 3, generator=torch.Generator().manual_seed(1)), dim=1)
    level = zero_level(fused, index, (0.1 * d).double().numpy(), d.double().numpy())
    points = torch.as_tensor(level.points[level.arrived], dtype=torch.float32)
    return points[in_overlap(fused.shares(points), index)]


def test_the_zero_level_of_a_part_is_where_it_is_shown():
    """|x - (0, 2 mm, 0) + (0, 0, 3 mm)| = 105 mm: Eq. 5 and the mean displacement both count."""
    points = _surface(_spheres(), 1)
    assert len(points) > 500
    away = (points - torch.tensor([0, 0.002, -0.003])).norm(dim=1) - 0.105
    assert away.abs().max() < 7e-4  # the template's cells are 1 cm


def test_a_head_that_eq5_scales_shows_distances_in_metres_and_unit_normals():
    """A sphere of 105 mm in a head frame 2 % too large is one of 105 / 1.02 mm, its distance a distance."""
    fused = FusedField([sphere_field(0.1), sphere_field(0.105)], SPHERES, turned_head(1.02)).eval()
    fused.requires_grad_(False)
    d = torch.nn.functional.normalize(torch.randn(500, 3, generator=torch.Generator().manual_seed(3)), dim=1)
    away = torch.linspace(-0.01, 0.01, 500)
    points = d * (0.105 / 1.02 + away)[:, None]
    assert (fused.part_distance(1, points) - away).abs().max() < 7e-4  # the template's cells are 1 cm
    sample, gradient = fused.part_gradient(1, points)
    torch.testing.assert_close(sample.distance, fused.part_distance(1, points))
    assert (torch.nn.functional.normalize(gradient, dim=1) - d).norm(dim=1).max() < 0.12  # a wrong turn: .63
    assert (gradient.norm(dim=1) - 1).abs().max() < 0.07


@pytest.mark.parametrize("consistency, surface", [(1.0, 1.0), (1.0, 0.0), (0.0, 1.0)])
def test_each_term_of_L_g_pulls_the_body_sphere_onto_the_head_in_their_overlap_alone(consistency, surface):
    fused = _spheres()
    target = _surface(fused, 1)
    head = copy.deepcopy(fused.field(1).state_dict())
    assert fused.part_distance(0, target).mean() > 0.0045
    preset = replace(DEMO, union=replace(DEMO.union, consistency=consistency, surface=surface))
    L_g = geometry_loss(fused, [target], preset.parts, preset)
    body = fused.field(0).requires_grad_(True)
    parameters = [p for name, p in body.named_parameters() if name.startswith("geometry")]
    optimiser = torch.optim.Adam(parameters, lr=3e-3)
    generator = torch.Generator().manual_seed(2)
    for _ in range(150):
        d = torch.nn.functional.normalize(torch.randn(512, 3, generator=generator), dim=1)
        shown = d * (0.09 + 0.03 * torch.rand(512, 1, generator=generator))
        points = shown + torch.tensor([0.001, 0, 0])  # moved by the body's T_nr, as the batch's are
        loss = L_g(points, body(points).distance)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    body.requires_grad_(False)
    assert fused.part_distance(0, target).abs().mean() < 4e-4
    assert fused.part_distance(0, target).mean().abs() < 2e-4
    assert_same_bits(fused.field(1).state_dict(), head)  # the other parts are fixed


def test_L_g_is_zero_where_one_part_has_all_weight_and_a_run_without_its_body_is_refused(capture, run, tmp_path):
    fused = _spheres()
    L_g = geometry_loss(fused, [torch.zeros(0, 3)], DEMO.parts, DEMO)
    alone = torch.tensor([[-0.1, 0, 0], [0.11, 0, 0]])
    deep = torch.tensor([[0.0, 0.05, 0.0], [0.0, 0.16, 0.0]])  # in the slab, out of the head's band
    both = torch.tensor([[0.0, 0.1, 0.0]])
    asked = lambda points: float(L_g(points, torch.full((len(points),), 1.0)))
    assert asked(alone) == 0 and asked(deep) == 0
    # 1 m against the head's -7 mm there
    assert asked(both) == pytest.approx(DEMO.union.consistency * (1 + 0.007), rel=2e-3)
    with pytest.raises(AssetError, match=r"body_stage1\.pt: no such file"):
        variant(replace(run, path=tmp_path), capture, "no_L_g")


def test_L_g_compares_metres_with_metres_where_eq5_scales_the_head():
    """The body's sphere and the same sphere in a head frame 5 % larger, 1 cm outside: both say 10 mm."""
    torch.manual_seed(0)
    head_from_canonical = torch.eye(4)
    head_from_canonical[:3, :3] *= 1.05
    fields = [sphere_field(0.1), sphere_field(0.105)]
    fused = FusedField(fields, SPHERES, head_from_canonical).eval().requires_grad_(False)
    L_g = geometry_loss(fused, [torch.zeros(0, 3)], DEMO.parts, DEMO)
    d = torch.nn.functional.normalize(torch.randn(500, 3, generator=torch.Generator().manual_seed(5)), dim=1)
    points = 0.11 * d[in_overlap(fused.shares(0.11 * d), 1)]
    assert len(points) > 50
    apart = (fused.part_distance(1, points) - fused.part_distance(0, points)).abs().mean()
    found = float(L_g(points, fused.field(0)(points).distance)) / DEMO.union.consistency
    assert found == pytest.approx(float(apart), abs=1e-7)
    assert found < 3e-4  # without the scale half a millimetre is added


def _coloured_spheres(step: float) -> FusedField:
    """The same sphere twice; the head's mean code differs from the body's, a planted change of its light."""
    torch.manual_seed(3)
    body = sphere_field(0.1, frames=20)
    with torch.no_grad():
        layers = body.color_network.network
        assert isinstance(layers, torch.nn.Sequential)
        first, last = layers[0], layers[-1]
        assert isinstance(first, torch.nn.Linear) and isinstance(last, torch.nn.Linear)
        code = slice(39 + SMALL.feature + 3 + 9, 39 + SMALL.feature + 3 + 9 + SMALL.appearance)
        first.weight[:, code] *= 10  # an untrained network hardly reads its code
        last.weight *= 3
        body.appearance.weight.copy_(0.5 * torch.randn(20, SMALL.appearance))
    head = copy.deepcopy(body)
    with torch.no_grad():
        head.appearance.weight += step
        for field in (body, head):
            field.reference.copy_(field.appearance.weight.mean(0))
    return FusedField([body, head], SPHERES, torch.eye(4)).eval().requires_grad_(False)


def _seen_overlap(fused: FusedField) -> tuple[torch.Tensor, torch.Tensor]:
    points = _surface(fused, 1)
    noise = 0.3 * torch.randn(points.shape, generator=torch.Generator().manual_seed(4))
    return points, torch.nn.functional.normalize(-points / 0.1 + noise, dim=1)


def test_the_rate_of_eq8_decays_to_its_last():
    """The same seed and steps: one that decays to a hundredth moves the code less far, and both come nearer."""
    moved = []
    for last in (1.0, 0.01):
        fused = _coloured_spheres(0.4)
        start = fused.field(1).reference.clone()
        preset = replace(TINY, appearance_steps=20, appearance_rate=2e-3, appearance_last_rate=last)
        before, after = match_appearance(fused, 1, *_seen_overlap(fused), preset, 0)
        assert after < before
        moved.append(float((fused.field(1).reference - start).norm()))
    # Adam's steps are about as long as the rate: the mean of .01^t over t in [0, 1] is .215
    assert 0.15 < moved[1] / moved[0] < 0.35


def test_eq8_recovers_a_planted_colour_change_and_eq9_then_hides_it():
    fused = _coloured_spheres(0.4)
    points, directions = _seen_overlap(fused)
    body = fused.part_color(0, points, directions)
    assert (fused.part_color(1, points, directions) - body).abs().mean() > 0.02
    before, after = match_appearance(fused, 1, points, directions, replace(TINY, appearance_steps=300), 0)
    assert before > 0.02 and after < 0.1 * before
    assert (fused.part_color(1, points, directions) - body).abs().mean() == pytest.approx(after, rel=1e-4)
    # the other direction of light and other points too: it is the code that was found, not the samples
    others = torch.nn.functional.normalize(torch.randn(200, 3), dim=1) * 0.1
    away = fused.part_color(1, others, -others / 0.1) - fused.part_color(0, others, -others / 0.1)
    assert away.abs().mean() < 0.2 * before
    assert torch.equal(fused.field(0).reference, fused.field(0).appearance.weight.mean(0))


def test_eq9_blends_linearly_a_switch_jumps_in_its_middle_and_eq8_of_one_frame_stays_finite():
    fused = _coloured_spheres(0.4)
    points, directions = _seen_overlap(fused)
    body, head = (fused.part_color(i, points, directions) for i in (0, 1))
    share = (points[:, :1] + 0.05) / 0.1
    torch.testing.assert_close(fused.color(points, directions), body * (1 - share) + head * share)
    switched = SwitchedField([fused.field(0), fused.field(1)], fused.parts, fused.head_from_canonical)
    torch.testing.assert_close(switched.color(points, directions), torch.where(share > 0.5, head, body))
    head = fused.field(1)
    head.appearance.weight.data = head.appearance.weight.data[:1].clone()
    _, after = match_appearance(fused, 1, points, directions, replace(TINY, appearance_steps=5), 0)
    assert np.isfinite(after) and torch.isfinite(head.reference).all()


@pytest.fixture(scope="module")
def untrained(capture):
    """The template as all four parts, and the body's rays."""
    parts, subject = part_boxes(capture.subject), capture.subject
    visible = visible_faces(subject)
    fields, rays = [], None
    torch.manual_seed(7)
    for index, part in enumerate(parts):
        cloud = surface_cloud(subject, index, visible, 0.006)
        template = template_grid(cloud, part.extent.low, part.extent.high, 0.006)
        fields.append(build_field(subject, index, TINY.parts[index], template, 4))
        if index == 0:
            rays = rays_of(
                FilmedPart(part, capture.videos["body"], subject, cloud), TINY.parts[0], ends=14, per_frame=3000
            )
    return FusedField(fields, parts, torch.eye(4)).eval().requires_grad_(False), rays


@pytest.mark.slow
@pytest.mark.parametrize("index", [1, 2, 3])
def test_overlap_rays_hit_the_surface_from_outside_in_the_overlap_in_many_frames(untrained, index):
    fused, rays = untrained
    points, directions = overlap_rays(fused, index, rays)
    assert len(points) >= 4  # the pictures are 48 pixels wide
    assert in_overlap(fused.shares(points), index).all()
    assert fused.distance(points).abs().max() < 3e-3
    assert ((directions * fused.normal(points)).sum(1) < 0.2).float().mean() > 0.95
    torch.testing.assert_close(directions.norm(dim=1), torch.ones(len(points)))


@pytest.mark.slow
def test_stage_2_interrupted_and_resumed_equals_stage_2_never_stopped(capture, untrained, tmp_path, one_thread):
    fused, rays = untrained
    preset = replace(TINY, union=replace(TINY.union, iterations=20))

    def stop(iteration, step):
        raise KeyboardInterrupt

    def train(field, **options):
        train_union(field, capture.subject, rays, preset, seed=3, **options)

    whole, halves, again = (copy.deepcopy(fused) for _ in range(3))
    train(whole)
    path = tmp_path / "union.ckpt"
    with pytest.raises(KeyboardInterrupt):
        train(halves, checkpoints=Checkpoints(path=path, every=0.0), watch=Watch(report=stop))
    train(again, checkpoints=Checkpoints(path=path, resume=True))
    assert_same_bits(whole.state_dict(), again.state_dict())
    moved = [name for name, value in whole.state_dict().items() if not torch.equal(value, fused.state_dict()[name])]
    assert moved and all(name.startswith("fields.0.") for name in moved)


def test_a_part_without_template_in_its_overlap_has_no_surface_there():
    assert zero_level(_spheres(), 1, np.zeros((0, 3)), np.zeros((0, 3))).points.shape == (0, 3)


@pytest.mark.slow
def test_overlap_surfaces_lie_on_each_part_in_its_overlap(capture, untrained):
    fused, _ = untrained
    for index, points in enumerate(overlap_surface(fused, capture.subject), start=1):
        assert 100 < len(points) <= 1500
        assert fused.part_distance(index, points).abs().max() < 1e-3
        assert in_overlap(fused.shares(points), index).all()


@pytest.fixture(scope="module")
def run(tiny_run):
    return read_run(tiny_run)


def test_stage_2_brings_the_body_nearer_to_every_part(run):
    union = json.loads((run.path / "run.json").read_text("utf-8"))["union"]
    assert set(union["step_mm_after"]) == {"head", "hand_left", "hand_right"}
    for name, after in union["step_mm_after"].items():
        assert after < union["step_mm_before"][name], name


@pytest.mark.slow
def test_variants_differ_from_the_run_in_what_they_name_and_leave_it_alone(capture, run):
    before = {name: value.clone() for name, value in run.field.state_dict().items()}
    got = {name: variant(run, capture, name) for name in VARIANTS}
    assert_same_bits(run.field.state_dict(), before)
    assert got["ours"] is run

    other = got["landmarks_only"]
    # where the head's own video moved it from its landmarks is undone as well
    moved = np.array(run.provenance["registration"].get("own_video", {}).get("moved", np.eye(4)))
    np.testing.assert_allclose(other.field.head_from_canonical.numpy(), moved, atol=1e-6)
    assert all(other.field.field(i) is run.field.field(i) for i in range(4))
    assert other.provenance["registration"] == run.provenance["registration"]
    ours = np.linalg.inv(np.array(run.provenance["head_from_canonical"]))
    landmarks = np.linalg.inv(np.array(other.provenance["head_from_canonical"]))
    corrected = np.array(run.provenance["canonical_from_head_field"]) @ moved @ landmarks
    np.testing.assert_allclose(corrected, ours, atol=1e-9)

    other = got["no_L_g"]
    stage1 = torch.load(run.path / "body_stage1.pt", weights_only=True)["state"]
    assert_same_bits(other.field.field(0).state_dict(), stage1)
    assert all(other.field.field(i) is run.field.field(i) for i in (1, 2, 3))
    points = torch.as_tensor(other.surface.vertices, dtype=torch.float32)
    assert other.field.distance(points).abs().quantile(0.95) < 0.003
    assert len(other.surface.vertices) != len(run.surface.vertices)
    assert (other.surface.view_count > 0).mean() > 0.4

    points = torch.as_tensor(run.surface.vertices, dtype=torch.float32)
    directions = -torch.as_tensor(run.surface.normals, dtype=torch.float32)
    loudest = run.field.shares(points).argmax(1)
    for name in ("no_fusion", "no_codes_no_fusion"):
        other = got[name]
        assert other.surface is run.surface
        torch.testing.assert_close(other.field.distance(points), run.field.distance(points))
        shown = other.field.color(points, directions)
        for index in range(4):
            own = loudest == index
            expected = other.field.part_color(index, points[own], directions[own])
            torch.testing.assert_close(shown[own], expected, atol=1e-6, rtol=0)
            reference = other.field.field(index).reference
            mean = run.field.field(index).appearance.weight.mean(0)
            torch.testing.assert_close(reference, mean if "codes" in name else run.field.field(index).reference)
    with pytest.raises(ValueError, match=r"should be one of .*is 'no_head'"):
        variant(run, capture, "no_head")


def test_seam_steps_are_what_they_say(run, capture):
    steps = seam_steps(run)
    assert set(steps) == {"neck", "wrist_left", "wrist_right"}
    points = torch.as_tensor(run.surface.vertices, dtype=torch.float32)
    seen = torch.as_tensor(run.surface.view_count > 0)
    chosen = points[in_overlap(run.field.shares(points), 1) & seen]
    apart = (run.field.part_distance(1, chosen) - run.field.part_distance(0, chosen)).abs().mean()
    assert steps["neck"]["step_mm"] == pytest.approx(1000 * float(apart), abs=2e-3)
    # the body with an offset of 4 mm is 4 mm off, give or take what it was
    shifted = copy.deepcopy(run.field)
    shifted.field(0).template.values += 0.004
    far = seam_steps(replace(run, field=shifted))
    for name, step in steps.items():
        assert abs(far[name]["step_mm"] - 4) < 1.1 * step["step_mm"] + 0.01, name
        assert far[name]["color_step"] == pytest.approx(step["color_step"], abs=2.0)


def test_a_part_goes_back_to_its_template_and_the_others_stay(tiny_run):
    run = read_run(tiny_run)
    fused, hand = run.field, PARTS.index("hand_left")
    source = run.bake_source
    assert source.with_templates is not None
    back = source.with_templates({"hand_left"})
    surface = torch.as_tensor(run.surface.vertices, dtype=torch.float32)
    of_hand = surface[fused.shares(surface)[:, hand] == 1]
    elsewhere = surface[fused.shares(surface)[:, hand] == 0]
    template = fused.field(hand).template(of_hand)
    assert (fused.distance(of_hand) - template).abs().max() > 1e-5
    torch.testing.assert_close(back.distance(of_hand), template)
    torch.testing.assert_close(back.normal(of_hand), unit_normals(fused.field(hand).template.sample(of_hand)[1]))
    torch.testing.assert_close(back.distance(elsewhere), fused.distance(elsewhere))
    assert not fused.field(hand).keeps_template
