"""Accuracy against time of one avatar on this machine (`selfscan bench`): table, JSON, plot.

Every rung of the player's ladder, and the field it was baked from when the run is given, is timed on a few
frames by alternating rounds and compared with the best rung, and with the truth when the capture is given.
"""

import argparse
import json
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from PIL import Image

from avatar.avatar_file import Avatar, read_avatar
from avatar.camera import Camera, orbit_camera
from avatar.errors import AssetError
from avatar.files import whole_file, whole_folder
from avatar.motion import builtin_motion, fitted
from avatar.progress import progress
from avatar.skeleton import skin_transforms
from avatar.skinning import SkinWeights, skin_points
from bench import metrics
from bench.contact import save_sheet, sheet, spread_poses
from bench.held_out import HeldOutView, read_held_out
from bench.machine import machine
from player.context import Context, opened
from player.ladder import Rung, rungs_of, time_rungs
from player.raster import Rasteriser
from player.renderer import Pose, Renderer

FRAMES = 4
SIZE = (512, 512)
CROP = 0.03  # metres round the person where pictures are compared
FIELD_ROUNDS = 3


@dataclass(frozen=True)
class Frame:
    """A pose under a camera, with the true picture when there is one."""

    pose: Pose
    camera: Camera
    truth: HeldOutView | None


def bench(
    avatar_path: Path,
    out: Path,
    *,
    run: Path | None = None,
    capture: Path | None = None,
    rounds: int = 20,
    count: int = FRAMES,
) -> dict[str, Any]:
    """Measure the ladder, write bench.json, bench.md, pareto.png and rungs.png into folder `out`."""
    avatar = read_avatar(avatar_path)
    frames = held_out_frames(capture, count) if capture is not None else motion_frames(avatar, count)
    context = opened("auto", None)
    try:
        rungs = rungs_of(avatar)
        full = frames[0].camera.size
        timings = time_rungs(
            context, avatar, rungs, [(f.pose, f.camera) for f in frames], full, rounds=rounds
        )
        pictures = {rung.name: rung_pictures(context, avatar, rung, frames) for rung in rungs}
        rows = [row_of(rung.name, t.ms, t.bytes) for rung, t in zip(rungs, timings, strict=True)]
        if run is not None:
            for name, ms, size, drawn in field_rungs(context, run, frames):
                rows.insert(0, row_of(name, ms, size))
                pictures = {name: drawn} | pictures
    finally:
        kind, renderer = context.kind, context.renderer
        context.release()

    best = rows[0]["name"]
    crops = [crop_of(pictures[best][i], frame) for i, frame in enumerate(frames)]
    truths = [f.truth.image() if f.truth is not None else None for f in frames]
    for row in rows:
        drawn = pictures[row["name"]]
        row |= compared(pictures[best], drawn, crops)
        if capture is not None:
            row["against_truth"] = compared(truths, drawn, crops)
    mark_dominated(rows)
    result = {
        "format": "selfscan-bench",
        "machine": machine(renderer, kind),
        "avatar": avatar.name,
        "frames": len(frames),
        "size": list(full),
        "rounds": rounds,
        "best_rung": best,
        "rungs": rows,
    }
    with whole_folder(out) as folder:
        with whole_file(folder / "bench.json", "w") as file:
            json.dump(result, file, indent=1)
        with whole_file(folder / "bench.md", "w") as file:
            file.write(markdown(result))
        plot(result, folder / "pareto.png")
        save_sheet(folder / "rungs.png", rung_sheet(result, pictures, crops, truths))
    return result


# what is drawn


def held_out_frames(capture: Path, count: int = FRAMES) -> list[Frame]:
    """Body views of novel poses."""
    views = spread_poses(read_held_out(capture, "novel_pose"), "body", count)
    if not views:
        raise AssetError(f"{capture}: truth/novel_pose holds no body views")
    return [Frame((v.axis_angle, v.root), v.camera, v) for v in views]


