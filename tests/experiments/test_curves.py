"""The experiment on training time: which trainings it makes, what it keeps, and what it reads off its curves."""

import json
from pathlib import Path

import numpy as np
import pytest
from recorded_commands import recorded_commands

import experiments.curves
from command.settings import settings_json
from experiments.curve_page import items_table, seconds_to
from experiments.curves import leaves_out, main
from train.preset import DEMO, ITEMS

CAPTURE = {"format": "selfscan-capture", "subject": "Person", "light": "even", "size": 64}


def point(seconds: float, decibels: float, **changed) -> dict:
    """A point of a curve with the same quality everywhere."""
    seconds, decibels = float(seconds), float(decibels)
    scores = {"psnr_db": decibels, "psnr_mask_db": decibels - 4, "ssim": 0.9, "flip": 0.1, "p2s_cm": 3 / decibels}
    return {
        "capture": "cap", "subject": "Person", "light": "even", "size": 64, "preset": "demo", "steps": 10,
        "total_steps": 40, "without": [], "given": False, "device": "cpu", "seconds": seconds, "cpu_seconds": seconds,
        "cpu_seconds_in_steps": seconds / 2, "stamp": {"poses": 2},
        "scores": {name: {"total": scores, "head": scores, "hands": scores} for name in ("novel_pose", "novel_view")},
        "machine": {"commit": "abc", "load_average": 1.0},
    } | changed  # fmt: skip


def test_a_quality_is_reached_between_two_points_on_a_line_over_the_logarithm_of_seconds():
    curve = [point(10, 20), point(100, 26), point(1000, 26.5)]
    assert seconds_to(curve, 23.0, "psnr_db", "novel_pose") == f"{10 * np.sqrt(10):.0f}"
    assert seconds_to(curve, 18.0, "psnr_db", "novel_pose") == "at most 10"
    assert seconds_to(curve, 27.0, "psnr_db", "novel_pose") == "not in 1000"


def test_an_item_is_compared_with_the_same_training_that_has_it():
    points = [point(50, 24, steps=150), point(60, 25, steps=10), point(45, 22, steps=150, without=["eyes"])]
    row = items_table(points)[-1]
    # 3 / 24 - 3 / 22 cm
    assert "| Person: eyes | 150 | +5 | 2.0 / 2.0 / 2.0 | 2.0 / 2.0 / 2.0 | -0.01 / -0.01 / -0.01 |" in row
    assert items_table(points[:2]) == []


def test_what_a_run_left_out_is_read_from_its_settings():
    for name, change in ITEMS.items():
        assert not leaves_out(settings_json(DEMO), "demo", change)
        assert leaves_out(settings_json(change(DEMO)), "demo", change), name


@pytest.fixture
def capture(tmp_path) -> Path:
    folder = tmp_path / "cap"
    folder.mkdir()
    (folder / "capture.json").write_text(json.dumps(CAPTURE))
    return folder


@pytest.fixture
def calls(monkeypatch):
    """Commands that the experiment runs, which leave runs and evaluations."""

    def leave(words):
        if words[1] == "train":
            write_run(Path(words[words.index("-o") + 1]), Path(words[2]))
            return
        scored = point(0, 25)["scores"]["novel_pose"]
        found = {"capture": CAPTURE, "novel_pose": scored, "novel_view": scored}
        machine = {"machine": {"commit": "abc", "load_average": 1.0}}
        Path(words[words.index("--json") + 1]).write_text(json.dumps(found | machine))

    return recorded_commands(monkeypatch, experiments.curves, leave)


def write_run(run: Path, capture: Path, **changed) -> None:
    run.mkdir(parents=True)
    parts = {name: {"steps": 10, "cpu_seconds": 20.0, "cpu_seconds_preparing": 15.0} for name in ("body", "head")}
    facts = {
        "format": "selfscan-run", "version": 1, "preset": "demo", "settings": settings_json(DEMO), "device": "cpu",
        "seconds": {"all": 40.0}, "cpu_seconds": 60.0, "parts": parts,
        "capture_at": {"folder": str(capture.resolve())},
    } | changed  # fmt: skip
    (run / "run.json").write_text(json.dumps(facts))


def test_every_training_is_made_and_scored_once_short_ones_first(calls, capture, tmp_path, capsys):
    out = tmp_path / "out"
    words = [str(capture), "-o", str(out), "--steps", "whole", "10", "--without", "eyes", "--without-steps", "20"]
    assert main(words) == 0
    trainings = [call for call in calls if call[1] == "train"]
    steps = [call[call.index("--iterations") + 1] if "--iterations" in call else None for call in trainings]
    assert steps == ["10", "20", "20", None]
    assert [call[call.index("--without") + 1] for call in trainings if "--without" in call] == ["eyes"]
    points = json.loads((out / "curves.json").read_text())["points"]
    assert [(p["steps"], p["without"]) for p in points] == [(10, []), (20, []), (None, []), (20, ["eyes"])]
    assert points[0]["cpu_seconds"] == 60.0 and points[0]["cpu_seconds_in_steps"] == 10.0
    assert "| Person, demo, without eyes | 20 | 60 | 10 | 40 | 25.0 / 25.0 / 25.0 |" in (out / "curves.md").read_text()
    assert len(calls) == 8
    assert main(words) == 0
    assert len(calls) == 8
    # another run asks for new scores only
    run = out / "cap" / "demo_10" / "run" / "run.json"
    run.write_text(run.read_text() + " ")
    assert main(words) == 0
    assert [call[1] for call in calls[8:]] == ["eval"]
    assert "all points are there" in capsys.readouterr().err


def test_an_interrupted_training_begins_anew_or_its_seconds_would_not_be_all(calls, capture, tmp_path):
    (tmp_path / "out" / "cap" / "demo_10" / "run.partial").mkdir(parents=True)
    assert main([str(capture), "-o", str(tmp_path / "out"), "--steps", "10"]) == 0
    assert "--force" in calls[0] and "--resume" not in calls[0]


def test_a_finished_run_is_a_point_of_its_capture_and_is_not_trained(calls, capture, tmp_path):
    write_run(tmp_path / "mine", capture, cpu_seconds=33.0)
    write_run(tmp_path / "resumed", capture, resumed=True)
    out = tmp_path / "out"
    assert main([str(tmp_path / "mine"), str(tmp_path / "resumed"), "-o", str(out)]) == 0
    assert [call[1] for call in calls] == ["eval", "eval"]
    points = json.loads((out / "curves.json").read_text())["points"]
    assert [(p["capture"], p["given"], p["cpu_seconds"]) for p in points] == [("cap", True, 33.0), ("cap", True, None)]
    assert points[1]["seconds"] is None
