"""Effects that change how exact an avatar is, beside its best rung: what they cost, and what they bring against truth.

Another skinning or light is no worse copy of the best rung: its difference from that is no error. Whether it is nearer
to the person only true pictures tell, and there it is a point of the frontier (`effect_point`); without them its change
is told as a change. The true bodies of `selfscan synth`
are skinned by linear blending themselves: they favour it over dual quaternions and helper joints. Secondary motion has
no true pose to be compared with, and other effects (ground, blur ...) only have a price: `selfscan bench --effects`.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from avatar.baked_avatar import Avatar
from bench.rung_page import number
from bench.rung_pictures import ComparedFrame
from bench.rung_scores import compared, median_interval
from player.context import Context
from player.passes.light import Light
from player.rung import Rung
from player.scenes.effects import PLAIN, Effects

Picture = Float[np.ndarray, "height width 3"]


@dataclass(frozen=True)
class EffectRung:
    """The best rung drawn in another way."""

    name: str
    avatar: Avatar
    effects: Effects


class DrawnEffect(NamedTuple):
    """What was measured of an effect, and its frames."""

    row: dict[str, Any]
    pictures: list[Picture]


def effect_rungs(avatar: Avatar) -> list[EffectRung]:
    """What the file allows: dual quaternions; the capture's light; without its twist and bend joints."""
    rungs = [EffectRung("dual quaternions", avatar, replace(PLAIN, skinning="dual_quaternion"))]
    if avatar.light is not None:
        rungs.append(EffectRung("light by the capture's lamps", avatar, replace(PLAIN, light=Light())))
    if avatar.levels[0].twist is not None:
        levels = tuple(replace(level, twist=None) for level in avatar.levels)
        rungs.append(EffectRung("without twist and bend joints", replace(avatar, levels=levels, bend=None), PLAIN))
    return rungs


def effect_rows(
    context: Context,
    avatar: Avatar,
    rung: Rung,
    frames: Sequence[ComparedFrame],
    plain: list[Picture],
    crops: list[tuple[slice, slice]],
    masks: list[Bool[np.ndarray, "height width"]],
    truths: list[Picture],
    rounds: int,
) -> list[DrawnEffect]:
    """Of each effect the ratio of its frames' times to those of the rung without it, which take turns; FLIP by which it
    changes the picture; with `truths` the scores against them without it and with it."""
    full, effects = frames[0].camera.size, []
    bare = rung.renderer(context, [avatar], full)
    try:
        for one in effect_rungs(avatar):
            renderer = rung.renderer(context, [one.avatar], full, effects=one.effects)
            try:
                ms = np.array([[_timed(r, frames[k % len(frames)]) for r in (bare, renderer)] for k in range(rounds)])
                drawn = [renderer.draw([f.pose], f.camera)[..., :3].astype(np.float32) / 255 for f in frames]
                size = renderer.plan.bytes
            finally:
                renderer.release()
            low, high = median_interval(ms[:, 1] / ms[:, 0])
            row: dict[str, Any] = {
                "name": one.name,
                "ms_median": round(float(np.median(ms[:, 1])), 3),
                "times_plain": round(float(np.median(ms[:, 1] / ms[:, 0])), 3),
                "times_plain_interval": [round(low, 3), round(high, 3)],
                "change_flip": compared(plain, drawn, crops)["flip"],
                "bytes": int(size),
            }
            if truths:
                row["plain_against_truth"] = compared(truths, plain, crops, masks)
                row["against_truth"] = compared(truths, drawn, crops, masks)
            effects.append(DrawnEffect(row, drawn))
    finally:
        bare.release()
    return effects


def effect_point(row: dict[str, Any], plain: dict[str, Any]) -> dict[str, Any]:
    """An effect judged by truth, as a rung beside those of the ladder. It only took turns with the one it changes,
    `plain`, so its time is that one's times the ratio of both."""
    low, high = row["times_plain_interval"]
    return {
        "name": f"{plain['name']}, {row['name']}",
        "ms_median": round(plain["ms_median"] * row["times_plain"], 3),
        "ms_interval": [round(plain["ms_median"] * edge, 3) for edge in (low, high)],
        "bytes": row["bytes"],
        "times_faster": round(1 / row["times_plain"], 3),
        "against_truth": dict(row["against_truth"]),
    }


def _timed(renderer: Any, frame: ComparedFrame) -> float:
    """Milliseconds of a frame after one untimed: caches hold its own meshes and textures."""
    gl, target = renderer.context.gl, renderer.target
    for _ in range(2):
        gl.finish()
        start = time.perf_counter()
        renderer.draw_into(target, [frame.pose], frame.camera)
        gl.finish()
    return 1e3 * (time.perf_counter() - start)


def effects_section(rows: Sequence[dict[str, Any]], rung: str) -> str:
    """The rows as Markdown, below the ladder's table."""
    with_truth = any("against_truth" in row for row in rows)
    judged = ": only true pictures (`--capture`) tell which of both is nearer to the person."
    if with_truth:
        judged = (
            "; FLIP and the person's PSNR against truth: without it -> with it (a synthetic truth is skinned by linear "
            "blending itself, which favours that)."
        )
    lines = [
        "## Effects that change how exact the avatar is",
        "",
        f"Beside `{rung}`, in alternating frames. *Change* is FLIP beside it, which is no error{judged} "
        "What other effects cost tells `selfscan bench AVATAR --effects`.",
        "",
        "| effect | ms | times (95 %) | change |" + (" FLIP against truth | PSNR |" if with_truth else ""),
        "|-|-|-|-|" + ("-|-|" if with_truth else ""),
    ]
    for row in rows:
        low, high = row["times_plain_interval"]
        cells = [row["name"], number(row["ms_median"], 2), f"{row['times_plain']:.2f} ({low:.2f} - {high:.2f})"]
        cells.append(number(row["change_flip"], 4))
        if "against_truth" in row:
            pair = row["plain_against_truth"], row["against_truth"]
            cells.append(" -> ".join(number(scores["flip"], 4) for scores in pair))
            cells.append(" -> ".join(number(scores["psnr_mask_db"], 2) for scores in pair))
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join([*lines, ""])
