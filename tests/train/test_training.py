"""The training from a capture folder to a run folder, small."""

import itertools
import json
import os
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from filmed_part import filmed_part, rays_of, untrained
from refusals import refused
from sphere_field import assert_same_bits
from tiny import TINY, tiny_training

from avatar.light import CaptureLight, Lamp
from avatar.skeleton import PARTS
from capture.fit import refine
from capture.fit.refine import with_refined
from capture.light.fit import LightFit
from capture.template.parts import part_boxes
from capture.template.surface import surface_cloud, visible_faces
from command.errors import AssetError
from command.progress import Reporter
from experiments.variants import variant
from train import part_job, stages
from train import run as run_folder
from train.fused import FusedField
from train.networks.triplane import TriPlaneNetworks
from train.objective import Batch, functions_of, render_rays
from train.pose_correction import PoseCorrection
from train.preset import PRESETS
from train.render import jittered
from train.surface import extract_surface
from train.template_grid import template_grid
from train.trainer import Checkpoints, FieldTraining, Watch, train_field


@pytest.fixture(scope="module")
def hand(capture):
    filmed = filmed_part(capture)
    rays = rays_of(filmed, TINY.parts[2], ends=18, per_frame=300)
    return lambda: untrained(filmed, TINY.parts[2], 4), rays


def by(**changes):
    """What the hand of these tests learns by."""
    return FieldTraining(**({"part": TINY.parts[2], "preset": TINY, "seed": 3} | changes))


def trained(capture, out, *options):
    """The run of a training with these options."""
    return run_folder.read_run(tiny_training(capture.path, out, *options))


@pytest.fixture
def own_run(tiny_run, tmp_path):
    """A copy of the shared run, to be changed."""
    return Path(shutil.copytree(tiny_run, tmp_path / "own"))


def test_denormals_are_flushed_while_training_and_cached_sections_begin_outside_the_template(capture, hand):
    build, rays = hand
    field = build()
    with torch.no_grad():
        s = field.template(rays.ends.reshape(-1, 3)).view(rays.ends.shape[:2])
    on = rays.mask > 0.5
    assert (s[:, 0] > -0.004).float().mean() > 0.98
    assert (s[on].amin(1) < 0.002).float().mean() > 0.95  # rays on the person enter the template
    assert len(rays.ends) > 100
    # A k-d tree built with flushed denormals never ends: it split beside equal points and the process crashed.
    tiny = lambda: float(torch.tensor([1e-310], dtype=torch.float64).mul(1.0)[0])
    seen = []
    train_field(build(), rays, by(), watch=Watch(report=lambda *_: seen.append(tiny())))
    assert seen and max(seen) == 0.0
    assert tiny() > 0


@pytest.mark.parametrize("learns_poses", [False, True])
def test_resumed_training_equals_training_never_stopped(capture, hand, tmp_path, one_thread, learns_poses):
    build, rays = hand
    preset = replace(TINY, pose_begin=0.0)

    def field():
        built = build()
        if learns_poses:
            built.poses = PoseCorrection(capture.videos["hand_left"], capture.subject)
        return built

    whole, halves, again = field(), field(), field()
    train_field(whole, rays, by(preset=preset))
    path = tmp_path / "half.ckpt"
    train_field(halves, rays, by(preset=preset), checkpoints=Checkpoints(path=path, stop_after=3))
    train_field(again, rays, by(preset=preset), checkpoints=Checkpoints(path=path, resume=True))
    assert ("poses.increments" in whole.state_dict()) == learns_poses
    assert_same_bits(whole.state_dict(), again.state_dict())


def test_a_broken_checkpoint_is_refused_and_a_folder_that_is_no_run(hand, tmp_path):
    build, rays = hand
    path = tmp_path / "half.ckpt"
    train_field(build(), rays, by(), checkpoints=Checkpoints(path=path, stop_after=1))
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(AssetError, match=r"half\.ckpt: expected a checkpoint"):
        train_field(build(), rays, by(), checkpoints=Checkpoints(path=path, resume=True))
    poisoned = replace(rays, color=torch.full_like(rays.color, float("nan")))
    field = build()
    before = {name: value.clone() for name, value in field.state_dict().items()}
    refused(FloatingPointError, "not finite", lambda: train_field(field, poisoned, by()))
    assert_same_bits(field.state_dict(), before)
    refused(AssetError, r"run\.json: no such file", run_folder.read_run, tmp_path)


