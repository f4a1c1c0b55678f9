"""Every call that writes fails once: the old output stays whole or the new one is, and nothing is left for good."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from foreign_layouts import write_authors
from nth_call_commands import COMMANDS, IMPORT, SLOW
from smplh_model import write_model

from capture.folder import read_capture

TESTS = Path(__file__).parents[1]


def swept(spec: dict, folder: Path) -> dict:
    """The outcome of all trials of a command, in a process of its own: nth_call.py forks it."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(TESTS.parent), str(TESTS)])}
    words = [sys.executable, "-m", "nth_call", json.dumps(spec | {"folder": str(folder)})]
    done = subprocess.run(words, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def judged(name: str, outcome: dict, within) -> None:
    """Nothing lost, nothing left, no stray exception; the figures stand in the report."""
    for kind in ("lost", "litter", "strays"):
        assert not outcome[kind], "\n".join(outcome[kind])
    assert outcome["trials"] == sum(outcome["fired"].values())
    within(0, 0, f"lost of {outcome['trials']} trials at {outcome['calls']} calls of {name}")


@pytest.mark.rows
@pytest.mark.parametrize("name", COMMANDS)
def test_no_failing_call_loses_a_file(tmp_path, within, name):
    judged(name, swept(COMMANDS[name], tmp_path), within)


@pytest.mark.rows
@pytest.mark.slow
@pytest.mark.parametrize("name", SLOW)
def test_no_failing_call_loses_what_a_command_wrote(tmp_path, within, name):
    """At twelve of its calls; at all of them by night (experiments/nth_calls.py)."""
    judged(name, swept(SLOW[name] | {"most": 12}, tmp_path), within)


@pytest.mark.slow
def test_no_failing_call_loses_a_capture_that_is_imported(tmp_path, tiny_capture, within):
    for name in ("old", "new"):
        write_authors(read_capture(tiny_capture), tmp_path / f"authors/male-{name}")
    write_model(tmp_path / "authors/model.npz")
    (tmp_path / "trials").mkdir()
    spec = json.loads(json.dumps(IMPORT).replace("{authors}", str(tmp_path / "authors")))
    judged("import", swept(spec, tmp_path / "trials"), within)
