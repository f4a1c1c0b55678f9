"""Takes on an even clock, the One-Euro filter, and the stamps."""

import signal
import subprocess
import sys
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from pose_twins import angles_between
from refusals import refused

from avatar.motion.amass import read_amass, write_amass
from avatar.motion.clip import Clip, Motion
from command.errors import AssetError
from player.draw.drawing import Pose
from player.live.frame import LiveFrame
from player.live.latency import Latency
from player.live.one_euro import LEAST, MOVE_GAIN, TURN_GAIN, OneEuro
from player.live.take import MOST_FRAMES, Take, even_rate

ROOT = Path(__file__).parents[3]


def pose(angle, joint=16):
    axis_angle = np.zeros((52, 3))
    axis_angle[joint, 2] = angle
    return Pose(axis_angle, np.array([angle, 1.0, 0.0]))


@pytest.fixture
def clip_of(tmp_path):
    """The clip of a take of poses that came at given times."""

    def made(times):
        take = Take(tmp_path / "take.npz")
        for time in times:
            take.add(time, pose(0.1 * time))
        clip = take.motion().read()
        take.close()
        return clip

    return made


def test_gaps_are_filled_silence_is_cut_and_clocks_that_go_back_stand_still(clip_of):
    times = np.arange(20) / 30
    clip = clip_of(np.delete(times, [7, 8]))
    assert len(clip.root) == 20 and np.allclose(clip.axis_angle[:, 16, 2], 0.1 * times, atol=1e-6)
    assert np.allclose(clip.root[:, 0], 0.1 * times, atol=1e-6)
    silent = clip_of(np.concatenate([times, times + 3600]))
    assert len(silent.root) == 20 + 20 + 59  # two seconds of the hour
    clip = clip_of([0, 1 / 30, 2 / 30, -100, -100 + 1 / 30])
    assert len(clip.root) == 4 and np.allclose(clip.axis_angle[2, 16, 2], -10)
    for rate in (24, 30, 60, 72, 240):
        assert even_rate(np.full(9, 1.005 / rate)) == rate
    assert abs(even_rate(np.full(9, 1 / 41)) - 41) < 1e-9
    assert even_rate(np.zeros(0)) == 30.0
    rng = np.random.default_rng(0)
    times = 5 + np.arange(100) / 60 + 1e-3 * rng.uniform(-1, 1, 100)
    clip = clip_of(times)
    assert clip.rate == 60 and len(clip.root) == 100
    assert np.array_equal(clip.axis_angle[:, 16, 2], (0.1 * times).astype(np.float32))


def test_takes_that_fill_the_disk_stop_and_without_a_pose_nothing_is_written(tmp_path):
    assert Take(tmp_path / "a.npz").finish() == ["no pose came: no take written"]
    assert list(tmp_path.iterdir()) == []
    take = Take(tmp_path / "a.npz", most=10)
    take.sender_height = lambda: 0.9
    for n in range(50):
        take.add(n / 30, pose(0.0))
    assert take.finish() == [
        "take: stopped after 10 frames: as many as a take holds", f"{tmp_path / 'a.npz'}: 10 frames at 30 a second",
    ]  # fmt: skip
    found = read_amass(tmp_path / "a.npz")
    assert found.frames == 10 and found.pelvis_height == 0.9
    assert [path.name for path in tmp_path.iterdir()] == ["a.npz"]


