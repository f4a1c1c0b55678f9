"""Accuracy against time of one avatar on this machine (`selfscan bench`): a page that plays, table, JSON, plot.

Every rung of the player's ladder, and the field it was baked from when the run is given, is timed on a few
frames by alternating rounds and compared with the best rung, and with the truth when the capture is given.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from jaxtyping import Bool, Float

from avatar.files import check_folder, whole_file, whole_folder
from avatar.gltf.avatar_file import Avatar, read_avatar
from avatar.settings import AtLeast, AtMost, Help, Option, parse
from bench.contact import save_sheet
from bench.effect_rungs import effect_point, effect_rows, effects_section
from bench.effects import SIZE as EFFECTS_SIZE
from bench.effects import bench_effects
from bench.frontier.page import PagePictures, frontier_page
from bench.machine import machine
from bench.part_boxes import part_boxes
from bench.quiet import Quiet, warning
from bench.rung_page import markdown, plot, rung_sheet
from bench.rung_pictures import FRAMES, flicker_frames, held_out_frames, motion_frames, rung_pictures
from bench.rung_scores import compared, crop_of, flicker, mark_dominated, row_of
from bench.scale import SIZE as SCALE_SIZE
from bench.scale import bench_scale
from player.arguments import parse_size
from player.context import Context, opened
from player.ladder import Timing, rungs_of, time_rungs
from player.mannequin import mannequin
from player.rung import Rung

Pictures = dict[str, list[Float[np.ndarray, "height width 3"]]]
Boxes = list[tuple[slice, slice]]


def bench(
    avatar_path: Path,
    out: Path,
    *,
    run: Path | None = None,
    capture: Path | None = None,
    rounds: int = 20,
    count: int = FRAMES,
    size: tuple[int, int] | None = None,
    samples: int = 1,
) -> dict[str, Any]:
    """Measure the ladder, write bench.html, bench.json, bench.md, pareto.png and rungs.png into folder `out`."""
    avatar = read_avatar(avatar_path)
    sized = {} if size is None else {"size": size}
    frames = held_out_frames(capture, count) if capture is not None else motion_frames(avatar, count, **sized)
    context = opened("auto", None)
    try:
        rungs, full = rungs_of(avatar), frames[0].camera.size
        with Quiet() as quiet:
            timings = time_rungs(context, avatar, rungs, [(f.pose, f.camera) for f in frames], full, rounds=rounds)
        rows = [timed_row(rung, timing, timings[0]) for rung, timing in zip(rungs, timings, strict=True)]
        pictures = {rung.name: rung_pictures(context, avatar, rung, frames) for rung in rungs}
        score_flicker(context, avatar, rungs, rows, full)
        times: list[np.ndarray | None] = [timing.ms for timing in timings]
        if run is not None:
            from bench.field_rungs import field_rungs  # it brings ONNX Runtime, or torch

            for name, ms, bytes_, drawn in field_rungs(context, run, frames, samples=samples):
                faster = float(np.median(timings[0].ms) / np.median(ms))
                rows.insert(0, row_of(name, ms, bytes_) | {"times_faster": round(faster, 5)})
                # it took no turns with the others
                times.insert(0, None)
                pictures = {name: drawn} | pictures
        best, baked = rows[0]["name"], rungs[0].name
        masks = [
            frame.truth.mask() if frame.truth is not None else picture.max(-1) > 0
            for frame, picture in zip(frames, pictures[best], strict=True)
        ]
        crops = [crop_of(mask) for mask in masks]
        truths = [f.truth.image() for f in frames if f.truth is not None]
        drawn_effects = effect_rows(context, avatar, rungs[0], frames, pictures[baked], crops, masks, truths, rounds)
        facts = machine(context.renderer, context.kind)
    finally:
        context.release()

    parts = [part_boxes(avatar, *frame.pose, frame.camera) for frame in frames]
    others: Pictures = {} if best == baked else {"against_baked": pictures[baked]}
    others |= {} if capture is None else {"against_truth": truths}
    for row in rows:
        drawn = pictures[row["name"]]
        row |= compared(pictures[best], drawn, crops, masks)
        row["parts"] = part_scores(pictures[best], drawn, parts)
        for against, shown in others.items():
            row[against] = compared(shown, drawn, crops, masks) | {"parts": part_scores(shown, drawn, parts)}
    effects = [effect.row for effect in drawn_effects]
    plain = next(row for row in rows if row["name"] == baked)
    for effect in drawn_effects if truths else ():
        point = effect.row["point"] = effect_point(effect.row, plain)
        point["against_truth"]["parts"] = part_scores(truths, effect.pictures, parts)
        pictures[point["name"]] = effect.pictures
    for against in (None, *others):
        # only truth judges effects
        points = [row["point"] for row in effects] if against == "against_truth" else []
        mark_dominated(rows + points, times + [None] * len(points), against)
    result = {
        "format": "selfscan-bench",
        "machine": facts | {"others_cpu_share": quiet.others},
        "warning": warning(quiet.others, facts["load_average"]),
        "avatar": avatar.name,
        "frames": len(frames),
        "size": list(full),
        "rounds": rounds,
        "best_rung": best,
        "best_baked_rung": baked,
        "rungs": rows,
        "effects": effects,
    }
    first = PagePictures(
        {name: drawn[0] for name, drawn in pictures.items()}, truths[0] if truths else None, crops[0], parts[0]
    )
    with whole_folder(out) as folder:
        with whole_file(folder / "bench.json", "w") as file:
            json.dump(result, file, indent=1)
        with whole_file(folder / "bench.md", "w") as file:
            file.write(markdown(result) + "\n" + effects_section(effects, baked))
        with whole_file(folder / "bench.html", "w") as file:
            file.write(frontier_page(result, first, avatar, rungs))
        plot(result, folder / "pareto.png")
        save_sheet(folder / "rungs.png", rung_sheet(result, pictures, crops, truths))
    return result


def timed_row(rung: Rung, timing: Timing, best: Timing) -> dict[str, Any]:
    return row_of(rung.name, timing.ms, timing.bytes) | {
        "start_ms": round(timing.start_ms, 1),
        "times_faster": round(float(np.median(best.ms / timing.ms)), 3),
    }


def score_flicker(
    context: Context, avatar: Avatar, rungs: Sequence[Rung], rows: Sequence[dict[str, Any]], size: tuple[int, int]
) -> None:
    """Add to each row how much its clip flickers beside that of the first rung."""
    frames = flicker_frames(avatar, size)
    references = rung_pictures(context, avatar, rungs[0], frames)
    masks: list[Bool[np.ndarray, "height width"]] = [picture.max(-1) > 0 for picture in references]
    for rung, row in zip(rungs, rows, strict=True):
        drawn = references if rung is rungs[0] else rung_pictures(context, avatar, rung, frames)
        row["flicker"] = flicker(references, drawn, masks)


def part_scores(references: list, drawn: list, boxes: list[dict[str, tuple[slice, slice]]]) -> dict[str, Any]:
    """FLIP and PSNR of head and hands, over their rectangles in the pictures that show them."""
    out = {}
    for name, kinds in (("head", ("head",)), ("hands", ("hand_left", "hand_right"))):
        seen = [(a, b, box[kind]) for a, b, box in zip(references, drawn, boxes) for kind in kinds if kind in box]
        if seen:
            scores = compared(*map(list, zip(*seen)))
            out[name] = {key: scores[key] for key in ("psnr_db", "ssim", "flip")}
    return out


@dataclass(frozen=True)
class BenchCommand:
    """`selfscan bench`."""

    out: Annotated[Path, Option(("-o",), "DIR"), "folder to write"]
    avatar: Annotated[
        Path | None,
        Option(positional=True, metavar="AVATAR"),
        "avatar file (.glb); of --effects and --scale none: the built-in body",
    ] = None
    effects: Annotated[bool, "instead: what each effect of a scene costs, alone and all together"] = False
    scale: Annotated[bool, "instead: how time grows with avatars, triangles, pixels and frames of motion"] = False
    run: Annotated[Path | None, Option(metavar="RUN"), "run folder it was baked from: adds the field as a rung"] = None
    capture: Annotated[
        Path | None, Option(metavar="CAPTURE"), "capture folder with truth/: held-out poses and true pictures"
    ] = None
    rounds: Annotated[int, AtLeast(1), AtMost(100_000), "timed frames for each rung"] = 20
    frames: Annotated[int, AtLeast(1), AtMost(10_000), "pictures compared"] = FRAMES
    samples: Annotated[
        int,
        AtLeast(1),
        AtMost(4),
        "with --run: up to how many samples a pixel the field is refined, half a minute each",
    ] = 1
    size: Annotated[
        tuple[int, int] | None, AtLeast(1), Option(metavar="WxH", parse=parse_size), "pixels (default: 640x640)"
    ] = None

    def __post_init__(self):
        if self.avatar is None and not (self.effects or self.scale):
            raise ValueError("give AVATAR, --effects or --scale")
        if self.effects and self.scale:
            raise ValueError("--effects and --scale: expected one of them, found both")
        if (self.effects or self.scale) and (self.run or self.capture):
            raise ValueError("--run and --capture are of the ladder of an avatar: leave --effects and --scale out")
        if self.size is not None and self.capture is not None:
            raise ValueError("--size: the true pictures of --capture have their own")


BENCH = Help(
    "selfscan bench",
    """What accuracy costs in time on this machine: every way the player can draw an avatar, timed and compared with the