def test_a_part_is_written_whole_or_stays_what_it_was(hand, tmp_path, monkeypatch):
    path = tmp_path / "hand_left.pt"
    run_folder.write_part(path, hand[0]())
    before = path.read_bytes()

    def torn(content, file):
        file.write(before[:100])
        raise KeyboardInterrupt

    monkeypatch.setattr(torch, "save", torn)
    with pytest.raises(KeyboardInterrupt):
        run_folder.write_part(path, hand[0]())
    assert path.read_bytes() == before and os.listdir(tmp_path) == [path.name]


def planted(*steps):
    """An extra term that is 0, or not a number at some steps (the first is 1)."""
    taken = itertools.count(1)

    def extra(points, distance):
        return distance.sum() * (float("nan") if next(taken) in steps else 0.0)

    return extra


def test_one_step_that_is_not_finite_is_skipped_and_counted_and_training_goes_on(hand):
    """The step after it begins from the weights before it: the same as stopping there, whatever it was."""
    build, rays = hand
    field, short = build(), build()
    reports = []
    report = lambda iteration, step: reports.append((iteration, step))
    skipped = train_field(field, rays, by(extra=planted(6)), watch=Watch(report=report)).skipped
    assert skipped == 1
    assert np.isnan(reports[-1][1].loss) and np.isfinite(reports[-1][1].color)
    train_field(short, rays, by(extra=planted()), checkpoints=Checkpoints(stop_after=5))
    assert_same_bits(dict(short.named_parameters()), dict(field.named_parameters()))
    with pytest.raises(FloatingPointError, match="2 of 4 steps were not finite"):
        train_field(build(), rays, by(extra=planted(2, 4)))


class Ramp(torch.nn.Module):
    """A displacement that is known everywhere: half a millimetre times the unit point and the frame's number."""

    def forward(self, unit, frame):
        return 5e-4 * unit * (1 + frame[:, None])


