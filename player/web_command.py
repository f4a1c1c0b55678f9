"""`selfscan web`: one HTML page that draws an avatar by itself."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from avatar.baked_avatar import Avatar
from avatar.motion.clip import Motion
from command.command_line import Help, Option, parse
from command.errors import AssetError
from command.progress import plural
from command.settings import OneOf
from files.whole import check_file, write_text
from player.scene.arguments import AvatarOption, BodyOption, FramesOption, GroundOption, HandsOption, MotionOption
from player.scene.motions import frame_range, ground_for, motion_for
from player.scene.opened import opened_avatar

# what people call those whose names are for commands
PEOPLE = {"builtin:male": "The built-in man", "builtin:female": "The built-in woman"}

EXAMPLES = """examples
  selfscan web me.glb -o me.html                                  the counting motion
  selfscan web me.glb --motion walk.bvh --frames 0:600 -o me.html
  selfscan web me.glb --levels 1 -o small.html                    the finest level alone

The page needs a browser with WebGL 2 and nothing else: no network, no server, no other file. It draws with the shaders
of this program. Drag turns, wheel or pinch comes nearer, two fingers or the right button shift; space plays, comma and
full stop step, v changes the view mode, r resets, g hides everything but the picture. Settings stand in the URL after
the #, so that a link shows the same: view=network, level=1, frame=40, play=0, edges=0, bar=0, size=640x640, speed=.5,
azimuth, elevation, distance, x, y, z (radians, metres)."""


@dataclass(frozen=True)
class WebCommand:
    avatar: AvatarOption
    output: Annotated[Path, Option(("-o", "--output"), "PAGE"), "page to write (.html)"]
    motion: MotionOption = "counting"
    frames: FramesOption = None
    levels: Annotated[str, OneOf(("all", "1", "2", "3")), "how many levels of detail, the finest first"] = "all"
    title: Annotated[str | None, Option(metavar="TEXT"), "heading of the page (default: the person's name)"] = None
    body: BodyOption = None
    hands: HandsOption = "file"
    ground: GroundOption = "auto"

    def __post_init__(self):
        if self.output.suffix.lower() not in (".html", ".htm"):
            raise ValueError(f"-o: expected a name that ends in .html, found {str(self.output)!r}")


WRITES = "Write one page that draws an avatar in any browser with WebGL 2: offline, asking no one."
WEB = Help("selfscan web", WRITES, EXAMPLES)


def web_main(argv: list[str]) -> int:
    """Write the page."""
    command = parse(WebCommand, argv, WEB)
    check_file(command.output)
    avatar = opened_avatar(command.avatar, None if command.levels == "all" else int(command.levels))
    ground = ground_for(command.ground, ())
    motion = motion_for(avatar, command.motion, body=command.body, hands=command.hands, ground=ground)
    start, stop = frame_range(motion.name, motion.frames, command.frames)
    title = command.title or PEOPLE.get(avatar.name, avatar.name)
    written = write_page(command.output, avatar, motion, start, stop, title)
    for note in motion.notes:
        print(note)
    size = command.output.stat().st_size / 1e6
    print(f"{command.output}: {size:.1f} MB, {plural(stop - start, 'frame')}; {parts_summary(written)}")
    return 0


def write_page(path: Path, avatar: Avatar, motion: Motion, start: int, stop: int, title: str) -> dict[str, int]:
    """Write the page; the bytes of its parts.

    Raises:
        AssetError: it would be larger than a page may be, or the motion cannot be read.
    """
    from player.web.packing import MOTION_BYTES
    from player.web.page import MOST_BYTES, avatar_page

    # before a long motion is read at all
    if (stop - start) * MOTION_BYTES > MOST_BYTES:
        most = MOST_BYTES // MOTION_BYTES
        raise AssetError(f"{motion.name}: expected at most {most} frames on a page, found {stop - start}; --frames A:B")
    clip = motion.read(start, stop)
    text, written = avatar_page(avatar, clip, title)
    size = len(text.encode())
    if size > MOST_BYTES:
        found = f"{size / 1e6:.1f} ({parts_summary(written)})"
        advice = "fewer --frames, --levels 1, or bake with a smaller --texture"
        raise AssetError(f"{path}: expected at most {MOST_BYTES / 1e6:.0f} MB, found {found}; {advice}")
    write_text(path, text)
    return written


def parts_summary(written: dict[str, int]) -> str:
    """Where the bytes are, before a page writes them as text (4 letters for 3)."""
    kinds = {"mesh": "geometry", "color": "base color", "features": "features", "motion": "motion", "face": "face"}
    sums = dict.fromkeys(kinds.values(), 0)
    for name, size in written.items():
        sums[kinds[name.rsplit(".", 1)[-1]]] += size
    return ", ".join(f"{words} {size / 1e6:.2f} MB" for words, size in sums.items() if size)
