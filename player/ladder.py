"""Rungs of accuracy against time: the ways one avatar can be drawn, and what each costs on this machine.

Only time and memory are measured here. How exact a rung is stands in the avatar file, where the bake put it, or
is measured by `selfscan bench`.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from avatar.baked_avatar import Avatar
from avatar.camera import Camera
from avatar.texture import mipmaps
from player.context import Context
from player.passes.view import VIEWS
from player.renderer import Pose, Renderer

SHARES = {0.75: "3/4 resolution", 0.5: "half resolution"}
SMALLEST_TEXTURE = 64  # texels a side
VIEW_NAMES = {"network": "network per pixel", "linear": "linear", "vertex": "per vertex", "off": "paper mode"}


@dataclass(frozen=True)
class Rung:
    """One way to draw: view dependence, level of detail (0 the finest), pixels as a share of full resolution, and
    how often the sides of the textures are halved."""

    name: str
    view: str
    level: int = 0
    share: float = 1.0
    halvings: int = 0

    def size(self, full: tuple[int, int]) -> tuple[int, int]:
        """Pixels it draws, at least one."""
        return max(1, round(full[0] * self.share)), max(1, round(full[1] * self.share))

    def renderer(self, context: Context, avatar: Avatar, full: tuple[int, int]) -> Renderer:
        """A renderer that draws the avatar so, on its share of `full` pixels."""
        avatar = with_halved_textures(avatar, self.halvings)
        return Renderer(context, [avatar], self.size(full), view=self.view, level=self.level)


class Timing(NamedTuple):
    ms: Float[np.ndarray, "rounds"]  # one frame each, milliseconds
    bytes: int  # GL memory of the rung's plan, target included
    start_ms: float  # until the first frame is drawn: programs, textures, meshes


def views_of(avatar: Avatar) -> list[str]:
    """View modes the file holds, dearest first: network, linear, vertex, off."""
    has = {"network": avatar.network is not None, "linear": avatar.linear is not None, "off": True}
    has["vertex"] = has["network"] or has["linear"]
    return [view for view in reversed(VIEWS) if has[view]]


def rungs_of(avatar: Avatar) -> list[Rung]:
    """View modes on every level; the dearest mode and paper mode with smaller textures and fewer pixels; last the
    coarsest level at half resolution."""
    views = views_of(avatar)
    named = partial(rung_name, avatar)
    rungs = [Rung(named(view), view) for view in views]
    ends = list(dict.fromkeys((views[0], "off")))
    coarser = range(1, len(avatar.levels))
    rungs += [
        Rung(named(view, level), view, level)
        for view in views
        for level in coarser
        if view == "off" or avatar.levels[level].features is not None
    ]
    largest = min(avatar.levels[0].base_color.shape[:2])
    for view in ends:
        for halvings in (1, 2, 3):
            if largest >> halvings >= SMALLEST_TEXTURE:
                name = f"{named(view)}, texture {largest >> halvings}"
                rungs.append(Rung(name, view, halvings=halvings))
        rungs += [Rung(f"{named(view)}, {words}", view, share=share) for share, words in SHARES.items()]
    if coarser:
        last = coarser[-1]
        rungs.append(Rung(f"{named('off', last)}, {SHARES[0.5]}", "off", last, 0.5))
    return rungs


def rung_name(avatar: Avatar, view: str, level: int = 0) -> str:
    return f"{VIEW_NAMES[view]}, {round(len(avatar.levels[level].faces) / 1000)}k"


def with_halved_textures(avatar: Avatar, times: int) -> Avatar:
    """The avatar with the sides of all textures halved `times` times, each texel the mean of four."""
    if not times:
        return avatar
    levels = [
        replace(
            level,
            base_color=mipmaps(level.base_color, times + 1)[-1],
            features=None if level.features is None else mipmaps(level.features, times + 1)[-1],
        )
        for level in avatar.levels
    ]
    return replace(avatar, levels=tuple(levels))


def time_rungs(
    context: Context,
    avatar: Avatar,
    rungs: Sequence[Rung],
    frames: Sequence[tuple[Pose, Camera]],
    full: tuple[int, int],
    *,
    rounds: int = 20,
) -> list[Timing]:
    """Milliseconds of posing and drawing one frame on every rung, without reading the picture back.

    Rounds alternate: every rung draws one frame, then every rung the next, so that a slow stretch of a shared
    machine falls on all alike. Each rung draws a frame untimed before each timed one: the caches hold its own
    meshes and textures, as they would if nothing else were drawn.

    Raises:
        ValueError: no frames, or no rounds.
    """
    if not frames or rounds < 1:
        raise ValueError(f"{len(frames)} frames and {rounds} rounds give nothing to time")
    renderers, starts = [], []
    try:
        for rung in rungs:
            start = time.perf_counter()
            renderer = rung.renderer(context, avatar, full)
            renderers.append(renderer)
            assert renderer.target is not None
            renderer.draw_into(renderer.target, [frames[0][0]], frames[0][1])
            context.gl.finish()
            starts.append(1e3 * (time.perf_counter() - start))
        ms = np.zeros((len(rungs), rounds))
        for number in range(rounds):
            pose, camera = frames[number % len(frames)]
            for row, renderer in enumerate(renderers):
                assert renderer.target is not None
                for _ in range(2):
                    context.gl.finish()
                    start = time.perf_counter()
                    renderer.draw_into(renderer.target, [pose], camera)
                    context.gl.finish()
                    ms[row, number] = 1e3 * (time.perf_counter() - start)
        sizes = [renderer.plan.bytes for renderer in renderers]
        return [Timing(*row) for row in zip(ms, sizes, starts, strict=True)]
    finally:
        for renderer in renderers:
            renderer.release()
