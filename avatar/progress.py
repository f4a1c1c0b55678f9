"""Progress of long work: a bar on a terminal, plain lines elsewhere."""

import sys
import time
from collections.abc import Iterable, Iterator
from typing import TextIO, TypeVar

T = TypeVar("T")


class Progress:
    """Reports how far a count has come, with the time left and a note such as a loss.

    On a terminal one line is redrawn; elsewhere a line is printed when work begins to take long and about
    every ten seconds after that.
    """

    def __init__(self, label: str, total: int, stream: TextIO | None = None):
        self.label, self.total = label, total
        self.stream = sys.stderr if stream is None else stream
        self.live = self.stream.isatty()
        self.began = self.shown = time.monotonic()

    def update(self, done: int, note: str = "") -> None:
        now = time.monotonic()
        last = done >= self.total
        if now - self.shown < (0.1 if self.live else 10.0) and not (last and self.live):
            return
        self.shown = now
        spent = now - self.began
        left = spent / max(done, 1) * (self.total - done)
        text = f"{self.label} {done}/{self.total}  {spent:.0f} s, {left:.0f} s left  {note}".rstrip()
        if self.live:
            filled = int(24 * done / max(self.total, 1))
            self.stream.write(
                f"\r\x1b[K[{'#' * filled}{'.' * (24 - filled)}] {text}" + ("\n" if last else "")
            )
        else:
            self.stream.write(text + "\n")
        self.stream.flush()


def progress(items: Iterable[T], label: str, total: int | None = None) -> Iterator[T]:
    """The items, one by one, with progress reported after each."""
    if total is None:
        items = list(items)
        total = len(items)
    report = Progress(label, total)
    for done, item in enumerate(items, 1):
        yield item
        report.update(done)
