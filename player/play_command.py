"""`selfscan play`: avatars in a window, moved by files or by live poses."""

import argparse
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from avatar.baked_avatar import Avatar
from avatar.errors import AssetError
from avatar.skeleton import PARTS
from player.address import Address, parse_address
from player.arguments import add_effects, add_ground, add_hands, parse_background, parse_size, with_effects
from player.context import NoContextError
from player.live.command import add_live_options
from player.motions import beside
from player.scenes.scene import Scene, SceneAvatar, SceneCamera
from player.window.help import command_line_help

if TYPE_CHECKING:
    from player.gui.panels import Panels
    from player.window.parts import Parts

EXAMPLES = """examples
  selfscan play me.glb                                      the counting motion
  selfscan play me.glb you.glb --motion walk.bvh --motion counting
  selfscan play me.glb --capture my_capture                 against the video it was made from
  selfscan play me.glb --live vmc:39539                     posed by a sender
  selfscan play --scene two.toml                            as a scene file says
"""


def play_parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="selfscan play",
        description="Avatars in a window: orbit, scrub, pick, film, compare with the video.",
        epilog=f"{EXAMPLES}\n{command_line_help()}\ndocs/play.md has more",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("avatar", nargs="*", metavar="AVATAR", help="avatar file (.glb); several stand side by side")
    parser.add_argument("--scene", metavar="FILE", help="scene file (.toml) instead of AVATAR, --motion and --live")
    parser.add_argument("--motion", action="append", metavar="FILE",
                        help="pose file, EasyMocap folder, counting (default) or walking: one for all avatars, or "
                        "once for each, in order")  # fmt: skip
    parser.add_argument(
        "--at",
        type=parse_place,
        action="append",
        metavar="X,Y,Z[,DEG]",
        help="where an avatar stands, metres, and how it is turned; once for each, in order",
    )
    parser.add_argument("--capture", metavar="CAPTURE",
                        help="look through the cameras of this capture, its video behind the avatar")  # fmt: skip
    parser.add_argument("--part", choices=PARTS, default="body", help="which video of the capture (default: body)")
    parser.add_argument("--camera-path", metavar="FILE", help="a path of camera keys (.json) to look along")
    parser.add_argument("--body", metavar="MODEL", help="SMPL+H model (.npz, .pkl) that the pose file was made for")
    add_hands(parser)
    add_ground(parser)
    parser.add_argument("--size", type=parse_size, metavar="WxH", help="of the window (default: 1280x800)")
    add_effects(parser)
    parser.add_argument("--background", type=parse_background, metavar="#rrggbb|FILE",
                        help="colour (default #2b2d33), a picture, film or panorama (.hdr)")  # fmt: skip
    parser.add_argument("--no-gui", action="store_true",
                        help="no panels, only keys and a line of text (as without imgui-bundle)")  # fmt: skip
    parser.add_argument("--platform", choices=("auto", "null"), default="auto",
                        help="null: no display, drawn by OSMesa in memory (for tests)")  # fmt: skip
    parser.add_argument("--script", metavar="WORDS",
                        help="words done one a frame, as 'space . click:300:200'; then the window closes")  # fmt: skip
    parser.add_argument("--screenshot", metavar="FILE", help="write the last frame shown to a .png")
    add_live_options(parser)
    return parser


def parse_place(text: str) -> tuple[float, float, float, float]:
    """X,Y,Z and, where given, degrees about the vertical."""
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) not in (3, 4) or not np.isfinite(values).all():
        raise argparse.ArgumentTypeError(f"expected X,Y,Z or X,Y,Z,DEGREES, found {text!r}")
    x, y, z, *turn = values
    return x, y, z, turn[0] if turn else 0.0


def play_main(argv: list[str]) -> int:
    """Open the window."""
    parser = play_parser()
    options = parser.parse_args(argv)
    check_options(parser, options)
    script = options.script.split() if options.script is not None else None
    try:
        return play_scene(scene_of(options), options, script)
    except (ValueError, NoContextError) as error:
        raise AssetError(str(error)) from None


