"""Effects beside the best rung: which the file allows, and that truth, not the best rung, judges them."""

import json
from dataclasses import replace

import numpy as np
import pytest

from avatar.camera import project
from avatar.light import CaptureLight, Lamp
from bench.ladder.rung_pictures import motion_frames, rung_pictures
from bench.ladder.rung_scores import crop_of
from experiments.effect_rungs import effect_rows, effect_rungs, effects_section, main
from player.budget.ladder import rungs_of
from player.scene.effects import PLAIN
from player.scene.mannequin import mannequin


@pytest.fixture(scope="module")
def avatar():
    return mannequin(texture=64)


def test_only_what_the_file_allows_is_compared(avatar):
    named = {one.name: one for one in effect_rungs(avatar)}
    assert "dual quaternions" in named and "light by the capture's lamps" not in named
    assert ("without twist and bend joints" in named) == (avatar.levels[0].twist is not None)


def test_an_effect_that_is_the_truth_is_nearer_to_it_and_costs_what_its_frames_take(context, avatar):
    frames = motion_frames(avatar, 2, (96, 96))
    rung = rungs_of(avatar)[0]
    plain = rung_pictures(context, avatar, rung, frames)
    renderer = rung.renderer(context, [avatar], (96, 96), effects=replace(PLAIN, skinning="dual_quaternion"))
    truths = [renderer.draw([f.pose], f.camera)[..., :3].astype(np.float32) / 255 for f in frames]
    renderer.release()
    masks = [picture.max(-1) > 0 for picture in plain]
    crops = [crop_of(mask) for mask in masks]
    row = effect_rows(context, avatar, rung, frames, plain, crops, masks, truths, 8)[0].row
    assert row["name"] == "dual quaternions" and row["change_flip"] > 0
    assert not row["against_truth"]["flip"] and row["plain_against_truth"]["flip"] == row["change_flip"]
    low, high = row["times_plain_interval"]
    assert 0 < low <= row["times_plain"] <= high
    page = effects_section([row], rung.name)
    assert "FLIP against truth" in page and "--effects" in page
    bare = effect_rows(context, avatar, rung, frames, plain, crops, masks, [], 8)[0].row
    assert "against_truth" not in bare and "which is no error: only true pictures" in effects_section([bare], rung.name)


def test_the_command_measures_the_effects_of_a_file(oracle, tmp_path):
    capture, avatar, _ = oracle
    assert main([str(avatar), "--capture", str(capture), "-o", str(tmp_path / "out"), "--rounds", "2"]) == 0
    rows = json.loads((tmp_path / "out" / "effect_rungs.json").read_text())["effects"]
    assert rows[0]["name"] == "dual quaternions" and rows[0]["against_truth"]["flip"] > 0
    assert "dual quaternions" in (tmp_path / "out" / "effect_rungs.md").read_text()


def test_the_capture_s_light_is_a_row_of_a_file_that_holds_it_and_comes_from_its_lamps(context, avatar):
    """Videos without any shading; a lamp of the world at +x, as bright as the rest."""
    lamp = CaptureLight(0.5, (Lamp((1.0, 0.0, 0.0), 0.5),), frame="world")
    plain_light = [replace(one, light=np.tile(np.float32([1, 0]), (len(one.positions), 1))) for one in avatar.levels]
    lit = replace(avatar, light=lamp, levels=tuple(plain_light))
    assert [one.name for one in effect_rungs(lit)][:2] == ["dual quaternions", "light by the capture's lamps"]
    frames = motion_frames(lit, 2, (96, 96))
    rung = next(one for one in rungs_of(lit) if one.view == "off")
    plain = rung_pictures(context, lit, rung, frames)
    masks = [picture.max(-1) > 0 for picture in plain]
    effect = effect_rows(context, lit, rung, frames, plain, [crop_of(m) for m in masks], masks, plain, 2)[1]
    assert effect.row["name"] == "light by the capture's lamps" and effect.row["change_flip"] > 0
    # the pictures as they are without it are the truth here
    assert not effect.row["plain_against_truth"]["flip"] and effect.row["against_truth"]["flip"] > 0
    for frame, before, after, mask in zip(frames, plain, effect.pictures, masks, strict=True):
        pixels, _ = project(frame.camera, frame.pose[1] + np.array([[-0.1, 0.0, 0.0], [0.1, 0.0, 0.0]]))
        brighter = np.where(mask, after.sum(-1) / np.maximum(before.sum(-1), 1e-6), np.nan)
        left, right = brighter[:, : int(pixels[:, 0].mean())], brighter[:, int(pixels[:, 0].mean()) :]
        near, far = (right, left) if pixels[1, 0] > pixels[0, 0] else (left, right)
        # half the light without a normal towards the lamp, all of it straight towards it
        assert np.nanmean(near) > np.nanmean(far) + 0.04 and 0.45 < np.nanmin(far) < 0.6
