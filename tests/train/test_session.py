"""Trainings that are stopped and go on: signals, lost processes, what lies at the place of a run already."""

import csv
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from command.errors import AssetError
from files.whole import whole_folder
from train.command import TrainOptions
from train.preset import DEMO
from train.session import FILE, capture_digest, exclusive_lock, open_session
from train.stages import train

DRIVER = Path(__file__).parents[1] / "hands_training.py"
HANDS = ("hand_left", "hand_right")
# seconds after which a process is no longer slow, on a machine however busy
HANGS = 900


def start(capture: Path, out: Path, *options: str) -> subprocess.Popen:
    """A training in a process group of its own, as a shell starts it."""
    return subprocess.Popen(
        [sys.executable, str(DRIVER), str(capture), "-o", str(out), *options],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True,
        env={**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": str(DRIVER.parents[1])},
    )  # fmt: skip


def finish(process: subprocess.Popen, code: int) -> str:
    said, _ = process.communicate(timeout=HANGS)
    assert process.returncode == code, said
    return said


def kill(process: subprocess.Popen, act: Callable[[], None]) -> None:
    """Kill without a word; what it said is not read (its workers may still hold the other end)."""
    act()
    process.wait()
    assert process.stdout is not None
    process.stdout.close()


def rows(path: Path) -> list[dict[str, str]]:
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


def until(there: Callable[[], bool], process: subprocess.Popen | None = None) -> None:
    """Wait for it; a process that it comes from has to live meanwhile."""
    for _ in range(20 * HANGS):
        if there():
            return
        assert process is None or process.poll() is None, process.communicate()[0]
        time.sleep(0.05)
    pytest.fail(f"not there after {HANGS} s")


def until_learning(process: subprocess.Popen, out: Path) -> None:
    """Both hands have logged a row."""
    logs = [out.with_name(out.name + ".partial") / f"logs/{name}.csv" for name in HANDS]
    until(lambda: all(log.exists() and log.read_text().count("\n") >= 2 for log in logs), process)


@pytest.fixture(scope="module")
def never_stopped(tiny_capture, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("whole") / "run"
    finish(start(tiny_capture, out), 0)
    return out


def assert_equal_runs(run: Path, other: Path) -> None:
    """The same bits in every weight; the same rows in every log, times apart."""
    for name in HANDS:
        one, two = (torch.load(folder / f"{name}.pt", weights_only=True)["state"] for folder in (run, other))
        assert one.keys() == two.keys()
        for key in one:
            assert torch.equal(one[key], two[key]), (name, key)
        logs = [rows(folder / f"logs/{name}.csv") for folder in (run, other)]
        assert [row["step"] for row in logs[1]] == [str(step) for step in range(10, 241, 10)]
        for first, second in zip(*logs, strict=True):
            assert {**first, "seconds": ""} == {**second, "seconds": ""}


@pytest.mark.slow
@pytest.mark.parametrize(("number", "group"), [(signal.SIGINT, True), (signal.SIGTERM, True), (signal.SIGTERM, False)])
def test_a_training_stopped_by_a_signal_and_resumed_equals_one_never_stopped(
    tiny_capture, never_stopped, tmp_path, number, group
):
    """A terminal's Ctrl-C reaches parent and workers; `kill` the parent alone."""
    out = tmp_path / "run"
    process = start(tiny_capture, out)
    until_learning(process, out)
    (os.killpg if group else os.kill)(process.pid, number)
    said = finish(process, 128 + number)
    assert "Traceback" not in said
    assert f"selfscan train {tiny_capture} -o {out} --resume" in said
    for name in HANDS:
        state = torch.load(tmp_path / f"run.partial/{name}.ckpt", weights_only=True)
        assert 10 <= state["position"]["iteration"] < 240
    assert not out.exists()
    finish(start(tiny_capture, out, "--resume"), 0)
    assert_equal_runs(never_stopped, out)


@pytest.mark.slow
def test_a_training_whose_parent_was_killed_saves_itself_and_goes_on(tiny_capture, never_stopped, tmp_path):
    out = tmp_path / "run"
    process = start(tiny_capture, out, "--save-every", "3600")
    until_learning(process, out)
    kill(process, process.kill)
    checkpoints = [tmp_path / f"run.partial/{name}.ckpt" for name in HANDS]
    until(lambda: all(path.exists() for path in checkpoints))
    finish(start(tiny_capture, out, "--resume"), 0)
    assert_equal_runs(never_stopped, out)


@pytest.mark.slow
def test_after_a_power_loss_a_periodic_checkpoint_goes_on(tiny_capture, never_stopped, tmp_path):
    """All processes killed at once; rows logged after the checkpoint are not doubled."""
    out = tmp_path / "run"
    process = start(tiny_capture, out, "--save-every", "0.2")
    until_learning(process, out)
    checkpoints = [tmp_path / f"run.partial/{name}.ckpt" for name in HANDS]
    until(lambda: all(path.exists() for path in checkpoints), process)
    kill(process, lambda: os.killpg(process.pid, signal.SIGKILL))
    log = tmp_path / "run.partial/logs/hand_left.csv"
    log.write_text(log.read_text() + "230,1.0")  # a row that the power loss cut short
    finish(start(tiny_capture, out, "--resume", "--save-every", "0.2"), 0)
    assert_equal_runs(never_stopped, out)


# What lies there already


SETTINGS = {"capture": "c0ffee", "preset": "demo", "seed": 0}


def interrupted(folder: Path) -> Path:
    """The place of a run whose training was interrupted."""
    session = open_session(folder / "run", SETTINGS, resume=False, force=False, say=print)
    assert session is not None
    (session.partial / "head.ckpt").write_bytes(b"weights")
    return folder / "run"


def test_an_interrupted_training_is_resumed_only_with_its_own_settings(tmp_path):
    out = interrupted(tmp_path)
    with pytest.raises(AssetError, match=r"begun with seed 0, not with seed 1; --resume needs the same"):
        open_session(out, {**SETTINGS, "seed": 1}, resume=True, force=False, say=print)
    session = open_session(out, SETTINGS, resume=True, force=False, say=print)
    assert session is not None and session.resumed
    assert (session.partial / "head.ckpt").read_bytes() == b"weights"


def test_an_interrupted_training_is_begun_anew_only_by_force(tmp_path):
    out = interrupted(tmp_path)
    with pytest.raises(AssetError, match="interrupted training lies here; --resume goes on, --force begins anew"):
        open_session(out, SETTINGS, resume=False, force=False, say=print)
    session = open_session(out, {**SETTINGS, "seed": 1}, resume=False, force=True, say=print)
    assert session is not None and not session.resumed
    assert [path.name for path in session.partial.iterdir()] == [FILE]
    assert json.loads((session.partial / FILE).read_text())["seed"] == 1


def test_nothing_to_resume_and_nothing_left_to_resume_are_said(tmp_path):
    said: list[str] = []
    session = open_session(tmp_path / "run", SETTINGS, resume=True, force=False, say=said.append)
    assert session is not None and not session.resumed
    assert said == [f"{tmp_path / 'run.partial'} holds no checkpoint: nothing to resume, training begins"]
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "run.json").write_text("{}")
    assert open_session(tmp_path / "run", SETTINGS, resume=True, force=False, say=said.append) is None
    assert "is finished already; nothing to resume" in said[1]


def test_a_finished_run_is_replaced_only_by_force(tmp_path):
    with whole_folder(tmp_path / "run") as folder:
        (folder / "run.json").write_text("{}")
    with pytest.raises(AssetError, match="a finished run lies here; --force replaces it"):
        open_session(tmp_path / "run", SETTINGS, resume=False, force=False, say=print)
    assert open_session(tmp_path / "run", SETTINGS, resume=False, force=True, say=print) is not None
    assert (tmp_path / "run" / "run.json").exists()  # until the new one is complete


def test_two_processes_do_not_train_into_one_folder(tiny_capture, tmp_path):
    out = tmp_path / "run"
    with exclusive_lock(out), pytest.raises(AssetError, match=rf"process {os.getpid()} is training into it"):
        train(TrainOptions(capture=tiny_capture, out=out), DEMO)
    assert list(tmp_path.iterdir()) == []
    with exclusive_lock(out):  # the lock went with its holder
        pass


def test_a_capture_is_known_by_its_content_not_by_its_place(tmp_path):
    for name in ("a", "b"):
        (tmp_path / name / "head").mkdir(parents=True)
        (tmp_path / name / "truth").mkdir()
        (tmp_path / name / "head/cameras.npz").write_bytes(b"cameras")
        (tmp_path / name / "truth/rest.npz").write_bytes(name.encode())
    assert capture_digest(tmp_path / "a") == capture_digest(tmp_path / "b")
    (tmp_path / "b/head/cameras.npz").write_bytes(b"Cameras")
    assert capture_digest(tmp_path / "a") != capture_digest(tmp_path / "b")
