"""`selfscan render`: avatars and a motion become a picture, frames or a film."""

import argparse
import json
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from avatar.avatar_file import read_avatar
from avatar.baked_avatar import Avatar
from avatar.camera import Camera, read_camera
from avatar.errors import AssetError
from avatar.files import whole_file
from avatar.motion import Clip
from avatar.progress import progress
from player.arguments import add_hands, frame_number, parse_color, parse_frames, parse_size
from player.context import opened
from player.effects import VIEWS
from player.film import Film, film_kind
from player.framing import extent, facing, fitted_camera, orbit, outermost
from player.motions import BLOCK, beside, frame_range, notes, opened_motion, posed_frames, retargeted
from player.renderer import Renderer

RENDER_EXAMPLES = """examples
  selfscan render me.glb --motion counting -o counting.mp4
  selfscan render me.glb --motion walk.bvh --camera orbit --size 1280x720 -o walk.mp4
  selfscan render me.glb --motion walk.npz --frames 100:200 --background transparent -o frames/
  selfscan render me.glb --motion walk.npz --frame 12 --explain -o frame.png

OUT is .png (one frame), .mp4, .webm, .mov, .gif, .webp, or a folder for PNG frames."""


def render_parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="selfscan render",
        description="Draw an avatar in motion: a picture, frames or a film. Needs no GPU and no display.",
        epilog=RENDER_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "avatar", nargs="+", metavar="AVATAR", help="avatar file (.glb); several stand side by side"
    )
    parser.add_argument("--motion", metavar="FILE",
                        help="pose file (.npz, .pkl, .bvh, .glb, .vrma ...), EasyMocap folder, or: counting, walking "
                        "(default: T-pose)")  # fmt: skip
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--frame", type=frame_number, metavar="N", help="draw only this frame")
    which.add_argument("--frames", type=parse_frames, metavar="A:B", help="draw frames A to B-1")
    parser.add_argument("--camera", default="front", metavar="FILE|front|orbit",
                        help="camera file (.json), or one fitted to the avatar (default: front)")  # fmt: skip
    parser.add_argument(
        "--size", type=parse_size, metavar="WxH", help="pixels (default: the camera file's, else 640x640)"
    )
    parser.add_argument("--view", choices=("auto", *VIEWS), default="auto",
                        help="view dependence: off is the paper; auto picks by avatar and device")  # fmt: skip
    parser.add_argument(
        "--background", type=parse_color, default=parse_color("#2b2d33"), metavar="#rrggbb|transparent"
    )
    parser.add_argument(
        "--body", metavar="MODEL", help="SMPL+H model (.npz, .pkl) that the pose file was made for"
    )
    add_hands(parser)
    parser.add_argument(
        "--context", choices=("auto", "egl", "osmesa"), default="auto", help="how to reach OpenGL"
    )
    parser.add_argument("--gpu", type=frame_number, metavar="N", help="this GPU only, counted as CUDA counts")
    parser.add_argument(
        "--explain", action="store_true", help="print which passes ran, why, and what each costs"
    )
    parser.add_argument("--json", metavar="FILE", help="write what --explain prints to a file")
    parser.add_argument("-o", "--output", required=True, metavar="OUT")
    return parser


def render_main(argv: list[str]) -> int:
    """Draw a picture, frames or a film."""
    parser = render_parser()
    options = parser.parse_args(argv)
    try:
        kind = film_kind(options.output)
    except ValueError as error:
        parser.error(str(error))
    if options.json and not options.explain:
        parser.error("--json writes what --explain finds: give both")
    if kind == ".png" and options.frames:
        parser.error("a .png holds one frame: give --frame N, or another OUT")

    avatars = [read_avatar(path) for path in options.avatar]
    motion = opened_motion(options.motion, options.body, options.hands)
    start, stop = frame_range(motion, options.frame, options.frames, single=kind == ".png")
    clips = [retargeted(motion, avatar) for avatar in avatars]
    context = opened(options.context, options.gpu)
    try:
        camera_at, size = cameras(options.camera, options.size, avatars, clips, start, stop)
        try:
            renderer = Renderer(context, avatars, size, view=options.view, background=options.background)
        except ValueError as error:
            raise AssetError(str(error)) from None
        transparent = options.background[3] == 0
        began, drawing = time.perf_counter(), 0.0
        with Film(options.output, motion.rate, transparent=transparent) as film:
            for number, poses in progress(posed_frames(clips, start, stop), "frames", stop - start):
                camera = camera_at((number - start) / (stop - start), poses[0][1])
                before = time.perf_counter()
                image = renderer.draw(poses, camera)
                drawing += time.perf_counter() - before
                film.add(image)
        took = time.perf_counter() - began
        for note in (*notes(clips, start), *film.notes):
            print(note)
        print(f"{context.attempts[-1]}; view {', '.join(view_names(renderer))}")
        count = stop - start
        print(
            f"{options.output}: {count} frame{'s' * (count != 1)}, {size[0]}x{size[1]}, "
            f"drawn at {count / max(drawing, 1e-9):.0f} frames/s, written in {took:.1f} s"
        )
        if options.explain:
            explain(renderer, options.json)
    finally:
        context.release()
    return 0


def cameras(
    choice: str,
    size: tuple[int, int] | None,
    avatars: Sequence[Avatar],
    clips: Sequence[Callable[[int, int], Clip]],
    start: int,
    stop: int,
) -> tuple[Callable[[float, np.ndarray], Camera], tuple[int, int]]:
    """The camera as a function of the part of the film that has passed and of the first pelvis, and the image size."""
    if choice not in ("front", "orbit"):
        camera = read_camera(choice)
        camera = camera.resized(size) if size else camera
        return (lambda _part, _root: camera), camera.size
    size = size or (640, 640)
    everything, azimuth = np.zeros((0, 3)), 0.0
    for k, (avatar, clip) in enumerate(zip(avatars, clips, strict=True)):
        for first in range(start, stop, BLOCK):
            block = clip(first, min(first + BLOCK, stop))
            if k == 0 and first == start:
                azimuth = facing(block.axis_angle[0], avatar.joint_positions.astype(np.float64))
            points = extent(avatar, block, following=choice == "orbit") + beside(k, len(avatars))
            everything = np.concatenate([everything, points])
            everything = everything[
                outermost(everything)
            ]  # a long motion takes no more memory than a short one
    if choice == "orbit":
        everything = everything - beside(0, len(avatars))  # the camera goes along with the first avatar
        return orbit(everything, azimuth, size), size
    camera = fitted_camera(everything, azimuth, size)
    return (lambda _part, _root: camera), size


def view_names(renderer: Renderer) -> list[str]:
    """The view mode of each avatar, as the plan resolved it."""
    names = []
    for index in range(len(renderer.avatars)):
        modes = [
            p.name.split(": view ")[1]
            for p in renderer.plan.passes
            if p.avatar == index and ": view " in p.name
        ]
        names += modes or ["off"]
    return names


def explain(renderer: Renderer, json_path: str | None) -> None:
    """Print and write the passes of the last frame."""
    rows = renderer.explain()
    for row in rows:
        state = "runs" if row["runs"] else "does not run"
        print(f"  {row['name']:24} {state:13} {row['ms']:8.2f} ms {row['bytes'] / 1e6:8.2f} MB  {row['why']}")
    if json_path:
        with whole_file(Path(json_path), "w") as file:
            json.dump({"passes": rows}, file, indent=1)