def motion_frames(avatar: Avatar, count: int = FRAMES) -> list[Frame]:
    """Frames of the built-in counting clip from the front."""
    level = avatar.levels[0]
    rest = skin_transforms(np.zeros((52, 3)), avatar.joint_positions, rest=avatar.canonical_pose)
    skin = SkinWeights(level.joints.astype(np.int64), (level.weights / np.float32(255)).astype(np.float32))
    standing = skin_points(level.positions, skin, rest)
    height = float(np.ptp(standing[:, 1]))
    clip = fitted(builtin_motion("counting").read(), -float(standing[:, 1].min()))
    chosen = np.linspace(0.15, 0.85, count) * (len(clip.root) - 1)
    frames = []
    for i in chosen.round().astype(int):
        target = clip.root[i] + [0, 0.5 * height + standing[:, 1].min(), 0]
        camera = orbit_camera(target, 1.9 * height, 0.25, 0.05, SIZE)
        frames.append(
            Frame((clip.axis_angle[i].astype(np.float64), clip.root[i].astype(np.float64)), camera, None)
        )
    return frames


def rung_pictures(
    context: Context, avatar: Avatar, rung: Rung, frames: list[Frame]
) -> list[Float[np.ndarray, "h w 3"]]:
    """The frames as this rung shows them, brought to full resolution."""
    full = frames[0].camera.size
    renderer = Renderer(context, [avatar], rung.size(full), view=rung.view, level=rung.level)
    try:
        drawn = []
        for frame in frames:
            pixels = Image.fromarray(np.ascontiguousarray(renderer.draw([frame.pose], frame.camera)[..., :3]))
            if pixels.size != full:
                pixels = pixels.resize(full, Image.Resampling.BILINEAR)
            drawn.append(np.asarray(pixels, np.float32) / 255)
        return drawn
    finally:
        renderer.release()


def field_rungs(context: Context, run: Path, frames: list[Frame]) -> list[tuple[str, np.ndarray, int, list]]:
    """The field drawn as its first surface crossing: paper mode, then inside the cone that was seen."""
    from bench.field_view import Directions, FieldView
    from train.run import read_run

    view = FieldView(read_run(run))
    raster = Rasteriser(context)
    rungs = []
    try:
        modes: tuple[tuple[str, Directions], ...] = (
            ("field, paper mode", "global"),
            ("field, seen cone", "cone"),
        )
        for name, directions in modes:
            ms, drawn = [], []
            for number in progress(range(max(FIELD_ROUNDS, len(frames))), name):
                frame = frames[number % len(frames)]
                start = time.perf_counter()
                picture = view.draw(raster, *frame.pose, frame.camera, directions=directions)
                ms.append(1e3 * (time.perf_counter() - start))
                if number < len(frames):
                    drawn.append(picture.colour)
            size = sum(tensor.numel() * tensor.element_size() for tensor in tensors_of(view.field))
            rungs.append((name, np.array(ms), size, drawn))
    finally:
        raster.release()
    return rungs


def tensors_of(field: Any) -> list:
    """Every tensor a field holds, wherever it keeps its networks."""
    import torch

    found: dict[int, torch.Tensor] = {}
    waiting, visited = [field], set()
    while waiting:
        thing = waiting.pop()
        if id(thing) in visited:
            continue
        visited.add(id(thing))
        if isinstance(thing, torch.Tensor):
            found[thing.data_ptr()] = thing
        elif isinstance(thing, torch.nn.Module):
            waiting += [*thing.parameters(), *thing.buffers()]
        elif isinstance(thing, dict):
            waiting += list(thing.values())
        elif isinstance(thing, (list, tuple)):
            waiting += list(thing)
        elif hasattr(thing, "__dict__") and type(thing).__module__.split(".")[0] == "train":
            waiting += list(vars(thing).values())
    return list(found.values())


# how it compares


def crop_of(picture: Float[np.ndarray, "h w 3"], frame: Frame) -> tuple[slice, slice]:
    """Where pictures are compared: the rectangle of the person, a little wider."""
    mask = frame.truth.mask() if frame.truth is not None else picture.max(-1) > 0
    where = metrics.rectangle(mask)
    height, width = mask.shape
    if where is None:
        return slice(0, height), slice(0, width)
    margin = 4
    rows, columns = where
    return (
        slice(max(0, rows.start - margin), min(height, rows.stop + margin)),
        slice(max(0, columns.start - margin), min(width, columns.stop + margin)),
    )


