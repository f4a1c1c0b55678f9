"""What single experiments measure: noise of captures, blur of a print, surfaces that cross."""

import numpy as np
import pytest
from capsules import ball_mesh
from painted_capture import write_capture
from scipy.ndimage import gaussian_filter

from avatar.rotation import axis_angle_from_matrix, matrix_from_axis_angle
from avatar.skinning import SkinWeights
from capture.folder import read_capture
from experiments.noise import NOISES, noisy_capture
from experiments.print_bands import bands
from experiments.skin_rules import crossing_pairs, nearest_vertex_weights

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


def test_two_balls_cross_exactly_where_they_overlap():
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


def test_nearest_vertex_rule_copies_a_vertex():
    vertices = np.array([[0.0, 0, 0], [1, 0, 0]])
    skin = SkinWeights(np.array([[3, 0, 0, 0], [5, 7, 0, 0]]), np.array([[1, 0, 0, 0], [0.6, 0.4, 0, 0]], np.float32))
    found = nearest_vertex_weights(np.array([[0.4, 0, 0], [0.6, 0, 0]]), vertices, skin)
    np.testing.assert_array_equal(found.joints[:, 0], [3, 5])
    np.testing.assert_allclose(found.weights[1], [0.6, 0.4, 0, 0], atol=1 / 255)
