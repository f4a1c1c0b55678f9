"""Rungs of accuracy against time: the ways avatars can be drawn (player/budget/rung.py), what each costs here, and
which of them a budget buys.

Only time and memory are measured here. How exact a rung is stands in the avatar file, where the bake put it, or is
measured by `selfscan bench`. The rungs of a scene are those of its avatars but for fewer pixels: the size is the
scene's, and so are effects.
"""

import argparse
import math
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from avatar.baked_avatar import Avatar
from avatar.camera import Camera
from player.budget.rung import MOST_JOINTS, SHARE_NAMES, Rung, rung_of
from player.draw.drawing import GivenPose
from player.effects.avatar import views_of
from player.gl.context import Context
from player.scene.renderer import Renderer

Frame = tuple[Sequence[GivenPose], Camera]
SMALLEST_TEXTURE = 64  # texels a side
# more pixels than shown, and fewer
FINER, COARSER = ([share for share in SHARE_NAMES if (share > 1) is more] for more in (True, False))
HALVINGS = (1, 2, 3)
FEWER_JOINTS = (2, 1)


# milliseconds of a frame that a budget may mean
SHORTEST, LONGEST = 0.01, 10_000.0
# the share of a budget that stays free, and by which rungs lie apart: what is nearer is no choice
HEADROOM = 0.05


class Timing(NamedTuple):
    ms: Float[np.ndarray, "rounds"]  # one frame each, milliseconds
    bytes: int  # GL memory of the rung's plan, target included
    start_ms: float  # until the first frame is drawn: programs, textures, meshes


def rungs_of(avatar: Avatar) -> list[Rung]:
    """A walk down from what the player draws unasked, not all products: view modes on every level; from the finest
    level of the dearest mode and of paper mode smaller textures, fewer joints, fewer pixels, one of them at a time;
    then from each coarser level of paper mode fewer joints and pixels; all of it at once; last the way up, several
    pixels for each that is shown."""
    views, coarser = views_of(avatar), range(1, len(avatar.levels))
    rungs = [rung_of(avatar, view) for view in views]
    rungs += [rung_of(avatar, view, level) for view in views for level in coarser if holds(avatar, view, level)]
    for view in dict.fromkeys((views[0], "off")):
        rungs += cheaper_rungs(avatar, view)
        rungs += [rung_of(avatar, view, share=share) for share in COARSER]
    fewest = min(FEWER_JOINTS)
    for level in coarser:
        rungs.append(rung_of(avatar, "off", level, joints=fewest))
        rungs += [rung_of(avatar, "off", level, share=share) for share in COARSER]
        rungs += [rung_of(avatar, "off", level, share=share, joints=fewest) for share in COARSER]
    last = len(avatar.levels) - 1
    smallest = max(halvings_of(avatar, last), default=0)
    if smallest:
        rungs.append(rung_of(avatar, "off", last, min(COARSER), smallest, fewest))
    rungs += [rung_of(avatar, view, share=share) for view in dict.fromkeys((views[0], "off")) for share in FINER]
    return [rung for rung in rungs if rung.joints == MOST_JOINTS or rung.joints < avatar.level(rung.level).influences]


def cheaper_rungs(avatar: Avatar, view: str, level: int = 0) -> list[Rung]:
    """A view mode of a level with smaller textures, then with fewer joints."""
    smaller = [rung_of(avatar, view, level, halvings=times) for times in halvings_of(avatar, level)]
    fewer = [joints for joints in FEWER_JOINTS if joints < avatar.level(level).influences]
    return smaller + [rung_of(avatar, view, level, joints=joints) for joints in fewer]


def holds(avatar: Avatar, view: str, level: int) -> bool:
    """Whether a level holds what a view mode draws."""
    return view == "off" or avatar.level(level).features is not None


def halvings_of(avatar: Avatar, level: int) -> list[int]:
    """How often the textures of a level can be halved."""
    side = min(avatar.level(level).base_color.shape[:2])
    return [times for times in HALVINGS if side >> times >= SMALLEST_TEXTURE]


