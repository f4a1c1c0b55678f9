"""Where a number was measured: processor, renderer, load, the commit of the code, and how much of the machine other
programs used meanwhile."""

import os
import platform
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from bench.report.writer import Json
from player.gl.context import Context

# timings are no more than hints where others use a larger share of the machine
BUSY = 0.1


def machine(context: Context) -> Json:
    """What a reader needs to know beside a measured number."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else None
    return {
        "cpu": cpu_name(),
        "cores": cores,
        "renderer": context.renderer,
        "context": context.kind,
        "python": platform.python_version(),
        "load_average": load,
        "commit": commit(),
    }


def commit() -> str | None:
    """Short name of the checked-out commit, with "+" where files differ from it; None outside a repository."""
    folder = Path(__file__).parent
    try:
        answer = subprocess.run(
            ["git", "describe", "--always", "--dirty=+"], cwd=folder, capture_output=True, text=True, timeout=10
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    return answer.stdout.strip() or None if answer.returncode == 0 else None


def times_of(context: Context, work: Callable[[], object]) -> tuple[float, float]:
    """Milliseconds of some drawing until the device is done: passed, and spent by all threads together."""
    context.gl.finish()
    spent = time.process_time()
    passed = context.milliseconds(work)
    return passed, 1e3 * (time.process_time() - spent)


def cpu_name() -> str:
    """What the processor calls itself; where it does not say, its architecture."""
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    except OSError:
        # not Linux: the platform module's word has to do
        pass
    return platform.processor() or platform.machine()


class Quiet:
    """How much of the machine others used while a block ran. `with Quiet() as quiet: ...; quiet.others` in [0, 1].

    Where /proc/stat is not there, `others` is None. Processes we start count as ours once they have ended.
    """

    def __enter__(self) -> "Quiet":
        self.start, self.begun = machine_seconds(), own_seconds()
        return self

    def __exit__(self, *_error: object) -> None:
        now = machine_seconds()
        self.others: float | None = None
        if now is not None and self.start is not None:
            busy, whole = (b - a for a, b in zip(self.start, now, strict=True))
            self.others = round(float(np.clip((busy - (own_seconds() - self.begun)) / max(whole, 1e-9), 0, 1)), 3)

    def facts(self, context: Context) -> Json:
        """The machine, and what a reader must know when it was not ours alone."""
        found, warning = machine(context) | {"others_cpu_share": self.others}, None
        if self.others is not None and self.others > BUSY:
            load = "" if found["load_average"] is None else f" (load {found['load_average']:.1f})"
            warning = (
                f"NOT QUIET: other programs used {100 * self.others:.0f} % of this machine meanwhile{load}. Times are "
                "too long and ratios uncertain: measure again on an idle machine."
            )
        return {"machine": found, "warning": warning}


def machine_seconds() -> tuple[float, float] | None:
    """Busy and all CPU seconds of the machine since it started, over all its processors."""
    try:
        numbers = [int(n) for n in Path("/proc/stat").read_text().split("\n", 1)[0].split()[1:9]]
    except (OSError, ValueError):
        return None
    tick = os.sysconf("SC_CLK_TCK")
    user, nice, system, idle, waiting, irq, soft, steal = numbers
    busy = user + nice + system + irq + soft + steal
    return busy / tick, (busy + idle + waiting) / tick


def own_seconds() -> float:
    """CPU seconds of this process and of its ended children."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system
