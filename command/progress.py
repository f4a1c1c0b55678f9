"""Progress of long work: a bar on a terminal, plain lines elsewhere."""

import heapq
import shutil
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from io import TextIOBase
from typing import NamedTuple, TextIO, TypeVar

T = TypeVar("T")


class _Display:
    """Where progress is shown. What cannot be shown is lost: the work goes on."""

    def __init__(self, stream: TextIO | TextIOBase | None):
        # None where the program was started without one
        self.stream = sys.stderr if stream is None else stream
        try:
            self.live = self.stream is not None and self.stream.isatty()
        except (OSError, ValueError):
            self.live, self.stream = False, None

    def write(self, text: str) -> None:
        if self.stream is None:
            return
        try:
            self.stream.write(text)
            self.stream.flush()
        except (OSError, ValueError):  # the reader has gone, or the stream was closed
            self.live, self.stream = False, None


class Progress:
    """Reports how far a count has come, with the time left and a note such as a loss.

    On a terminal one line is redrawn; elsewhere a line is printed when work begins to take long and about
    every ten seconds after that.
    """

    def __init__(self, label: str, total: int, stream: TextIO | TextIOBase | None = None):
        self.label, self.total = label, total
        self.display = _Display(stream)
        self.began = self.shown = time.monotonic()

    def update(self, done: float | int, note: str = "") -> None:
        """So many steps are done; a part of one is a fraction."""
        now = time.monotonic()
        last = done >= self.total
        live = self.display.live
        if now - self.shown < (0.1 if live else 10.0) and not (last and live):
            return
        self.shown = now
        spent = now - self.began
        share = min(done / max(self.total, 1), 1.0)
        left = None if share <= 0 else spent / share - spent
        text = f"{self.label} {int(done)}/{self.total}  {clock_time(spent)}, {_left_text(left)}  {note}".rstrip()
        if live:
            text = "\r\x1b[K" + _cut(f"{_bar(share, 24)} {text}")
        self.display.write(text if live and not last else text + "\n")


def progress(items: Iterable[T], label: str, total: int | None = None) -> Iterator[T]:
    """The items, one by one, with progress reported after each."""
    if total is None:
        items = list(items)
        total = len(items)
    report = Progress(label, total)
    for done, item in enumerate(items, 1):
        yield item
        report.update(done)


@dataclass
class _Job:
    total: int
    # when work on it began, preparation included
    began: float | None = None
    # time and count of its first report: preparation is over
    first: tuple[float, int] | None = None
    last: tuple[float, int] | None = None
    ended: bool = False
    note: str = ""

    @property
    def rate(self) -> float | None:
        """Seconds per count, or None before there are two reports."""
        if self.first is None or self.last is None or self.last[1] <= self.first[1]:
            return None
        return (self.last[0] - self.first[0]) / (self.last[1] - self.first[1])

    @property
    def preparation(self) -> float | None:
        """Seconds before it began to count, or None where it has not."""
        return None if self.first is None or self.began is None else self.first[0] - self.began

    def left(self, now: float, rate: float | None, preparation: float) -> float | None:
        """Seconds until it is done: by its own rate, else at `rate` seconds a count after such a preparation."""
        if self.rate is not None and self.last is not None:
            return max((self.total - self.last[1]) * self.rate - (now - self.last[0]), 0.0)
        if rate is None:
            return None
        if self.first is None:
            spent = 0.0 if self.began is None else now - self.began
            return max(preparation - spent, 0.0) + self.total * rate
        return max(self.total * rate - (now - self.first[0]), 0.0)


