"""What each effect of a scene costs now: frames with all of them, in turns with frames without one."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from avatar.camera import Camera
from command.settings import settings_of
from player.budget.ladder import released
from player.budget.measure import BudgetScene
from player.budget.rung import Rung
from player.draw.drawing import Pose
from player.gl.context import Context
from player.scene.effects import PLAIN, Effects
from player.scene.renderer import Renderer

ROUNDS = 8
# each setting of a scene that calls for nothing
NOTHING = replace(PLAIN, view="off")
STEP = 1 / 60  # seconds between two frames of loose parts


def called_for(effects: Effects) -> list[str]:
    """The settings that are not those of a scene that calls for nothing."""
    return [one.name for one in settings_of(Effects) if one.value_in(effects) != one.value_in(NOTHING)]


def effect_prices(
    context: Context, scene: BudgetScene, rung: Rung, *, rounds: int = ROUNDS, offered: Sequence[str] = ()
) -> dict[str, float]:
    """Milliseconds that each effect the scene calls for adds to a frame drawn as `rung` says, its view mode too: the
    median over the rounds of the difference to a frame without it. Effects of films alone add nothing here.

    offered: effects that the scene does not call for yet, by name; theirs is the difference to a frame with it.
    """
    names = called_for(scene.effects)
    nothing = {setting.name: setting.value_in(NOTHING) for setting in settings_of(Effects)}
    ways = [scene.effects, *(replace(scene.effects, **{name: nothing[name]}) for name in names)]
    tables = {setting.name: setting.table for setting in settings_of(Effects) if setting.table is not None}
    ways += [replace(scene.effects, **{name: tables[name]()}) for name in offered]
    drawn = (
        replace(rung, view=effects.view).renderer(
            context, scene.avatars, scene.size, effects=effects, background=scene.background
        )
        for effects in ways
    )
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


def _frame(renderer: Renderer, poses: Sequence[Pose], camera: Camera, seconds: float) -> None:
    """A frame, its loose parts moved on."""
    assert renderer.target is not None
    renderer.move(poses, seconds)
    renderer.draw_into(renderer.target, poses, camera)
