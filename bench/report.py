"""Accuracy against time of one avatar on this machine (`selfscan bench`): table, JSON, plot.

Every rung of the player's ladder, and the field it was baked from when the run is given, is timed on a few
frames by alternating rounds and compared with the best rung, and with the truth when the capture is given.
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from jaxtyping import Float
from PIL import Image

from avatar.camera import Camera, orbit_camera
from avatar.errors import AssetError
from avatar.files import check_folder, whole_file, whole_folder
from avatar.gltf.avatar_file import Avatar, read_avatar
from avatar.motion.clip import fitted
from avatar.motion.read import builtin_motion
from avatar.settings import AtLeast, AtMost, Help, Option, parse
from avatar.skeleton import skin_transforms
from avatar.skinning import skin_points
from bench.contact import save_sheet, spread_poses
from bench.machine import machine
from bench.quiet import Quiet, warning
from bench.rung_page import markdown, plot, rung_sheet
from bench.rung_scores import compared, crop_of, mark_dominated, row_of
from capture.held_out import HeldOutView, read_held_out
from player.context import Context, opened
from player.ladder import Rung, rungs_of, time_rungs
from player.renderer import Pose

FRAMES = 4
SIZE = (512, 512)


@dataclass(frozen=True)
class ComparedFrame:
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
        with Quiet() as quiet:
            timings = time_rungs(context, avatar, rungs, [(f.pose, f.camera) for f in frames], full, rounds=rounds)
        pictures = {rung.name: rung_pictures(context, avatar, rung, frames) for rung in rungs}
        rows = [row_of(rung.name, t.ms, t.bytes) for rung, t in zip(rungs, timings, strict=True)]
        for row, timing in zip(rows, timings, strict=True):
            row["times_faster"] = round(float(np.median(timings[0].ms / timing.ms)), 3)
        if run is not None:
            from bench.field_rungs import field_rungs  # it brings torch

            for name, ms, size, drawn in field_rungs(context, run, frames):
                faster = float(np.median(timings[0].ms) / np.median(ms))
                rows.insert(0, row_of(name, ms, size) | {"times_faster": round(faster, 5)})
                pictures = {name: drawn} | pictures
        facts = machine(context.renderer, context.kind)
    finally:
        context.release()

    best, baked = rows[0]["name"], rungs[0].name
    masks = [
        frame.truth.mask() if frame.truth is not None else picture.max(-1) > 0
        for frame, picture in zip(frames, pictures[best], strict=True)
    ]
    crops = [crop_of(mask) for mask in masks]
    truths = [f.truth.image() if f.truth is not None else None for f in frames]
    for row in rows:
        drawn = pictures[row["name"]]
        row |= compared(pictures[best], drawn, crops)
        if best != baked:
            row["against_baked"] = compared(pictures[baked], drawn, crops)
        if capture is not None:
            row["against_truth"] = compared(truths, drawn, crops)
    mark_dominated(rows)
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


def held_out_frames(capture: Path, count: int = FRAMES) -> list[ComparedFrame]:
    """Body views of novel poses."""
    views = spread_poses(read_held_out(capture, "novel_pose"), "body", count)
    if not views:
        raise AssetError(f"{capture}: truth/novel_pose holds no body views")
    return [ComparedFrame((v.axis_angle, v.root), v.camera, v) for v in views]


def motion_frames(avatar: Avatar, count: int = FRAMES) -> list[ComparedFrame]:
    """Frames of the built-in counting clip from the front."""
    level = avatar.levels[0]
    rest = skin_transforms(np.zeros((52, 3)), avatar.joint_positions, rest=avatar.canonical_pose)
    standing = skin_points(level.positions, level.skin, rest)
    height = float(np.ptp(standing[:, 1]))
    clip = fitted(builtin_motion("counting"), -float(standing[:, 1].min())).read()
    chosen = np.linspace(0.15, 0.85, count) * (len(clip.root) - 1)
    frames = []
    for i in chosen.round().astype(int):
        target = clip.root[i] + [0, 0.5 * height + standing[:, 1].min(), 0]
        camera = orbit_camera(target, 1.9 * height, 0.25, 0.05, SIZE)
        frames.append(
            ComparedFrame((clip.axis_angle[i].astype(np.float64), clip.root[i].astype(np.float64)), camera, None)
        )
    return frames


def rung_pictures(
    context: Context, avatar: Avatar, rung: Rung, frames: list[ComparedFrame]
) -> list[Float[np.ndarray, "height width 3"]]:
    """The frames as this rung shows them, brought to full resolution."""
    full = frames[0].camera.size
    renderer = rung.renderer(context, avatar, full)
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


@dataclass(frozen=True)
class BenchCommand:
    """`selfscan bench`."""

    avatar: Annotated[Path, Option(positional=True, metavar="AVATAR"), "avatar file (.glb)"]
    out: Annotated[Path, Option(("-o",), "DIR"), "folder to write"]
    run: Annotated[Path | None, Option(metavar="RUN"), "run folder it was baked from: adds the field as a rung"] = None
    capture: Annotated[
        Path | None, Option(metavar="CAPTURE"), "capture folder with truth/: held-out poses and true pictures"
    ] = None
    rounds: Annotated[int, AtLeast(1), AtMost(100_000), "timed frames for each rung"] = 20
    frames: Annotated[int, AtLeast(1), AtMost(10_000), "pictures compared"] = FRAMES


BENCH = Help(
    "selfscan bench",
    """What accuracy costs in time on this machine: every way the player can draw an avatar, timed and compared with the
best one, with the field it came from (--run) and with the truth (--capture).""",
    "example: selfscan bench avatar.glb --run out/run --capture out/capture -o out/bench",
)


def bench_main(argv: list[str]) -> int:
    """`selfscan bench AVATAR [--run RUN] [--capture CAPTURE] -o DIR`."""
    command = parse(BenchCommand, argv, BENCH)
    check_folder(command.out)
    result = bench(
        command.avatar,
        command.out,
        run=command.run,
        capture=command.capture,
        rounds=command.rounds,
        count=command.frames,
    )
    for row in result["rungs"]:
        psnr = "same" if row["psnr_db"] is None else f"{row['psnr_db']:.2f} dB"
        print(f"{row['name']:36}{row['ms_median']:10.2f} ms{psnr:>12}" + ("  dominated" if row["dominated"] else ""))
    if result["warning"]:
        print(result["warning"])
    print(f"wrote {command.out}/bench.md")
    return 0
