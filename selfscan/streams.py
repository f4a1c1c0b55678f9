"""Standard streams that stop no work: what cannot be printed, because the reader has gone or its disk is full, is lost.

A film takes an hour, and a line about its progress is not worth it.
"""

import errno
import io
import os
import sys
from typing import Any, TextIO


class GuardedStream:
    """A text stream whose first failure is kept in `failure`; from then on what is printed goes nowhere."""

    def __init__(self, stream: TextIO):
        self.stream = stream
        self.failure: OSError | None = None

    def write(self, text: str) -> int:
        try:
            return self.stream.write(text)
        except OSError as error:
            self._give_up(error)
            return len(text)

    def flush(self) -> None:
        try:
            self.stream.flush()
        except OSError as error:
            self._give_up(error)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.stream, name)

    def _give_up(self, error: OSError) -> None:
        self.failure = self.failure or error
        # what the stream still holds, and what libraries print beneath Python, fails no more
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, self.stream.fileno())
        os.close(nowhere)


def guard_streams() -> None:
    """Guard standard output and error.

    A stream that is closed (`>&-`) is opened on nothing first: the next file that is opened would take its number, and
    what a library prints would be written into that file.
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(number)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(number, "r" if number == 0 else "w", encoding="utf-8", closefd=False))
    for stream in (sys.stdout, sys.stderr):
        # the name of a file may be no text
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    sys.stdout, sys.stderr = GuardedStream(sys.stdout), GuardedStream(sys.stderr)


def exit_code(code: int) -> int:
    """The code with which to leave once all is printed: 1 where the output was asked for and could not be written.

    That its reader has gone, as of `selfscan doctor | head -1`, is no failure.
    """
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    failure = sys.stdout.failure if isinstance(sys.stdout, GuardedStream) else None
    if failure is None or failure.errno == errno.EPIPE:
        return code
    print(f"selfscan: what was printed is lost: {failure.strerror}", file=sys.stderr, flush=True)
    return code or 1