class ProgressBoard:
    """Jobs that run side by side: one line each while at work, and one for all of them with the time left.

    On a terminal the lines are redrawn in place; elsewhere they are printed about every ten seconds. Of the time
    left: jobs without a speed yet are taken to prepare and to count as long as the others did, and wait for one of
    `workers`.
    """

    def __init__(
        self, totals: Mapping[str, int], workers: int, *, stream: TextIO | TextIOBase | None = None,
        clock: Callable[[], float] = time.monotonic,
    ):  # fmt: skip
        self.display = _Display(stream)
        self.clock, self.workers = clock, workers
        self.jobs = {name: _Job(total) for name, total in totals.items()}
        self.began = self.shown = clock()
        # lines on the terminal that the next drawing replaces
        self.drawn = 0

    def begin(self, name: str) -> None:
        self.jobs[name].began = self.clock()

    def update(self, name: str, done: int, note: str = "") -> None:
        job, now = self.jobs[name], self.clock()
        if job.first is None:
            job.first = (now, done)
        job.last, job.note = (now, done), note
        self.refresh()

    def end(self, name: str) -> None:
        self.jobs[name].ended = True

    def reporter(self, name: str) -> "Reporter":
        """What a job reports by to this board."""
        return Reporter(self.say, partial(self.update, name))

    def say(self, text: str) -> None:
        """A line that stays, above the others, on standard output."""
        self.close()
        _Display(sys.stdout).write(text + "\n")

    def refresh(self, *, now: bool = False) -> None:
        """Show the lines if it is time to; call it often."""
        if now or self.clock() - self.shown >= (0.2 if self.display.live else 10.0):
            self.shown = self.clock()
            self.close()
            lines = self.lines()
            if self.display.live:
                lines = [_cut(line) for line in lines]
                self.drawn = len(lines)
            self.display.write("".join(line + "\n" for line in lines))

    def close(self) -> None:
        """No more lines; what is on the terminal is taken away."""
        if self.drawn:
            self.display.write(f"\x1b[{self.drawn}A\x1b[J")
            self.drawn = 0

    def lines(self) -> list[str]:
        """What is shown now."""
        out, width, now = [], max(len(name) for name in self.jobs), self.clock()
        for name, job in self.jobs.items():
            if job.began is None or job.ended:
                continue
            left = job.left(now, *self._usual())
            if job.last is None:
                known = "" if left is None else f", {_left_text(left)}"
                out.append(f"{name:<{width}}  preparing, {clock_time(now - job.began)} so far{known}")
                continue
            line = f"{name:<{width}}  {_bar(job.last[1] / max(job.total, 1))} {job.last[1]}/{job.total}"
            out.append(f"{line}  {_left_text(left)}  {job.note}".rstrip())
        left, spent = self.left(), now - self.began
        share = 0.0 if left is None else spent / max(spent + left, 1e-9)
        out.append(f"{'all':<{width}}  {_bar(share)} {share:4.0%}  {clock_time(spent)} so far, {_left_text(left)}")
        return out

    def left(self) -> float | None:
        """Seconds until all jobs are done, or None before the first job has a speed."""
        now, open_ = self.clock(), [job for job in self.jobs.values() if not job.ended]
        # when each worker is free: those at work first
        free = [0.0] * self.workers
        for job in sorted(open_, key=lambda job: job.began is None):
            left = job.left(now, *self._usual())
            if left is None:
                return None
            heapq.heapreplace(free, free[0] + left)
        return max(free)

    def _usual(self) -> tuple[float | None, float]:
        """Seconds per count, None before a job has a speed, and seconds of preparation: the means so far."""
        rates = [rate for rate in (job.rate for job in self.jobs.values()) if rate is not None]
        preparations = [time for time in (job.preparation for job in self.jobs.values()) if time is not None]
        return sum(rates) / len(rates) if rates else None, sum(preparations) / max(len(preparations), 1)


def plural(number: int, noun: str) -> str:
    """1 frame, 2 frames."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


def clock_time(seconds: float | int) -> str:
    """Seconds as 0:07, 12:34 or 1:02:03."""
    minutes, seconds = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{seconds:02}" if hours else f"{minutes}:{seconds:02}"


def _left_text(seconds: float | int | None) -> str:
    return "time left not known yet" if seconds is None else f"{clock_time(seconds)} left"


def _cut(line: str) -> str:
    """What fits into one line of the terminal: a longer one takes two, of which a redraw takes back one."""
    return line[: shutil.get_terminal_size().columns - 1]


def _bar(share: float, width: int = 16) -> str:
    filled = int(width * share)
    return f"[{'#' * filled}{'.' * (width - filled)}]"


class Reporter(NamedTuple):
    """How a job reports its progress; in a worker process both go to the parent."""

    say: Callable[[str], None]  # a line that stays
    # a count and a note, as often as wished
    step: Callable[[int, str], None]
