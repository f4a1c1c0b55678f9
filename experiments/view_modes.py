"""Every view mode of an avatar file beside true pictures that training never saw, and which of them shows the person
best: a residual trained on one turning person can be wrong under a camera that moves.

python -m experiments.view_modes AVATAR CAPTURE --json quality.json

adds them as "view_modes" to what `selfscan eval --json` wrote of an avatar of given poses; experiments/quality_page.py
shows them.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from avatar.baked_avatar import Avatar
from avatar.gltf.avatar_file import read_avatar
from avatar.psnr import PooledError, error_between, pooled
from avatar.skeleton import PARTS
from bake.measure import scored_mask
from bake.promises import baked_facts
from bench.report.writer import Json
from bench.score.picture_scores import REGIONS, VIEW_REGION
from capture.held_out import SETS, HeldOutView, read_held_out
from files.input_file import read_json_object
from files.whole import write_json
from player.effects.avatar import views_of
from player.gl.context import Context, open_context
from player.scene.renderer import Renderer

# less than the third digit after the point: the simpler mode stands
TIE_DB = 0.005


def view_modes(avatar: Avatar, held_out: dict[str, list[HeldOutView]]) -> Json:
    """Every view mode of the file side by side: PSNR inside the true person, by set and region, and which is best."""
    with open_context() as context:
        scores = scores_by_mode(context, avatar, held_out)
    best, reason = better_mode(scores["all"])
    return {"psnr_db": scores, "best": best, "reason": reason, "default": avatar.default_view,
            "file_says": baked_facts(avatar).get("default_view"),
            "pictures": {name: len(views) for name, views in held_out.items()}}  # fmt: skip


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
                region = VIEW_REGION[view.view]
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


def scores_by_mode(context: Context, avatar: Avatar, sets: dict[str, list[HeldOutView]]) -> Json:
    """{set: {mode: {total, head, hands, all}}} in decibels, simplest mode first, and the pooled {mode: db} over both
    sets as `all`."""
    modes = views_of(avatar)[::-1]
    errors = {name: mode_errors(context, avatar, views, modes) for name, views in sets.items()}
    out: Json = {name: {m: decibels_by_region(errors[name][m]) for m in modes} for name in sets}
    together = {m: pooled(e for one in errors.values() for e in one[m].values()) for m in modes}
    return out | {"all": {m: one.rounded(3) for m, one in together.items()}}


def better_mode(scores: dict[str, float | None]) -> tuple[str, str]:
    """The mode nearest to the truth (a simpler one within TIE_DB), and the reason as a sentence; what is asked at
    vertices is no mode of its own."""
    known = {mode: db for mode, db in scores.items() if db is not None and mode != "vertex"}
    if not known:
        return "off", "the true pictures show no person, so nothing could be measured"
    nearest = next(mode for mode, db in known.items() if db >= max(known.values()) - TIE_DB)
    return nearest, f"nearest to the true pictures: {', '.join(f'{mode} {db:.3f} dB' for mode, db in known.items())}"


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m experiments.view_modes", description=__doc__)
    parser.add_argument("avatar", type=Path)
    parser.add_argument("capture", type=Path)
    parser.add_argument("--json", type=Path, required=True)
    options = parser.parse_args(argv)
    found = view_modes(read_avatar(options.avatar), {name: read_held_out(options.capture, name) for name in SETS})
    write_json(options.json, read_json_object(options.json, "what eval wrote") | {"view_modes": found})
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
