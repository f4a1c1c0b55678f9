"""What each effect costs: every one is timed, with its passes and bytes, and there is a page to look at."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tiny_avatar import tiny_avatar

from avatar.camera import orbit_camera
from avatar.motion.read import builtin_motion
from avatar.settings import parse, settings_of
from bench import effects
from bench.bare_program import BareProgram
from bench.report import BENCH, BenchCommand
from player.context import open_context
from player.mannequin import mannequin
from player.renderer import Renderer
from player.scenes.effects import PLAIN, STUDIO, Effects


def test_every_effect_is_timed_alone_and_together():
    names = {case.name for case in effects.cases()}
    assert {s.name.replace("_", " ") for s in settings_of(Effects) if s.table is not None} <= names
    everything = effects.cases()[-1].effects
    assert all(getattr(everything, s.name) is not None for s in settings_of(Effects) if s.table is not None)


def test_the_table_has_what_ran_and_what_it_holds(tmp_path, monkeypatch):
    chosen = [case for case in effects.cases() if case.name in ("ground", "motion blur")]
    monkeypatch.setattr(effects, "cases", lambda: chosen)
    result = effects.bench_effects(tiny_avatar(), tmp_path / "out", rounds=1, size=(64, 64))
    written = json.loads((tmp_path / "out" / "effects.json").read_text())
    assert written["effects"] == result["effects"] and (tmp_path / "out" / "effects.png").stat().st_size > 1000
    rows = {row["name"]: row for row in written["effects"]}
    assert all(row["ms"] > 0 and row["times_bare"] > 0 and row["cpu_times_bare"] > 0 for row in rows.values())
    assert (
        rows["ground"]["ran"] == ["ground: floor", "ground: mask", "ground: shadow"] and rows["ground"]["passes"] == 3
    )
    assert rows["motion blur"]["bytes"] == 0 < rows["ground"]["bytes"]
    low, high = written["bare_times_program"]["interval"]
    assert 0 < low <= written["bare_times_program"]["median"] <= high
    page = (tmp_path / "out" / "effects.md").read_text()
    assert "never heard of effects" in page
    assert all(f"| {name} |" in page for name in rows)


def test_the_command_needs_an_avatar_or_effects():
    assert parse(BenchCommand, ["--effects", "-o", "x"], BENCH).avatar is None
    with pytest.raises(ValueError, match="give AVATAR, --effects or --scale"):
        BenchCommand(Path("x"))
    with pytest.raises(ValueError, match="leave --effects and --scale out"):
        BenchCommand(Path("x"), effects=True, run=Path("run"))


def test_the_program_without_effects_draws_the_bare_scenes_picture():
    """Else the time beside it would say nothing."""
    avatar, size = mannequin(), (160, 120)
    camera = orbit_camera(avatar.joint_positions.mean(0), 2.6, 0.4, 0.1, size)
    clip = builtin_motion("walking").read(20, 21)
    pose = clip.axis_angle[0].astype(np.float64), np.zeros(3)
    context = open_context()
    try:
        renderer = Renderer(context, [avatar], size, effects=replace(PLAIN, view="off"), background=STUDIO)
        expected = renderer.draw([pose], camera)
        program = BareProgram(context, avatar, size, STUDIO.color)
        program.draw(pose, camera)
        assert np.array_equal(program.picture(), expected) and len(np.unique(expected)) > 50
        program.release()
        renderer.release()
    finally:
        context.release()


def test_the_bare_scene_makes_the_calls_of_the_program_and_no_more():
    avatar, size = mannequin(), (96, 96)
    camera = orbit_camera(avatar.joint_positions.mean(0), 2.6, 0.4, 0.1, size)
    poses = [(np.full((52, 3), 0.01 * k), np.zeros(3)) for k in range(4)]
    context = open_context()
    try:
        renderer = Renderer(context, [avatar], size, effects=replace(PLAIN, view="off"), background=STUDIO)
        program = BareProgram(context, avatar, size, STUDIO.color)
        target, calls = renderer.target, []
        for draw in (lambda pose: renderer.draw_into(target, [pose], camera), lambda pose: program.draw(pose, camera)):
            draw(poses[0])
            before, sent, objects = context.counts.calls.copy(), context.counts.uploaded, context.counts.objects()
            for pose in poses[1:]:
                draw(pose)
            assert context.counts.objects() == objects
            calls.append((context.counts.calls - before, context.counts.uploaded - sent))
        assert calls[0] == calls[1] and calls[0][0]["draw"] == 3
        program.release()
        renderer.release()
    finally:
        context.release()
