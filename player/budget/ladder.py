"""Rungs of accuracy against time: the ways one avatar can be drawn (player/budget/rung.py), and what each costs here.

Only time and memory are measured here. How exact a rung is stands in the avatar file, where the bake put it, or
is measured by `selfscan bench`.
"""

import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from avatar.baked_avatar import Avatar
from avatar.camera import Camera
from player.budget.rung import MOST_JOINTS, SHARE_NAMES, Rung, rung_of
from player.effects.avatar import VIEWS
from player.gl.context import Context
from player.scene.renderer import Pose, Renderer

Frame = tuple[Sequence[Pose], Camera]
SMALLEST_TEXTURE = 64  # texels a side
# more pixels than shown, and fewer
FINER, COARSER = ([share for share in SHARE_NAMES if (share > 1) is more] for more in (True, False))
HALVINGS = (1, 2, 3)
FEWER_JOINTS = (2, 1)


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
    return [rung for rung in rungs if rung.joints == MOST_JOINTS or rung.joints < joints_of(avatar, rung.level)]


def cheaper_rungs(avatar: Avatar, view: str, level: int = 0) -> list[Rung]:
    """A view mode of a level with smaller textures, then with fewer joints."""
    smaller = [rung_of(avatar, view, level, halvings=times) for times in halvings_of(avatar, level)]
    return smaller + [
        rung_of(avatar, view, level, joints=joints) for joints in FEWER_JOINTS if joints < joints_of(avatar, level)
    ]


def holds(avatar: Avatar, view: str, level: int) -> bool:
    """Whether a level holds what a view mode draws."""
    return view == "off" or avatar.level(level).features is not None


def halvings_of(avatar: Avatar, level: int) -> list[int]:
    """How often the textures of a level can be halved."""
    side = min(avatar.level(level).base_color.shape[:2])
    return [times for times in HALVINGS if side >> times >= SMALLEST_TEXTURE]


def joints_of(avatar: Avatar, level: int) -> int:
    """How many joints a vertex of a level follows at most."""
    return avatar.level(level).influences


def time_rungs(
    context: Context, avatar: Avatar, rungs: Sequence[Rung], frames: Sequence[tuple[Pose, Camera]],
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
    context: Context, renderer: Renderer, poses: Sequence[Pose], camera: Camera, reads_back: bool = False
) -> float:
    """Milliseconds of one frame; a film needs its picture back, a window does not."""
    if reads_back:
        return context.milliseconds(lambda: renderer.draw(poses, camera))
    target = renderer.target
    assert target is not None
    return context.milliseconds(lambda: renderer.draw_into(target, poses, camera))
