"""Effects that change how exact an avatar is, beside its best rung: what they cost, and what they bring against truth.

    python -m experiments.effect_rungs AVATAR [--capture CAPTURE] -o out/effect_rungs [--rounds 20]

Another skinning or light is no worse copy of the best rung: its difference from that is no error. Whether it is nearer
to the person only true pictures show. The true bodies of `selfscan synth`
are skinned by linear blending themselves: they favour it over dual quaternions and helper joints. Secondary motion has
no true pose to be compared with, and other effects (ground, blur ...) only have a price: `selfscan bench --effects`.
"""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from avatar.baked_avatar import Avatar
from avatar.gltf.avatar_file import read_avatar
from bench.ladder.rung_pictures import FRAMES, ComparedFrame, held_out_frames, motion_frames, rung_pictures
from bench.ladder.rung_scores import compared, crop_of, median_interval
from bench.report.writer import markdown_table, number
from files.whole import check_folder, whole_folder, write_json, write_text
from player.budget.ladder import frame_times, rungs_of
from player.budget.rung import Rung
from player.effects.light import Light
from player.gl.context import Context, open_context
from player.scene.effects import PLAIN, Effects

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
                ms = frame_times(context, [bare, renderer], [([f.pose], f.camera) for f in frames], range(rounds))
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


def effects_section(rows: Sequence[dict[str, Any]], rung: str) -> str:
    """The rows as Markdown."""
    with_truth = any("against_truth" in row for row in rows)
    judged = ": only true pictures (`--capture`) show which of both is nearer to the person."
    if with_truth:
        judged = (
            "; FLIP and the person's PSNR against truth: without it -> with it (a synthetic truth is skinned by linear "
            "blending itself, which favours that)."
        )
    lines = [
        "## Effects that change how exact the avatar is",
        "",
        f"Beside `{rung}`, in alternating frames. *Change* is FLIP beside it, which is no error{judged} "
        "`selfscan bench AVATAR --effects` says what other effects cost.",
        "",
    ]
    table = []
    for row in rows:
        low, high = row["times_plain_interval"]
        cells = [row["name"], number(row["ms_median"], 2), f"{row['times_plain']:.2f} ({low:.2f} - {high:.2f})"]
        cells.append(number(row["change_flip"], 4))
        if "against_truth" in row:
            pair = row["plain_against_truth"], row["against_truth"]
            cells.append(" -> ".join(number(scores["flip"], 4) for scores in pair))
            cells.append(" -> ".join(number(scores["psnr_mask_db"], 2) for scores in pair))
        table.append(cells)
    head = ["effect", "ms", "times (95 %)", "change", *(["FLIP against truth", "PSNR"] if with_truth else [])]
    return "\n".join([*lines, *markdown_table(head, table), ""])


def main(argv: list[str] | None = None) -> int:
    """Measure the effects of an avatar; writes effect_rungs.json and effect_rungs.md."""
    parser = argparse.ArgumentParser("python -m experiments.effect_rungs", description="Effects beside the best rung.")
    parser.add_argument("avatar", type=Path, help="avatar file (.glb)")
    parser.add_argument("-o", dest="out", type=Path, required=True, help="folder to write")
    parser.add_argument("--capture", type=Path, help="capture folder with truth/, whose pictures judge")
    parser.add_argument("--rounds", type=int, default=20, help="pairs of frames")
    command = parser.parse_args(argv)
    command.out.parent.mkdir(parents=True, exist_ok=True)
    check_folder(command.out)
    avatar = read_avatar(command.avatar)
    frames = motion_frames(avatar, FRAMES) if command.capture is None else held_out_frames(command.capture, FRAMES)
    truths = [frame.truth.image() for frame in frames if frame.truth is not None]
    rung = rungs_of(avatar)[0]
    with open_context() as context:
        plain = rung_pictures(context, avatar, rung, frames)
        masks = [
            picture.max(-1) > 0 if frame.truth is None else frame.truth.mask()
            for frame, picture in zip(frames, plain, strict=True)
        ]
        crops = [crop_of(mask) for mask in masks]
        drawn = effect_rows(context, avatar, rung, frames, plain, crops, masks, truths, command.rounds)
    rows = [effect.row for effect in drawn]
    page = effects_section(rows, rung.name)
    result = {"format": "selfscan-effect-rungs", "avatar": avatar.name, "effects": rows}
    with whole_folder(command.out) as folder:
        write_json(folder / "effect_rungs.json", result)
        write_text(folder / "effect_rungs.md", page)
    print(page)
    return 0


if __name__ == "__main__":
    sys.exit(main())
