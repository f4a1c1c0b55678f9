"""The bench of noise: what it adds to a capture, and the page it makes of the scores."""

import numpy as np
import pytest
from painted_capture import write_capture

from avatar.rotation import axis_angle_from_matrix, matrix_from_axis_angle
from capture.folder import read_capture
from experiments.noise import NOISES, noisy_capture

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