@pytest.mark.parametrize("every", [1, 3, 4, 16, 40])
def test_the_displacement_of_an_end_lies_on_the_line_between_its_knots(hand, every):
    """T_nr is evaluated at every n-th end of a ray; ends behind the last knot continue the last line."""
    build, rays = hand
    field = build()
    field.displacement = Ramp()
    chosen, u = torch.arange(0, len(rays.ends), 7), torch.rand(-(-len(rays.ends) // 7))
    drawn = render_rays(functions_of(field), rays, Batch(chosen, u, 0.001), replace(TINY, displaced_every=every))
    ends, frame = jittered(rays.ends[chosen], u), rays.frame[chosen]
    batch, count, _ = ends.shape
    knots = list(range(0, count, every))
    exact = Ramp()(field.unit(ends.reshape(-1, 3)), frame.repeat_interleave(count)).view(batch, count, 3)
    assert torch.equal(drawn.displacement, exact[:, knots].reshape(-1, 3))
    for end in range(count):
        before = min(end // every, max(len(knots) - 2, 0))
        a, b = knots[before], knots[min(before + 1, len(knots) - 1)]
        share = (end - a) / (b - a) if b > a else 0.0
        expected = ends[:, end] + (1 - share) * exact[:, a] + share * exact[:, b]
        torch.testing.assert_close(drawn.ends[:, end], expected, rtol=0, atol=1e-6)


def test_the_mean_displacement_is_that_of_all_frames_codes(hand):
    """`settle` stores it on a grid: exact at the grid's points, which lie at the corners of the unit box too."""
    field = hand[0]()
    with torch.no_grad():
        field.displacement.out.weight.normal_(generator=torch.Generator().manual_seed(1))
    axis = torch.linspace(-1, 1, field.displacement.mean_grid.shape[-1])
    points = axis[torch.randint(len(axis), (64, 3), generator=torch.Generator().manual_seed(2))]
    assert torch.equal(field.displacement.mean(points), torch.zeros(64, 3))  # before it is stored
    field.displacement.settle()
    each = torch.stack([field.displacement(points, torch.full((64,), frame)) for frame in range(4)])
    assert each.std(0).max() > 1e-5
    torch.testing.assert_close(field.displacement.mean(points), each.mean(0), rtol=1e-4, atol=1e-7)


def test_a_run_from_capture_to_fused_field(own_run):
    run = run_folder.read_run(own_run)
    points = torch.as_tensor(run.surface.vertices, dtype=torch.float32)
    assert run.field.distance(points).abs().quantile(0.95) < 0.003
    torch.testing.assert_close(run.field.shares(points).sum(1), torch.ones(len(points)))
    color = run.field.color(points, torch.tensor([0.0, 0, -1]).expand(len(points), 3))
    assert torch.isfinite(color).all() and color.min() >= 0 and color.max() <= 1
    assert (run.surface.view_count > 0).mean() > 0.5
    assert run.field.normal(torch.zeros(0, 3)).shape == (0, 3)
    placed = run.provenance["registration"]["video"]  # by the body's pixels, or said why not
    assert "moved_mm" in placed or placed["kept"] == "surfaces"
    # of all processes: parts learn in processes of their own
    parts = sum(part["cpu_seconds"] for part in run.provenance["parts"].values())
    assert run.provenance["cpu_seconds"] > parts > 0 and run.provenance["resumed"] is False
    assert run.provenance["body_licence"] == "a licence of the body's own"
    assert run.provenance["subject_licence"] == "not stated by the capture"
    assert (run.path / "logs" / "hand_left.csv").exists()

    (run.path / "hand_left.pt").write_bytes(b"not a part")
    refused(AssetError, r"hand_left\.pt: expected a trained part", run_folder.read_run, run.path)


@pytest.mark.slow
def test_a_run_whose_poses_are_refined_says_so_and_keeps_them(capture, tmp_path):
    """They are aligned before training and learned with the field; the head's video has none."""
    run = trained(capture, tmp_path / "run", "--refine-poses", "on")
    assert run.provenance["parts"]["body"]["poses_learned_deg"] > 0
    assert "poses_learned_deg" not in run.provenance["parts"]["head"]
    assert set(run.provenance["refined"]) >= {"body", "hand_left", "hand_right"}
    for name in ("body", "hand_left"):
        video = with_refined(capture, run.path).videos[name]
        assert np.abs(video.axis_angle[0] - capture.videos[name].axis_angle[0]).max() > 1e-4
    assert run.field.field(0).poses is None


@pytest.mark.slow
def test_a_frame_that_is_left_out_is_left_out_of_every_stage(capture, tmp_path, monkeypatch):
    """Of the light as well, which is told by frame."""
    found = LightFit(dict.fromkeys(PARTS, CaptureLight(0.6, (Lamp((0.0, 0.6, 0.8), 0.5),))), 9.0, 1.0, 5000)
    monkeypatch.setattr(stages, "fit_capture_light", lambda capture, seed: found)
    monkeypatch.setattr(refine, "frames_on_the_mask", lambda edge: np.arange(1, len(edge)))
    run = trained(capture, tmp_path / "run", "--refine-poses", "on")
    assert run.provenance["refined"]["hand_left"]["frames_left_out"] == [0]
    assert set(run.provenance["light_seen"]) == set(PARTS)


def test_a_run_is_rebuilt_from_its_own_settings_when_the_preset_was_edited(capture, own_run, monkeypatch):
    run = run_folder.read_run(own_run)
    wider = tuple(replace(part, networks=TriPlaneNetworks(width=48)) for part in TINY.parts)
    monkeypatch.setitem(PRESETS, "demo", replace(TINY, parts=wider, surface_cells=(0.05, 0.05, 0.05)))
    again = run_folder.read_run(run.path)
    assert again.preset == TINY
    assert_same_bits(run.field.state_dict(), again.field.state_dict())
    assert len(variant(again, capture, "no_L_g").surface.vertices) > 1000

    facts = json.loads((run.path / "run.json").read_text())
    del facts["settings"]["union"], facts["check"]
    (run.path / "run.json").write_text(json.dumps(facts))
    refused(AssetError, r"run\.json: settings: .settings. needs the key union", run_folder.read_run, run.path)


class Hollow(FusedField):
    """The template, empty more than 2.5 cm under its skin, and with a hole 1.6 cm wide into the chest."""

    device = torch.device("cpu")

    def __init__(self, subject):
        torch.nn.Module.__init__(self)  # no parts: one distance for everything
        self.eyes = None
        low, high = subject.vertices.min(0) - 0.08, subject.vertices.max(0) + 0.08
        self.template = template_grid(surface_cloud(subject, 0, visible_faces(subject), 0.01), low, high, 0.01)
        chest = subject.vertices[(np.abs(subject.vertices[:, :2] - [0, 0.3]) < 0.05).all(1), 2]
        self.axis = torch.tensor([0, 0.3, (chest.min() + chest.max()) / 2], dtype=torch.float32)

    def distance(self, points):
        skin = self.template(points)
        hole = 0.008 - (points[:, :2] - self.axis[:2]).norm(dim=1)
        hole = torch.where(points[:, 2] > self.axis[2], hole, -1.0)
        return torch.maximum(skin, torch.maximum(-0.025 - skin, hole))


@pytest.mark.slow
def test_the_surface_is_the_skin_although_the_field_is_hollow_and_a_pinhole_leads_in(capture):
    field = Hollow(capture.subject)
    parts = part_boxes(capture.subject)
    (vertices, faces), layer = extract_surface(field, parts, capture.subject, (0.008, 0.008, 0.008))
    assert not layer.any()
    depth = -field.template(torch.as_tensor(vertices, dtype=torch.float32)).numpy()
    assert len(vertices) > 1000
    # what is left are folds of the face; a third of all vertices when the hollow stays
    assert (depth > 0.024).mean() < 0.002
    assert trimesh.Trimesh(vertices, faces, process=False).volume > 0.03  # m³; negative where triangles face inwards


def test_a_field_without_a_surface_is_one_line_with_what_to_look_at(capture):
    nowhere = Hollow(capture.subject)
    nowhere.distance = lambda points: torch.ones(len(points))
    with pytest.raises(AssetError, match="its distance is positive everywhere; `selfscan check`"):
        extract_surface(nowhere, part_boxes(capture.subject), capture.subject, (0.05, 0.05, 0.05))


def test_a_part_that_breaks_off_is_said_while_it_trains_and_when_it_is_whole_again(hand, tmp_path, monkeypatch):
    make, rays = hand
    field, preset = make(), replace(TINY, parts=(replace(TINY.parts[2], iterations=40),))
    points = torch.from_numpy(surface_points(field))
    job = part_job.PartJob(capture="", index=0, preset=preset, canonical_from_head=np.eye(4), folder=str(tmp_path),
                           device="cpu", threads=1)  # fmt: skip
    part = part_job.Untrained(field, rays, 0.0, 0.0, points)
    shares, said = iter([0.05, 0.3, 0.4, 0.02]), []
    monkeypatch.setattr(part_job, "LOOK_EVERY", 10)
    assert part_job.share_off(field, points) == 0 and part_job.share_off(field, points + 0.05) > 0.5
    monkeypatch.setattr(part_job, "share_off", lambda *_: next(shares))
    part_job._trained(job, part, Reporter(said.append, lambda *_: None))
    assert len(said) == 2 and "breaks off: 30% of its template" in said[0] and said[1].endswith("it is whole again")


def surface_points(field):
    """Points on the zero set of an untrained part's grid, canonical."""
    grid = np.stack(np.meshgrid(*[np.linspace(0.02, 0.98, 60)] * 3), -1).reshape(-1, 3).astype(np.float32)
    inside = torch.from_numpy(grid) * (field.high - field.low) + field.low
    with torch.no_grad():
        return inside[field(inside).distance.abs() < 0.002].numpy()
