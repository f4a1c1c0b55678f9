"""Timing programs against each other on a machine that is not ours alone: alternating rounds, ratios of neighbours.

Each round draws a few frames of every program, in a new random order, so that a slow stretch falls on all alike.
What is compared is the median over rounds of the ratio within a round (identical programs: 1.5 % off at worst over
60 rounds, where medians are 7 % and minima 2.4 % off: measured). A frame is drawn untimed before each turn: the
caches hold the program's own meshes and textures, as they would if nothing else were drawn.
"""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float


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
