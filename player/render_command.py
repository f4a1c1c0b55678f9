"""`selfscan render`: avatars and a motion become a picture, frames or a film."""

import argparse
import json
import math
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import chain
from pathlib import Path

from avatar.baked_avatar import Avatar
from avatar.errors import AssetError
from avatar.files import check_file, check_folder, whole_file
from avatar.progress import Progress, counted, progress
from player.arguments import (
    add_effects,
    add_ground,
    add_hands,
    frame_number,
    parse_background,
    parse_frames,
    parse_gpu,
    parse_share,
    parse_size,
    parse_workers,
    with_effects,
)
from player.context import Context, opened
from player.filming.film import VIDEO, film_kind, join_pieces
from player.filming.parts import LENGTH, Parts
from player.filming.shot import Set, Shot, with_whole_paths
from player.filming.stage import Stage, camera_from_option
from player.motions import beside, frame_range
from player.renderer import Renderer
from player.scenes.effects import Effects
from player.scenes.scene import Scene, SceneAvatar, SceneCamera

RENDER_EXAMPLES = """examples
  selfscan render me.glb --motion counting -o counting.mp4
  selfscan render me.glb --motion walk.bvh --camera orbit --size 1280x720 -o walk.mp4
  selfscan render me.glb --motion walk.npz --frames 100:200 --background transparent -o frames/
  selfscan render me.glb --motion walk.npz --frame 12 --explain -o frame.png
  selfscan render me.glb --camera turntable --seconds 4 -o me.gif
  selfscan render --scene two.toml -o two.mp4
  selfscan render me.glb --motion long.npz -o long.mp4 --resume         goes on after a stop
  selfscan render me.glb --motion long.npz -o long.mp4 --workers 4      or tcp://SCHEDULER:8786

OUT is .png (one frame), .mp4, .webm, .mov, .gif, .webp, or a folder for PNG frames."""
FASTEST = 60.0  # frames a second of a film, unless more are asked for
DRAFT_LEVEL = 99  # the coarsest there is


def render_parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="selfscan render",
        description="Draw an avatar in motion: a picture, frames or a film. Needs no GPU and no display.",
        epilog=RENDER_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add("avatar", nargs="*", metavar="AVATAR", help="avatar file (.glb); several stand side by side")
    add("--scene", metavar="FILE", help="scene file (.toml) instead of AVATAR and --motion")
    add(
        "--motion",
        metavar="FILE",
        help="pose file (.npz, .pkl, .bvh, .glb, .vrma ...), EasyMocap folder, or: counting, walking (default: T-pose)",
    )
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--frame", type=frame_number, metavar="N",
                       help="only this frame; with a turntable, the one that is shown from all sides")  # fmt: skip
    which.add_argument("--frames", type=parse_frames, metavar="A:B", help="draw frames A to B-1")
    add("--camera", metavar="front|orbit|turntable|FILE",
        help="fitted to the avatar (default: front); a camera or a camera path (.json); cameras.npz or the folder "
        "of a capture, CAPTURE:head for its head video")  # fmt: skip
    add("--seconds", type=positive, metavar="S", help="one turn of orbit (default: the film) or turntable (6)")
    add(
        "--rate",
        type=positive,
        metavar="HZ",
        help="frames a second of the film (default: the motion's, halved, cut to a third ... where that is above 60)",
    )
    add("--size", type=parse_size, metavar="WxH", help="pixels (default: the camera file's, else 640x640)")
    add("--background", type=parse_background, metavar="#rrggbb|transparent|FILE",
        help="colour (default #2b2d33), nothing, a picture, film or panorama (.hdr)")  # fmt: skip
    add_effects(parser)
    add("--quality", choices=("draft", "good", "best"), default="good",
        help="draft: coarsest mesh, paper colours, jagged edges, small file; best: the avatar's own view model per "
        "pixel, MSAA, large file; single options go before it (default: good)")  # fmt: skip
    add("--level", type=frame_number, metavar="N", help="level of detail, 0 the finest")
    add("--body", metavar="MODEL", help="SMPL+H model (.npz, .pkl) that the pose file was made for")
    add_hands(parser)
    add_ground(parser)
    add("--encoder", default="auto", metavar="auto|software|NAME",
        help="of .mp4: auto takes the GPU's if it really encodes a frame, else x264")  # fmt: skip
    add("--resume", action="store_true", help="go on with the parts that an earlier run of this film left")
    add("--part", type=parse_share, metavar="K/N",
        help="draw only the Kth of N shares of the film; --resume then joins them")  # fmt: skip
    add(
        "--workers",
        type=parse_workers,
        metavar="ADDRESS|N",
        help="draw on a Dask cluster, or on N processes of this machine",
    )
    add("--context", choices=("auto", "egl", "osmesa"), default="auto", help="how to reach OpenGL")
    add("--gpu", type=parse_gpu, metavar="N|NODE",
        help="this GPU only, counted as CUDA counts, or its DRM node, as /dev/dri/renderD128")  # fmt: skip
    add("--explain", action="store_true", help="print which passes ran, why, and what each costs")
    add("--json", metavar="FILE", help="write what --explain prints to a file")
    add("-o", "--output", required=True, metavar="OUT")
    return parser


