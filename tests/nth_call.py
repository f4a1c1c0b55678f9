"""Makes the N-th call that writes under a folder fail, for N = 1, 2, ... until none does, and looks at what is left.

The calls: open (to write), write, close, fsync, mkdir, rename, replace, exchange, unlink, rmdir, chmod, truncate, mmap;
of Python's files also what their buffers write. Each fails as a disk or a table of files does (ENOSPC, EIO, EMFILE,
short write), or is the moment of Ctrl-C (SIGINT, which is also what EINTR comes of) or of SIGKILL. A trial is a child.

    python -m nth_call SPEC      SPEC: JSON of `Spec`; prints the Outcome as JSON
"""

import builtins
import errno
import hashlib
import importlib
import io
import json
import mmap
import os
import shutil
import signal
import sys
import traceback
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

import files.whole

ERRORS = {"open": ("EMFILE", "ENOSPC", "EIO"), "write": ("ENOSPC", "EIO", "short")}
PATCHED = "open write pwrite fsync replace rename unlink remove mkdir rmdir chmod ftruncate close".split()
MARK = ".selfscan"


@dataclass
class Spec:
    """A command, tried again and again."""

    modules: list[str]  # imported once, before the first fork
    old: list[str]  # arguments of `selfscan` that leave an old output; {} is the folder of the trial
    new: list[str]  # those that are to replace it
    out: str  # the output's name in that folder
    folder: str  # for all trials
    seed: int = 0
    most: int = 10**6  # calls that are tried, the first, the last and a seeded choice between
    call: str = ""  # "module:function" of (folder, arguments) in place of `selfscan`
    also: str = ""  # a function of nth_call_commands: whether an output is whole that is neither of the two


@dataclass
class Outcome:
    """What came of it."""

    calls: int = 0
    trials: int = 0
    fired: Counter = field(default_factory=Counter)
    # what should not be, in words
    lost: list[str] = field(default_factory=list)
    litter: list[str] = field(default_factory=list)
    strays: list[str] = field(default_factory=list)


