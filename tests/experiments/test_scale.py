"""How time grows: exponents are those of the numbers, and every sweep is measured."""

import json
import tracemalloc

import numpy as np
import pytest

from avatar.motion.read import read_motion
from experiments.scale import ScaleSteps, bench_scale, crowd, fitted_power, main, take_turns, write_still_motion
from player.gl.context import open_context
from player.scene.mannequin import mannequin


@pytest.mark.parametrize("power", [0.0, 0.5, 1.0, 2.0])
def test_the_exponent_is_that_of_the_times(power):
    x = [1, 3, 10, 100]
    exact = np.tile(0.7 * np.array(x, float) ** power, (9, 1))
    assert fitted_power(x, exact) == pytest.approx((power, power, power), abs=1e-12)
    noisy = exact * np.exp(0.1 * np.random.default_rng(1).normal(size=exact.shape))
    found = fitted_power(x, noisy)
    assert found.low < power < found.high and found.high - found.low < 0.15


def test_a_fixed_cost_draws_the_exponent_below_one():
    x = np.array([1, 10, 100])
    assert 0.2 < fitted_power(x.tolist(), np.tile(10.0 + x, (3, 1))).exponent < 0.8


def test_programs_take_turns_and_run_once_untimed():
    ran = []
    wall, cpu = take_turns([lambda n: ran.append(("a", n)), lambda n: ran.append(("b", n))], 2)
    assert ran == [(who, n) for first in (0, 2) for who in "ab" for n in (first, first + 1)]
    assert wall.shape == cpu.shape == (2, 2) and wall.min() > 0 and cpu.min() > 0


def test_a_crowd_is_all_in_the_picture():
    context = open_context()
    one = crowd(context, mannequin(), 7, size=(96, 96))
    one.draw(0)
    assert one.renderer.last is not None
    image = one.renderer.draw(one.poses[0], one.camera)
    edge = np.concatenate([image[0], image[-1], image[:, 0], image[:, -1]])
    assert image[..., 3].any() and not edge[..., 3].any(), "somebody is cut off"
    one.renderer.release()
    context.release()


def test_a_motion_file_of_any_length_is_written_in_constant_memory_and_read(tmp_path):
    tracemalloc.start()
    write_still_motion(tmp_path / "long.npz", 100_003)
    assert tracemalloc.get_traced_memory()[1] < 4e6
    tracemalloc.stop()
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


def test_the_command_prints_the_exponents(tmp_path, capsys, monkeypatch):
    row = {"name": "avatars", "exponents": {"cpu": {"exponent": 0.97, "low": 0.9, "high": 1.0}}}
    monkeypatch.setattr("experiments.scale.bench_scale", lambda *_, **__: {"sweeps": [row], "warning": None})
    assert main(["-o", str(tmp_path / "x")]) == 0
    assert "x^0.97 (0.90 to 1.00)" in capsys.readouterr().out
