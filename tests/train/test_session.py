"""Trainings that are stopped and go on, presets in run.json, logs, and two processes that train as one."""

import csv
import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
from sphere_field import assert_same_bits

from command.errors import AssetError
from command.settings import SettingsSource, record_of, settings_json
from files.whole import exclusive_lock, whole_folder
from train import stages
from train.command import ITEM_NAMES, PRESET_NAMES, TrainOptions
from train.distributed import ONE_PROCESS, Ranks
from train.log import TrainingLog
from train.preset import DEMO, ITEMS, PRESETS, Preset
from train.session import FILE, capture_digest, open_session
from train.stages import train

TESTS = Path(__file__).parents[1]
DRIVER = TESTS / "hands_training.py"
HANDS = ("hand_left", "hand_right")
# seconds after which a process is no longer slow, on a machine however busy
HANGS = 900


def start(script: Path, *arguments: object, runner: tuple[str, ...] = (), **environment: str) -> subprocess.Popen:
    """A script in a process group of its own, as a shell starts it."""
    return subprocess.Popen(
        [sys.executable, *runner, str(script), *map(str, arguments)],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True,
        env={**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": f"{TESTS.parent}{os.pathsep}{TESTS}", **environment},
    )  # fmt: skip


def start_training(capture: Path, out: Path, *options: str) -> subprocess.Popen:
    return start(DRIVER, capture, "-o", out, *options)


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
    finish(start_training(tiny_capture, out), 0)
    return out


def assert_equal_runs(run: Path, other: Path) -> None:
    """The same bits in every weight; the same rows in every log, times apart."""
    for name in HANDS:
        one, two = (torch.load(folder / f"{name}.pt", weights_only=True)["state"] for folder in (run, other))
        assert one.keys() == two.keys()
        assert_same_bits(one, two)
        logs = [rows(folder / f"logs/{name}.csv") for folder in (run, other)]
        assert [row["step"] for row in logs[1]] == [str(step) for step in range(10, 241, 10)]
        for first, second in zip(*logs, strict=True):
            assert {**first, "seconds": ""} == {**second, "seconds": ""}


@pytest.mark.slow
@pytest.mark.parametrize(("number", "group"), [(signal.SIGINT, True), (signal.SIGTERM, False)])
def test_a_training_stopped_by_a_signal_and_resumed_equals_one_never_stopped(
    tiny_capture, never_stopped, tmp_path, number, group
):
    """A terminal's Ctrl-C reaches parent and workers; `kill` the parent alone."""
    out = tmp_path / "run"
    process = start_training(tiny_capture, out)
    until_learning(process, out)
    (os.killpg if group else os.kill)(process.pid, number)
    said = finish(process, 128 + number)
    assert "Traceback" not in said
    assert f"selfscan train {tiny_capture} -o {out} --resume" in said
    for name in HANDS:
        state = torch.load(tmp_path / f"run.partial/{name}.ckpt", weights_only=True)
        assert 10 <= state["position"]["iteration"] < 240
    assert not out.exists()
    finish(start_training(tiny_capture, out, "--resume"), 0)
    assert_equal_runs(never_stopped, out)


@pytest.mark.slow
@pytest.mark.parametrize(("every", "power_loss"), [("3600", False), ("0.2", True)], ids=["parent", "power loss"])
def test_a_killed_training_saves_itself_or_has_saved_and_goes_on(
    tiny_capture, never_stopped, tmp_path, every, power_loss
):
    """Its parent alone, or all processes at once; rows logged after a periodic checkpoint are not doubled."""
    out, saving = tmp_path / "run", ("--save-every", every)
    process = start_training(tiny_capture, out, *saving)
    until_learning(process, out)
    saved = lambda: all((tmp_path / f"run.partial/{name}.ckpt").exists() for name in HANDS)
    if power_loss:
        until(saved, process)
        kill(process, lambda: os.killpg(process.pid, signal.SIGKILL))
        log = tmp_path / "run.partial/logs/hand_left.csv"
        log.write_text(log.read_text() + "230,1.0")  # a row that the power loss cut short
    else:
        kill(process, process.kill)
        until(saved)
    finish(start_training(tiny_capture, out, "--resume", *saving), 0)
    assert_equal_runs(never_stopped, out)


# What lies there already


SETTINGS = {"capture": "c0ffee", "preset": "demo", "seed": 0}


def interrupted(folder: Path) -> Path:
    """The place of a run whose training was interrupted."""
    session = open_session(folder / "run", SETTINGS, resume=False, force=False, say=print)
    assert session is not None
    (session.partial / "head.ckpt").write_bytes(b"weights")
    return folder / "run"


def test_an_interrupted_training_goes_on_with_its_own_settings_or_begins_anew_by_force(tmp_path):
    out = interrupted(tmp_path)
    with pytest.raises(AssetError, match=r"begun with seed 0, not with seed 1; --resume needs the same"):
        open_session(out, {**SETTINGS, "seed": 1}, resume=True, force=False, say=print)
    session = open_session(out, SETTINGS, resume=True, force=False, say=print)
    assert session is not None and session.resumed
    assert (session.partial / "head.ckpt").read_bytes() == b"weights"
    with pytest.raises(AssetError, match="interrupted training lies here; --resume goes on, --force begins anew"):
        open_session(out, SETTINGS, resume=False, force=False, say=print)
    session = open_session(out, {**SETTINGS, "seed": 1}, resume=False, force=True, say=print)
    assert session is not None and not session.resumed
    assert [path.name for path in session.partial.iterdir()] == [FILE]
    assert json.loads((session.partial / FILE).read_text())["seed"] == 1


def test_the_paper_presets_are_named_and_finished_runs_replaced_by_force_alone(tmp_path):
    with whole_folder(tmp_path / "run") as folder:
        (folder / "run.json").write_text("{}")
    with pytest.raises(AssetError, match="a finished run lies here; --force replaces it"):
        open_session(tmp_path / "run", SETTINGS, resume=False, force=False, say=print)
    assert open_session(tmp_path / "run", SETTINGS, resume=False, force=True, say=print) is not None
    assert (tmp_path / "run" / "run.json").exists()  # until the new one is complete
    assert [preset.name for preset in PRESETS.values()] == list(PRESETS) == list(PRESET_NAMES)
    assert list(ITEMS) == list(ITEM_NAMES)
    said: list[str] = []
    session = open_session(tmp_path / "run2", SETTINGS, resume=True, force=False, say=said.append)
    assert session is not None and not session.resumed
    assert said == [f"{tmp_path / 'run2.partial'} holds no checkpoint: nothing to resume, training begins"]
    (tmp_path / "run2").mkdir()
    (tmp_path / "run2" / "run.json").write_text("{}")
    assert open_session(tmp_path / "run2", SETTINGS, resume=True, force=False, say=said.append) is None
    assert "is finished already; nothing to resume" in said[1]


def test_two_processes_do_not_train_into_one_folder(tiny_capture, tmp_path):
    out = tmp_path / "run"
    with exclusive_lock(out), pytest.raises(AssetError, match=rf"process {os.getpid()} is making it"):
        train(TrainOptions(capture=tiny_capture, out=out), DEMO)
    assert list(tmp_path.iterdir()) == []
    with exclusive_lock(out):  # the lock went with its holder
        pass


@pytest.mark.parametrize("out", [".", "/"])
def test_a_run_folder_has_a_name(tmp_path, out):
    with pytest.raises(ValueError, match=f"-o should name a run folder to make, is {re.escape(out)}"):
        TrainOptions(capture=tmp_path, out=Path(out))


def test_a_capture_is_known_by_its_content_not_by_its_place(tmp_path):
    for name in ("a", "b"):
        (tmp_path / name / "head").mkdir(parents=True)
        (tmp_path / name / "truth").mkdir()
        (tmp_path / name / "head/cameras.npz").write_bytes(b"cameras")
        (tmp_path / name / "truth/rest.npz").write_bytes(name.encode())
    # a desktop's note, and a training into the capture itself
    (tmp_path / "b/head/.DS_Store").write_bytes(b"icons")
    (tmp_path / "b/run.partial").mkdir()
    (tmp_path / "b/run.partial/body.ckpt").write_bytes(b"hours of work")
    assert capture_digest(tmp_path / "a") == capture_digest(tmp_path / "b")
    (tmp_path / "b/head/cameras.npz").write_bytes(b"Cameras")
    assert capture_digest(tmp_path / "a") != capture_digest(tmp_path / "b")


def stored(name="demo"):
    return json.loads(json.dumps(settings_json(PRESETS[name])))


def read(content):
    return record_of(Preset, content, SettingsSource(whole=True), ("settings",))


@pytest.mark.parametrize("name", PRESETS)
def test_a_preset_comes_back_as_it_was(name):
    assert read(stored(name)) == PRESETS[name]
    assert read(stored(name) | {"rays": 7}) == replace(PRESETS[name], rays=7)


@pytest.mark.parametrize("networks", [{"kind": "cloud"}, {}, 7, {"kind": ["hash"]}])
def test_unknown_networks_are_refused_by_name(networks):
    content = stored()
    content["parts"][2]["networks"] = networks
    with pytest.raises(ValueError, match=r"settings\.parts 3\.networks\.kind: expected one of triplane, hash, paper"):
        read(content)


def log_steps(folder, begin, steps):
    log = TrainingLog(folder, "head")
    log.begin(begin)
    for step in steps:
        log.row(step, step / 8, 0.5, {"loss": 1.0 / step, "psnr": 20.0 + step})
    log.close()


def test_a_resumed_log_has_every_step_once(tmp_path):
    """Ten rows, a checkpoint after step 50, and a kill that left rows beyond it and half a row."""
    log_steps(tmp_path / "whole", 0, range(10, 110, 10))
    log_steps(tmp_path / "halves", 0, range(10, 80, 10))
    path = tmp_path / "halves" / "head.csv"
    path.write_text(path.read_text() + "80,9.9")
    log_steps(tmp_path / "halves", 50, range(60, 110, 10))
    assert path.read_text() == (tmp_path / "whole" / "head.csv").read_text()
    assert rows(path)[0] == {"step": "10", "seconds": "1.250", "rate": "0.5", "loss": "0.1", "psnr": "30"}


def test_a_log_begun_anew_holds_nothing_old_and_rows_are_on_the_disk_when_written(tmp_path):
    log_steps(tmp_path, 0, [10, 20])
    log_steps(tmp_path, 0, [10])
    assert [row["step"] for row in rows(tmp_path / "head.csv")] == ["10"]
    log = TrainingLog(tmp_path, "head")
    log.begin(0)
    log.row(10, 1.0, 1.0, {"loss": float("nan")})
    assert list(rows(tmp_path / "head.csv")[0].values()) == ["10", "1.000", "1", "nan"]
    log.close()


def test_a_log_of_other_columns_is_refused(tmp_path):
    log_steps(tmp_path, 0, [10])
    log = TrainingLog(tmp_path, "head")
    log.begin(10)
    with pytest.raises(AssetError, match=r"head\.csv: columns should be"):
        log.row(20, 1.0, 1.0, {"loss": 1.0})
    log.close()


TORCHRUN = ("-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2")


@pytest.mark.slow
def test_two_processes_equal_one_after_a_dozen_steps(tmp_path):
    """In float64, on a ball, up to the order of summation.

    One process sums the gradients of 63 rays, two sum 32 and 31 and then the two sums: each element differs by at
    most 63 eps sum|terms|, eps = 1.1e-16. Adam divides by the element's own size, so where the terms cancel to
    1/c of their sum, a step differs by 63 eps c rate = 3e-17 c, with rate = 4e-3. For c up to a thousand, and
    twelve steps that act on each other, that stays below 1e-12 (measured 6e-16, of weights that moved by 1e-2).
    """
    script = TESTS / "ranks_training.py"
    finish(start(script, tmp_path / "one.pt"), 0)
    finish(start(script, tmp_path / "two.pt", runner=TORCHRUN), 0)
    one, two = (torch.load(tmp_path / name, weights_only=True) for name in ("one.pt", "two.pt"))
    assert two["count"] == 2 and one["count"] == 1
    moved = 0.0
    for name, value in one["after"].items():
        torch.testing.assert_close(two["after"][name], value, rtol=0, atol=1e-12, msg=name)
        moved = max(moved, float((value - one["before"][name]).abs().max()))
    assert moved > 0.01  # it did learn
    assert two["loss"] == pytest.approx(one["loss"], abs=1e-12)  # the report is of the whole batch


@pytest.mark.slow
def test_torchrun_trains_from_the_command_line_like_one_process(tiny_capture, tmp_path):
    """float32, where Adam's first steps turn rounding of vanishing gradients into whole steps: the loss, not bits."""
    for out, runner in (("one", ()), ("two", TORCHRUN)):
        arguments = (tiny_capture, "-o", tmp_path / out)
        finish(start(DRIVER, *arguments, runner=runner, SELFSCAN_TEST_STEPS="12"), 0)
    for name in HANDS:
        logs = [(tmp_path / run / f"logs/{name}.csv").read_text().splitlines() for run in ("one", "two")]
        assert len(logs[1]) == 3  # header, step 10, step 12: one rank wrote
        for first, second in zip(*(log[1:] for log in logs), strict=True):
            one, two = ([float(value) for value in row.split(",")] for row in (first, second))
            assert two[0] == one[0] and two[3] == pytest.approx(one[3], rel=2e-3)


def test_one_rank_alone_writes_the_parts_that_are_not_learned(tmp_path, monkeypatch):
    facts, found = {"head": {"steps": 0}}, []
    training = SimpleNamespace(
        ranks=Ranks(1, 2), preset=SimpleNamespace(learned=()), session=SimpleNamespace(partial=tmp_path)
    )
    training.from_writer = partial(stages.Training.from_writer, training)
    monkeypatch.setattr(Ranks, "broadcast", lambda ranks, thing: facts)
    monkeypatch.setattr(stages, "begin", lambda *_: training)
    monkeypatch.setattr(stages, "prepared", lambda training: training)
    monkeypatch.setattr(stages, "seen_parts", lambda *_: pytest.fail("another rank writes them"))
    monkeypatch.setattr(stages, "finish", lambda training, facts: found.append(facts))
    train(TrainOptions(capture=tmp_path, out=tmp_path / "run"), DEMO)
    assert found == [facts]


def test_the_shares_of_a_batch_are_the_batch():
    batch = torch.arange(7)
    shares = [Ranks(rank, 3).share(batch) for rank in range(3)]
    assert torch.equal(torch.cat(shares).sort().values, batch)
    assert [Ranks(rank, 3).weight(7) for rank in range(3)] == [len(share) / 7 for share in shares]
    assert ONE_PROCESS.weight(7) == 1.0
