"""`selfscan render`, `selfscan play` and `selfscan doctor`."""

import argparse
import json
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from avatar.avatar_file import read_avatar
from avatar.baked_avatar import Avatar
from avatar.body import read_body
from avatar.camera import Camera, read_camera
from avatar.errors import AssetError
from avatar.files import whole_file
from avatar.hands import HANDS, with_hands
from avatar.motion import Clip, Motion, fitted, read_motion
from avatar.progress import progress
from player.context import Context, NoContextError, open_context
from player.film import Film, film_kind
from player.framing import extent, facing, fitted_camera, orbit, outermost, pelvis_height
from player.live.command import add_live_options
from player.plan import VIEWS
from player.renderer import Pose, Renderer

BLOCK = 256  # frames read at once: memory does not grow with the film
SPACING = 1.0  # metres between several avatars, side by side

RENDER_EXAMPLES = """examples
  selfscan render me.glb --motion counting -o counting.mp4
  selfscan render me.glb --motion walk.bvh --camera orbit --size 1280x720 -o walk.mp4
  selfscan render me.glb --motion walk.npz --frames 100:200 --background transparent -o frames/
  selfscan render me.glb --motion walk.npz --frame 12 --explain -o frame.png

OUT is .png (one frame), .mp4, .webm, .mov, .gif, .webp, or a folder for PNG frames."""


def parse_size(text: str) -> tuple[int, int]:
    """WxH in pixels."""
    try:
        width, height = (int(part) for part in text.lower().split("x"))
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected WIDTHxHEIGHT, as 640x640, found {text!r}") from None
    if not (1 <= width <= 16384 and 1 <= height <= 16384):
        raise argparse.ArgumentTypeError(f"expected 1 to 16384 pixels a side, found {text}")
    return width, height


def parse_frames(text: str) -> tuple[int | None, int | None]:
    """A:B, either end may be left out; B is not drawn."""
    parts = text.split(":")
    try:
        start, stop = (int(part) if part else None for part in parts)
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected FIRST:END, as 0:120, found {text!r}") from None
    if (start or 0) < 0 or (stop is not None and stop <= (start or 0)):
        raise argparse.ArgumentTypeError(f"expected a first frame before the end, found {text!r}")
    return start, stop


def parse_color(text: str) -> tuple[float, float, float, float]:
    """#rrggbb or "transparent", as premultiplied RGBA."""
    if text == "transparent":
        return (0.0, 0.0, 0.0, 0.0)
    digits = text.removeprefix("#")
    if len(digits) != 6 or any(digit not in "0123456789abcdefABCDEF" for digit in digits):
        raise argparse.ArgumentTypeError(f"expected #rrggbb or transparent, found {text!r}")
    red, green, blue = (int(digits[i : i + 2], 16) / 255 for i in (0, 2, 4))
    return (red, green, blue, 1.0)


def frame_number(text: str) -> int:
    if not text.isdigit():
        raise argparse.ArgumentTypeError(f"expected a frame number from 0, found {text!r}")
    return int(text)


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


def add_hands(parser: argparse.ArgumentParser) -> None:
    """The option --hands."""
    parser.add_argument("--hands", choices=HANDS, default="file",
                        help="the motion's hands: file as they are (flat where there are none), flat, relaxed, or "
                        "mean, the mean hands of --body")  # fmt: skip


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


def opened(kind: str, gpu: int | None) -> Context:
    """A context, or one line about why there is none."""
    try:
        return open_context(kind, gpu)
    except NoContextError as error:
        raise AssetError(str(error)) from None


def opened_motion(source: str | None, body: str | None, hands: str = "file") -> Motion:
    """The motion with the hands asked for, or one frame of T-pose."""
    model = read_body(body) if body else None
    if source is None:
        note = "no --motion: one frame, T-pose"

        def block(start: int, stop: int) -> tuple[np.ndarray, np.ndarray]:
            return np.zeros((stop - start, 52, 3)), np.zeros((stop - start, 3))

        return with_hands(Motion("T-pose", 1, 30.0, (note,), block), hands, model)
    motion = read_motion(source, body=model)
    if motion.frames < 1:
        raise AssetError(f"{source}: expected at least one frame, found none")
    return with_hands(motion, hands, model)


def frame_range(
    motion: Motion, frame: int | None, frames: tuple[int | None, int | None] | None, *, single: bool
) -> tuple[int, int]:
    """First frame and end, checked against the motion."""
    if frame is None and frames is None:
        return (0, 1) if single else (0, motion.frames)
    start, stop = (frame, frame + 1) if frame is not None else frames or (None, None)
    start, stop = start or 0, motion.frames if stop is None else stop
    if stop > motion.frames or start >= stop:
        asked = f"frame {start}" if stop == start + 1 else f"frames {start}:{stop}"
        raise AssetError(
            f"{motion.name}: {asked} asked for, it has {motion.frames} (0 to {motion.frames - 1})"
        )
    return start, stop


def retargeted(motion: Motion, avatar: Avatar) -> Callable[[int, int], Clip]:
    """Stretches of the motion with the root scaled to this avatar's legs."""
    height = pelvis_height(avatar)

    def read(start: int, stop: int) -> Clip:
        return fitted(motion.read(start, stop), height)

    return read


def notes(clips: Sequence[Callable[[int, int], Clip]], start: int) -> list[str]:
    """What was assumed in reading the motion and fitting it to each avatar, each said once."""
    return list(dict.fromkeys(note for clip in clips for note in clip(start, start + 1).notes))