def test_a_take_that_cannot_be_written_is_kept_and_saved_by_the_next(tmp_path, monkeypatch):
    take = Take(tmp_path / "a.npz")
    for n in range(20):
        take.add(n / 30, pose(0.01 * n))

    def full(*_args, **_options):
        raise AssetError("a.npz: cannot be written: No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr("player.live.take.write_amass", full)
        refused(AssetError, r"No space left on device; 20 frames kept in .*a\.npz\.recording", take.finish)
    assert [path.name for path in tmp_path.iterdir()] == ["a.npz.recording"]
    assert "20 frames of a take that was cut off" in Take(tmp_path / "a.npz").finish()[0]
    assert read_amass(tmp_path / "a-recovered.npz").frames == 20


KILLED = """
import os, signal, sys
import numpy as np
from player.draw.drawing import Pose
from player.live.take import Take
take = Take(sys.argv[1])
take.sender_height = lambda: 0.85
for n in range(100):
    take.add(n / 60, Pose(np.full((52, 3), 0.01 * n), np.zeros(3)))
os.write(take.file, bytes(100))  # a record cut short
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_the_take_of_a_killed_program_is_saved_by_the_next(tmp_path):
    path = tmp_path / "take.npz"
    done = subprocess.run([sys.executable, "-c", KILLED, str(path)], cwd=ROOT)
    assert done.returncode == -signal.SIGKILL
    take = Take(path)
    refused(AssetError, "another process records into it", Take, path)
    take.add(0, pose(0.5))
    assert take.finish()[0] == f"{tmp_path / 'take-recovered.npz'}: 100 frames of a take that was cut off"
    found = read_amass(tmp_path / "take-recovered.npz")
    assert found.frames == 100 and found.rate == 60 and found.pelvis_height == 0.85
    assert np.abs(found.read(99, 100).axis_angle - 0.99).max() < 1e-6
    assert sorted(p.name for p in tmp_path.iterdir()) == ["take-recovered.npz", "take.npz"]
    (tmp_path / "take.npz.recording").write_text("a diary that has nothing to do with it")
    refused(AssetError, "move it away", Take, path)
    assert (tmp_path / "take.npz.recording").read_text().startswith("a diary")


def test_a_burst_and_then_slow_packets_take_little_memory(tmp_path):
    """Steps of .2 ms set the rate; at 5000 a second the hour after it would have 18 million frames, 23 GB."""
    take = Take(tmp_path / "a.npz")
    times = np.concatenate([np.arange(3000) * 2e-4, 0.6 + np.arange(1800) * 2.0])
    for time in times:
        take.add(time, pose(1e-4 * time))
    motion = take.motion()
    assert motion.frames <= MOST_FRAMES + 1 and motion.rate < 1000
    assert abs(motion.frames / motion.rate - times[-1]) < 1
    tracemalloc.start()
    for start in (0, 100_000, motion.frames - 1024):
        motion.read(start, start + 1024)
    assert tracemalloc.get_traced_memory()[1] < 30e6
    tracemalloc.stop()
    take.close()
    end = motion.read(motion.frames - 1, motion.frames)
    assert np.allclose(end.axis_angle[0, 16, 2], 1e-4 * times[-1])


def test_a_motion_is_written_by_rows_as_numpy_writes_it_whole(tmp_path, monkeypatch):
    monkeypatch.setattr("avatar.motion.amass.WRITTEN_AT_ONCE", 7)
    rng = np.random.default_rng(0)
    clip = Clip(rng.normal(size=(50, 52, 3)), rng.normal(size=(50, 3)), 60.0, (), 0.9)
    motion = Motion("m", 50, 60.0, (), lambda a, b: (clip.axis_angle[a:b], clip.root[a:b]), 0.9)
    for name, source in (("clip.npz", clip), ("motion.npz", motion)):
        write_amass(tmp_path / name, source)
    assert (tmp_path / "clip.npz").read_bytes() == (tmp_path / "motion.npz").read_bytes()
    with np.load(tmp_path / "clip.npz") as fields:
        np.savez_compressed(tmp_path / "numpy.npz", **fields)
    assert (tmp_path / "numpy.npz").read_bytes() == (tmp_path / "clip.npz").read_bytes()
    bad = Motion("m", 50, 60.0, (), lambda a, b: (clip.axis_angle[a:b] / (a < 40), clip.root[a:b]))
    with np.errstate(all="ignore"), pytest.raises(ValueError, match="finite"):
        write_amass(tmp_path / "bad.npz", bad)
    assert not (tmp_path / "bad.npz").exists()


def test_one_euro_steadies_a_jitter_follows_a_motion_and_takes_the_short_way():
    rng = np.random.default_rng(1)
    noise = 0.01 * rng.normal(size=600)
    smooth = OneEuro()
    still = [smooth(pose(x), 1 / 60).axis_angle[16, 2] for x in noise][100:]
    assert np.std(still) < 0.4 * np.std(noise)
    smooth = OneEuro()
    swing = np.sin(2 * np.pi * np.arange(240) / 60)  # once a second, up to 6 rad/s
    found = np.array([smooth(pose(x), 1 / 60).axis_angle[16, 2] for x in swing])
    assert np.abs(found - swing)[60:].max() < 0.25
    smooth = OneEuro(1000.0)
    for angle in np.linspace(3.0, 3.3, 50):
        found = smooth(pose(angle), 1 / 60).axis_angle[16, 2]
    assert abs((found - 3.3 + np.pi) % (2 * np.pi) - np.pi) < 0.01


def test_one_euro_lags_behind_an_even_motion_as_its_cut_off_says():
    """A low pass of cut-off f is v / (2 pi f) behind what moves at v: f = least + gain v, of turn and root apart."""
    turn, move, smooth = 2.0, 0.5, OneEuro()
    for step in range(600):
        at = Pose(pose(turn * step / 60).axis_angle, np.array([move * step / 60, 1.0, 0.0]))
        found = smooth(at, 1 / 60)
    (left,) = angles_between(found.axis_angle[16:17], at.axis_angle[16:17])
    assert left == pytest.approx(turn / (2 * np.pi * (LEAST + TURN_GAIN * turn)), rel=1e-3)
    assert found.root == pytest.approx(at.root - [move / (2 * np.pi * (LEAST + MOVE_GAIN * move)), 0, 0], abs=1e-5)


def test_stamps_become_percentiles():
    latency = Latency()
    for n in range(100):
        frame = LiveFrame(None, 10 + n + 0.001 * (n % 2), float(n), 10.0 + n, n)
        latency.applied(frame, frame.received + 0.002)
        latency.applied(frame, frame.received + 0.5)  # drawn again: only the first time counts
        latency.drawn(frame.received + 0.010)
        latency.drawn(frame.received + 0.6)
    assert len(latency.spans) == 100 and np.allclose(latency.spans[1], [0.001, 0.002, 0.010])
    found = latency.percentiles().get("received to drawn")
    assert found is not None and np.allclose(found, 10)
    assert "sent to received: p50 0.50 ms, p95 1.00" in latency.summary()[0]
