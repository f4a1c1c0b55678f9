"""Which view mode shows the person best: every mode drawn beside true pictures that training never saw.

One fixed light ties what is seen to where it is seen from: a residual trained on one turning person can be wrong
under a camera that moves. So where the truth is known it decides, not the distance to the field.
"""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Bool
from scipy.ndimage import binary_erosion

from avatar.baked_avatar import Avatar
from avatar.psnr import PooledError, error_between, pooled
from avatar.skeleton import PARTS
from bake.promises import Facts
from capture.held_out import SETS, HeldOutView, read_capture_facts, read_held_out
from command.errors import AssetError
from player.gl.context import Context, open_context
from player.scene.renderer import Renderer

Mode = Literal["off", "linear", "network"]
MODES: tuple[Mode, ...] = ("off", "linear", "network")  # simplest first
REGIONS = {"total": "body", "head": "head", "left_hand": "hand_left", "right_hand": "hand_right"}  # view of each
# less than the third digit after the point: the simpler mode stands
TIE_DB = 0.005


# what a capture says of itself by which it is known again
IDENTITY = ("subject", "light", "sheen", "seed")


class TrueViews(NamedTuple):
    """Held-out pictures of a capture and what it says of itself."""

    facts: Facts
    sets: dict[str, list[HeldOutView]]  # novel_pose, novel_view


def read_true_views(capture: Path, poses: int | None = None) -> TrueViews:
    """The held-out pictures of a capture, of `poses` poses spread evenly over each set.

    Raises:
        AssetError: the capture has no ground truth.
    """
    facts = read_capture_facts(capture)
    if not (Path(capture) / "truth" / SETS[0]).is_dir():
        raise AssetError(
            f"{capture}: expected truth/ with held-out pictures (selfscan synth), found none: bake without --capture"
        )
    sets = {name: some_poses(read_held_out(capture, name), poses) for name in SETS}
    known = {key: facts[key] for key in IDENTITY if key in facts}
    return TrueViews(known, sets)


def some_poses(views: list[HeldOutView], count: int | None) -> list[HeldOutView]:
    """The views of `count` poses spread evenly over the set; all of them for None."""
    numbers = pose_numbers(views)
    if count is None or count >= len(numbers):
        return views
    kept = {numbers[i] for i in np.linspace(0, len(numbers) - 1, count).round().astype(int)}
    return [view for view in views if view.pose_index in kept]


def modes_of(avatar: Avatar) -> list[str]:
    """View modes that the file holds, simplest first; `vertex` is the richest of them, asked at vertices."""
    there = {"off": True, "linear": avatar.linear is not None, "network": avatar.network is not None}
    held = [mode for mode in MODES if there[mode]]
    return held if len(held) == 1 else [held[0], "vertex", *held[1:]]


def scored_mask(mask: Bool[np.ndarray, "height width"]) -> Bool[np.ndarray, "height width"]:
    """The mask eroded by one pixel: silhouettes differ by a fraction of a pixel in any two rasterisers."""
    return binary_erosion(mask, np.ones((3, 3), bool), border_value=0)


def mode_errors(
    context: Context, avatar: Avatar, views: Sequence[HeldOutView], modes: Sequence[str]
) -> dict[str, dict[str, PooledError]]:
    """Color errors by mode and region against true pictures, the same pixels for every mode.

    Pixels: those of the region's true part (the whole person on the body view), one pixel off its outline, that
    the avatar covers: silhouettes are geometry, which no view mode changes.
    """
    found = {mode: dict.fromkeys(REGIONS, PooledError()) for mode in modes}
    by_size: dict[tuple[int, int], list[HeldOutView]] = {}
    for view in views:
        by_size.setdefault(view.camera.size, []).append(view)
    for size, group in by_size.items():
        renderers = {mode: Renderer(context, [avatar], size, view=mode) for mode in modes}
        try:
            for view in group:
                region = next(name for name, shown in REGIONS.items() if shown == view.view)
                mask = view.mask() if region == "total" else view.parts() == PARTS.index(view.view) + 1
                inside, truth = scored_mask(mask), view.image()
                for mode, renderer in renderers.items():
                    image = renderer.draw([(view.axis_angle, view.root)], view.camera)
                    scored = inside & (image[..., 3] == 255)
                    error = error_between(image[..., :3][scored] / np.float64(255), truth[scored])
                    found[mode][region] = found[mode][region].plus(error)
        finally:
            for renderer in renderers.values():
                renderer.release()
    return found


