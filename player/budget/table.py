"""Prices of rungs, kept in the user's cache folder: one file for each machine, avatar, size and what else is drawn.

A table is measured anew when it is older than a month, or when the rung it chooses takes another time than it says.
"""

import contextlib
import hashlib
import json
import os
import platform
import time
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path

from command.errors import AssetError
from command.progress import progress
from files.whole import write_json
from player.budget.ladder import PricedRung, best_within, scene_rungs
from player.budget.measure import BudgetScene, check, price
from player.budget.rung import Rung
from player.gl.context import Context

FORMAT = 3
OLDEST = 30 * 86400.0  # seconds
# the chosen rung takes so many times as long, or as short, as its table says: it is measured anew
STALE = 1.35


def cache_folder() -> Path:
    """The user's own: $XDG_CACHE_HOME/selfscan, else ~/.cache/selfscan."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "selfscan"


def rung_within(
    context: Context, scene: BudgetScene, files: Sequence[str], *, budget: float, level: int | None = None
) -> tuple[list[PricedRung], PricedRung]:
    """The prices of a scene's rungs, from the cache where they still hold, and the one that a budget buys, ms. A view
    mode of the effects that is not auto, and a level that is given, are kept; `files` are those of the avatars.

    Raises:
        ValueError: a view mode or a level that an avatar does not hold, or motion blur or depth of field.
    """
    if scene.effects.motion_blur is not None or scene.effects.depth_of_field is not None:
        raise ValueError("motion blur and depth of field draw a frame many times: expected none of them with a budget")
    rungs = scene_rungs(scene.avatars, view=scene.effects.view, level=level)
    if not rungs:
        at = "" if level is None else f" at level {level}"
        raise ValueError(f"view {scene.effects.view}{at}: not in every avatar's file")
    path = cache_folder() / "budget" / f"{key_of(context, scene, files, rungs)}.json"
    kept = read_table(path, rungs)
    if kept is not None:
        chosen = best_within(kept, budget)
        now = check(context, scene, chosen.rung)
        if 1 / STALE <= now / max(chosen.ms_median, 1e-6) <= STALE:
            return kept, chosen
    priced = price(context, scene, rungs, report=lambda rounds: progress(rounds, "timing what fits the budget"))
    write_table(path, priced)
    return priced, best_within(priced, budget)


def key_of(context: Context, scene: BudgetScene, files: Sequence[str], rungs: Sequence[Rung]) -> str:
    """The key of this table, as a file name."""
    said = {
        "format": FORMAT,
        "machine": [platform.node(), platform.machine(), os.cpu_count(), context.renderer, context.kind],
        "avatars": [digest(file) for file in files],
        "rungs": [asdict(rung) for rung in rungs],
        "size": scene.size,
        "effects": repr(replace(scene.effects, view="auto")),
        "background": repr(scene.background),
        "reads_back": scene.reads_back,
    }
    return hashlib.sha256(json.dumps(said, sort_keys=True).encode()).hexdigest()[:32]


def digest(file: str) -> str:
    """Of a file's content; a built-in body is its name."""
    path = Path(file)
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else file


def read_table(path: Path, rungs: Sequence[Rung]) -> list[PricedRung] | None:
    """A table that was kept and is not too old, of those rungs that were worth timing; None where there is none, or it
    cannot be read."""
    try:
        content = json.loads(path.read_text("utf-8"))
        if not 0 <= time.time() - content["measured"] <= OLDEST:
            return None
        named = {rung.name: rung for rung in rungs}
        priced = [
            PricedRung(named[row["name"]], *(float(row[key]) for key in ("ms_median", "ms_p95", "error")))
            for row in content["rungs"]
        ]
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return priced if priced and all(0 < one.ms_median <= one.ms_p95 for one in priced) else None


def write_table(path: Path, priced: Sequence[PricedRung]) -> None:
    """Keep a table; where nothing can be kept, it is measured again next time."""
    rows = [{"name": one.rung.name} | {k: v for k, v in asdict(one).items() if k != "rung"} for one in priced]
    with contextlib.suppress(OSError, AssetError):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_json(path, {"measured": time.time(), "rungs": rows})
