"""Ctrl-C between frames.

A KeyboardInterrupt that Python raises while OpenGL calls back into it (player/counting.py) is dropped by ctypes, and
the OpenGL call with it. So while frames are drawn the wish to stop is only noted, and taken up when a frame is whole.
"""

import signal
import threading
from types import FrameType, TracebackType


class Stop:
    """`with Stop() as stop:` notes the first Ctrl-C; `stop.check()` raises it. A second one is raised at once."""

    def __init__(self):
        self.asked = False
        self._before: object = None

    def __enter__(self) -> "Stop":
        if threading.current_thread() is threading.main_thread():  # others have no signals
            self._before = signal.signal(signal.SIGINT, self._note)
        return self

    def check(self) -> None:
        """Raise what was noted."""
        if self.asked:
            raise KeyboardInterrupt

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._before is not None:
            signal.signal(signal.SIGINT, self._before)  # type: ignore[arg-type]
        if error is None:
            self.check()

    def _note(self, _number: int, _frame: FrameType | None) -> None:
        if self.asked:
            raise KeyboardInterrupt
        self.asked = True