def decibels_by_region(errors: dict[str, PooledError]) -> dict[str, float | None]:
    """Decibels by region, hands together, and of all pictures."""
    hands = errors["left_hand"].plus(errors["right_hand"])
    by_region = {"total": errors["total"], "head": errors["head"], "hands": hands, "all": pooled(errors.values())}
    return {name: one.rounded(3) for name, one in by_region.items()}


def scores_by_mode(
    context: Context, avatar: Avatar, sets: dict[str, list[HeldOutView]], modes: Sequence[str] | None = None
) -> Facts:
    """{set: {mode: {total, head, hands, all}}} in decibels, and the pooled {mode: db} over both sets as `all`."""
    modes = modes_of(avatar) if modes is None else modes
    errors = {name: mode_errors(context, avatar, views, modes) for name, views in sets.items()}
    out: Facts = {name: {m: decibels_by_region(errors[name][m]) for m in modes} for name in sets}
    together = {m: pooled(e for one in errors.values() for e in one[m].values()) for m in modes}
    return out | {"all": {m: one.rounded(3) for m, one in together.items()}}


def better_mode(scores: dict[str, float | None]) -> tuple[Mode, str]:
    """The mode nearest to the truth (a simpler one within TIE_DB), and the reason as a sentence."""
    known: dict[Mode, float] = {}
    for mode in MODES:
        db = scores.get(mode)
        if db is not None:
            known[mode] = db
    if not known:
        return "off", "the true pictures show no person, so nothing could be measured"
    best = max(known.values())
    nearest: list[Mode] = [mode for mode in known if known[mode] >= best - TIE_DB]
    scores_text = ", ".join(f"{mode} {db:.3f} dB" for mode, db in known.items())
    return nearest[0], f"nearest to the true pictures: {scores_text}"


def measured_default(avatar: Avatar, true: TrueViews) -> tuple[Mode, Facts]:
    """The view mode that the truth prefers among those in the file, with numbers and reason for its provenance.

    Half of the poses choose; what the file says of the modes, `psnr_db`, is measured on the other half.
    """
    modes = [mode for mode in modes_of(avatar) if mode != "vertex"]
    choosing, reporting = halves(true.sets)
    context = open_context()
    try:
        chosen = scores_by_mode(context, avatar, choosing, modes)["all"]
        scores = scores_by_mode(context, avatar, reporting, modes)
    finally:
        context.release()
    mode, reason = better_mode(chosen)
    if len(modes) == 1:
        reason = f"the only mode of this file: {reason}"
    return mode, {
        "by": "truth",
        "reason": reason,
        "psnr_db": scores,
        "pictures": {name: len(views) for name, views in reporting.items()},
        "chosen_on": {"psnr_db": chosen, "poses": {name: pose_numbers(views) for name, views in choosing.items()}},
        **true.facts,
    }


def halves(sets: dict[str, list[HeldOutView]]) -> tuple[dict[str, list[HeldOutView]], dict[str, list[HeldOutView]]]:
    """Every second pose of each set, the first among them, and the others: no picture is in both."""
    first = {name: set(pose_numbers(views)[::2]) for name, views in sets.items()}
    one, other = (
        {name: [v for v in views if (v.pose_index in first[name]) == chosen] for name, views in sets.items()}
        for chosen in (True, False)
    )
    return one, other


def pose_numbers(views: Iterable[HeldOutView]) -> list[int]:
    """The poses of some views, ascending."""
    return sorted({int(view.pose_index) for view in views})
