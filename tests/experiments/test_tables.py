"""The tables, presets and single network of a tiny person, whose rows and trainings run in this process."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from painted_capture import write_capture
from tiny import TINY, tiny, tiny_training

import experiments.presets
import experiments.table_row
import experiments.tables
from capture.fit.refine import with_refined
from capture.folder import read_capture
from command.errors import AssetError
from experiments.paper_numbers import PAPER_IMAGE
from experiments.presets import checkpoints
from experiments.presets import main as compared
from experiments.rivals import single
from experiments.table_page import as_in_paper, mean_of, page
from experiments.tables import main
from experiments.variants import seam_steps
from train import run as run_folder
from train.command import main as train
from train.preset import DEMO, PRESETS
from train.template_grid import TemplateGrid

# the demo preset in name and networks, so that its run reads as one; everything else small
SMALL = replace(
    TINY, parts=tuple(replace(p, networks=own.networks) for p, own in zip(TINY.parts, DEMO.parts, strict=True))
)
ROWS = ["ours", "landmarks_only", "no_L_g", "no_fusion", "single", "no_ray_transform"]


def in_process(*words):
    """A command in this process: rows are measured, a training is the small one above."""
    if words[0] == "experiments.table_row":
        return lambda: experiments.table_row.main([str(word) for word in words[1:]])
    alone = words[0] == "experiments.rivals.single"
    assert alone or words[:2] == ("selfscan", "train")
    capture, o, run, *rest = words[1 if alone else 2 :]
    assert o == "-o" and rest[:2] == ["--preset", "demo"] and alone == ("--head-from" in rest)

    def trained() -> int:
        options = [str(word) for word in rest[2:]]
        tiny_training(Path(capture), Path(run), *options, preset=SMALL, command=single.main if alone else train)
        return 0

    return trained


@pytest.fixture(scope="module")
def people(oracle, tmp_path_factory):
    """(arguments of the command, its OUT) after one call; the person's truth is the striped oracle's."""
    folder = tmp_path_factory.mktemp("tables")
    capture = write_capture(folder / "striped")
    shutil.copytree(oracle[0] / "truth", capture / "truth")
    out = folder / "out"
    arguments = [str(out), "--captures", str(capture), "--poses", "1", "--our-poses", "1", "--rows", *ROWS]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(experiments.tables, "command", in_process)
        assert main(arguments) == 0
    return arguments, out


def test_every_row_has_its_numbers_its_seams_and_its_picture(people):
    _, out = people
    folder = out / "striped" / "seed0"
    rows = {name: json.loads((folder / f"{name}.json").read_text()) for name in ROWS}
    for name, row in rows.items():
        assert (folder / f"{name}.png").stat().st_size > 10_000
        assert row["novel_pose"]["head"]["psnr_db"] > 5 and row["cpu_seconds"] > 0
        assert (row.get("geometry") == "as ours") == (name in ("no_fusion", "no_ray_transform"))
        assert ("p2s_cm" in row["novel_pose"]["total"]) == (name not in ("no_fusion", "no_ray_transform"))
        assert (row["seams"] is None) == (name in ("single", "no_ray_transform"))
    moved = [rows[name]["novel_pose"]["head"]["psnr_db"] for name in ("ours", "landmarks_only")]
    assert moved[0] != moved[1]
    assert 0.97 < rows["single"]["parameters"] / rows["ours"]["parameters"] < 1.03
    assert rows["single"]["novel_pose"]["head"]["chamfer_cm"] != rows["ours"]["novel_pose"]["head"]["chamfer_cm"]
    apart = [rows[name]["novel_pose"]["total"]["psnr_db"] for name in ("ours", "no_ray_transform")]
    assert apart[0] != apart[1]


def test_a_second_call_trains_nothing_measures_nothing_and_writes_the_same_page(people, monkeypatch):
    arguments, out = people
    page_before = (out / "tables.md").read_text()

    def refuse(*words):
        raise AssertionError(f"was done again: {words}")

    monkeypatch.setattr(experiments.tables, "command", refuse)
    assert main(arguments) == 0
    assert (out / "tables.md").read_text() == page_before


def test_a_run_of_another_capture_is_refused(people, tmp_path):
    arguments, out = people
    capture = tmp_path / "striped"
    shutil.copytree(arguments[2], capture)
    facts = json.loads((capture / "capture.json").read_text())
    (capture / "capture.json").write_text(json.dumps(facts | {"light": "fixed"}))
    with pytest.raises(AssetError, match=r"light 'fixed'.*is light 'even'"):
        main([str(tmp_path / "out"), "--captures", str(capture), "--runs", str(out / "runs")])


def result(row, seed=0, name="a", total=20.0, neck=1.0):
    scores = {"psnr_db": total, "ssim": 0.9, "flip": 0.1}
    return {
        "row": row, "seed": seed, "name": name, "stamp": {"poses": 5}, "preset": "demo", "parameters": 10**6,
        "cpu_seconds": 30.0, "picture": f"{name}.png", "capture": {"light": "varied", "sheen": 0.5},
        "machine": {"cpu": "x", "cores": 2, "commit": "abc"},
        "novel_pose": {region: dict(scores) for region in ("head", "hands", "total")},
        "seams": {"neck": {"step_mm": neck, "color_step": 9.0, "shown_color_step": neck}},
    }  # fmt: skip


def test_order_is_judged_by_every_number_on_the_same_people_and_seeds_give_mean_and_deviation():
    ours = [result("ours", total=22.0), result("ours", name="b", total=10.0)]
    worse = [result("no_ray_transform", total=21.0)]
    verdict = as_in_paper("no_ray_transform", ours, worse, PAPER_IMAGE)
    # person b has no such row and must not count; SSIM is equal here and better in the paper
    assert verdict == "no: head SSIM, hands SSIM, total SSIM"
    worse[0]["novel_pose"]["head"] |= {"ssim": 0.8, "psnr_db": 23.0}
    assert as_in_paper("no_ray_transform", ours, worse, PAPER_IMAGE).startswith("no: head PSNR, hands SSIM")
    assert as_in_paper("single", ours, [], PAPER_IMAGE) == "not measured"
    results = [result("ours", seed, name, total) for seed, name, total in
               [(0, "a", 20.0), (0, "b", 22.0), (1, "a", 22.0), (1, "b", 24.0)]]  # fmt: skip
    mean = mean_of(results, "novel_pose", "total", "psnr_db")
    assert mean is not None and mean.text(2) == "22.00 ± 1.41"  # of 21 and 23
    alone = mean_of([*results, result("ours", 0, "c", 28.0)], "novel_pose", "total", "psnr_db")
    assert alone is not None and alone.text(2) == "24.00 ± 1.41"  # c has one seed: in the mean, not in the deviation
    text = page(results, [], ["c, seed 0: ours (training failed)"])
    assert "22.00 ± 1.41" in text and "## Varied light, sheen 0.5" in text
    assert "- c, seed 0: ours (training failed)" in text


def test_a_row_of_another_training_is_trained_apart_and_asked_for_it(people, monkeypatch, capsys):
    arguments, out = people
    asked = []

    def fail(*words):
        asked.append([str(word) for word in words])
        return lambda: 1

    monkeypatch.setattr(experiments.tables, "command", fail)
    assert main([*arguments[:3], "--poses", "1", "--rows", "light_off"]) == 1
    assert "without light as its own factor (training failed)" in (out / "tables.md").read_text()
    (words,) = asked  # ours is not trained again, and no row is measured
    assert words[:2] == ["selfscan", "train"] and words[4].endswith("striped_light_off")
    assert words[-2:] == ["--without", "light"]
    capsys.readouterr()


@pytest.fixture(scope="module")
def capture(tiny_capture):
    return read_capture(tiny_capture)


def trained(capture, out, *options):
    """The run of a single network with these options."""
    return run_folder.read_run(tiny_training(capture.path, out, *options, command=single.main))


@pytest.mark.slow
def test_a_single_network_has_the_parameters_rays_steps_and_head_of_the_four_parts(
    capture, tiny_run, tmp_path, monkeypatch
):
    # a place that only this run has
    own_run = Path(shutil.copytree(tiny_run, tmp_path / "own"))
    facts = json.loads((own_run / "run.json").read_text())
    place = np.linalg.inv(facts["head_from_canonical"])
    place[:3, 3] += [0.001, 0.002, -0.003]
    facts["head_from_canonical"] = np.linalg.inv(place).tolist()
    del facts["check"]
    (own_run / "run.json").write_text(json.dumps(facts))
    given, rays_of = [], single.single_rays
    remembered = lambda job, *rest: given.append(job.canonical_from_head) or rays_of(job, *rest)
    monkeypatch.setattr(single, "single_rays", remembered)
    run = trained(capture, tmp_path / "run", "--head-from", str(own_run))
    np.testing.assert_allclose(given[0], place, atol=1e-12)
    np.testing.assert_allclose(np.linalg.inv(run.provenance["head_from_canonical"]), place, atol=1e-12)
    assert np.array_equal(run.provenance["canonical_from_head_field"], np.eye(4))
    with pytest.raises(AssetError, match="is a single network; --head-from needs a run of four parts"):
        trained(capture, tmp_path / "again", "--head-from", str(run.path))
    assert len(run.field.fields) == 1 and run.provenance["parts"]["single"]["steps"] == 4 * 6
    field = run.field.field(0)
    assert len(field.appearance.weight) == sum(len(video.images) for video in capture.videos.values())
    body = field.appearance.weight[: len(capture.videos["body"].images)].mean(0)
    torch.testing.assert_close(field.reference, body)
    # the same vertices have hands and a head, with their own videos' view statistics
    assert set(np.unique(run.surface.part)) == {0, 1, 2, 3}
    assert all((run.surface.view_count[run.surface.part == part] > 0).mean() > 0.4 for part in range(4))
    points = torch.as_tensor(run.surface.vertices, dtype=torch.float32)
    assert run.field.distance(points).abs().quantile(0.95) < 0.003
    assert seam_steps(run) == {}


@pytest.mark.slow
def test_a_single_network_without_a_run_of_ours_has_body_and_head_placed_first(capture, tmp_path):
    run = trained(capture, tmp_path / "run", "--refine-poses", "on")
    registration = run.provenance["registration"]
    assert registration["from"] == "body and head trained for it"
    assert "moved_mm" in registration["video"] or registration["video"]["kept"] == "surfaces"
    assert set(run.provenance["parts"]) == {"single"} and len(run.field.fields) == 1
    # the poses that the body learned for the placement are not the single network's
    assert "poses_learned_deg" not in run.provenance["parts"]["single"]
    aligned = with_refined(capture, run.path).videos["body"].axis_angle
    assert np.abs(aligned - capture.videos["body"].axis_angle).max() > 1e-4


def test_the_demo_single_network_has_as_many_parameters_as_the_parts_together(capture):
    template = TemplateGrid(torch.zeros(2, 2, 2), torch.zeros(3), 1.0)
    count = lambda index, part, frames: sum(
        p.numel() for p in run_folder.build_field(capture.subject, index, part, template, frames).parameters()
    )
    parts = sum(count(index, part, 40) for index, part in enumerate(DEMO.parts))
    alone = count(0, single.single_part(DEMO), 160)
    assert abs(alone / parts - 1) < 0.02


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """presets.json of a small demo preset on a hand of eight frames, and what the trainer was given."""
    folder = tmp_path_factory.mktemp("presets")
    capture = write_capture(folder / "person", frames=8)
    given = {}

    def watched(field, rays, training, **others):
        given.update(frames=rays.frame.unique().tolist(), before=field.appearance.weight.detach().clone())
        skipped = train_field(field, rays, training, **others)
        given["after"] = field.appearance.weight.detach().clone()
        return skipped

    train_field = experiments.presets.train_field
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(PRESETS, "demo", tiny(DEMO, rays=128))
        patch.setattr(experiments.presets, "train_field", watched)
        words = [str(folder / "out"), "--capture", str(capture), "--part", "hand_left", "--presets", "demo"]
        assert compared([*words, "--iterations", "60"]) == 0
    return json.loads((folder / "out" / "presets.json").read_text()), folder / "out", given


def test_the_held_out_frame_trains_nothing_and_is_drawn_with_the_mean_code(measured):
    _, _, given = measured
    assert given["frames"] == [0, 1, 2, 4, 5, 6, 7]
    torch.testing.assert_close(given["after"][3], given["after"][given["frames"]].mean(0), rtol=0.02, atol=1e-4)
    assert (given["before"][3] != given["after"][3]).any()


def test_scores_rise_with_the_steps_and_are_taken_where_the_trainer_reports(measured):
    preset = measured[0]["presets"][0]
    points = preset["checkpoints"]
    assert points[-1]["iteration"] == 60 and points[-1]["psnr_db"] > points[0]["psnr_db"] + 1
    assert all(a["seconds"] < b["seconds"] for a, b in zip(points, points[1:]))
    assert preset["held_out_rays"] > 20
    for iterations in (7, 60, 1000, 1505):
        steps = checkpoints(iterations)
        assert steps[-1] == iterations and all(step % 10 == 0 for step in steps[:-1])
    assert checkpoints(1000)[0] == 20