def positive(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not (math.isfinite(value) and value > 0):
        raise argparse.ArgumentTypeError(f"expected a positive number of seconds, found {text!r}")
    return value


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
    if kind == ".png" and options.rate:
        parser.error("--rate is of a film; a .png holds one frame")
    if kind == ".png" and (options.part or options.workers):
        parser.error("--part and --workers share the frames of a film; a .png holds one")
    if options.part and options.workers:
        parser.error("give --part or --workers")
    if options.explain and options.workers:
        parser.error("--explain asks the context that drew: leave --workers out")
    if bool(options.scene) == bool(options.avatar):
        parser.error("give AVATAR or --scene")
    if options.scene and (options.motion or options.body or (options.hands, options.ground) != ("file", "auto")):
        parser.error("--motion, --body, --hands and --ground are in the scene file")

    (check_file if kind else check_folder)(options.output)
    if options.json:
        check_file(options.json)
    scene = scene_of(options)
    # while files are read and unpacked, the driver wakes up; both are work outside of Python
    with ThreadPoolExecutor(1) as pool:
        reading = pool.submit(Stage, scene, level_of(options) + 1)
        context = None if options.workers else opened(options.context, options.gpu)
        try:
            try:
                stage = reading.result()
            finally:
                # if it failed it keeps its error, and that this frame with all that is open
                del reading
            return filmed(options, kind, stage, context)
        finally:
            if context is not None:
                context.release()


def filmed(options: argparse.Namespace, kind: str, stage: Stage, context: Context | None) -> int:
    """Draw what the options ask for, from an opened scene, with this context (None: workers draw)."""
    stage.scene = replace(stage.scene, effects=effects_for(options.quality, stage.scene.effects, stage.avatars))
    if options.frame is not None and stage.camera.kind == "turntable" and stage.still is None:
        frame_range(stage, options.frame, None, single=True)
        stage.hold(options.frame)
        options.frame = None
    start, stop = frame_range(stage, options.frame, options.frames, single=kind == ".png")
    if kind == ".png":
        print(
            f"{stage.name}: frame {start} of {counted(stage.frames, 'frame')}"
            + ("" if options.frame is not None or stage.frames == 1 else "; --frame N draws another")
        )
    else:
        start, stop = at_rate(options, stage, start, stop)
    level = level_of(options)
    shot = Shot(
        stage.scene, start, stop, stage.size(), stage.rate, stage.fit(start, stop), stage.still, level,
        options.encoder, options.quality, options.context, options.gpu,
    )  # fmt: skip
    path = Path(options.output)
    shared = bool(options.resume or options.part or options.workers)
    if kind == ".png" or not (shared or (stop - start > LENGTH and kind in ("", *VIDEO))):
        return filmed_at_once(shot, stage, context, path, options)
    return filmed_in_parts(shot, stage, context, path, options)


def at_rate(options: argparse.Namespace, stage: Stage, start: int, stop: int) -> tuple[int, int]:
    """The film's frames for the frames start .. stop - 1 of the motion, at the rate asked for.

    A rate that no one asked for is at most FASTEST, the motion's divided by a whole number: every second, third ...
    frame as it is.
    """
    before = stage.rate
    rate = options.rate or (before if stage.scene.rate else before / math.ceil(before / FASTEST))
    if rate == before or (options.rate is None and options.frame is not None):
        return start, stop
    stage.film_at(rate)
    if options.rate is None:
        stage.notes.append(
            f"{stage.name}: {before:g} frames a second, filmed at {rate:g} (--rate {before:g} takes all)"
        )
    if stage.still is not None:
        return 0, stage.frames
    first, last = (min(math.ceil(frame * rate / before - 1e-6), stage.frames) for frame in (start, stop))
    if first >= last:
        raise AssetError(f"--rate {rate:g}: frames {start}:{stop} are shorter than one frame of the film")
    return first, last


def level_of(options: argparse.Namespace) -> int:
    """The level of detail that the options ask for."""
    if options.level is not None:
        return options.level
    return DRAFT_LEVEL if options.quality == "draft" else 0


def scene_of(options: argparse.Namespace) -> Scene:
    """The scene that the options ask for; those given go before what a scene file says."""
    if options.scene:
        from player.scenes.scene_file import read_scene

        scene = read_scene(options.scene)
    else:
        places = [beside(k, len(options.avatar)) for k in range(len(options.avatar))]
        avatars = tuple(
            SceneAvatar(
                path,
                options.motion,
                at=tuple(at.tolist()),
                hands=options.hands,
                ground=options.ground,
                body=options.body,
            )
            for path, at in zip(options.avatar, places, strict=True)
        )
        scene = Scene(avatars)
    if options.camera is not None:
        scene = replace(scene, cameras=(camera_from_option(options.camera),))
    if options.seconds is not None:
        camera = replace((scene.cameras or (SceneCamera(),))[0], seconds=options.seconds)
        scene = replace(scene, cameras=(camera,))
    scene = replace(scene, effects=with_effects(scene.effects, options))
    if options.size is not None:
        scene = replace(scene, size=options.size)
    if options.background is not None:
        scene = replace(scene, background=options.background)
    return scene


def effects_for(quality: str, effects: Effects, avatars: Sequence[Avatar]) -> Effects:
    """What a quality means for the effects that are left open."""
    if quality == "draft":
        view = "off" if effects.view == "auto" else effects.view
        return replace(effects, view=view, antialiasing=_unless_given(effects.antialiasing, "none"))
    if quality == "best":
        views = {avatar.default_view for avatar in avatars}
        view = views.pop() if effects.view == "auto" and len(views) == 1 else effects.view
        return replace(effects, view=view, antialiasing=_unless_given(effects.antialiasing, "msaa"))
    return effects


def _unless_given(value: str, otherwise: str) -> str:
    return otherwise if value == "auto" else value


def filmed_at_once(shot: Shot, stage: Stage, context: Context | None, path: Path, options: argparse.Namespace) -> int:
    """Draw straight into the file."""
    drawn = Set(shot, stage, context)
    try:
        began = time.perf_counter()
        film = drawn.film(path, progress(range(shot.start, shot.stop), "frames", shot.stop - shot.start))
        took = time.perf_counter() - began
        say(shot, stage, [*film.notes, how(drawn)])
        done(
            shot,
            path,
            f"drawn at {len_of(shot) / max(drawn.drawing, 1e-9):.0f} frames/s, written in {took:.1f} s",
        )
        if options.explain:
            explain(drawn.renderer, options.json)
    finally:
        drawn.release()
    return 0


def filmed_in_parts(shot: Shot, stage: Stage, context: Context | None, path: Path, options: argparse.Namespace) -> int:
    """Draw the parts that are missing, here or on a cluster, and join them when all are there."""
    kind = film_kind(path)
    tried: list[str] = []
    # chosen once, or two machines might choose differently
    if kind in VIDEO:
        from player.filming.encoder import chosen_encoder

        alpha = shot.transparent and kind != ".mp4"
        encoder, tried = chosen_encoder(kind, shot.encoder, shot.size, alpha=alpha)
        shot = replace(shot, encoder=encoder.name)
    shot = replace(shot, scene=with_whole_paths(shot.scene))
    parts = Parts(path, shot.start, shot.stop, shot.identity())
    parts.begin(resume=options.resume or options.part is not None)
    wanted = parts.share(*options.part) if options.part else parts.ranges
    missing = [part for part in parts.missing() if part in wanted]
    had = sum(b - a for a, b in wanted) - sum(b - a for a, b in missing)
    if had:
        print(f"{had} of {sum(b - a for a, b in wanted)} frames are in {parts.folder}")
    began, notes = time.perf_counter(), []
    try:
        if missing and options.workers:
            notes = drawn_by_workers(options.workers, shot, parts)
        elif missing:
            drawn = Set(shot, stage, context)
            try:
                frames = chain.from_iterable(range(*part) for part in missing)
                film = drawn.film(
                    path,
                    progress(frames, "frames", sum(b - a for a, b in missing)),
                    list(map(parts.piece, missing)),
                )
                notes = [*film.notes, how(drawn)]
                if options.explain:
                    explain(drawn.renderer, options.json)
            finally:
                drawn.release()
    except BaseException:
        there = len(parts.ranges) - len(parts.missing())
        if there:
            print(f"{there} of {len(parts.ranges)} parts are kept in {parts.folder}; the same command with "
                  f"--resume goes on", file=sys.stderr)  # fmt: skip
        else:
            parts.discard()
        raise
    say(shot, stage, notes)
    left = parts.missing()
    if options.part and left:
        print(f"{parts.folder}: share {options.part[0]} of {options.part[1]} is there, {len(left)} of "
              f"{len(parts.ranges)} parts are missing; --resume joins them")  # fmt: skip
        return 0
    join_pieces(list(map(parts.piece, parts.ranges)), path, shot.rate)
    parts.discard()
    done(shot, path, f"in {len(parts.ranges)} parts, written in {time.perf_counter() - began:.1f} s")
    return 0


def drawn_by_workers(address: str, shot: Shot, parts: Parts) -> list[str]:
    """Have a cluster draw the missing parts; what it has to say."""
    try:
        from player.filming.cluster import film_on
    except ModuleNotFoundError as error:
        raise AssetError(f"--workers needs the package {error.name!r}: pip install 'selfscan[cluster]'") from None

    missing = parts.missing()
    if address.isdecimal() and len(missing) < 2 * int(address):
        print(f"{counted(len(missing), 'part')} of at most {LENGTH} frames for {counted(int(address), 'worker')}: a "
              "film this short is drawn sooner without --workers")  # fmt: skip
    report, frames = Progress("frames", sum(b - a for a, b in missing)), 0
    notes: list[str] = []
    for (start, stop), drawn in film_on(address, shot, parts, parts.identity["files"]):
        frames += stop - start
        report.update(frames)
        notes += [line for line in (*drawn.notes, f"drawn by {drawn.renderer}") if line not in notes]
    return notes


def len_of(shot: Shot) -> int:
    return shot.stop - shot.start


def say(shot: Shot, stage: Stage, notes: Sequence[str]) -> None:
    for note in (*stage.notes, *notes):
        print(note)


def how(drawn: Set) -> str:
    return f"{drawn.context.attempts[-1]}; view {', '.join(drawn.renderer.views)}"


def done(shot: Shot, path: Path, rest: str) -> None:
    count = len_of(shot)
    width, height = shot.size
    if film_kind(path) in VIDEO:
        from player.filming.encoder import padded_size

        width, height = padded_size(shot.size)
    print(f"{path}: {counted(count, 'frame')}, {width}x{height}, {rest}")


def explain(renderer: Renderer, json_path: str | None) -> None:
    """Print and write the passes of the last frame."""
    rows = renderer.explain()
    for row in rows:
        cost = f"{row['ms']:8.2f} ms {row['bytes'] / 1e6:8.2f} MB"
        print(f"  {row['name']:24} {row['state']:13} {cost}  {row['why']}")
    if json_path:
        with whole_file(Path(json_path), "w") as file:
            json.dump({"passes": rows}, file, indent=1)
