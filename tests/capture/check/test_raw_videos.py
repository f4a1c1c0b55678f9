"""What `check` says of videos as they were filmed."""

import json
from pathlib import Path

import pytest
from filmed_figure import film_anew
from refusals import refused

from capture.check.command import _then
from capture.check.options import main
from capture.raw.four_videos import find_videos, holds_videos
from capture.raw.judge import verdict_of
from command.errors import AssetError


def test_good_videos_are_usable_as_a_folder_and_as_four_files(filmed_four, tmp_path, capsys):
    assert main([str(filmed_four), "-o", str(tmp_path / "out")]) == 0
    text = capsys.readouterr().out
    assert "body.mp4   240 x 180, 30 frames/s, 3.0 s; empty room 0." in text
    assert "\nusable" in text and text.endswith(f"\nthen: selfscan make {filmed_four} -o NAME.glb\n")
    assert "head.mp4: keypoints: 7 of 133 points seen" in text
    facts = json.loads((tmp_path / "out" / "check.json").read_text())
    assert facts["usable"] and facts["videos"]["body"]["frames"] == 90
    files = [filmed_four / f"{name}.mp4" for name in ("body", "head", "left", "right")]
    assert find_videos(files) == find_videos([filmed_four])


@pytest.mark.slow
def test_a_hand_that_leaves_the_picture_is_said_with_the_time_and_the_body_alone_is_enough(
    filmed_four, tmp_path, capsys
):
    film_anew(filmed_four, tmp_path / "me", "hand_left", shift=(0, -66))
    assert main([str(tmp_path / "me")]) == 1
    text = capsys.readouterr().out
    assert "not usable because left.mp4: the left hand leaves the picture at the top from" in text
    assert "film again with it in the middle" in text
    assert main([str(filmed_four / "body.mp4")]) == 0
    text = capsys.readouterr().out
    assert "head: no film of its own; body.mp4 shows it about" in text and "hand_right: no film" in text


def test_films_are_told_apart_by_name_or_order_and_none_is_given_twice(tmp_path):
    names = ("body", "left", "head")
    files = [tmp_path / f"{name}.mp4" for name in names]
    for file in files:
        file.write_bytes(file.name.encode())
    assert find_videos(files) == find_videos([tmp_path]) == dict(zip(("body", "hand_left", "head"), files))
    assert find_videos(files[:1]) == {"body": files[0]}
    # names say more than the order: `me/*.mp4` is body, hand_left, hand_right, head
    four = [tmp_path / name for name in ("body.mp4", "hand_left.MP4", "hand_right.avi", "head.mp4")]
    for file in four[1:3]:
        file.write_bytes(file.name.encode())
    found = dict(zip(("body", "head", "hand_left", "hand_right"), (four[0], four[3], *four[1:3])))
    assert find_videos(four) == found
    refused(AssetError, r"called body, head, left, right; found head.mp4", find_videos, four[3:])
    for file in four[1:3]:
        file.unlink()
    other = tmp_path / "IMG_7.mov"
    refused(AssetError, r"IMG_7.mov: expected a film, or a folder of them, found nothing", find_videos, [other])
    other.touch()
    refused(AssetError, r"called body, head, left, right; found body.mp4, IMG_7.mov", find_videos, [files[0], other])
    other.unlink()
    files[2].write_bytes(files[0].read_bytes())
    refused(AssetError, r"is the same film as .*body.mp4; leave it out", find_videos, files)
    files[0].unlink()
    refused(AssetError, r"expected body.mp4, and head.mp4, .* found .*left.mp4", find_videos, [tmp_path])


def test_films_as_a_phone_names_them_are_found(tmp_path):
    (tmp_path / "IMG_0012.MOV").write_bytes(b"body")
    assert holds_videos(tmp_path) and find_videos([tmp_path]) == {"body": tmp_path / "IMG_0012.MOV"}
    (tmp_path / "IMG_0013.MOV").write_bytes(b"head")
    refused(AssetError, r"expected body.mp4, .* found IMG_0012.MOV, IMG_0013.MOV", find_videos, [tmp_path])
    films = {part: (tmp_path / old).rename(tmp_path / f"{part.title()}.MOV")
             for part, old in (("body", "IMG_0012.MOV"), ("head", "IMG_0013.MOV"))}  # fmt: skip
    assert find_videos([tmp_path]) == find_videos([films["head"], films["body"]]) == films
    (tmp_path / "body.mp4").write_bytes(b"made of it")
    assert find_videos([tmp_path])["body"].name == "body.mp4"


def test_a_name_that_begins_with_a_dash_is_no_option_of_the_command_that_comes_next():
    assert _then(verdict_of([]), "make", Path("-body.mp4")) == ["then: selfscan make ./-body.mp4"]


def test_a_folder_with_neither_films_nor_a_capture_says_what_was_expected(tmp_path):
    refused(AssetError, r"expected a capture, .* or films \(body.mp4, .*\), found neither", main, [str(tmp_path)])
    (tmp_path / "me.gif").write_bytes(b"GIF89a")
    (tmp_path / "keypoints").mkdir()
    refused(AssetError, r"me.gif: expected a video .*, found a file that begins", main, [str(tmp_path / "me.gif")])


def test_without_keypoints_it_says_which_are_needed(filmed_four, tmp_path):
    for name in ("body", "head", "left", "right"):
        (tmp_path / f"{name}.mp4").symlink_to(filmed_four / f"{name}.mp4")
    refused(Exception, r"keypoints: expected keypoints .*--keypoints DIR says where", main, [str(tmp_path)])
    assert main([str(tmp_path), "--keypoints", str(filmed_four / "keypoints")]) == 0