def time_rungs(
    context: Context, avatar: Avatar, rungs: Sequence[Rung], frames: Sequence[tuple[GivenPose, Camera]],
    full: tuple[int, int], *, rounds: int = 20,
) -> list[Timing]:  # fmt: skip
    """Milliseconds of posing and drawing one frame on every rung, without reading the picture back (`frame_times`).

    Raises:
        ValueError: no frames, or no rounds.
    """
    if not frames or rounds < 1:
        raise ValueError(f"{len(frames)} frames and {rounds} rounds give nothing to time")
    seen, starts = [([pose], camera) for pose, camera in frames], []

    def begun() -> Iterator[Renderer]:
        for rung in rungs:
            start = time.perf_counter()
            yield (renderer := rung.renderer(context, [avatar], full))
            frame_ms(context, renderer, *seen[0])
            starts.append(1e3 * (time.perf_counter() - start))

    with released(begun()) as renderers:
        ms = frame_times(context, renderers, seen, range(rounds))
        sizes = [renderer.plan.bytes for renderer in renderers]
    return [Timing(*row) for row in zip(ms.T, sizes, starts, strict=True)]


@contextmanager
def released(renderers: Iterable[Renderer]) -> Iterator[list[Renderer]]:
    """Renderers, each freed in the end, if the next cannot be made too."""
    with ExitStack() as stack:
        made = []
        for renderer in renderers:
            stack.callback(renderer.release)
            made.append(renderer)
        yield made


def frame_times(
    context: Context, renderers: Sequence[Renderer], frames: Sequence[Frame], rounds: Iterable[int], *,
    reads_back: bool = False,
) -> Float[np.ndarray, "rounds renderers"]:  # fmt: skip
    """Milliseconds of a frame of each.

    Rounds alternate: every renderer draws one frame, then every one the next, so that a slow stretch of a shared
    machine falls on all alike. Each draws a frame untimed before each timed one: the caches hold its own meshes and
    textures, as they would if nothing else were drawn.
    """
    out = []
    for number in rounds:
        frame = frames[number % len(frames)]
        out.append([[frame_ms(context, one, *frame, reads_back) for _ in range(2)][1] for one in renderers])
    return np.array(out)


def frame_ms(
    context: Context, renderer: Renderer, poses: Sequence[GivenPose], camera: Camera, reads_back: bool = False
) -> float:
    """Milliseconds of one frame; a film needs its picture back, a window does not."""
    if reads_back:
        return context.milliseconds(lambda: renderer.draw(poses, camera))
    target = renderer.target
    assert target is not None
    return context.milliseconds(lambda: renderer.draw_into(target, poses, camera))


# -- priced: what a budget buys


@dataclass(frozen=True)
class PricedRung:
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
    ways = [(one, number) for one in views for number in levels]
    drawn = [way for way in ways if all(holds(avatar, *way) for avatar in avatars)]
    rungs = [rung_of(first, *way) for way in drawn]
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


def choice_words(chosen: PricedRung, priced: Sequence[PricedRung], budget: float) -> str:
    """What was chosen, what it costs and loses, and what the next better one would cost."""
    front = frontier(priced)
    best = front[-1]
    cost = f"{chosen.ms_median:.1f} ms a frame here, p95 {chosen.ms_p95:.1f}"
    words = f"budget {budget:.3g} ms: {chosen.rung.name}: {cost}"
    if chosen.ms_p95 > budget:
        words += "; nothing is faster"
    if chosen is best:
        return f"{words}; the best there is"
    words += f"; {chosen.error:.1f} of 255 from {best.rung.name}"
    costlier = front[front.index(chosen) + 1] if chosen in front[:-1] else best
    return f"{words}; {costlier.rung.name} would cost {costlier.ms_p95 - chosen.ms_p95:.1f} ms more"
