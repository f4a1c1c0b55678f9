"""Work side by side: jobs in a process each, shown on one board; pieces of one job in threads."""

import contextlib
import multiprocessing
import multiprocessing.connection
import multiprocessing.resource_tracker
import os
import signal
import traceback
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any, TypeVar

from command.errors import AssetError
from command.interrupt import Stopped, deferred_stop, prompt_stop, signals_arrive, signals_wait
from command.progress import ProgressBoard, Reporter

T = TypeVar("T")
U = TypeVar("U")
Work = Callable[[T, Reporter], U]


def on_all_cores(function: Callable[[T], U], items: Iterable[T]) -> Iterator[U]:
    """What `function` gives for each item, in their order; items are asked for only as cores become free."""
    count = os.cpu_count() or 1
    waiting = deque()
    with ThreadPoolExecutor(count) as cores:
        for item in items:
            waiting.append(cores.submit(function, item))
            if len(waiting) > count:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()


def run_jobs(jobs: Mapping[str, T], work: Work[T, U], board: ProgressBoard, workers: int) -> dict[str, U]:
    """work(job) of every job by name, at most `workers` at a time; with one worker in this process. Closes the board.

    A signal, or the failure of one job, stops the others where they can save. An interrupted run raises
    `Stopped` when all of them have.
    """
    try:
        return (_in_processes if workers > 1 else _in_turn)(jobs, work, board, workers)
    finally:
        board.close()


def _in_turn(jobs: Mapping[str, T], work: Work[T, U], board: ProgressBoard, workers: int) -> dict[str, U]:
    results = {}
    for name, job in jobs.items():
        board.begin(name)
        results[name] = work(job, board.reporter(name))
        board.end(name)
    return results


def _in_processes(jobs: Mapping[str, T], work: Work[T, U], board: ProgressBoard, workers: int) -> dict[str, U]:
    crew, waiting, stopping = _Crew(work, board), list(jobs), False
    try:
        with deferred_stop() as stop:
            while crew.busy or (waiting and not stop.asked and crew.failure is None):
                while waiting and len(crew.busy) < workers and not stop.asked and crew.failure is None:
                    name = waiting.pop(0)
                    crew.start(name, jobs[name])
                if (stop.asked or crew.failure is not None) and not stopping:
                    stopping = True
                    crew.stop()
                for connection in multiprocessing.connection.wait(list(crew.busy), timeout=0.2):
                    assert isinstance(connection, Connection)
                    number = crew.receive(connection)
                    # a signal sent only to the worker
                    if number is not None and not stop.asked:
                        stop.ask(number)
                board.refresh()
    finally:
        # only after a second Ctrl-C or an error here
        for _, process in crew.busy.values():
            process.kill()
    if crew.failure is not None:
        raise crew.failure
    if stop.number is not None:
        raise Stopped(stop.number)
    return crew.results


class _Crew:
    """Worker processes at their jobs, by the connection that they report on; what jobs gave, and the first failure."""

    def __init__(self, work: Work, board: ProgressBoard):
        self.work, self.board = work, board
        # a forked torch may hang
        self.context = multiprocessing.get_context("spawn")
        self.busy: dict[Connection, tuple[str, BaseProcess]] = {}
        self.results: dict[str, Any] = {}
        self.failure: BaseException | None = None

    def start(self, name: str, job: object) -> None:
        """A process that does the job."""
        here, there = self.context.Pipe()
        process = self.context.Process(target=_worker, args=(self.work, job, there), name=name)
        # its start would let signals through
        multiprocessing.resource_tracker.ensure_running()
        with signals_wait():
            process.start()
        there.close()
        self.busy[here] = (name, process)
        self.board.begin(name)

    def stop(self) -> None:
        """Ask all to save and end."""
        for _, process in self.busy.values():
            if process.is_alive() and process.pid is not None:
                os.kill(process.pid, signal.SIGTERM)

    def receive(self, connection: Connection) -> int | None:
        """Take one message of a worker; the number of the signal that stopped it, where one did."""
        name, process = self.busy[connection]
        content: list
        try:
            kind, *content = connection.recv()
        except EOFError:
            process.join()
            kind, content = "lost", [process.exitcode]
        shown = self.board.reporter(name)._asdict()
        if kind in shown:
            shown[kind](*content)
            return None
        if kind == "done":
            self.results[name] = content[0]
            self.board.end(name)
        elif kind != "stopped":
            self.failure = self.failure or (content[0] if kind == "failed" else _lost(name, content[0]))
        del self.busy[connection]
        connection.close()
        process.join()
        return content[0] if kind == "stopped" else None


def _lost(name: str, code: int | None) -> AssetError:
    why = "killed, perhaps for want of memory" if code == -9 else f"exit code {code}"
    return AssetError(f"{name}: its process ended unexpectedly ({why}); what was done before is kept")


def _worker(work: Work, job: object, connection: Connection) -> None:
    """A worker process: does one job and reports to its parent. A parent that is gone counts as SIGTERM."""

    def send(*message) -> None:
        try:
            connection.send(message)
        except OSError:
            signal.raise_signal(signal.SIGTERM)

    try:
        with prompt_stop():
            signals_arrive()
            facts = work(job, Reporter(*(partial(send, kind) for kind in Reporter._fields)))
            connection.send(("done", facts))
    except Stopped as stopped:
        _send_outcome(connection, "stopped", stopped.number)
    except Exception as error:
        if not isinstance(error, (AssetError, FloatingPointError)):
            traceback.print_exc()
        sent = type(error)(str(error)) if len(error.args) == 1 else RuntimeError(repr(error))
        _send_outcome(connection, "failed", sent)


def _send_outcome(connection: Connection, *message) -> None:
    # the parent may be gone
    with contextlib.suppress(OSError):
        connection.send(message)
