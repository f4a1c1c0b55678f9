"""Effects beside the best rung: which the file allows, and that truth, not the best rung, judges them."""

from dataclasses import replace

import numpy as np
import pytest

from bench.effect_rungs import effect_rows, effect_rungs, effects_section
from bench.rung_pictures import motion_frames, rung_pictures
from bench.rung_scores import crop_of
from player.context import open_context
from player.ladder import rungs_of
from player.mannequin import mannequin
from player.scenes.effects import PLAIN


@pytest.fixture(scope="module")
def avatar():
    return mannequin(texture=64)


@pytest.fixture(scope="module")
def context():
    made = open_context()
    yield made
    made.release()


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
    row = effect_rows(context, avatar, rung, frames, plain, crops, masks, truths, 8)[0]
    assert row["name"] == "dual quaternions" and row["change_flip"] > 0
    assert not row["against_truth"]["flip"] and row["plain_against_truth"]["flip"] == row["change_flip"]
    low, high = row["times_plain_interval"]
    assert 0 < low <= row["times_plain"] <= high
    page = effects_section([row], rung.name)
    assert "FLIP against truth" in page and "--effects" in page
    (bare,) = effect_rows(context, avatar, rung, frames, plain, crops, masks, [], 8)[:1]
    assert "against_truth" not in bare and "which is no error: only true pictures" in effects_section([bare], rung.name)
