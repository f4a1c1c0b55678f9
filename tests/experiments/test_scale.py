"""How time grows: exponents are those of the numbers, and every sweep is measured."""

import json

import numpy as np
import pytest
from memory_use import at_most

from avatar.motion.read import read_motion
from experiments.scale import ScaleSteps, bench_scale, crowd, fitted_power, write_still_motion
from player.scene.mannequin import mannequin


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
