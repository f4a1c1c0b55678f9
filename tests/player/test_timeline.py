"""Time that plays, loops, steps and scrubs, and the tracks on it."""

import numpy as np
import pytest

from avatar.motion.clip import Clip, Motion
from avatar.rotation import matrix_from_axis_angle
from player.scene.motions import BLOCK
from player.scene.track import Track
from player.window.playback import Playback
from player.window.timeline import SPEEDS, Timeline


def test_a_second_of_play_is_a_second_of_clip_at_any_speed():
    for speed in SPEEDS:
        line = Timeline(1000, 30)
        line.speed = speed
        for _ in range(60):
            line.advance(1 / 60)
        assert line.frame == int(30 * speed) and abs(line.seconds - speed) < 1e-12


def test_steps_pause_and_stop_at_the_ends_and_scrubbing_shows_the_moment():
    line = Timeline(100, 30)
    line.step(-3)
    assert line.frame == 0 and not line.playing
    line.step(500)
    assert line.frame == 99
    for seconds in (0.0, 1.0, 1.033, 99.0, -1.0):
        line.scrub(seconds)
        assert line.frame == min(max(int(seconds * 30 + 1e-6), 0), 99)


def test_time_stays_in_the_clip_over_a_long_run():
    line = Timeline(7, 30)
    line.speed = 4.0
    rng = np.random.default_rng(0)
    for dt in [float("nan"), *rng.uniform(-0.1, 1.0, 20_000)]:
        line.advance(dt)
        assert 0 <= line.seconds <= line.duration
        assert 0 <= line.frame < 7


def test_a_timeline_needs_frames_and_a_rate():
    for frames, rate in ((0, 30), (10, 0), (10, float("nan"))):
        with pytest.raises(ValueError, match="needs frames and a rate"):
            Timeline(frames, rate)


def numbered(frames, rate=30.0, reads=None):
    """A motion whose pelvis is as high as the frame's number."""

    def block(start, stop):
        if reads is not None:
            reads.append((start, stop))
        root = np.zeros((stop - start, 3))
        root[:, 1] = np.arange(start, stop)
        return np.zeros((stop - start, 52, 3)), root

    return Track(Motion("", frames, rate, (), block))


def test_each_track_has_its_own_rate_start_and_length():
    slow, fast = numbered(10, 10.0), numbered(200, 100.0)
    fast.start = 0.5
    playback = Playback([slow, fast])
    assert playback.timeline.duration == 1.5 and playback.timeline.rate == 10
    playback.timeline.seconds = 0.42
    assert [pose[1][1] for pose in playback.poses()] == [4, 92]
    playback.timeline.seconds = 1.45
    assert [pose[1][1] for pose in playback.poses()] == [9, 195]  # past its end the last frame is held


def test_a_track_reads_blocks_and_keeps_two():
    reads = []
    track = numbered(10 * BLOCK, reads=reads)
    for frame in [*range(3 * BLOCK), 3 * BLOCK - 1, 2 * BLOCK - 1, 2 * BLOCK]:
        assert track.pose((frame + 0.5) / 30)[1][1] == frame
    assert reads == [(k * BLOCK, (k + 1) * BLOCK) for k in range(3)]
    assert len(track._blocks) == 2


def test_a_place_turns_the_body_about_the_vertical_and_then_moves_it():
    rng = np.random.default_rng(1)
    axis_angle, root = rng.normal(size=(1, 52, 3)), rng.normal(size=(1, 3))
    track = Track(Clip(axis_angle, root, 30.0), at=np.array([1.0, 0.0, -2.0]), turn=2.0)
    turned = matrix_from_axis_angle(np.array([0.0, 2.0, 0.0]))
    pose, place = track.pose(0.0)
    assert np.allclose(place, turned @ root[0] + [1, 0, -2], atol=1e-12)
    assert np.allclose(matrix_from_axis_angle(pose[0]), turned @ matrix_from_axis_angle(axis_angle[0, 0]), atol=1e-12)
    assert np.array_equal(pose[1:], axis_angle[0, 1:])
