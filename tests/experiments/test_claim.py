"""The claim's table: which commands make it, what is kept, and that kinds of input are never mixed."""

import json
from pathlib import Path

import pytest
from recorded_commands import recorded_commands

import experiments.claim
from command.errors import AssetError
from experiments.claim import collect, main
from experiments.claim_page import page


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
    assert main(["some/She.glb:female", "-o", str(out), *WORDS]) == 0
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
    assert main(["builtin", "-o", str(out), *WORDS]) == 0
    before = len(calls)
    (out / "builtin" / "from_pixels" / "quality.json").unlink()
    assert main(["builtin", "-o", str(out), *WORDS]) == 0
    assert len(calls) == before + 1 and calls[-1][1] == "eval"
    assert "from pixels: evaluate: about" in capsys.readouterr().out
    with pytest.raises(AssetError, match=r"options\.json: holds results of steps 200; ask for the same, or choose"):
        main(["builtin", "-o", str(out), *WORDS[2:], "--steps", "300"])


def test_a_column_that_fails_is_said_and_the_others_are_made(made, monkeypatch, capsys):
    _, out = made
    whole = experiments.claim.command
    monkeypatch.setattr(
        experiments.claim, "command", lambda *words: (lambda: 1) if "import" in words else whole(*words)
    )
    assert main(["builtin", "-o", str(out), *WORDS]) == 1
    assert "not made: builtin, from pixels: " in capsys.readouterr().err
    told = json.loads((out / "claim.json").read_text())
    assert set(told["people"]["builtin"]) == {"given", "shape only"} and len(told["absent"]) == 1
    assert "| 0.50 / 0.50 / 0.50 | 0.50 / 0.50 / 0.50 | - | 1.84" in (out / "claim.md").read_text()


def test_a_result_of_another_kind_is_no_part_of_a_column(tmp_path):
    path = tmp_path / "She" / "from_pixels" / "quality.json"
    path.parent.mkdir(parents=True)
    path.write_text(json.dumps(result("given", 0.1)))
    with pytest.raises(AssetError, match="input should be 'from pixels', is 'given'"):
        collect(tmp_path)


def test_the_mean_is_of_all_people_or_of_nobody():
    facts = {"share": "some", "frames": 8, "size": 96, "light": "room", "seed": 0, "poses": 2}
    people = {"He": {"given": result("given", 1.0), "from pixels": result("from pixels", 2.0)},
              "She": {"given": result("given", 2.0)}}  # fmt: skip
    text = page(people, facts)
    mean = text[text.index("## Mean of 2 people") : text.index("## He")]
    assert "| held-out poses: P2S in place, cm | 1.50 / 1.50 / 1.50 | - | - | - |" in mean
