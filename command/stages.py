"""Work in stages: each a command of the project as a process of its own, kept once its product is there."""

import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from command.errors import AssetError
from command.interrupt import SIGNALS, Stopped

# exit codes of a process that a signal stopped, by its own handler or by none
STOPPED = {code: number for number in SIGNALS for code in (128 + number, -number)}


@dataclass(frozen=True)
class Stage:
    name: str
    # written whole or not at all by the stage, last of what it writes
    product: Path
    run: Callable[[], int | None]
    # on two cores
    minutes: float = 1.0


def as_word(value: object) -> str:
    """A value on a command line; a path that begins with a dash is no option."""
    return f"./{value}" if isinstance(value, Path) and str(value).startswith("-") else str(value)


def command(*words: str | Path) -> Callable[[], int]:
    """A command of the project as a process of its own.

    Training must not share a process with drawing: torch's optimiser brings its own LLVM (triton), which crashes
    where Mesa's was loaded first. A person types the commands one by one as well.
    """

    def run() -> int:
        """The process's exit code, once it has ended."""
        process = subprocess.Popen([sys.executable, "-m", *map(as_word, words)])
        try:
            return process.wait()
        except KeyboardInterrupt:
            # Ctrl-C reached it as well, SIGTERM did not; what it has done is saved before it ends
            process.terminate()
            process.wait()
            raise

    return run


def run_stages(todo: list[Stage], after: float = 0.0) -> dict[str, float]:
    """Run what is not there yet, and everything after it; the seconds of what ran, by name. `after`: minutes of what
    comes behind these stages.

    Raises:
        AssetError: a stage ended without its product.
    """
    seconds: dict[str, float] = {}
    for number, stage in enumerate(todo, 1):
        label = f"[{number}/{len(todo)}] {stage.name}"
        if stage.product.exists() and not seconds:
            print(f"{label}: kept {stage.product}", flush=True)
            continue
        left = sum(later.minutes for later in todo[number - 1 :]) + after
        print(f"\n{label}: about {stage.minutes:.2g} min on 2 cores, {left:.0f} to the end ...", flush=True)
        start = time.perf_counter()
        code = stage.run()
        if code in STOPPED:
            raise Stopped(STOPPED[code])
        if code not in (None, 0) or not stage.product.exists():
            raise AssetError(
                f"{stage.product}: {stage.name!r} ended without writing it, its own line says why; once that is "
                "mended, the same command goes on from there"
            )
        seconds[stage.name] = time.perf_counter() - start
        print(f"{label}: {seconds[stage.name]:.0f} s, {stage.product}", flush=True)
    return seconds