def compared(references: list, drawn: list, crops: list[tuple[slice, slice]]) -> dict[str, Any]:
    """PSNR of the pooled error, SSIM and FLIP over the rectangles; null with the reason for equal pictures."""
    error, ssim, flip = metrics.PooledError(), [], []
    for reference, picture, where in zip(references, drawn, crops, strict=True):
        error.add(reference[where], picture[where])
        ssim.append(metrics.ssim(reference[where], picture[where]))
        flip.append(metrics.flip(reference[where], picture[where]))
    scores = {"psnr_db": error.psnr(), "ssim": metrics.mean_score(ssim), "flip": metrics.mean_score(flip)}
    out: dict[str, Any] = {n: None if s.value is None else round(s.value, 4) for n, s in scores.items()}
    reasons = {n: s.reason for n, s in scores.items() if s.value is None}
    return out | ({"reasons": reasons} if reasons else {})


def row_of(name: str, ms: Float[np.ndarray, "n"], size: int) -> dict[str, Any]:
    median, tail = float(np.median(ms)), float(np.percentile(ms, 95))
    return {"name": name, "ms_median": round(median, 3), "ms_p95": round(tail, 3), "bytes": int(size)}


def mark_dominated(rows: list[dict[str, Any]]) -> None:
    """A rung is dominated when another is no slower and no less exact, and better in one of the two."""

    def exactness(row: dict[str, Any]) -> float:
        return float("inf") if row["psnr_db"] is None else float(row["psnr_db"])

    for row in rows:
        row["dominated"] = any(
            other["ms_median"] <= row["ms_median"]
            and exactness(other) >= exactness(row)
            and (other["ms_median"], -exactness(other)) != (row["ms_median"], -exactness(row))
            for other in rows
        )


# how it is told


