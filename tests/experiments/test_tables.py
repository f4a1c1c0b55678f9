"""The tables command on a tiny person: rows in processes' stead in this one, training by a small preset."""

import json
import shutil
import subprocess
import sys

import pytest
from painted_capture import write_capture

import experiments.table_row
import experiments.tables
from command.errors import AssetError
from experiments.paper_numbers import PAPER_IMAGE
from experiments.table_page import as_in_paper, mean_of, page
from experiments.tables import main

# the demo preset in name and networks, so that its run reads as one; everything else small
TRAIN = """
import sys
from dataclasses import replace
from pathlib import Path
from train.command import TrainOptions
from train.preset import DEMO
from experiments.single import train_single
from train.stages import train
parts = [replace(p, iterations=6, cell=max(p.cell, .006), spacing=max(p.spacing, .006)) for p in DEMO.parts]
small = replace(DEMO, rays=64, rays_per_frame=300, warm_up=5, appearance_steps=5, surface_cells=(.03, .015, .008),
                parts=tuple(parts))
options = TrainOptions(capture=Path(sys.argv[1]), out=Path(sys.argv[2]))
train_single(options, small, Path(sys.argv[3])) if sys.argv[3:] else train(options, small)
"""
ROWS = ["ours", "landmarks_only", "no_L_g", "no_fusion", "single", "no_ray_transform"]


def in_process(*words):
    """A command in this process: rows are measured, a training is the small one above."""
    if words[0] == "experiments.table_row":
        return lambda: experiments.table_row.main([str(word) for word in words[1:]])
    single = words[0] == "experiments.single"
    assert single or words[:2] == ("selfscan", "train")
    capture, o, run, *rest = words[1 if single else 2 :]
    assert o == "-o" and rest[:2] == ["--preset", "demo"] and single == ("--head-from" in rest)
    script = [sys.executable, "-c", TRAIN, capture, run, *([rest[rest.index("--head-from") + 1]] if single else [])]
    return lambda: subprocess.run(script, check=False).returncode


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


def test_order_is_judged_on_the_same_people_and_by_every_measured_number():
    ours = [result("ours", total=22.0), result("ours", name="b", total=10.0)]
    worse = [result("no_ray_transform", total=21.0)]
    verdict = as_in_paper("no_ray_transform", ours, worse, PAPER_IMAGE)
    # person b has no such row and must not count; SSIM is equal here and better in the paper
    assert verdict == "no: head SSIM, hands SSIM, total SSIM"
    worse[0]["novel_pose"]["head"] |= {"ssim": 0.8, "psnr_db": 23.0}
    assert as_in_paper("no_ray_transform", ours, worse, PAPER_IMAGE).startswith("no: head PSNR, hands SSIM")
    assert as_in_paper("single", ours, [], PAPER_IMAGE) == "not measured"


def test_seeds_give_mean_and_deviation_of_the_means_over_people():
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
