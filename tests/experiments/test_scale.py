"""Crowds and long motions, budgets that hold or fail, and the program without effects."""

import json
from dataclasses import replace

import numpy as np
import pytest
from memory_use import at_most

from avatar.camera import orbit_camera
from avatar.motion.read import builtin_motion, read_motion
from experiments import budgets
from experiments.bare_program import BareProgram
from experiments.scale import ScaleSteps, bench_scale, crowd, fitted_power, write_still_motion
from player.budget.ladder import PricedRung
from player.budget.measure import BudgetScene
from player.budget.rung import Rung
from player.effects.background import Background
from player.scene.effects import PLAIN, STUDIO
from player.scene.mannequin import mannequin
from player.scene.renderer import Renderer


@pytest.mark.parametrize("power", [0.0, 0.5, 1.0, 2.0])
def test_the_exponent_is_that_of_the_times(power):
    x = [1, 3, 10, 100]
    exact = np.tile(0.7 * np.array(x, float) ** power, (9, 1))
    assert fitted_power(x, exact) == pytest.approx((power, power, power), abs=1e-12)
    noisy = exact * np.exp(0.1 * np.random.default_rng(1).normal(size=exact.shape))
    found = fitted_power(x, noisy)
    assert found.low < power < found.high and found.high - found.low < 0.15


def test_a_crowd_is_all_in_the_picture(context):
    one = crowd(context, mannequin(), 7, size=(96, 96))
    one.draw(0)
    assert one.renderer.last is not None
    image = one.renderer.draw(one.poses[0], one.camera)
    edge = np.concatenate([image[0], image[-1], image[:, 0], image[:, -1]])
    assert image[..., 3].any() and not edge[..., 3].any(), "somebody is cut off"
    one.renderer.release()


def test_a_motion_file_of_any_length_is_written_in_constant_memory_and_read(tmp_path):
    with at_most(4e6):
        write_still_motion(tmp_path / "long.npz", 100_003)
    motion = read_motion(tmp_path / "long.npz")
    assert motion.frames == 100_003 and not motion.read(100_000, 100_003).axis_angle[:, 1:].any()


def test_every_sweep_is_measured_and_written(tmp_path):
    steps = ScaleSteps(avatars=(1, 3), sides=(16, 32), frames=(600, 1200))
    told = []
    result = bench_scale(mannequin(), tmp_path / "out", rounds=2, size=(48, 48), steps=steps, report=told.append)
    assert json.loads((tmp_path / "out/scale.json").read_text()) == result
    names = [row["name"] for row in result["sweeps"]]
    assert names == told and [name.split(",")[0] for name in names] == [
        "avatars", "pixels", "frames in the motion file"
    ]  # fmt: skip
    assert [row["x"] for row in result["sweeps"]] == [[1, 3], [256, 1024], [600, 1200]]
    text = (tmp_path / "out/scale.md").read_text()
    assert all(name in text for name in names)


LADDER = [Rung(name, "off", level) for level, name in enumerate(("fine", "middle", "coarse"))]
SCENE = BudgetScene([], [([], orbit_camera(np.zeros(3), 2.0, 0.0, 0.0, (8, 8)))], (8, 8), PLAIN, Background(), False)


def priced(times):
    return [PricedRung(rung, ms, ms, float(k)) for k, (rung, ms) in enumerate(zip(LADDER, times, strict=True))]


@pytest.mark.parametrize(
    ("table", "now", "expected"),
    [
        ((9.0, 5.0, 2.0), (9.0, 5.5, 2.0), ("middle", True, 0)),
        ((9.0, 5.0, 2.0), (9.0, 6.5, 2.0), ("middle", False, 0)),
        # steps that would have held
        ((9.0, 7.0, 2.0), (5.0, 4.0, 2.0), ("coarse", True, 2)),
    ],
)
def test_a_budget_holds_or_fails_by_what_is_drawn_and_is_wasted_by_finer_steps_that_hold(
    monkeypatch, context, table, now, expected
):
    drawn = dict(zip(LADDER, now, strict=True))

    def rung_times(context, scene, rungs, rounds):
        return np.array([[drawn[one] for one in rungs]] * rounds)

    monkeypatch.setattr(budgets, "rung_times", rung_times)
    row = budgets.tried(context, SCENE, priced(table), 6.0, 10)
    assert (row["rung"], row["holds"], row["steps_wasted"]) == expected


def test_the_program_without_effects_draws_the_bare_scenes_picture(context):
    """Else the time beside it would say nothing."""
    avatar, size = mannequin(), (160, 120)
    camera = orbit_camera(avatar.joint_positions.mean(0), 2.6, 0.4, 0.1, size)
    clip = builtin_motion("walking").read(20, 21)
    pose = clip.axis_angle[0].astype(np.float64), np.zeros(3)
    renderer = Renderer(context, [avatar], size, effects=replace(PLAIN, view="off"), background=STUDIO)
    expected = renderer.draw([pose], camera)
    program = BareProgram(context, avatar, size, STUDIO.color)
    program.draw(pose, camera)
    assert np.array_equal(program.picture(), expected) and len(np.unique(expected)) > 50
    program.release()
    renderer.release()


def test_the_bare_scene_makes_the_calls_of_the_program_and_no_more(context):
    avatar, size = mannequin(), (96, 96)
    camera = orbit_camera(avatar.joint_positions.mean(0), 2.6, 0.4, 0.1, size)
    poses = [(np.full((52, 3), 0.01 * k), np.zeros(3)) for k in range(4)]
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
