"""Training times and the claim's table: which commands they run, what they keep, and that no kinds are mixed."""

import json
from pathlib import Path

import numpy as np
import pytest
from recorded_commands import recorded_commands

import experiments.claim
import experiments.curves
import experiments.first_avatars
from command.errors import AssetError
from command.settings import settings_json
from experiments.claim import collect
from experiments.claim import main as claim
from experiments.claim_page import page
from experiments.curve_page import items_table, seconds_to
from experiments.curves import leaves_out, main
from experiments.first_avatars import main as first_avatars
from train.preset import DEMO, ITEMS

CAPTURE = {"format": "selfscan-capture", "version": 1, "subject": "Person", "light": "even", "size": 64}


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


def test_what_a_run_left_out_is_read_and_an_item_is_compared_between_two_points():
    curve = [point(10, 20), point(100, 26), point(1000, 26.5)]
    assert seconds_to(curve, 23.0, "psnr_db", "novel_pose") == f"{10 * np.sqrt(10):.0f}"
    assert seconds_to(curve, 18.0, "psnr_db", "novel_pose") == "at most 10"
    assert seconds_to(curve, 27.0, "psnr_db", "novel_pose") == "not in 1000"
    points = [point(50, 24, steps=150), point(60, 25, steps=10), point(45, 22, steps=150, without=["eyes"])]
    row = items_table(points)[-1]
    # 3 / 24 - 3 / 22 cm
    assert "| Person: eyes | 150 | +5 | 2.0 / 2.0 / 2.0 | 2.0 / 2.0 / 2.0 | -0.01 / -0.01 / -0.01 |" in row
    assert items_table(points[:2]) == []
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


def test_an_interrupted_training_begins_anew_and_a_finished_run_is_a_point(calls, capture, tmp_path):
    (tmp_path / "out" / "cap" / "demo_10" / "run.partial").mkdir(parents=True)
    assert main([str(capture), "-o", str(tmp_path / "out"), "--steps", "10"]) == 0
    assert "--force" in calls[0] and "--resume" not in calls[0]
    calls.clear()
    write_run(tmp_path / "mine", capture, cpu_seconds=33.0)
    write_run(tmp_path / "resumed", capture, resumed=True)
    out = tmp_path / "out1"
    assert main([str(tmp_path / "mine"), str(tmp_path / "resumed"), "-o", str(out)]) == 0
    assert [call[1] for call in calls] == ["eval", "eval"]
    points = json.loads((out / "curves.json").read_text())["points"]
    assert [(p["capture"], p["given"], p["cpu_seconds"]) for p in points] == [("cap", True, 33.0), ("cap", True, None)]
    assert points[1]["seconds"] is None


def result(kind: str, p2s: float) -> dict:
    """What `selfscan eval` writes, as far as the table reads it."""
    regions = lambda **scores: dict.fromkeys(("total", "head", "hands"), scores)
    return {
        "input": kind,
        "machine": {"cpu": "some processor", "cores": 2, "commit": "abc1234"},
        "novel_pose": regions(p2s_cm=p2s, psnr_db=25.04, psnr_mask_db=20.0),
        "novel_view": regions(psnr_db=27.0, psnr_mask_db=22.0),
        "beside": {"aligned": regions(p2s_cm=p2s / 2, chamfer_cm=p2s), "zero_steps": regions(p2s_cm=2 * p2s),
                   "zero_steps_aligned": regions(p2s_cm=p2s),
                   "filmed": regions(p2s_cm=p2s / 5), "filmed_aligned": regions(p2s_cm=p2s / 10, chamfer_cm=p2s)},
    }  # fmt: skip


@pytest.fixture
def made(monkeypatch, tmp_path):
    """Commands that the experiment runs; each leaves what it is asked for."""

    def leave(words):
        out = Path(words[words.index("-o") + 1] if "-o" in words else words[3])
        if words[1] == "eval":
            path = Path(words[words.index("--json") + 1])
            path.write_text(json.dumps(result(path.parent.name.replace("_", " "), 1.0)))
            return
        name = "run.json" if words[1] == "train" else "truth/raw.json" if "--raw" in words else "capture.json"
        (out / name).parent.mkdir(parents=True)
        (out / name).write_text("{}")

    monkeypatch.setattr(experiments.claim, "stature_of", lambda person: 1.64)
    return recorded_commands(monkeypatch, experiments.claim, leave), tmp_path / "out"


WORDS = ["--steps", "200", "--poses", "2", "--size", "360"]


