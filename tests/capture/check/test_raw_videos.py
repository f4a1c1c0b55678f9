"""`selfscan check` on videos as filmed: a verdict that says what to do, and JSON."""

import json

import pytest
from filmed_figure import film_anew

from capture.check.options import main


def test_good_videos_are_usable_as_a_folder_and_as_four_files(filmed_four, tmp_path, capsys):
    assert main([str(filmed_four), "-o", str(tmp_path / "out")]) == 0
    text = capsys.readouterr().out
    assert "body.mp4   240 x 180, 30 frames/s, 3.0 s; empty room 0." in text
    assert text.splitlines()[5].startswith("usable")
    facts = json.loads((tmp_path / "out" / "check.json").read_text())
    assert facts["usable"] and facts["videos"]["body"]["frames"] == 90
    files = [str(filmed_four / f"{name}.mp4") for name in ("body", "head", "left", "right")]
    assert main(files) == 0 and capsys.readouterr().out == text


def test_a_hand_that_leaves_the_picture_is_said_with_the_time(filmed_four, tmp_path, capsys):
    film_anew(filmed_four, tmp_path / "me", "hand_left", shift=(0, -66))
    assert main([str(tmp_path / "me")]) == 1
    text = capsys.readouterr().out
    assert "not usable because left.mp4: the left hand leaves the picture at the top from" in text
    assert "film again with it in the middle" in text


def test_a_folder_of_one_video_is_refused_by_what_is_missing(filmed_four, tmp_path):
    (tmp_path / "body.mp4").symlink_to(filmed_four / "body.mp4")
    with pytest.raises(Exception, match=r"found no head, left, right"):
        main([str(tmp_path)])


def test_without_keypoints_it_says_which_are_needed(filmed_four, tmp_path):
    for name in ("body", "head", "left", "right"):
        (tmp_path / f"{name}.mp4").symlink_to(filmed_four / f"{name}.mp4")
    with pytest.raises(Exception, match=r"keypoints: expected keypoints .*--keypoints DIR says where"):
        main([str(tmp_path)])
    assert main([str(tmp_path), "--keypoints", str(filmed_four / "keypoints")]) == 0
