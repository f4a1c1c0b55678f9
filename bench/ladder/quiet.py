"""How much of the machine other programs used while something was timed."""

import os
from pathlib import Path

import numpy as np

# timings are no more than hints where others use a larger share of the machine
BUSY = 0.1


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


def warning(others: float | None, load: float | None) -> str | None:
    """What a reader must know when the machine was not ours alone."""
    if others is None or others <= BUSY:
        return None
    return (
        f"NOT QUIET: other programs used {100 * others:.0f} % of this machine meanwhile"
        + (f" (load {load:.1f})" if load is not None else "")
        + ". Times are too long and ratios uncertain: measure again on an idle machine."
    )
