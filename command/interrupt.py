"""Ctrl-C and SIGTERM, taken at a moment of our choosing.

While frames are drawn, and while a training step runs, a signal is only noted (`deferred_stop`): what is begun is
finished, and a KeyboardInterrupt raised in a callback from C (a window's keys) would be dropped by ctypes.
"""

import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager

SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Stopped(KeyboardInterrupt):
    """The user asked to stop. `number` is the signal; a shell expects the exit code 128 + number."""

    def __init__(self, number: int = signal.SIGINT):
        super().__init__()
        self.number = number


class StopRequest:
    """What arrived inside a `deferred_stop` block."""

    number: int | None = None  # the signal
    at: float = 0.0

    @property
    def asked(self) -> bool:
        return self.number is not None

    def ask(self, number: int = signal.SIGTERM) -> None:
        """Ask from within: a lost parent process counts as SIGTERM."""
        if self.number is None:
            self.number, self.at = number, time.monotonic()

    def check(self) -> None:
        if self.number is not None:
            raise Stopped(self.number)


# the request of the innermost `prompt_stop` block
_prompt = StopRequest()


@contextmanager
def prompt_stop() -> Iterator[StopRequest]:
    """In this block either signal raises `Stopped` at once, so that `finally` and context managers run.

    Where the exception was dropped the request still knows, and so does a `deferred_stop` block that begins later.
    """
    global _prompt
    request, outer = StopRequest(), _prompt

    def handler(number, frame):
        request.ask(number)
        raise Stopped(number)

    _prompt = request
    try:
        with _handled(handler):
            yield request
    finally:
        _prompt = outer


@contextmanager
def deferred_stop(*, patience: float | int = 1.0) -> Iterator[StopRequest]:
    """In this block a signal is only noted; the block looks at `.asked`, or calls `.check()`, where it can leave.

    A second Ctrl-C, `patience` seconds or more after the first, raises `Stopped` wherever the block is. Other repeats
    change nothing: `timeout` and torchrun send to a process and then to its group.
    """
    request = StopRequest()
    if _prompt.number is not None:
        request.ask(_prompt.number)

    def handler(number, frame):
        if request.asked and number == signal.SIGINT and time.monotonic() - request.at >= patience:
            raise Stopped(number)
        request.ask(number)

    with _handled(handler):
        yield request


@contextmanager
def _handled(handler) -> Iterator[None]:
    try:
        previous = [signal.signal(number, handler) for number in SIGNALS]
    except ValueError:  # not the main thread: the program's own handlers stay
        yield
        return
    try:
        yield
    finally:
        for number, before in zip(SIGNALS, previous):
            signal.signal(number, before)


@contextmanager
def signals_wait() -> Iterator[None]:
    """Hold both signals back while a process is started; it inherits that, and takes them when it is ready.

    Otherwise a Ctrl-C during a child's imports would end it with a traceback.
    """
    # Windows has no signal mask
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def signals_arrive() -> None:
    """In a process started inside `signals_wait`: from here on they are delivered."""
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)
