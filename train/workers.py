"""Parts that learn side by side, each in a process of its own, shown on one board."""

import contextlib
import multiprocessing
import multiprocessing.connection
import multiprocessing.resource_tracker
import os
import signal
import traceback
from collections.abc import Callable, Mapping
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any, TypeVar

from avatar.errors import AssetError
from avatar.interrupt import Stopped, deferred_stop, prompt_stop, signals_arrive, signals_wait
from avatar.progress import ProgressBoard, Reporter

T = TypeVar("T")


Work = Callable[[T, Reporter], dict]


def run_jobs(jobs: Mapping[str, T], work: Work, board: ProgressBoard, workers: int) -> dict[str, dict]:
    """work(job) of every job by name, at most `workers` at a time; with one worker in this process.

    A signal, or the failure of one job, stops the others where they can save. An interrupted run raises
    `Stopped` when all of them have.
    """
    if workers > 1:
        return _in_processes(jobs, work, board, workers)
    results = {}
    for name, job in jobs.items():
        board.begin(name)
        reporter = Reporter(
            board.say, lambda done, note: board.update(name, done, note), lambda share: board.prepare(name, share)
        )
        results[name] = work(job, reporter)
        board.end(name)
    return results


def _in_processes(jobs: Mapping[str, T], work: Work, board: ProgressBoard, workers: int) -> dict[str, dict]:
    # a forked torch may hang
    context = multiprocessing.get_context("spawn")
    waiting = list(jobs)
    busy: dict[Connection, tuple[str, BaseProcess]] = {}
    results: dict[str, dict] = {}
    failure: BaseException | None = None
    content: list[Any]
    stopping = False
    try:
        with deferred_stop() as stop:
            while busy or (waiting and not stop.asked and failure is None):
                while waiting and len(busy) < workers and not stop.asked and failure is None:
                    name = waiting.pop(0)
                    ours, theirs = context.Pipe()
                    process = context.Process(target=_worker, args=(work, jobs[name], theirs), name=name)
                    # its start would let signals through
                    multiprocessing.resource_tracker.ensure_running()
                    with signals_wait():
                        process.start()
                    theirs.close()
                    busy[ours] = (name, process)
                    board.begin(name)
                if (stop.asked or failure is not None) and not stopping:
                    stopping = True
                    for _, process in busy.values():
                        if process.is_alive() and process.pid is not None:
                            os.kill(process.pid, signal.SIGTERM)
                for connection in multiprocessing.connection.wait(list(busy), timeout=0.2):
                    assert isinstance(connection, Connection)
                    name, process = busy[connection]
                    try:
                        kind, *content = connection.recv()
                    except EOFError:
                        process.join()
                        kind, content = "lost", [process.exitcode]
                    if kind == "say":
                        board.say(*content)
                        continue
                    if kind == "step":
                        board.update(name, *content)
                        continue
                    if kind == "prepare":
                        board.prepare(name, *content)
                        continue
                    if kind == "done":
                        results[name] = content[0]
                        board.end(name)
                    elif kind == "failed":
                        failure = failure or content[0]
                    elif kind == "lost":
                        failure = failure or _lost(name, content[0])
                    elif not stop.asked:  # a signal sent only to the worker
                        stop.ask(content[0])
                    del busy[connection]
                    connection.close()
                    process.join()
                board.refresh()
    finally:
        # only after a second Ctrl-C or an error here
        for _, process in busy.values():
            process.kill()
    if failure is not None:
        raise failure
    if stop.number is not None:
        raise Stopped(stop.number)
    return results


def _lost(name: str, code: int | None) -> AssetError:
    why = "killed, perhaps for want of memory" if code == -9 else f"exit code {code}"
    return AssetError(f"{name}: its process ended unexpectedly ({why}); --resume goes on from its checkpoint")


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
            reporter = Reporter(
                lambda text: send("say", text),
                lambda done, note: send("step", done, note),
                lambda share: send("prepare", share),
            )
            facts = work(job, reporter)
            connection.send(("done", facts))
    except Stopped as stopped:
        _send_outcome(connection, "stopped", stopped.number)
    except Exception as error:
        if not isinstance(error, (AssetError, FloatingPointError)):
            traceback.print_exc()
        _send_outcome(
            connection,
            "failed",
            type(error)(str(error)) if len(error.args) == 1 else RuntimeError(repr(error)),
        )


def _send_outcome(connection: Connection, *message) -> None:
    # the parent may be gone
    with contextlib.suppress(OSError):
        connection.send(message)