def check_options(parser: argparse.ArgumentParser, options: argparse.Namespace) -> None:
    """Stop with a usage message where options exclude each other."""
    if bool(options.scene) == bool(options.avatar):
        parser.error("give AVATAR or --scene")
    if options.scene and (
        options.motion
        or options.live
        or options.at
        or options.body
        or (options.hands, options.ground) != ("file", "auto")
    ):
        parser.error("--motion, --live, --at, --body, --hands and --ground are in the scene file")
    if (
        options.live is None
        and options.scene is None
        and any(
            value is not None
            for value in (options.smooth, options.buffer, options.calibrate, options.record, options.latency)
        )
    ):
        parser.error("--smooth, --buffer, --calibrate, --record and --latency go with --live")
    if options.live is not None and (options.motion or options.capture):
        parser.error("give --motion or --capture or --live")
    count = len(options.avatar)
    for name, values in (("--motion", options.motion), ("--at", options.at)):
        if values and len(values) not in (1, count):
            parser.error(f"{name}: expected one, or one for each of {count} avatars, found {len(values)}")


def scene_of(options: argparse.Namespace) -> Scene:
    """The scene that the options ask for; those given go before what a scene file says."""
    if options.scene:
        from player.scenes.scene_file import read_scene

        scene = read_scene(options.scene)
    else:
        scene = Scene(_avatars(options))
    cameras = list(scene.cameras)
    if options.camera_path:
        cameras.insert(0, SceneCamera("path", options.camera_path))
    if options.capture:
        cameras.insert(0, SceneCamera("capture", options.capture, options.part))
    return replace(
        scene, cameras=tuple(cameras), effects=with_effects(scene.effects, options), size=options.size or scene.size,
        background=options.background or scene.background,
    )  # fmt: skip


def _avatars(options: argparse.Namespace) -> tuple[SceneAvatar, ...]:
    count = len(options.avatar)
    motions = options.motion or [None if options.capture or options.live else "counting"]
    live = str(options.live) if options.live else None
    avatars = []
    for k, path in enumerate(options.avatar):
        x, y, z, turn = (*beside(k, count).tolist(), 0.0)
        if options.at and (len(options.at) > 1 or count == 1):
            x, y, z, turn = options.at[k]
        motion = motions[k % len(motions)]
        avatars.append(
            SceneAvatar(
                path, motion, live, (x, y, z), turn, hands=options.hands, ground=options.ground, body=options.body
            )
        )
    return tuple(avatars)


def play_scene(scene: Scene, options: argparse.Namespace, script: Sequence[str] | None) -> int:
    """Open the scene's files and sources, then the window."""
    from player.scenes.opened import opened_avatars
    from player.window.show import opened_show

    # glfw only when a window is asked for
    from player.window.window import play

    avatars = opened_avatars(scene)
    with ExitStack() as sources:
        live = [
            (sources.enter_context(_listening(address, options, [avatars[k] for k in indices])), indices)
            for address, indices in _addresses(scene, options)
        ]
        show = opened_show(scene, avatars, live)
        for note in show.notes:
            print(note)
        return play(
            show, size=scene.size or (1280, 800), null=options.platform == "null",
            panels=None if options.no_gui else installed_panels(), script=script, screenshot=options.screenshot,
        )  # fmt: skip


def installed_panels() -> "Callable[[Parts], Panels] | None":
    """What makes the panels; None where imgui-bundle is not installed: then there are keys and a line of text."""
    try:
        from player.gui.panels import Panels
    except ModuleNotFoundError as error:
        if (error.name or "").split(".")[0] != "imgui_bundle":
            raise
        return None
    return Panels


def _addresses(scene: Scene, options: argparse.Namespace) -> list[tuple[Address, list[int]]]:
    """Each live source with the avatars it poses."""
    found: dict[Address, list[int]] = {}
    for index, entry in enumerate(scene.avatars):
        if entry.live is not None:
            found.setdefault(parse_address(entry.live, ("vmc", "udp", "ws")), []).append(index)
    if len(found) > 1 and (options.record or options.latency):
        raise ValueError(f"--record and --latency write one file; the scene has {len(found)} live sources")
    return list(found.items())


def _listening(address: Address, options: argparse.Namespace, avatars: Sequence[Avatar]):
    from player.live.session import LiveOptions, live_session

    asked = LiveOptions(
        address, smooth=options.smooth, buffer=options.buffer, record=options.record, latency=options.latency,
        calibrate_after=options.calibrate,
    )  # fmt: skip
    return live_session(asked, avatars, [np.zeros(3)] * len(avatars))  # places are the scene's
