"""What the rungs of a scene cost on this machine, how their pictures differ from the best one's, and what each effect
costs."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from avatar.baked_avatar import Avatar
from avatar.camera import Camera
from command.settings import settings_of
from player.budget.ladder import Frame, PricedRung, frame_ms, frame_times, released
from player.budget.rung import Rung
from player.draw.drawing import GivenPose
from player.effects.background import Background
from player.gl.context import Context
from player.scene.effects import PLAIN, Effects
from player.scene.renderer import Renderer

ROUNDS = 24
# in which rungs fall out that another surely beats: no less exact, and so much faster
SIEVE_ROUNDS, SURELY = 3, 1.5
# rounds of the rung that was chosen before, which show whether the table still holds
CHECK_ROUNDS = 6
# rounds of effects; seconds between two frames of loose parts
EFFECT_ROUNDS, STEP = 8, 1 / 60
# each setting of a scene that calls for nothing
NOTHING = replace(PLAIN, view="off")


class BudgetScene(NamedTuple):
    avatars: Sequence[Avatar]
    frames: Sequence[Frame]
    size: tuple[int, int]
    effects: Effects
    background: Background
    # a film needs the picture back, a window does not
    reads_back: bool

    def renderer(self, context: Context, rung: Rung, effects: Effects | None = None) -> Renderer:
        """What draws it as a rung says, with its own effects or others."""
        drawn = self.effects if effects is None else effects
        return rung.renderer(context, self.avatars, self.size, effects=drawn, background=self.background)


def price(
    context: Context, scene: BudgetScene, rungs: Sequence[Rung], *, rounds: int = ROUNDS,
    report: Callable[[Iterable[int]], Iterable[int]] = iter,
) -> list[PricedRung]:  # fmt: skip
    """The rungs that are worth timing, timed in alternating rounds and compared with the first. What another rung
    surely beats after SIEVE_ROUNDS is left out."""
    with released(scene.renderer(context, rung) for rung in rungs) as renderers:
        errors, timed = _errors(renderers, scene), partial(frame_times, context, reads_back=scene.reads_back)
        kept = worth_timing(timed(renderers, scene.frames, range(min(SIEVE_ROUNDS, rounds))), errors)
        ms = timed([renderers[k] for k in kept], scene.frames, report(range(rounds)))
    return [
        PricedRung(rungs[k], float(np.median(times)), p95, errors[k])
        for k, times, p95 in zip(kept, ms.T, steady_p95(ms, len(scene.frames)), strict=True)
    ]


def steady_p95(ms: Float[np.ndarray, "rounds rungs"], frames: int) -> list[float]:
    """Of every rung the 95th percentile of its frames; `frames` took turns from round to round.

    A rung's own two dozen times say little of their slowest twentieth. What slows a frame down slows any rung, so the
    medians of a rung's frames are its own, and the spread round them is that of all rungs together.
    """
    shown = np.arange(len(ms)) % frames
    medians = np.stack([np.median(ms[shown == frame], axis=0) for frame in range(min(frames, len(ms)))])
    spread = (ms / medians[shown]).ravel()
    return [float(np.percentile(np.outer(own, spread), 95)) for own in medians.T]


def worth_timing(ms: Float[np.ndarray, "rounds rungs"], errors: Sequence[float]) -> list[int]:
    """The numbers of the rungs that none is SURELY times faster than without being less exact."""
    fastest = ms.min(0)
    exact = np.array(errors)
    beaten = (exact <= exact[:, None]) & (SURELY * fastest < fastest[:, None])
    return np.flatnonzero(~beaten.any(1)).tolist()


def check(context: Context, scene: BudgetScene, rung: Rung) -> float:
    """Milliseconds of one rung now, the median of a few frames."""
    with released([scene.renderer(context, rung)]) as (renderer,):
        frames = [scene.frames[number % len(scene.frames)] for number in range(CHECK_ROUNDS + 2)]
        return float(np.median([frame_ms(context, renderer, *frame, scene.reads_back) for frame in frames][2:]))


def _errors(renderers: Sequence[Renderer], scene: BudgetScene) -> list[float]:
    squares = np.zeros(len(renderers))
    for poses, camera in scene.frames:
        best = renderers[0].draw(poses, camera).astype(np.float32)
        for k, renderer in enumerate(renderers[1:], 1):
            squares[k] += float(np.square(renderer.draw(poses, camera) - best)[..., :3].mean())
    return np.sqrt(squares / len(scene.frames)).tolist()


# -- effects: frames with all of them, in turns with frames without one


def effect_prices(
    context: Context, scene: BudgetScene, rung: Rung, *, rounds: int = EFFECT_ROUNDS, offered: Sequence[str] = ()
) -> dict[str, float]:
    """Milliseconds that each effect the scene calls for adds to a frame drawn as `rung` says, its view mode too: the
    median over the rounds of the difference to a frame without it. Effects of films alone add nothing here.

    offered: effects that the scene does not call for yet, by name; their price is the difference to a frame with it.
    """
    nothing = {setting.name: setting.value_in(NOTHING) for setting in settings_of(Effects)}
    names = [one.name for one in settings_of(Effects) if one.value_in(scene.effects) != nothing[one.name]]
    ways = [scene.effects, *(replace(scene.effects, **{name: nothing[name]}) for name in names)]
    tables = {setting.name: setting.table for setting in settings_of(Effects) if setting.table is not None}
    ways += [replace(scene.effects, **{name: tables[name]()}) for name in offered]
    drawn = (scene.renderer(context, replace(rung, view=effects.view), effects) for effects in ways)
    with released(drawn) as renderers:
        ms = np.array([_round(context, renderers, scene, number) for number in range(rounds)])
    # one that shows nothing now is as fast as none, and half of the time faster
    signs = np.repeat([1.0, -1.0], [len(names), len(offered)])
    costs = np.maximum(np.median(ms[:, :1] - ms[:, 1:], axis=0) * signs, 0.0)
    return dict(zip([*names, *offered], costs.tolist(), strict=True))


def _round(context: Context, renderers: Sequence[Renderer], scene: BudgetScene, number: int) -> list[float]:
    """Milliseconds of one frame of each renderer, after another one that brings its own into the caches."""
    out = []
    for renderer in renderers:
        for k in (2 * number, 2 * number + 1):
            poses, camera = scene.frames[k % len(scene.frames)]
            took = context.milliseconds(lambda: _frame(renderer, poses, camera, k * STEP))
        out.append(took)
    return out


def _frame(renderer: Renderer, poses: Sequence[GivenPose], camera: Camera, seconds: float) -> None:
    """A frame, its loose parts moved on."""
    assert renderer.target is not None
    renderer.move(poses, seconds)
    renderer.draw_into(renderer.target, poses, camera)
