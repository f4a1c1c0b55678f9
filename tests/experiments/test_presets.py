"""Accuracy against seconds: what is held out trains nothing, and what is extrapolated says so."""

import json
from dataclasses import replace

import pytest
import torch
from painted_capture import write_capture

import experiments.presets
from experiments.presets import checkpoints, main
from train.preset import DEMO, PRESETS

SMALL = replace(
    DEMO, rays=128, rays_per_frame=300, warm_up=5,
    parts=tuple(replace(p, cell=max(p.cell, 0.006), spacing=max(p.spacing, 0.006)) for p in DEMO.parts),
)  # fmt: skip


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """presets.json of a small demo preset on a hand of eight frames, and what the trainer was given."""
    folder = tmp_path_factory.mktemp("presets")
    capture = write_capture(folder / "person", frames=8)
    given = {}

    def watched(field, rays, training, **others):
        given.update(frames=rays.frame.unique().tolist(), before=field.appearance.weight.detach().clone())
        skipped = train_field(field, rays, training, **others)
        given["after"] = field.appearance.weight.detach().clone()
        return skipped

    train_field = experiments.presets.train_field
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(PRESETS, "demo", SMALL)
        patch.setattr(experiments.presets, "train_field", watched)
        words = [str(folder / "out"), "--capture", str(capture), "--part", "hand_left", "--presets", "demo"]
        assert main([*words, "--iterations", "60"]) == 0
    return json.loads((folder / "out" / "presets.json").read_text()), folder / "out", given


def test_the_held_out_frame_trains_nothing_and_is_drawn_with_the_mean_code(measured):
    _, _, given = measured
    assert given["frames"] == [0, 1, 2, 4, 5, 6, 7]
    torch.testing.assert_close(given["after"][3], given["after"][given["frames"]].mean(0), rtol=0.02, atol=1e-4)
    assert (given["before"][3] != given["after"][3]).any()


def test_scores_rise_with_the_steps_and_time_runs_forward(measured):
    preset = measured[0]["presets"][0]
    points = preset["checkpoints"]
    assert points[-1]["iteration"] == 60 and points[-1]["psnr_db"] > points[0]["psnr_db"] + 1
    assert all(a["seconds"] < b["seconds"] for a, b in zip(points, points[1:]))
    assert preset["held_out_rays"] > 20


def test_scores_are_taken_at_steps_the_trainer_reports_at():
    for iterations in (7, 60, 1000, 1505):
        steps = checkpoints(iterations)
        assert steps[-1] == iterations and all(step % 10 == 0 for step in steps[:-1])
    assert checkpoints(1000)[0] == 20