class Faults:
    """Counts the calls under a folder and spoils one of them."""

    def __init__(self, root: Path, at: int, kind: str):
        self.root, self.at, self.kind = str(root), at, kind
        self.count, self.called = 0, ""
        self.handles: set[int] = set()
        self.real = {name: getattr(os, name) for name in PATCHED} | {"file": io.open, "mmap": mmap.mmap}

    def under(self, place: object, dir_fd: int | None = None) -> bool:
        if isinstance(place, int) or dir_fd is not None:
            return (place if dir_fd is None else dir_fd) in self.handles
        return os.path.abspath(os.fsdecode(place)).startswith(self.root)

    def happens(self, name: str) -> bool:
        """Count a call; whether it is to be a short write. Raises where it is to fail."""
        self.count += 1
        if self.count != self.at:
            return False
        self.called = name
        if self.kind in ("SIGINT", "SIGKILL"):
            os.kill(os.getpid(), getattr(signal, self.kind))
            return False
        kinds = ERRORS.get("write" if "write" in name else name, ("EIO", "ENOSPC"))
        kind = kinds[self.at % len(kinds)]
        if kind == "short":
            return True
        number = getattr(errno, kind)
        raise OSError(number, os.strerror(number), self.root)

    def install(self) -> None:
        for name in PATCHED:
            setattr(os, name, self._patched(name))
        builtins.open = io.open = self._open
        mmap.mmap = self._mmap
        exchanged = files.whole._exchanged
        files.whole._exchanged = lambda one, other: self.happens("exchange") or exchanged(one, other)

    def _patched(self, name: str) -> Callable:
        real = self.real[name]

        def call(place, *rest, **named):
            if not self.under(place, named.get("dir_fd")):
                return real(place, *rest, **named)
            if name == "open":
                if rest and rest[0] & (os.O_WRONLY | os.O_RDWR):
                    self.happens(name)
                handle = real(place, *rest, **named)
                self.handles.add(handle)
                return handle
            if name == "close":
                self.handles.discard(place)
                real(place)
                self.happens(name)
                return None
            if self.happens(name) and name in ("write", "pwrite"):
                return real(place, rest[0][: len(rest[0]) // 2], *rest[1:])
            return real(place, *rest, **named)

        return call

    def _mmap(self, *rest, **named):
        if rest and rest[0] in self.handles:
            self.happens("mmap")
        return self.real["mmap"](*rest, **named)

    def _open(self, place, mode="r", buffering=-1, encoding=None, errors=None, newline=None, closefd=True, opener=None):
        writes = any(letter in mode for letter in "wax+")
        if opener is not None or not writes or not self.under(place):
            return self.real["file"](place, mode, buffering, encoding, errors, newline, closefd, opener)
        if not isinstance(place, int):
            self.happens("open")
        raw = File(self, place, mode.replace("b", "").replace("t", ""), closefd)
        if buffering == 0:
            return raw
        buffered = io.BufferedRandom(raw) if "+" in mode else io.BufferedWriter(raw)
        return buffered if "b" in mode else io.TextIOWrapper(buffered, encoding, errors, newline)


class File(io.FileIO):
    """What is open to be written."""

    def __init__(self, faults: Faults, place, mode: str, closefd: bool):
        super().__init__(place, mode, closefd)
        self.faults = faults
        faults.handles.add(self.fileno())

    def write(self, data):
        if self.faults.happens("write"):
            return super().write(memoryview(data).cast("B")[: max(len(data) // 2, 1)])
        return super().write(data)

    def truncate(self, size=None):
        self.faults.happens("ftruncate")
        return super().truncate(size)

    def close(self):
        if not self.closed:
            self.faults.handles.discard(self.fileno())
            super().close()
            self.faults.happens("close")


def digest(place: Path) -> str:
    """Of a file or of all that lies in a folder; "" where nothing is."""
    if not os.path.lexists(place):
        return ""
    total = hashlib.sha256()
    for path in sorted(place.rglob("*")) if place.is_dir() else [place]:
        if path.name != MARK:
            total.update(str(path.relative_to(place)).encode() + b"\0")
            total.update(b"" if path.is_dir() else path.read_bytes())
    return total.hexdigest()[:16]


def names(folder: Path) -> set[str]:
    """What lies in a folder, and what was left unfinished anywhere below."""
    return {*os.listdir(folder), *(str(path.relative_to(folder)) for path in folder.rglob(".selfscan-*"))}


def forked(spec: Spec, arguments: list[str], folder: Path, faults: Faults | None) -> tuple[int, str, int, str]:
    """Exit status of the command in a child (negative: killed), what it said, and the calls it made with the last."""
    said, counted = folder.with_suffix(".said"), folder.with_suffix(".count")
    pid = os.fork()
    if not pid:
        code = 99
        try:
            handle = os.open(said, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
            os.dup2(handle, 1)
            os.dup2(handle, 2)
            module, _, name = (spec.call or "selfscan.__main__:main").partition(":")
            command = getattr(importlib.import_module(module), name)
            placed = [argument.replace("{}", str(folder)) for argument in arguments]
            if faults is not None:
                faults.install()
            code = command(folder, placed) if spec.call else command(placed)
        except BaseException:
            traceback.print_exc()
        finally:
            if faults is not None:
                for name in PATCHED:
                    setattr(os, name, faults.real[name])
                with faults.real["file"](counted, "w") as file:
                    file.write(f"{faults.count} {faults.called}")
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(code or 0)
    _, status = os.waitpid(pid, 0)
    count, _, called = counted.read_text().partition(" ") if counted.exists() else ("0", "", "")
    counted.unlink(missing_ok=True)
    return os.waitstatus_to_exitcode(status), said.read_text(errors="replace"), int(count), called


def trial(spec: Spec, base: Path, number: int, kind: str) -> tuple[Path, tuple[int, str, int, str]]:
    """The N-th call of the new command fails, beside the old output."""
    folder = base.with_name("trial")
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(base, folder, symlinks=True)
    return folder, forked(spec, spec.new, folder, Faults(folder, number, kind))


def sweep(spec: Spec) -> Outcome:
    """All trials of a command."""
    for module in spec.modules:
        importlib.import_module(module)
    out, base = Outcome(), Path(spec.folder) / "base"
    base.mkdir()
    assert forked(spec, spec.old, base, None)[0] == 0, Path(spec.folder, "base.said").read_text()
    folder, (code, said, out.calls, _) = trial(spec, base, 0, "")
    assert code == 0 and out.calls, said
    known = {digest(base / spec.out): "old", digest(folder / spec.out): "new"}
    assert len(known) == 2, "the two commands leave the same"
    clean = names(folder)
    numbers = np.arange(1, out.calls + 1)
    if len(numbers) > spec.most:
        rng, third = np.random.default_rng(spec.seed), spec.most // 3
        between = rng.choice(numbers[third:-third], spec.most - 2 * third, replace=False)
        numbers = np.sort(np.concatenate([numbers[:third], between, numbers[-third:]]))
    for kind in ("error", "SIGINT", "SIGKILL"):
        for number in numbers.tolist():
            folder, (code, said, _, called) = trial(spec, base, number, kind)
            out.trials += 1
            out.fired[f"{kind} {called}".strip()] += 1
            place = f"{kind} at call {number} {called}: exit {code}"
            whole = spec.also and getattr(importlib.import_module("nth_call_commands"), spec.also)
            if digest(folder / spec.out) not in known and not (whole and whole(folder / spec.out)):
                out.lost.append(f"{place}, {sorted(os.listdir(folder))}")
            allowed = {"error": (0, 1), "SIGINT": (0, 1, 130), "SIGKILL": (-9,)}[kind]
            if code not in allowed or "Traceback" in said or "should not happen" in said:
                out.strays.append(f"{place}: {said[-600:]}")
            if names(folder) - clean:
                left = sorted(names(folder) - clean)
                again = forked(spec, spec.new, folder, None)
                after = names(folder) - clean
                if after and not all(name in again[1] for name in after):
                    out.litter.append(f"{place}: {left}, after the next run {sorted(after)}")
                if again[0] == 0 and known.get(digest(folder / spec.out)) != "new":
                    out.lost.append(f"{place}: the next run leaves another output")
    return out


if __name__ == "__main__":
    print(json.dumps(vars(sweep(Spec(**json.loads(sys.argv[1]))))))
