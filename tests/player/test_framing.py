"""Fitted cameras: even margins round what is drawn, in pixels."""

import numpy as np
import pytest
from pictures import pictures_in

from player.film.command import render_main

SIZES = [(640, 640), (360, 640), (640, 360), (480, 270), (200, 600)]


def margins(folder, size):
    """Pixels free at the left, right, top and bottom of all frames together."""
    seen = np.zeros((size[1], size[0]), bool)
    pictures = pictures_in(folder)
    assert pictures
    for picture in pictures:
        seen |= picture[..., 3] > 0
    rows, columns = np.flatnonzero(seen.any(1)), np.flatnonzero(seen.any(0))
    return columns[0], size[0] - 1 - columns[-1], rows[0], size[1] - 1 - rows[-1]


def filmed(avatar_path, folder, size, *options):
    plain = ["--view", "off", "--level", "9", "--background", "transparent", "--size", f"{size[0]}x{size[1]}"]
    assert render_main([avatar_path, *plain, *options, "-o", str(folder)]) == 0
    return margins(folder, size)


def check(found, size, *, play):
    """6 % in the direction that decides, no less in the other, both sides alike within `play` of the picture."""
    left, right, top, bottom = found
    width, height = size
    shares = (left / width, right / width, top / height, bottom / height)
    assert min(shares) > 0.06 - play, shares
    assert min(max(shares[:2]), max(shares[2:])) < 0.06 + play, shares
    assert abs(left - right) <= play * width and abs(top - bottom) <= play * height, found


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize(
    "motion, frames, play", [("counting", "60:61", 0.008), ("walking", "0:24", 0.012), ("counting", "0:40", 0.012)]
)
def test_front_leaves_even_margins_round_a_picture_and_a_film(avatar_path, tmp_path, size, motion, frames, play):
    check(filmed(avatar_path, tmp_path / "f", size, "--motion", motion, "--frames", frames), size, play=play)


@pytest.mark.parametrize("size", SIZES[:3])
@pytest.mark.parametrize("camera", ["orbit", "turntable"])
def test_a_camera_that_goes_round_leaves_even_margins(avatar_path, tmp_path, size, camera):
    seconds = ("--seconds", "1.5") if camera == "turntable" else ()
    found = filmed(
        avatar_path, tmp_path / "f", size, "--motion", "counting", "--frames", "0:45", "--camera", camera, *seconds
    )
    check(found, size, play=0.02)


def test_a_t_pose_fills_the_width(avatar_path, tmp_path):
    left, right, top, bottom = filmed(avatar_path, tmp_path / "f", (640, 640))
    assert abs(left - 38) <= 4 and abs(right - 38) <= 4 and abs(top - bottom) <= 4
