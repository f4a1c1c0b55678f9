"""The ways a scene can be drawn, priced, and which of them a budget buys.

The rungs are those of ladder.py but for fewer pixels: the size is the scene's, and so are effects. `selfscan
bench` has better scores.
"""

import argparse
import math
from collections.abc import Sequence
from dataclasses import dataclass

from avatar.baked_avatar import Avatar
from player.budget.ladder import cheaper_rungs, holds, views_of
from player.budget.rung import Rung, rung_of

# frames of a second that a budget in frames a second means
SHORTEST, LONGEST = 0.01, 10_000.0  # ms
# the share of a budget that stays free, and by which rungs lie apart: what is nearer is no choice
HEADROOM = 0.05


@dataclass(frozen=True)
class PricedRung:
    """What a rung costs here."""

    rung: Rung
    ms_median: float
    ms_p95: float
    # root mean square of its difference from the best rung's pictures, of 255
    error: float


def scene_rungs(avatars: Sequence[Avatar], *, view: str = "auto", level: int | None = None) -> list[Rung]:
    """View modes that all avatars hold on every level that holds what they need, dearest first; then the dearest and
    the cheapest mode of the finest level, and the cheapest of every other, with smaller textures and fewer joints. Only
    those of a view or level that was asked for. Named after the first avatar."""
    first = avatars[0]
    views = [one for one in views_of(first) if all(one in views_of(avatar) for avatar in avatars)]
    views = views if view == "auto" else [view]
    levels = list(range(max(len(avatar.levels) for avatar in avatars))) if level is None else [level]
    rungs = [
        rung_of(first, one, number)
        for one in views
        for number in levels
        if all(holds(avatar, one, number) for avatar in avatars)
    ]
    drawn = [(rung.view, rung.level) for rung in rungs]
    for one, number in dict.fromkeys([*drawn[:1], *((views[-1], number) for number in levels)]):
        if (one, number) in drawn:
            rungs += cheaper_rungs(first, one, number)
    return rungs


def frontier(priced: Sequence[PricedRung]) -> list[PricedRung]:
    """Those that are more exact than every cheaper one by p95, cheapest first; of rungs that are no more than HEADROOM
    apart the most exact one."""
    kept: list[PricedRung] = []
    for one in sorted(priced, key=lambda one: (one.ms_p95, one.error)):
        if not kept or one.error < kept[-1].error:
            if kept and one.ms_p95 <= (1 + HEADROOM) * kept[-1].ms_p95:
                kept.pop()
            kept.append(one)
    return kept


def within(priced: Sequence[PricedRung], budget: float, load: float = 1.0) -> PricedRung | None:
    """The most exact rung whose p95, `load` times as long as measured, holds the budget, ms; None: there is none."""
    fitting = [one for one in frontier(priced) if one.ms_p95 * load <= budget]
    return fitting[-1] if fitting else None


def best_within(priced: Sequence[PricedRung], budget: float) -> PricedRung:
    """What a budget buys, ms, with HEADROOM left free; where nothing holds it, the cheapest."""
    return within(priced, (1 - HEADROOM) * budget) or frontier(priced)[0]


def at_quality(priced: Sequence[PricedRung], quality: float) -> PricedRung:
    """A place on the frontier: 0 its cheapest rung, 1 its most exact, between them by the logarithm of the time."""
    front = frontier(priced)
    least, most = (math.log(max(one.ms_median, SHORTEST)) for one in (front[0], front[-1]))
    allowed = least + quality * (most - least) + 1e-9
    return [one for one in front if math.log(max(one.ms_median, SHORTEST)) <= allowed or one is front[0]][-1]


def parse_budget(text: str) -> float:
    """8ms or 120fps, as milliseconds."""
    word = text.strip().lower()
    number, fps = word.removesuffix("ms").removesuffix("fps"), word.endswith("fps")
    try:
        value = float(number)
        budget = 1000 / value if fps else value
    except (ValueError, ZeroDivisionError):
        budget = math.nan
    if not SHORTEST <= budget <= LONGEST:
        raise argparse.ArgumentTypeError(f"expected milliseconds or frames a second, as 8ms or 120fps, found {text!r}")
    return budget


def choice_words(chosen: PricedRung, priced: Sequence[PricedRung], budget: float | None) -> str:
    """What was chosen, what it costs and loses, and what the next better one would cost."""
    front = frontier(priced)
    best = front[-1]
    words = f"{chosen.rung.name}: {chosen.ms_median:.1f} ms a frame here, p95 {chosen.ms_p95:.1f}"
    if budget is not None:
        words = f"budget {budget:.3g} ms: {words}"
        if chosen.ms_p95 > budget:
            words += "; nothing is faster"
    if chosen is best:
        return f"{words}; the best there is"
    words += f"; {chosen.error:.1f} of 255 from {best.rung.name}"
    costlier = front[front.index(chosen) + 1] if chosen in front[:-1] else best
    return f"{words}; {costlier.rung.name} would cost {costlier.ms_p95 - chosen.ms_p95:.1f} ms more"
