"""The board of jobs side by side: a line each, and the time left of them all."""

import io
import time

from command.progress import Progress, ProgressBoard, clock_time, progress


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
    assert left is not None and abs(left - 15.0) < 1e-9
    lines = board.lines()
    assert lines[0] == "body  [########........] 50/100  0:05 left  PSNR 20.0 dB"
    assert len(lines) == 3 and lines[2].startswith("all ") and lines[2].endswith("0:06 so far, 0:15 left")
    for name in ("body", "head"):
        board.end(name)
    assert [line.split()[0] for line in board.lines()] == ["all"]


def test_preparation_is_said():
    now = [0.0]
    board = ProgressBoard({"body": 100}, 1, stream=io.StringIO(), clock=lambda: now[0])
    board.begin("body")
    now[0] = 5.0
    assert board.lines()[0] == "body  preparing, 0:05 so far"


def test_a_terminal_is_redrawn_in_place():
    class Terminal(io.StringIO):
        def isatty(self):
            return True

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


def test_times_are_read_at_a_glance():
    assert [clock_time(t) for t in (7.4, 754.0, 3723.0)] == ["0:07", "12:34", "1:02:03"]


def test_the_time_left_counts_a_part_of_a_step_and_names_hours():
    stream = io.StringIO()
    report = Progress("fitting", 10, stream)
    report.began = report.shown = time.monotonic() - 720
    report.update(1.5)
    assert stream.getvalue() == "fitting 1/10  12:00, 1:08:00 left\n"


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
