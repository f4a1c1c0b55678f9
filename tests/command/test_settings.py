"""Settings are written once, in a dataclass; the board that shows how far a command is."""

import io
import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import pytest

from command.command_line import Help, Hidden, Option, OptionGroup, parse, parser_of
from command.interrupt import Stopped
from command.progress import Progress, ProgressBoard, clock_time, progress
from command.settings import LARGEST_INTEGER, Above, AtLeast, AtMost, OneOf, check, settings_json
from command.stages import Stage, command, run_stages

ABOUT = Help("selfscan try", "Tries settings.", "example: selfscan try a b")


@dataclass(frozen=True)
class Try:
    """Every kind of field that commands have."""

    source: Annotated[Path, Option(positional=True, metavar="SRC"), "what is read"]
    out: Annotated[Path, Option(("-o", "--out"), "OUT"), "what is written"]
    more: Annotated[tuple[str, ...], Option(positional=True, several=True), "others"] = ()
    count: Annotated[int, AtLeast(1), AtMost(100), "how many"] = 3
    rate: Annotated[float, Above(0), "frames per second"] = 30.0
    seconds: Annotated[float | None, Above(0), "of one turn; none: the film's"] = None
    light: Annotated[str, OneOf(("even", "soft")), "of the room"] = "even"
    quality: Annotated[Literal["normal", "high"], "of the network"] = "normal"
    truth: Annotated[bool, Option(("--no-truth",)), "leave out the truth"] = True
    force: Annotated[bool, "begin anew"] = False
    joint: Annotated[tuple[str, ...], Option(repeated=True), "a joint to look at"] = ()
    compare: Annotated[str | None, Option(const="mannequin", metavar="AVATAR"), "draw one frame"] = None
    first: Annotated[int | None, Option(exclusive="which"), "only this one"] = None
    last: Annotated[int | None, Option(exclusive="which"), "only that one"] = None
    inner: Annotated[int, Hidden(), "no option"] = 7
    size: Annotated[int, OptionGroup("the picture"), "of its side"] = 64
    seed: Annotated[int, OptionGroup("the picture").rare, "of its noise"] = 0
    gpu: Annotated[int, OptionGroup("the machine").rare, "which one"] = 0

    def __post_init__(self):
        check(self)
        if self.force and self.count == 2:
            raise ValueError("count 2 cannot be forced")


def test_what_is_not_given_is_the_default_and_help_says_meaning_and_choices():
    assert parse(Try, ["a", "-o", "b"], ABOUT) == Try(Path("a"), Path("b"))
    words = ["a", "x", "y", "-o", "b", "--count", "5", "--rate", "24", "--seconds", "1.5",
             "--light", "soft", "--quality", "high", "--no-truth", "--force", "--joint", "neck",
             "--joint", "head", "--compare"]  # fmt: skip
    expected = Try(Path("a"), Path("b"), ("x", "y"), 5, 24.0, 1.5, "soft", "high", False, True, ("neck", "head"),
                   "mannequin")  # fmt: skip
    assert parse(Try, words, ABOUT) == expected
    assert parse(Try, ["a", "-o", "b", "--compare", "me.glb"], ABOUT).compare == "me.glb"
    text = " ".join(parser_of(Try, ABOUT).format_help().split())
    assert "--count N how many (default: 3)" in text
    assert "--rate X frames per second (default: 30)" in text
    assert "--light {even,soft} of the room (default: even)" in text
    assert "--no-truth leave out the truth" in text and "--truth" not in text.replace("--no-truth", "")
    assert "example: selfscan try a b" in text and "inner" not in text


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--count", "0"], "--count: expected at least 1, found 0"),
        (["--count", "101"], "--count: expected at most 100, found 101"),
        (["--count", "9" * 23], "--count: expected at most 9007199254740992, found '9999"),
        (["--count", "9" * 6000], "--count: expected at most"),
        (["--count", "1.5"], "--count: expected a whole number, found '1.5'"),
        (["--count", "٣"], "--count: expected a whole number"),
        (["--rate", "0"], "--rate: expected more than 0, found 0"),
        (["--rate", "nan"], "--rate: expected a finite number, found 'nan'"),
        (["--rate", "1e999"], "--rate: expected a finite number"),
        (["--seconds", "-1"], "--seconds: expected more than 0"),
        (["--light", "dark"], "--light: invalid choice: 'dark'"),
        (["--quality", "best"], "--quality: invalid choice: 'best'"),
        (["--count", "2", "--force"], "count 2 cannot be forced"),
        (["--first", "1", "--last", "2"], "not allowed with argument --first"),
        (["--inner", "3"], "unrecognized arguments: --inner 3;"),
        (["--cuont", "3"], "unrecognized arguments: --cuont 3; did you mean --count?"),
    ],
)
def test_a_mistake_is_one_line_and_wrong_usage(capsys, words, message):
    with pytest.raises(SystemExit) as stopped:
        parse(Try, ["a", "-o", "b", *words], ABOUT)
    assert stopped.value.code == 2
    printed = capsys.readouterr().err
    assert message in printed and printed.count("\n") == 1 and "try --help; `try --help`" not in printed


def test_help_has_groups_and_help_all_the_rare_options_too(capsys):
    short, full = (parser_of(Try, ABOUT._replace(more="keys"), everything=on).format_help() for on in (False, True))
    assert "the picture:\n  --size N" in short and "all options, 2 more" in short and "keys" not in short
    assert not any(word in short for word in ("--seed", "--gpu", "the machine"))
    assert "--seed N" in full and "the machine:\n  --gpu N" in full and full.endswith("keys\n")
    assert short.startswith("usage: selfscan try SRC [more ...] -o OUT [options]\n")
    for option, text in (("--help", short), ("--help-all", full)):
        with pytest.raises(SystemExit) as stopped:
            parse(Try, [option], ABOUT._replace(more="keys"))
        assert stopped.value.code == 0 and capsys.readouterr().out == text
    assert parse(Try, ["a", "-o", "b", "--seed", "3"], ABOUT).seed == 3


