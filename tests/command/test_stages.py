"""Stages are commands in processes of their own; a stop reaches them, and is passed on when they are done."""

import os
import signal
import subprocess
import sys
import time

import pytest

from command.interrupt import Stopped
from command.stages import Stage, run_stages

CHILD = """
import pathlib, signal, sys, time
def stop(number, frame):
    time.sleep(0.5)
    pathlib.Path(sys.argv[1]).write_text("saved")
    sys.exit(128 + number)
signal.signal(signal.SIGTERM, stop)
signal.signal(signal.SIGINT, stop)
print("ready", flush=True)
time.sleep(600)
"""
PARENT = """
import sys
from pathlib import Path
from command.interrupt import prompt_stop
from command.stages import Stage, command, run_stages
out = Path(sys.argv[1])
with prompt_stop():
    run_stages([Stage("work", out / "product", command("child", out / "saved"))])
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_stop_waits_until_the_stage_has_saved_what_it_did(tmp_path, number):
    (tmp_path / "child.py").write_text(CHILD)
    paths = os.pathsep.join([str(tmp_path), *sys.path])
    words = [sys.executable, "-c", PARENT, str(tmp_path)]
    with subprocess.Popen(words, env={**os.environ, "PYTHONPATH": paths}, stdout=subprocess.PIPE, text=True) as process:
        while "ready" not in process.stdout.readline():
            assert process.poll() is None
        time.sleep(0.1)
        process.send_signal(number)
        assert process.wait() != 0
    assert (tmp_path / "saved").read_text() == "saved"


@pytest.mark.parametrize("code", [130, -2, 143, -15])
def test_a_stage_that_was_stopped_stops_the_work(tmp_path, code):
    with pytest.raises(Stopped) as stopped:
        run_stages([Stage("work", tmp_path / "product", lambda: code)])
    assert stopped.value.number in (signal.SIGINT, signal.SIGTERM)
