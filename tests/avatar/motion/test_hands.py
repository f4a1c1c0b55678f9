"""--hands: replaced and said, or left as they are."""

import dataclasses

import numpy as np
import pytest
from smplh_model import model_body
from tiny_avatar import tiny_avatar

from avatar.body import builtin_body
from avatar.gltf.avatar_file import write_avatar
from avatar.motion.fingers import relaxed_hands
from avatar.motion.hands import HANDS, with_hands
from avatar.motion.read import builtin_motion
from command.errors import AssetError
from player.film.command import render_main
from player.scene.mannequin import mannequin
from player.scene.motions import motion_for


def test_file_leaves_the_motion_as_it_is():
    motion = builtin_motion("counting")
    assert with_hands(motion, "file") is motion


@pytest.mark.parametrize("choice", ["flat", "relaxed", "mean"])
def test_hands_are_replaced_in_every_frame_and_nothing_else(tmp_path, choice):
    body = model_body(tmp_path)
    motion = builtin_motion("counting")
    new, old = with_hands(motion, choice, body).read(120, 140), motion.read(120, 140)
    expected = {"flat": np.zeros((30, 3)), "relaxed": relaxed_hands(), "mean": body.hands.mean.reshape(30, 3)}[choice]
    np.testing.assert_array_equal(new.axis_angle[:, 22:], np.broadcast_to(expected, (20, 30, 3)))
    np.testing.assert_array_equal(new.axis_angle[:, :22], old.axis_angle[:, :22])
    np.testing.assert_array_equal(new.root, old.root)
    assert np.ptp(old.axis_angle[:, 22:], axis=0).max() > 0.1  # the file's hands do move
    said = [note for note in new.notes if note.startswith("hands:")]
    assert len(said) == 1 and "in place of the file's" in said[0]


def test_the_mean_needs_a_model_that_has_it(tmp_path):
    motion = builtin_motion("counting")
    for body in (None, builtin_body("male"), model_body(tmp_path, hands=False)):
        with pytest.raises(AssetError, match="hands_meanl and hands_meanr, given with --body"):
            with_hands(motion, "mean", body)


def test_an_unknown_choice_is_refused():
    with pytest.raises(ValueError, match="file, flat, relaxed, mean, is 'fist'"):
        with_hands(builtin_motion("counting"), "fist")


@pytest.mark.parametrize("choice", HANDS)
def test_the_command_opens_the_motion_with_the_hands_asked_for(tmp_path, choice):
    body = model_body(tmp_path)
    avatar, model = mannequin(), str(tmp_path / "model.npz")
    motion = motion_for(avatar, "walking", body=model, hands=choice)
    same = with_hands(builtin_motion("walking"), choice, body)
    np.testing.assert_array_equal(motion.read(5, 6).axis_angle, same.read(5, 6).axis_angle)
    assert set(same.notes) < set(motion.notes)
    still = motion_for(avatar, None, body=model, hands=choice).read()
    assert bool(still.axis_angle[0, 22:].any()) == (choice in ("relaxed", "mean"))


def test_render_prints_what_it_did_with_the_hands(tmp_path, capsys):
    write_avatar(tmp_path / "a.glb", dataclasses.replace(tiny_avatar(), name="a"))
    frame = ["--frame", "3", "--size", "32x32", "-o", str(tmp_path / "a.png")]
    assert render_main([str(tmp_path / "a.glb"), "--motion", "counting", "--hands", "relaxed", *frame]) == 0
    assert "hands: relaxed, in place of the file's" in capsys.readouterr().out
