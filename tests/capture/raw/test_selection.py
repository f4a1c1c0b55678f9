"""Frames of a moving face are found by its keypoints, against what is usual for the person."""

from pathlib import Path

import numpy as np
import pytest

from capture.keypoints.record import Keypoints
from capture.raw.glance import Glance
from capture.raw.judge import Judged
from capture.raw.selection import EYES, MOUTH, moving_face, select
from capture.raw.video_file import VideoFile

FRAMES = 60
NAMES = tuple(f"face_{k}" for k in range(27, 68))


def head(eyes, mouth, part="head"):
    """A still head, 40 pixels wide eyes and mouth of the given openings, half a pixel of noise; all frames usable."""
    pixels = np.zeros((FRAMES, len(NAMES), 2))
    for opening, place, (across, *down) in ((eyes, 100, EYES[0]), (eyes, 200, EYES[1]), (mouth, 300, MOUTH[0])):
        for sign, k in zip((-1, 1), across):
            pixels[:, NAMES.index(f"face_{k}")] = [200 + sign * 20, place]
        for pair in down:
            for sign, k in zip((-1, 1), pair):
                pixels[:, NAMES.index(f"face_{k}"), 0] = 200
                pixels[:, NAMES.index(f"face_{k}"), 1] = place + sign * 20 * opening
    pixels += 0.5 * np.random.default_rng(0).standard_normal(pixels.shape)
    found = Keypoints(NAMES, pixels, np.ones((FRAMES, len(NAMES))), (400, 400))
    video = VideoFile(Path("head.mp4"), (400, 400), 0, 30.0, FRAMES)
    seen = np.ones(FRAMES, bool)
    at = Glance(video, part, np.arange(FRAMES) / 30, np.zeros((FRAMES, 160, 160), np.uint8), np.ones(FRAMES), found)
    return Judged(at, ~seen, seen, ())


@pytest.mark.parametrize("usual", [0.0, 0.3])
def test_blinks_and_an_open_mouth_are_left_out_and_said(usual):
    eyes, mouth = np.full(FRAMES, 0.3), np.full(FRAMES, usual)
    eyes[10:14], mouth[30:40] = 0.05, usual + 0.5
    judged = head(eyes, mouth)
    blinking, talking = moving_face(judged.glance)
    assert set(np.flatnonzero(blinking)) == {10, 11, 12, 13} and set(np.flatnonzero(talking)) == set(range(30, 40))
    chosen = select(judged, 40)
    assert not set(chosen.frames.tolist()) & {*range(10, 14), *range(30, 40)}
    assert "4 with closed eyes, 10 with an open mouth" in chosen.line("head.mp4")


def test_other_videos_narrow_eyes_and_a_film_of_talk_lose_nothing():
    eyes, mouth = np.full(FRAMES, 0.15), np.zeros(FRAMES)
    assert not any(found.any() for found in moving_face(head(eyes, mouth).glance))
    eyes[::2] = 0.01
    assert not any(found.any() for found in moving_face(head(eyes, mouth, "body").glance))
    eyes, mouth[:26] = np.full(FRAMES, 0.3), 0.6
    eyes[26:46] = 0.05
    chosen = select(head(eyes, mouth), 60)
    assert "left out" not in chosen.line("head.mp4") and len(chosen.frames) == FRAMES