def posed_frames(
    clips: Sequence[Callable[[int, int], Clip]], start: int, stop: int
) -> Iterator[tuple[int, list[Pose]]]:
    """Frame numbers with one pose per avatar, read in blocks."""
    for first in range(start, stop, BLOCK):
        blocks = [clip(first, min(first + BLOCK, stop)) for clip in clips]
        for i in range(len(blocks[0].root)):
            yield (
                first + i,
                [
                    (block.axis_angle[i], block.root[i] + beside(k, len(blocks)))
                    for k, block in enumerate(blocks)
                ],
            )


def beside(index: int, count: int) -> np.ndarray:
    """Where avatar `index` of `count` stands, metres."""
    return np.array([(index - 0.5 * (count - 1)) * SPACING, 0.0, 0.0])


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


def play_main(argv: list[str]) -> int:
    """Open the window."""
    parser = argparse.ArgumentParser(
        prog="selfscan play",
        description="An avatar in a window: drag to orbit, wheel to come nearer.",
        epilog="keys  space play/pause   , . one frame back/on   left right one second   home end   "
        "r reset camera   f follow   v view dependence   s screenshot   h help line   q quit   t T-pose (--live)",
    )
    parser.add_argument(
        "avatar", nargs="+", metavar="AVATAR", help="avatar file (.glb); several stand side by side"
    )
    parser.add_argument(
        "--motion", metavar="FILE", help="pose file, EasyMocap folder, or: counting (default), walking"
    )
    parser.add_argument(
        "--body", metavar="MODEL", help="SMPL+H model (.npz, .pkl) that the pose file was made for"
    )
    add_hands(parser)
    parser.add_argument("--size", type=parse_size, default=(960, 720), metavar="WxH")
    parser.add_argument("--view", choices=("auto", *VIEWS), default="auto")
    parser.add_argument("--background", type=parse_color, default=parse_color("#2b2d33"), metavar="#rrggbb")
    parser.add_argument("--platform", choices=("auto", "null"), default="auto",
                        help="null: no display, drawn by OSMesa in memory (for tests)")  # fmt: skip
    parser.add_argument(
        "--script",
        metavar="KEYS",
        help="keys pressed one a frame, as 'space . . right'; then the window closes",
    )
    parser.add_argument("--screenshot", metavar="FILE", help="write the last frame shown to a .png")
    add_live_options(parser)
    options = parser.parse_args(argv)
    if options.live is None and any(
        value is not None
        for value in (options.smooth, options.buffer, options.calibrate, options.record, options.latency)
    ):
        parser.error("--smooth, --buffer, --calibrate, --record and --latency go with --live")
    if options.live is not None and options.motion is not None:
        parser.error("give --motion or --live")
    from player.window import play  # glfw only when a window is asked for

    avatars = [read_avatar(path) for path in options.avatar]
    if options.live is not None:
        return play_live(avatars, options)
    motion = opened_motion(options.motion or "counting", options.body, options.hands)
    clips = [retargeted(motion, avatar) for avatar in avatars]
    for note in notes(clips, 0):
        print(note)
    try:
        return play(
            avatars, motion, clips, size=options.size, view=options.view, background=options.background,
            null=options.platform == "null", beside=[beside(k, len(avatars)) for k in range(len(avatars))],
            script=options.script.split() if options.script is not None else None, screenshot=options.screenshot,
        )  # fmt: skip
    except (ValueError, NoContextError) as error:
        raise AssetError(str(error)) from None


def play_live(avatars: Sequence[Avatar], options: argparse.Namespace) -> int:
    """The window, posed by what arrives; the avatars stand in T-pose until something does."""
    from player.live.session import LiveOptions, live_session
    from player.window import play

    places = [beside(k, len(avatars)) for k in range(len(avatars))]
    motion = opened_motion(None, None)
    clips = [standing(avatar) for avatar in avatars]
    asked = LiveOptions(
        options.live, smooth=options.smooth, buffer=options.buffer, record=options.record,
        latency=options.latency, calibrate_after=options.calibrate,
    )  # fmt: skip
    script = options.script.split() if options.script is not None else None
    try:
        with live_session(asked, avatars, places) as live:
            return play(
                avatars, motion, clips, size=options.size, view=options.view, background=options.background,
                null=options.platform == "null", beside=places, script=script, screenshot=options.screenshot,
                live=live,
            )  # fmt: skip
    except (ValueError, NoContextError) as error:
        raise AssetError(str(error)) from None


def standing(avatar: Avatar) -> Callable[[int, int], Clip]:
    """Frames of T-pose with the soles on the ground."""
    height = pelvis_height(avatar)

    def read(start: int, stop: int) -> Clip:
        count = stop - start
        return Clip(np.zeros((count, 52, 3)), np.tile([0.0, height, 0.0], (count, 1)), 30.0)

    return read


def doctor_main(argv: list[str]) -> int:
    """Print what this machine can draw with."""
    parser = argparse.ArgumentParser(
        prog="selfscan doctor",
        description="Which OpenGL contexts work here, which one wins and why, and what is missing.",
    )
    parser.add_argument(
        "--compare", action="store_true", help="draw one frame on EGL and on OSMesa and compare them"
    )
    parser.add_argument("--json", metavar="FILE", help="write the findings to a file")
    options = parser.parse_args(argv)
    from player.doctor import compare, findings, report

    found = findings()
    print(report(found))
    worked = found["winner"] is not None
    if options.compare:
        result = compare()
        found["compare"] = result
        print(result["text"])
        worked = worked and result["equal"]
    if options.json:
        with whole_file(Path(options.json), "w") as file:
            json.dump(found, file, indent=1)
    return 0 if worked else 1
