"""Quality against time from raw films: who is timed, and what stands in the table."""

import json
import os
import time
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from recorded_commands import recorded_commands

import experiments.minutes
from command.errors import AssetError
from experiments.minutes import main

WORDS = ["--minutes", "15"]


def result(value: float) -> dict:
    scores = {"p2s_cm": 1 / value, "psnr_db": value, "psnr_mask_db": value, "flip": 0.1}
    regions = dict.fromkeys(("total", "head", "hands", "eyes"), scores)
    return {"beside": {"filmed_aligned": regions}, "novel_pose": regions, "novel_view": regions,
            "machine": {"commit": "abc", "cpu": "some", "cores": 2}}  # fmt: skip


@pytest.fixture
def made(monkeypatch, tmp_path) -> tuple[list[list[str]], Path]:
    """What commands ran, as those leave it; the folder of results. He is better than she by 4 dB."""
    out = tmp_path / "out"

    def leave(words):
        if words[1] == "synth":
            Path(words[3], "truth").mkdir(parents=True)
            Path(words[3], "truth", "raw.json").write_text("{}")
        elif words[1] == "make":
            if "builtin_9" in words[2]:
                return 1
            work = Path(words[4]).with_suffix(".making")
            work.mkdir(exist_ok=True)
            names = ["first"] if words[-1] == "4" else ["first", "head", "fields_15"]
            for name in names:
                (work / f"{name}.glb").touch()
                os.utime(work / f"{name}.glb", (time.time() + 65,) * 2)
        else:
            value = {"first": 20.0, "head": 21.0, "fields_15": 22.0}[Path(words[2]).stem]
            Path(words[-1]).write_text(json.dumps(result(value + 4 * ("He" in words[2]))))
        return 0

    tile = np.zeros((4, 4, 3), np.uint8)
    shown = lambda *_: [tile, tile]
    for name, found in {
        "stature_of": lambda person: 1.7, "off_the_films": lambda avatar: 8.0, "true_tiles": shown,
        "avatar_tiles": shown,
    }.items():  # fmt: skip
        monkeypatch.setattr(experiments.minutes, name, found)
    return recorded_commands(monkeypatch, experiments.minutes, leave), out


def test_everybody_is_filmed_then_made_then_judged_and_medians_lead(made):
    calls, out = made
    assert main(["She.glb:female", "He.glb", "-o", str(out), *WORDS]) == 0
    assert [call[1] for call in calls] == ["synth"] * 2 + ["make"] * 4 + ["eval"] * 8
    makes = [call for call in calls if call[1] == "make"]
    assert [Path(call[2]).name for call in makes] == ["raw", "body.mp4"] * 2
    assert [call[-1] for call in makes] == ["15", "4"] * 2
    runs = {call[2]: call[call.index("--run") + 1] for call in calls if call[1] == "eval"}
    assert runs[str(out / "She/four/me.making/head.glb")] == str(out / "She/four/me.making/head")
    lines = (out / "README.md").read_text().splitlines()
    at = lines.index("## Median of 2")
    rows = [line for line in lines[at : at + 10] if line.startswith(("| four", "| the body"))]
    assert [row.split(" | ")[0] for row in rows] == [
        "| four videos: first avatar", "| four videos: learned head", "| four videos: fields, short training",
        "| the body's video alone: first avatar",
    ]  # fmt: skip
    assert (
        "| 1:05 | 8.0 |" in rows[0] and "| 22.0 / 22.0 / 22.0 | 0.100 / " in rows[0] and rows[-1].split(" | ")[2] == "-"
    )
    assert (out / "minutes.png").stat().st_size > 5000
    with Image.open(out / "sheet.jpg") as sheet:
        assert sheet.size == (5 * 4, 4 * 4)


def test_who_goes_on_has_no_time_and_who_fails_is_said(made, capsys):
    calls, out = made
    (out / "He" / "four").mkdir(parents=True)
    assert main(["He.glb", "builtin:9", "-o", str(out), *WORDS]) == 1
    assert "not made: builtin_9: " in capsys.readouterr().err
    row = next(line for line in (out / "README.md").read_text().splitlines() if line.startswith("| four videos: first"))
    assert row.split(" | ")[1] == "-"
    before = len(calls)
    assert main(["He.glb", "-o", str(out), *WORDS]) == 0
    assert len(calls) == before
    with pytest.raises(AssetError, match="nobody was made"):
        main(["builtin:9", "-o", str(out), *WORDS])
