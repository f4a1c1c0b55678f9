"""What the rungs of a scene cost on this machine, and how their pictures differ from the best one's."""

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from avatar.baked_avatar import Avatar
from avatar.camera import Camera
from player.budget.rungs import PricedRung, SceneRung
from player.context import Context
from player.drawing import Pose
from player.passes.background import Background
from player.renderer import Renderer
from player.scenes.effects import Effects

ROUNDS = 24
# of the rung that was chosen before, to see whether the table still holds
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
    rungs: Sequence[SceneRung],
    *,
    rounds: int = ROUNDS,
    report: Callable[[Iterable[int]], Iterable[int]] = iter,
) -> list[PricedRung]:
    """Every rung timed in alternating rounds, as player/ladder.py does, and compared with the first."""
    renderers: list[Renderer] = []
    try:
        for rung in rungs:
            renderers.append(_renderer(context, scene, rung))
        errors = _errors(renderers, scene)
        ms = np.zeros((rounds, len(rungs)))
        for number in report(range(rounds)):
            poses, camera = scene.frames[number % len(scene.frames)]
            for k, renderer in enumerate(renderers):
                # the first warms the caches, as if nothing else were drawn
                _seconds(context, renderer, poses, camera, scene.reads_back)
                ms[number, k] = 1e3 * _seconds(context, renderer, poses, camera, scene.reads_back)
    finally:
        for renderer in renderers:
            renderer.release()
    return [
        PricedRung(rung, float(np.median(times)), float(np.percentile(times, 95)), error)
        for rung, times, error in zip(rungs, ms.T, errors, strict=True)
    ]


def check(context: Context, scene: BudgetScene, rung: SceneRung) -> float:
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


def _renderer(context: Context, scene: BudgetScene, rung: SceneRung) -> Renderer:
    effects = replace(scene.effects, view=rung.view)
    return Renderer(
        context, scene.avatars, scene.size, effects=effects, background=scene.background, level=rung.level
    )  # fmt: skip


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
