"""`selfscan play`: avatars in a window, moved by a file or by live poses."""

import argparse
from collections.abc import Sequence

from avatar.avatar_file import read_avatar
from avatar.baked_avatar import Avatar
from avatar.errors import AssetError
from player.arguments import add_hands, parse_color, parse_size
from player.context import NoContextError
from player.effects import VIEWS
from player.live.command import add_live_options
from player.motions import beside, notes, opened_motion, retargeted, standing


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