best one, with the field it came from (--run) and with the truth (--capture).""",
    """examples
  selfscan bench avatar.glb --run out/run --capture out/capture -o out/bench
  selfscan bench --effects -o out/effects       or of an avatar: selfscan bench avatar.glb --effects -o out/effects
  selfscan bench avatar.glb --scale --rounds 8 -o out/scale       from one avatar to a hundred""",
)


def bench_main(argv: list[str]) -> int:
    """`selfscan bench AVATAR [--run RUN] [--capture CAPTURE] -o DIR`, or `selfscan bench [AVATAR] --effects -o DIR`."""
    command = parse(BenchCommand, argv, BENCH)
    check_folder(command.out)
    if command.effects:
        return _effects(command)
    if command.scale:
        return _scale(command)
    assert command.avatar is not None
    result = bench(
        command.avatar,
        command.out,
        run=command.run,
        capture=command.capture,
        rounds=command.rounds,
        count=command.frames,
        size=command.size,
        samples=command.samples,
    )
    for row in result["rungs"]:
        flip = "the best" if row["name"] == result["best_rung"] else f"FLIP {row['flip']:.4f}"
        print(f"{row['name']:36}{row['ms_median']:10.2f} ms{flip:>14}" + ("  dominated" if row["dominated"] else ""))
    if result["warning"]:
        print(result["warning"])
    print(f"wrote {command.out}/bench.html, to open in a browser, and bench.md")
    return 0


def _scale(command: BenchCommand) -> int:
    """The table of exponents."""
    avatar = mannequin() if command.avatar is None else read_avatar(command.avatar)
    result = bench_scale(avatar, command.out, rounds=command.rounds, size=command.size or SCALE_SIZE)
    for row in result["sweeps"]:
        power = row["exponents"]["cpu"]
        print(f"{row['name']:48} time ~ x^{power['exponent']:.2f} ({power['low']:.2f} to {power['high']:.2f})")
    if result["warning"]:
        print(result["warning"])
    print(f"wrote {command.out}/scale.md")
    return 0


def _effects(command: BenchCommand) -> int:
    """The table of effects."""
    avatar = mannequin() if command.avatar is None else read_avatar(command.avatar)
    result = bench_effects(avatar, command.out, rounds=command.rounds, size=command.size or EFFECTS_SIZE)
    for row in result["effects"]:
        print(f"{row['name']:36}{row['ms']:10.2f} ms{row['times_bare']:10.2f} x{row['bytes'] / 1e6:10.2f} MB")
    if result["warning"]:
        print(result["warning"])
    print(f"wrote {command.out}/effects.md")
    return 0