def number(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def markdown(result: dict[str, Any]) -> str:
    m = result["machine"]
    width, height = result["size"]
    truth = any("against_truth" in row for row in result["rungs"])
    lines = [
        f"# Accuracy against time: {result['avatar']}",
        "",
        f"{m['cpu']}, {m['cores']} cores, {m['renderer']} ({m['context']}); {width} x {height} px, "
        f"{result['frames']} frames, {result['rounds']} alternating rounds, load {number(m['load_average'], 1)}. "
        f"PSNR, SSIM and FLIP against `{result['best_rung']}`"
        + ("; beside them PSNR against truth." if truth else "."),
        "",
        "| rung | ms median | p95 | MB | PSNR dB | SSIM | FLIP |" + (" truth dB |" if truth else "") + " |",
        "|-|-|-|-|-|-|-|" + ("-|" if truth else "") + "-|",
    ]
    for row in result["rungs"]:
        psnr = number(row["psnr_db"], 2) if row["psnr_db"] is not None else "same"
        cells = [
            row["name"],
            number(row["ms_median"], 2),
            number(row["ms_p95"], 2),
            number(row["bytes"] / 1e6, 1),
        ]
        cells += [psnr, number(row["ssim"], 3), number(row["flip"], 3)]
        if truth:
            cells.append(number(row["against_truth"]["psnr_db"], 2))
        cells.append("dominated" if row["dominated"] else "")
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n\n![accuracy against time](pareto.png)\n\n![rungs](rungs.png)\n"


def plot(result: dict[str, Any], path: Path) -> None:
    """Milliseconds against PSNR, the rungs that nothing dominates joined by a line."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib.figure import Figure
    from matplotlib.ticker import FormatStrFormatter, NullFormatter

    rows = result["rungs"]
    finite = [row["psnr_db"] for row in rows if row["psnr_db"] is not None]
    top = (max(finite) if finite else 40.0) + 3.0  # where the best rung, equal to itself, is drawn
    figure = Figure(figsize=(8, 4.5), dpi=110, layout="constrained")
    axes = figure.add_subplot()
    points = [(row["ms_median"], row["psnr_db"] if row["psnr_db"] is not None else top, row) for row in rows]
    front = sorted((x, y) for x, y, row in points if not row["dominated"])
    axes.plot([x for x, _ in front], [y for _, y in front], "-", color="0.6", zorder=1)
    for x, y, row in points:
        axes.scatter([x], [y], s=28, color="0.7" if row["dominated"] else "tab:blue", zorder=2)
        axes.annotate(row["name"], (x, y), fontsize=7, xytext=(4, 4), textcoords="offset points")
    axes.set_xscale("log")
    axes.margins(x=0.25, y=0.12)  # room for the names
    axes.xaxis.set_major_formatter(FormatStrFormatter("%g"))
    few = 3 * min(x for x, _, _ in points) > max(
        x for x, _, _ in points
    )  # under a third of a decade: label all ticks
    axes.xaxis.set_minor_formatter(FormatStrFormatter("%g") if few else NullFormatter())
    axes.set_xlabel("ms per frame (median)")
    axes.set_ylabel(f"PSNR dB against {result['best_rung']} (its own point is on top)", fontsize=8)
    axes.set_title(f"{result['avatar']} on {result['machine']['renderer']}", fontsize=9)
    axes.grid(alpha=0.3)
    with whole_file(path) as file:
        figure.savefig(file, format="png")


def rung_sheet(result: dict[str, Any], pictures: dict, crops: list, truths: list) -> Image.Image:
    """The first frame of every rung side by side."""
    tiles, titles = [], []
    if truths[0] is not None:
        tiles.append([bytes_of(truths[0][crops[0]])])
        titles.append(["truth"])
    for row in result["rungs"]:
        tiles.append([bytes_of(pictures[row["name"]][0][crops[0]])])
        titles.append([f"{row['name']}: {row['ms_median']:.1f} ms"])
    return sheet(
        tiles, titles, f"{result['avatar']}: rungs of accuracy against time", columns=min(6, len(tiles))
    )


def bytes_of(picture: Float[np.ndarray, "h w 3"]) -> np.ndarray:
    return np.round(np.clip(picture, 0, 1) * 255).astype(np.uint8)


def bench_main(argv: list[str]) -> int:
    """`selfscan bench AVATAR [--run RUN] [--capture CAPTURE] -o DIR`."""
    parser = argparse.ArgumentParser(
        prog="selfscan bench",
        description="What accuracy costs in time on this machine: every way the player can draw an avatar, timed "
        "and compared with the best one, with the field it came from (--run) and with the truth (--capture).",
        epilog="example: selfscan bench avatar.glb --run out/run --capture out/capture -o out/bench",
    )
    parser.add_argument("avatar", metavar="AVATAR", type=Path, help="avatar file (.glb)")
    parser.add_argument("--run", type=Path, help="run folder it was baked from: adds the field as a rung")
    parser.add_argument(
        "--capture", type=Path, help="capture folder with truth/: held-out poses and true pictures"
    )
    parser.add_argument("-o", dest="out", metavar="DIR", type=Path, required=True, help="folder to write")
    parser.add_argument("--rounds", type=int, default=20, help="timed frames for each rung (%(default)s)")
    parser.add_argument("--frames", type=int, default=FRAMES, help="pictures compared (%(default)s)")
    options = parser.parse_args(argv)
    if options.frames < 1:
        parser.error(f"--frames should be at least 1, is {options.frames}")
    if options.rounds < 1:
        parser.error(f"--rounds should be at least 1, is {options.rounds}")
    result = bench(
        options.avatar,
        options.out,
        run=options.run,
        capture=options.capture,
        rounds=options.rounds,
        count=options.frames,
    )
    for row in result["rungs"]:
        psnr = "same" if row["psnr_db"] is None else f"{row['psnr_db']:.2f} dB"
        print(
            f"{row['name']:36}{row['ms_median']:10.2f} ms{psnr:>12}"
            + ("  dominated" if row["dominated"] else "")
        )
    print(f"wrote {options.out}/bench.md")
    return 0