def test_one_person_is_filmed_once_and_judged_in_three_columns_on_the_same_pictures(made):
    calls, out = made
    assert claim(["some/She.glb:female", "-o", str(out), *WORDS]) == 0
    assert [call[1] for call in calls] == ["synth", *["synth", "train", "eval"] * 2, "import", "train", "eval"]
    raw, given, shape, imported = (call for call in calls if call[1] in ("synth", "import"))
    assert {"--raw", "--keypoints", "--held-out"} < set(raw) and raw[2] == "some/She.glb"
    assert "--template" not in given and shape[shape.index("--template") + 1] == "shape"
    assert all(call[call.index("--light") + 1] == "room" for call in (raw, given, shape))
    # who imports reads the four videos' folder, and is told what one knows of oneself
    assert imported[3] == raw[3] and imported[imported.index("--sex") + 1] == "female"
    assert imported[imported.index("--stature") + 1] == "1.640"
    trainings = [call for call in calls if call[1] == "train"]
    assert {call[call.index("--iterations") + 1] for call in trainings} == {"200"}
    assert {call[3] for call in calls if call[1] == "eval"} == {raw[3]}
    text = (out / "claim.md").read_text()
    assert "| total / head / hands | given | shape only | from pixels | paper |" in text
    three = "0.50 / 0.50 / 0.50"
    row = f"| held-out poses: P2S aligned, cm | {three} | {three} | {three} | 1.84 / 0.59 / 0.55 |"
    assert row in text
    own = "| own videos: P2S aligned, cm | 0.10 / 0.10 / 0.10 | 0.10 / 0.10 / 0.10 | 0.10 / 0.10 / 0.10 | 1.84 / "
    assert own in text and text.index(own) < text.index(row)


def test_what_is_there_is_kept_and_other_settings_go_elsewhere(made, capsys):
    calls, out = made
    assert claim(["builtin", "-o", str(out), *WORDS]) == 0
    before = len(calls)
    (out / "builtin" / "from_pixels" / "quality.json").unlink()
    assert claim(["builtin", "-o", str(out), *WORDS]) == 0
    assert len(calls) == before + 1 and calls[-1][1] == "eval"
    assert "from pixels: evaluate: about" in capsys.readouterr().out
    with pytest.raises(AssetError, match=r"options\.json: holds results of steps 200; ask for the same, or choose"):
        claim(["builtin", "-o", str(out), *WORDS[2:], "--steps", "300"])


def test_a_column_that_fails_is_said_and_the_others_are_made(made, monkeypatch, capsys):
    _, out = made
    whole = experiments.claim.command
    monkeypatch.setattr(
        experiments.claim, "command", lambda *words: (lambda: 1) if "import" in words else whole(*words)
    )
    assert claim(["builtin", "-o", str(out), *WORDS]) == 1
    assert "not made: builtin, from pixels: " in capsys.readouterr().err
    told = json.loads((out / "claim.json").read_text())
    assert set(told["people"]["builtin"]) == {"given", "shape only"} and len(told["absent"]) == 1
    assert "| 0.50 / 0.50 / 0.50 | 0.50 / 0.50 / 0.50 | - | 1.84" in (out / "claim.md").read_text()


def test_a_result_of_another_kind_is_no_part_of_a_column_and_a_mean_is_of_all_or_none(tmp_path):
    path = tmp_path / "She" / "from_pixels" / "quality.json"
    path.parent.mkdir(parents=True)
    path.write_text(json.dumps(result("given", 0.1)))
    with pytest.raises(AssetError, match="input should be 'from pixels', is 'given'"):
        collect(tmp_path)
    facts = {"share": "some", "frames": 8, "size": 96, "light": "room", "seed": 0, "poses": 2}
    people = {"He": {"given": result("given", 1.0), "from pixels": result("from pixels", 2.0)},
              "She": {"given": result("given", 2.0)}}  # fmt: skip
    text = page(people, facts)
    mean = text[text.index("## Mean of 2 people") : text.index("## He")]
    assert "| held-out poses: P2S in place, cm | 1.50 / 1.50 / 1.50 | - | - | - |" in mean


def test_people_are_filmed_made_and_judged_and_who_fails_is_said(monkeypatch, tmp_path, capsys):
    def leave(words):
        if words[1] == "make" and "builtin_9" in words[-7]:
            return
        at = {"synth": Path(words[3]) / "truth" / "raw.json", "make": Path(words[4]), "eval": Path(words[-1])}[words[1]]
        at.parent.mkdir(parents=True, exist_ok=True)
        at.write_text(json.dumps(result("from pixels", {"She": 1.0, "He": 3.0}.get(at.parent.name, 0))))

    sheets = []
    for name in ("stature_of", "write_sheet"):
        found = {"stature_of": lambda person: 1.7, "write_sheet": lambda out, pairs: sheets.append(pairs)}[name]
        monkeypatch.setattr(experiments.first_avatars, name, found)
    calls, out = recorded_commands(monkeypatch, experiments.first_avatars, leave), tmp_path / "out"
    assert first_avatars(["She.glb:female", "He.glb", "builtin:9", "-o", str(out), "--minutes", "4"]) == 1
    assert [call[1] for call in calls] == ["synth", "make", "eval"] * 2 + ["synth", "make"]
    makes = [call for call in calls if call[1] == "make"]
    assert [call[call.index("--sex") + 1] for call in makes[:2]] == ["female", "male"]
    assert all(call[call.index("--stature") + 1] == "1.700" for call in makes)
    assert sheets == [[("She.glb", out / "She" / "me.glb"), ("He.glb", out / "He" / "me.glb")]]
    lines = (out / "README.md").read_text().splitlines()
    assert "| | median of 2 | She | He |" in lines
    three = lambda value: " / ".join([f"{value:.2f}"] * 3)
    assert f"| P2S aligned, cm | {three(0.2)} | {three(0.1)} | {three(0.3)} |" in lines
    assert "| outlines of the T-pose, mean of eight sides | - | - | - |" in lines
    assert "not made: builtin_9: " in capsys.readouterr().err
