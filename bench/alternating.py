"""Timing programs against each other on a machine that is not ours alone: alternating rounds, ratios of neighbours.

Each round draws a few frames of every program, in a new random order, so that a slow stretch falls on all alike.
What is compared is the median over rounds of the ratio within a round (identical programs: 1.5 % off at worst over
60 rounds, where medians are 7 % and minima 2.4 % off: measured). A frame is drawn untimed before each turn: the
caches hold the program's own meshes and textures, as they would if nothing else were drawn.
"""

import os
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

# of the machine used by others: timings are then no more than hints
BUSY = 0.1


class Turn(NamedTuple):
    """Milliseconds of each frame of one turn."""

    wall: Float[np.ndarray, "frames"]
    # all threads of the process
    cpu: Float[np.ndarray, "frames"]


@dataclass(frozen=True)
class Times:
    """Of one program: all frames, and per round the median of its turn."""

    wall: Float[np.ndarray, "frames"]
    cpu: Float[np.ndarray, "frames"]
    rounds: Float[np.ndarray, "rounds"]
    cpu_rounds: Float[np.ndarray, "rounds"]

    def row(self) -> dict[str, float]:
        """Numbers of a table: median, p95 and spread (half the middle half) of wall time, median of CPU time, ms."""
        q25, q50, q75, q95 = np.percentile(self.wall, [25, 50, 75, 95])
        return {
            "ms_median": round(float(q50), 3),
            "ms_p95": round(float(q95), 3),
            "ms_spread": round(float(q75 - q25) / 2, 3),
            "cpu_ms_median": round(float(np.median(self.cpu)), 3),
            "fps": round(1000 / float(q50), 1),
        }

    def share_of(self, yardstick: "Times") -> dict[str, float]:
        """Frames a second as a share of the yardstick's, from rounds side by side: wall, CPU, and their spread."""
        wall, cpu = yardstick.rounds / self.rounds, yardstick.cpu_rounds / self.cpu_rounds
        q25, q75 = np.percentile(wall, [25, 75])
        return {
            "wall": round(float(np.median(wall)), 3),
            "cpu": round(float(np.median(cpu)), 3),
            "spread": round(float(q75 - q25) / 2, 3),
        }


def here(draw: Callable[[int], object], frames: int) -> Callable[[int], Turn]:
    """Turns of a program of this process; `draw` takes the number of a frame and returns when it is done."""

    def turn(number: int) -> Turn:
        draw(number)
        wall, cpu = np.zeros(frames), np.zeros(frames)
        for i in range(frames):
            start, used = time.perf_counter(), time.process_time()
            draw(number + i + 1)
            cpu[i] = 1e3 * (time.process_time() - used)
            wall[i] = 1e3 * (time.perf_counter() - start)
        return Turn(wall, cpu)

    return turn


def alternate(
    programs: Mapping[str, Callable[[int], Turn]],
    *,
    seconds: float | int,
    least: int = 12,
    most: int = 400,
    seed: int = 0,
) -> dict[str, Times]:
    """Rounds of all programs until `seconds` have passed, but at least `least` and at most `most`.

    Raises:
        ValueError: nothing to time.
    """
    if not programs or least < 1:
        raise ValueError(f"{len(programs)} programs and {least} rounds give nothing to time")
    rng = np.random.default_rng(seed)
    turns: dict[str, list[Turn]] = {name: [] for name in programs}
    # what is made or compiled at first use is not timed
    for turn in programs.values():
        turn(0)
    end, rounds = time.perf_counter() + seconds, 0
    while rounds < most and (rounds < least or time.perf_counter() < end):
        for name in rng.permutation(list(programs)):
            turns[name].append(programs[name](rounds))
        rounds += 1
    return {
        name: Times(
            np.concatenate([t.wall for t in done]),
            np.concatenate([t.cpu for t in done]),
            np.array([np.median(t.wall) for t in done]),
            np.array([np.median(t.cpu) for t in done]),
        )
        for name, done in turns.items()
    }


class Quiet:
    """How much of the machine others used while a block ran. `with Quiet() as quiet: ...; quiet.others` in [0, 1].

    Where /proc/stat is not there, `others` is None. Processes we start count as ours once they have ended.
    """

    def __enter__(self) -> "Quiet":
        self.start, self.begun = machine_seconds(), own_seconds()
        return self

    def __exit__(self, *_error: Any) -> None:
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
