"""Do budgets hold? Random budgets, what each buys, and what a hundred frames of it then take.

    python -m experiments.budgets AVATAR [--count 5] [--frames 100] [--size 640x640] [--json FILE]

A budget holds when p95 of the frames lies within it. It is wasted when a rung two or more steps better would have held.
On a machine that others use, neither means much: the share they used is told.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from avatar.gltf.avatar_file import read_avatar
from bench.ladder.machine import Quiet
from bench.ladder.rung_pictures import motion_frames
from files.whole import write_json
from player.budget.ladder import PricedRung, best_within, frame_times, frontier, released, scene_rungs
from player.budget.measure import BudgetScene, price
from player.budget.rung import Rung
from player.effects.background import Background
from player.gl.context import Context, open_context
from player.scene.arguments import parse_size
from player.scene.effects import PLAIN


def rung_times(
    context: Context, scene: BudgetScene, rungs: Sequence[Rung], rounds: int
) -> Float[np.ndarray, "rounds rungs"]:
    """Milliseconds of every one of the rungs in alternating rounds."""
    with released(scene.renderer(context, rung) for rung in rungs) as renderers:
        return frame_times(context, renderers, scene.frames, range(rounds), reads_back=scene.reads_back)


def tried_budgets(
    context: Context, scene: BudgetScene, *, count: int = 5, frames: int = 100, seed: int = 0
) -> list[dict[str, Any]]:
    """Budgets between the cheapest and the dearest rung, at random on a logarithmic scale, each asked of one table."""
    bought_from = price(context, scene, scene_rungs(scene.avatars))
    front = frontier(bought_from)
    low, high = np.log(1.05 * front[0].ms_p95), np.log(1.1 * front[-1].ms_p95)
    budgets = np.exp(np.random.default_rng(seed).uniform(low, high, count)).tolist()
    return [tried(context, scene, bought_from, budget, frames) for budget in budgets]


def tried(
    context: Context, scene: BudgetScene, bought_from: list[PricedRung], budget: float, frames: int
) -> dict[str, Any]:
    """What a budget buys from a table, and what every rung of the frontier takes now."""
    front = frontier(bought_from)
    chosen = best_within(bought_from, budget)
    p95 = np.percentile(rung_times(context, scene, [one.rung for one in front], frames), 95, axis=0)
    taken = {one.rung: ms for one, ms in zip(front, p95.tolist(), strict=True)}
    place = front.index(chosen)
    held = [k for k, one in enumerate(front) if taken[one.rung] <= budget]
    return {
        "budget_ms": round(budget, 3),
        "rung": chosen.rung.name,
        "table_p95_ms": round(chosen.ms_p95, 3),
        "p95_ms": round(taken[chosen.rung], 3),
        "holds": taken[chosen.rung] <= budget,
        "steps_wasted": max(max(held, default=0) - place, 0),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("avatar", type=Path)
    parser.add_argument("--count", type=int, default=5, help="budgets")
    parser.add_argument("--frames", type=int, default=100, help="of each rung, for each budget")
    parser.add_argument("--size", type=parse_size, default=(640, 640), help="pixels")
    parser.add_argument("--json", type=Path)
    asked = parser.parse_args()
    avatar = read_avatar(asked.avatar)
    seen = [([frame.pose], frame.camera) for frame in motion_frames(avatar, 4, asked.size)]
    scene = BudgetScene([avatar], seen, asked.size, PLAIN, Background(), reads_back=False)
    with open_context() as context:
        with Quiet() as quiet:
            rows = tried_budgets(context, scene, count=asked.count, frames=asked.frames)
        facts = quiet.facts(context)
    for row in rows:
        print(f"{row['budget_ms']:8.2f} ms: {row['rung']:28} p95 {row['p95_ms']:7.2f}  "
              + ("holds" if row["holds"] else "FAILS") + f", {row['steps_wasted']} steps wasted")  # fmt: skip
    if facts["warning"]:
        print(facts["warning"])
    if asked.json:
        write_json(asked.json, {"machine": facts["machine"], "budgets": rows})


if __name__ == "__main__":
    main()