def test_records_obey_limits_and_become_json():
    with pytest.raises(ValueError, match="count: expected at least 1, found 0"):
        Try(Path("a"), Path("b"), count=0)
    with pytest.raises(ValueError, match="rate: expected a finite number, found inf"):
        Try(Path("a"), Path("b"), rate=float("inf"))
    with pytest.raises(ValueError, match="count: expected at most 9007199254740992, found a number of 17 digits"):
        Try(Path("a"), Path("b"), count=LARGEST_INTEGER * 10)
    facts_of = settings_json(Try(Path("a"), Path("b"), joint=("neck",)))
    assert facts_of["source"] == "a" and facts_of["joint"] == ["neck"] and facts_of["rate"] == 30.0
    made = parse(Both, ["r", "a", "-o", "b", "--count", "9"], ABOUT)
    assert made == Both(Path("r"), Try(Path("a"), Path("b"), count=9))


@dataclass(frozen=True)
class Both:
    """A command of its own place and of settings that others use too."""

    run: Annotated[Path, Option(positional=True, metavar="RUN"), "run folder"]
    inner: Annotated[Try, "what is tried"]


def test_the_time_left_schedules_what_waits_on_the_workers():
    """Two workers, 0.1 s a step: at 6 s, 5 s each remain, then a waiting job of 10 s."""
    now = [0.0]
    board = ProgressBoard({"body": 100, "head": 100, "hand": 100}, 2, stream=io.StringIO(), clock=lambda: now[0])
    assert board.left() is None
    board.begin("body")
    board.begin("head")
    now[0] = 1.0
    board.update("body", 0)
    board.update("head", 0)
    now[0] = 6.0
    board.update("body", 50, "PSNR 20.0 dB")
    board.update("head", 50)
    left = board.left()
    assert left is not None and abs(left - 16.0) < 1e-9  # the third prepares for a second, as the others did
    lines = board.lines()
    assert lines[0] == "body  [########........] 50/100  0:05 left  PSNR 20.0 dB"
    board.begin("hand")
    assert board.lines()[2] == "hand  preparing, 0:00 so far, 0:11 left"
    assert len(lines) == 3 and lines[2].startswith("all ") and lines[2].endswith("0:06 so far, 0:16 left")
    for name in ("body", "head"):
        board.end(name)
    assert [line.split()[0] for line in board.lines()] == ["hand", "all"]


def test_preparation_is_said_and_times_are_read_at_a_glance():
    now = [0.0]
    board = ProgressBoard({"body": 100}, 1, stream=io.StringIO(), clock=lambda: now[0])
    board.begin("body")
    now[0] = 5.0
    assert board.lines()[0] == "body  preparing, 0:05 so far"
    assert [clock_time(t) for t in (7.4, 754.0, 3723.0)] == ["0:07", "12:34", "1:02:03"]
    stream = io.StringIO()
    report = Progress("fitting", 10, stream)
    report.began = report.shown = time.monotonic() - 720
    report.update(1.5)
    assert stream.getvalue() == "fitting 1/10  12:00, 1:08:00 left\n"


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_a_line_that_is_redrawn_is_no_longer_than_the_terminal_is_wide(monkeypatch):
    monkeypatch.setenv("COLUMNS", "40")
    report = Progress("frames", 10, stream := Terminal())
    report.shown -= 1
    report.update(3, "a note")
    assert len(stream.getvalue().removeprefix("\r\x1b[K")) == 39


def test_a_terminal_is_redrawn_in_place():
    now = [0.0]
    stream = Terminal()
    board = ProgressBoard({"body": 10}, 1, stream=stream, clock=lambda: now[0])
    board.begin("body")
    now[0] = 1.0
    board.update("body", 1)
    assert "\x1b[" not in stream.getvalue()
    now[0] = 2.0
    board.update("body", 2)
    assert stream.getvalue().count("\x1b[2A\x1b[J") == 1  # two lines up, and what was there is gone


class Gone(io.StringIO):
    """A stream whose reader has gone."""

    def write(self, text):
        raise BrokenPipeError


def test_progress_that_cannot_be_shown_stops_no_work(monkeypatch):
    assert list(progress(range(5), "frames")) == [0, 1, 2, 3, 4]
    closed = io.StringIO()
    closed.close()
    monkeypatch.setattr("sys.stdout", Gone())
    for stream in (Gone(), closed):
        report = Progress("frames", 2, stream)
        report.began = report.shown = -100.0
        report.update(1)
        report.update(2)
        board = ProgressBoard({"body": 2}, 1, stream=stream)
        board.begin("body")
        board.update("body", 1)
        board.say("half")
        board.refresh(now=True)
        board.close()
    monkeypatch.setattr("sys.stderr", None)  # as with 2>&-
    Progress("frames", 2).update(1)
    ProgressBoard({"body": 2}, 1).refresh(now=True)


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


def test_a_path_that_begins_with_a_dash_is_no_option(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("-in").write_text("[]")
    assert command("json.tool", Path("-in"), Path("-out"))() == 0 and Path("-out").exists()


@pytest.mark.parametrize("code", [130, -2, 143, -15])
def test_a_stage_that_was_stopped_stops_the_work(tmp_path, code):
    with pytest.raises(Stopped) as stopped:
        run_stages([Stage("work", tmp_path / "product", lambda: code)])
    assert stopped.value.number in (signal.SIGINT, signal.SIGTERM)
