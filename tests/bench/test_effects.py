"""`selfscan bench --effects`: what each effect costs."""

import json
from pathlib import Path

import pytest
from tiny_avatar import tiny_avatar, tiny_face

from bench.bench_command import BENCH, BenchCommand
from bench.ladder import effects
from command.command_line import parse
from command.settings import settings_of
from player.scene.effects import Effects


def test_every_effect_is_timed_alone_and_together_and_the_command_needs_one():
    names = {case.name for case in effects.cases(tiny_avatar())}
    assert {case.name for case in effects.cases(tiny_face())} - names == {"a face at rest", "a face: 8 shapes and gaze"}
    assert {s.name.replace("_", " ") for s in settings_of(Effects) if s.table is not None} <= names
    everything = effects.cases(tiny_avatar())[-1].effects
    assert all(getattr(everything, s.name) is not None for s in settings_of(Effects) if s.table is not None)
    assert parse(BenchCommand, ["--effects", "-o", "x"], BENCH).avatar is None
    with pytest.raises(ValueError, match="give AVATAR or --effects"):
        BenchCommand(Path("x"))
    with pytest.raises(ValueError, match="leave --effects out"):
        BenchCommand(Path("x"), effects=True, run=Path("run"))


def test_the_table_has_what_ran_and_what_it_holds(tmp_path, monkeypatch):
    chosen = [case for case in effects.cases(tiny_avatar()) if case.name in ("ground", "motion blur")]
    monkeypatch.setattr(effects, "cases", lambda avatar: chosen)
    result = effects.bench_effects(tiny_avatar(), tmp_path / "out", rounds=1, size=(64, 64))
    written = json.loads((tmp_path / "out" / "effects.json").read_text())
    assert written["effects"] == result["effects"] and (tmp_path / "out" / "effects.png").stat().st_size > 1000
    rows = {row["name"]: row for row in written["effects"]}
    assert all(row["ms"] > 0 and row["times_bare"] > 0 and row["cpu_times_bare"] > 0 for row in rows.values())
    assert (
        rows["ground"]["ran"] == ["ground: floor", "ground: mask", "ground: shadow"] and rows["ground"]["passes"] == 3
    )
    assert rows["motion blur"]["bytes"] == 0 < rows["ground"]["bytes"]
    page = (tmp_path / "out" / "effects.md").read_text()
    assert all(f"| {name} |" in page for name in rows)
