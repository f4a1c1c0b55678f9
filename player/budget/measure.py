"""What the rungs of a scene cost on this machine, and how their pictures differ from the best one's."""

import time
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from avatar.baked_avatar import Avatar
from avatar.camera import Camera
from player.budget.rung import Rung
from player.budget.rungs import PricedRung
from player.draw.drawing import Pose
from player.effects.background import Background
from player.gl.context import Context
from player.scene.effects import Effects
from player.scene.renderer import Renderer

ROUNDS = 24
# in which rungs fall out that another surely beats: no less exact, and so much faster
SIEVE_ROUNDS, SURELY = 3, 1.5
# rounds of the rung that was chosen before, which show whether the table still holds
CHECK_ROUNDS = 6


class BudgetScene(NamedTuple):
    """What is drawn, and how, but for the rung."""

    avatars: Sequence[Avatar]
    frames: Sequence[tuple[Sequence[Pose], Camera]]
    size: tuple[int, int]
    effects: Effects
    background: Background
    # a film needs the picture back, a window does not
    reads_back: bool


def price(
    context: Context,
    scene: BudgetScene,
    rungs: Sequence[Rung],
    *,
    rounds: int = ROUNDS,
    report: Callable[[Iterable[int]], Iterable[int]] = iter,
) -> list[PricedRung]:
    """The rungs that are worth timing, timed in alternating rounds as ladder.py does, and compared with the
    first. What another rung surely beats after SIEVE_ROUNDS is left out."""
    renderers: list[Renderer] = []
    try:
        for rung in rungs:
            renderers.append(_renderer(context, scene, rung))
        errors = _errors(renderers, scene)
        kept = worth_timing(_rounds(context, scene, renderers, range(min(SIEVE_ROUNDS, rounds))), errors)
        ms = _rounds(context, scene, [renderers[k] for k in kept], report(range(rounds)))
    finally:
        for renderer in renderers:
            renderer.release()
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


def frame_ms(
    context: Context, scene: BudgetScene, rungs: Sequence[Rung], rounds: int = ROUNDS
) -> Float[np.ndarray, "rounds rungs"]:
    """Milliseconds of every one of the rungs in alternating rounds."""
    renderers: list[Renderer] = []
    try:
        for rung in rungs:
            renderers.append(_renderer(context, scene, rung))
        return _rounds(context, scene, renderers, range(rounds))
    finally:
        for renderer in renderers:
            renderer.release()


def worth_timing(ms: Float[np.ndarray, "rounds rungs"], errors: Sequence[float]) -> list[int]:
    """The numbers of the rungs that none is SURELY times faster than without being less exact."""
    fastest = ms.min(0)
    return [
        k
        for k, error in enumerate(errors)
        if not any(
            other <= error and SURELY * took < fastest[k] for other, took in zip(errors, fastest.tolist(), strict=True)
        )
    ]


def _rounds(
    context: Context, scene: BudgetScene, renderers: Sequence[Renderer], rounds: Iterable[int]
) -> Float[np.ndarray, "rounds rungs"]:
    """Milliseconds of a frame of each, in turns."""
    out = []
    for number in rounds:
        poses, camera = scene.frames[number % len(scene.frames)]
        out.append([])
        for renderer in renderers:
            # the first warms the caches, as if nothing else were drawn
            _seconds(context, renderer, poses, camera, scene.reads_back)
            out[-1].append(1e3 * _seconds(context, renderer, poses, camera, scene.reads_back))
    return np.array(out)


def check(context: Context, scene: BudgetScene, rung: Rung) -> float:
    """Milliseconds of one rung now, the median of a few frames."""
    renderer = _renderer(context, scene, rung)
    try:
        times = []
        for number in range(CHECK_ROUNDS + 2):
            poses, camera = scene.frames[number % len(scene.frames)]
            times.append(_seconds(context, renderer, poses, camera, scene.reads_back))
        return 1e3 * float(np.median(times[2:]))
    finally:
        renderer.release()


def _renderer(context: Context, scene: BudgetScene, rung: Rung) -> Renderer:
    return rung.renderer(context, scene.avatars, scene.size, effects=scene.effects, background=scene.background)


def _seconds(context: Context, renderer: Renderer, poses: Sequence[Pose], camera: Camera, reads_back: bool) -> float:
    assert renderer.target is not None
    context.gl.finish()
    start = time.perf_counter()
    if reads_back:
        renderer.draw(poses, camera)
    else:
        renderer.draw_into(renderer.target, poses, camera)
        context.gl.finish()
    return time.perf_counter() - start


def _errors(renderers: Sequence[Renderer], scene: BudgetScene) -> list[float]:
    squares = np.zeros(len(renderers))
    for poses, camera in scene.frames:
        best = renderers[0].draw(poses, camera).astype(np.float32)
        for k, renderer in enumerate(renderers[1:], 1):
            squares[k] += float(np.square(renderer.draw(poses, camera) - best)[..., :3].mean())
    return np.sqrt(squares / len(scene.frames)).tolist()
