"""Takes on an even clock, the One-Euro filter, and the stamps."""

import numpy as np
import pytest

from avatar.errors import AssetError
from avatar.motion.amass import read_amass
from player.live.frame import LiveFrame, LivePose
from player.live.latency import HEADER, Latency
from player.live.one_euro import OneEuro
from player.live.take import Take, even_rate


def pose(angle, joint=16):
    axis_angle = np.zeros((52, 3))
    axis_angle[joint, 2] = angle
    return LivePose(axis_angle, np.array([angle, 1.0, 0.0]))


def take_of(times):
    take = Take()
    for time in times:
        take.add(time, pose(0.1 * time))
    return take


def test_frames_on_an_even_clock_keep_their_poses_to_the_bit():
    rng = np.random.default_rng(0)
    times = 5 + np.arange(100) / 60 + 1e-3 * rng.uniform(-1, 1, 100)
    clip = take_of(times).clip()
    assert clip.rate == 60 and len(clip.root) == 100
    assert np.array_equal(clip.axis_angle[:, 16, 2], (0.1 * times).astype(np.float32))


def test_a_lost_frame_is_filled_between_its_neighbours_and_a_long_silence_is_cut():
    times = np.arange(20) / 30
    clip = take_of(np.delete(times, [7, 8])).clip()
    assert len(clip.root) == 20 and np.allclose(clip.axis_angle[:, 16, 2], 0.1 * times, atol=1e-6)
    assert np.allclose(clip.root[:, 0], 0.1 * times, atol=1e-6)
    silent = take_of(np.concatenate([times, times + 3600])).clip()
    assert len(silent.root) == 20 + 20 + 59  # two seconds of the hour


def test_a_clock_that_goes_backwards_stands_still_in_the_take():
    clip = take_of([0, 1 / 30, 2 / 30, -100, -100 + 1 / 30]).clip()
    assert len(clip.root) == 4 and np.allclose(clip.axis_angle[2, 16, 2], -10)


def test_the_rate_is_a_usual_one_or_the_median():
    for rate in (24, 30, 60, 72, 240):
        assert even_rate(np.full(9, 1.005 / rate)) == rate
    assert abs(even_rate(np.full(9, 1 / 41)) - 41) < 1e-9
    assert even_rate(np.zeros(0)) == 30.0


def test_a_take_that_would_fill_the_memory_stops_and_says_so(tmp_path):
    take = Take(most=10)
    for n in range(50):
        take.add(n / 30, pose(0.0))
    assert take.full and len(take.times) == 10
    clip = take.write(tmp_path / "a.npz", 0.9)
    assert "stopped after 10 frames" in clip.notes[0]
    found = read_amass(tmp_path / "a.npz")
    assert found.frames == 10 and found.pelvis_height == 0.9
    with pytest.raises(ValueError, match="no pose came"):
        Take().clip()


def test_one_euro_leaves_a_constant_pose_constant():
    rng = np.random.default_rng(0)
    still = LivePose(rng.normal(size=(52, 3)), rng.normal(size=3))
    smooth = OneEuro()
    for dt in [0.01, 1e-6, 10.0, 0.0, -5.0] * 200:
        found = smooth(still, dt)
    assert np.abs(found.axis_angle - still.axis_angle).max() < 1e-12
    assert np.abs(found.root - still.root).max() < 1e-12


def test_one_euro_steadies_a_jitter_and_follows_a_motion():
    rng = np.random.default_rng(1)
    noise = 0.01 * rng.normal(size=600)
    smooth = OneEuro()
    still = [smooth(pose(x), 1 / 60).axis_angle[16, 2] for x in noise][100:]
    assert np.std(still) < 0.4 * np.std(noise)
    smooth = OneEuro()
    swing = np.sin(2 * np.pi * np.arange(240) / 60)  # once a second, up to 6 rad/s
    found = np.array([smooth(pose(x), 1 / 60).axis_angle[16, 2] for x in swing])
    assert np.abs(found - swing)[60:].max() < 0.25
    with pytest.raises(ValueError, match="cut-off"):
        OneEuro(0.0)


def test_one_euro_crosses_a_half_turn_on_the_short_way():
    smooth = OneEuro(1000.0)
    for angle in np.linspace(3.0, 3.3, 50):
        found = smooth(pose(angle), 1 / 60).axis_angle[16, 2]
    assert abs((found - 3.3 + np.pi) % (2 * np.pi) - np.pi) < 0.01


def test_stamps_become_rows_and_percentiles(tmp_path):
    latency = Latency(tmp_path / "l.csv")
    for n in range(100):
        frame = LiveFrame(None, 10 + n + 0.001 * (n % 2), float(n), 10.0 + n, n)
        latency.applied(frame, frame.received + 0.002)
        latency.applied(frame, frame.received + 0.5)  # drawn again: only the first time counts
        latency.drawn(frame.received + 0.010)
        latency.drawn(frame.received + 0.6)
    found = latency.percentiles()
    assert found is not None and np.allclose(found, 10)
    assert "sent to received: p50 0.50 ms, p95 1.00" in latency.summary()[0]
    assert not (tmp_path / "l.csv").exists()
    latency.close()
    rows = (tmp_path / "l.csv").read_text().splitlines()
    assert rows[0] + "\n" == HEADER and len(rows) == 101
    number, sent, *_, clock, travelled, waited, drawing, whole = rows[2].split(",")
    assert (number, float(sent), clock) == ("1", 1.0, "relative")
    assert np.allclose([float(x) for x in (travelled, waited, drawing, whole)], [1, 2, 8, 10])


def test_a_stamp_file_that_cannot_be_written_is_one_line(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(AssetError, match="cannot be written"):
        Latency(tmp_path / "file" / "l.csv")
