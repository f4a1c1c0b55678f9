"""`selfscan play`: avatars in a window, moved by files or by live poses."""

import argparse
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from typing import Annotated

import numpy as np

from avatar.baked_avatar import Avatar
from avatar.skeleton import PARTS
from command.command_line import Help, Option, parse
from command.errors import AssetError, missing_package
from command.interrupt import deferred_stop
from command.settings import AtLeast, OneOf
from files.whole import check_file
from player.budget.ladder import parse_budget
from player.effects.background import Background
from player.effects.contact import Contact
from player.effects.ground import Ground
from player.live.command import LiveCommand
from player.scene import arguments
from player.scene.address import FACE_SENDERS, PORTS, Address, parse_address
from player.scene.arguments import CAMERA, LOOKS, MACHINE, TIME, WHO
from player.scene.effects import Effects
from player.scene.scene import BUILTIN, Scene, SceneAvatar, SceneCamera, side_by_side
from player.window.actions import command_line_help

EXAMPLES = """examples
  selfscan play me.glb                                      the counting motion
  selfscan play me.glb you.glb --motion walk.bvh --motion counting
  selfscan play me.glb --capture my_capture                 against the video it was made from
  selfscan play me.glb --live vmc:39539                     posed by a sender
  selfscan play --scene two.toml                            as a scene file says
  selfscan play me.glb --follow                             while `selfscan make` works on it
  selfscan play me.glb --budget 8ms                         the best that takes 8 ms a frame
"""


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


@dataclass(frozen=True)
class PlayCommand:
    """`selfscan play`.

    Raises:
        ValueError: settings that exclude each other.
    """

    avatar: Annotated[tuple[str, ...], Option(positional=True, metavar="AVATAR", several=True),
        "avatar file (.glb), or builtin, the person that travels with the program (default); several stand side by "
        "side"] = ()
    scene: Annotated[str | None, WHO, Option(metavar="FILE"),
        "scene file (.toml) instead of AVATAR, --motion and --live"] = None
    motion: Annotated[tuple[str, ...], WHO, Option(metavar="FILE", repeated=True),
        "pose file, folder of frames, counting (default) or walking: one for all avatars, or once for each, in "
        "order"] = ()
    life: Annotated[bool, WHO.rare, Option(("--no-life",)),
        "faces rest where nothing moves them; else they blink, look at the camera, and bodies breathe"] = True
    speech: Annotated[str | None, WHO, Option(metavar="FILE.wav"), "a voice that moves its mouth, silently"] = None
    at: Annotated[
        tuple[tuple[float, float, float, float], ...], WHO.rare,
        Option(metavar="X,Y,Z[,DEG]", parse=parse_place, repeated=True),
        "where an avatar stands, metres, and how it is turned; once for each, in order"
    ] = ()
    capture: Annotated[str | None, WHO, Option(metavar="CAPTURE"),
        "look through the cameras of this capture, its video behind the avatar"] = None
    part: Annotated[str, WHO.rare, OneOf(PARTS), "which video of the capture"] = "body"
    camera_path: Annotated[str | None, CAMERA.rare, Option(metavar="FILE"),
        "a path of camera keys (.json) to look along"] = None
    follow: Annotated[bool, WHO,
        "show an avatar's file anew as soon as it is replaced: `selfscan make` writes a better one over the first"
    ] = False
    body: Annotated[arguments.BodyOption, WHO.rare] = None
    hands: Annotated[arguments.HandsOption, WHO.rare] = "file"
    ground: Annotated[arguments.GroundOption, WHO.rare] = "auto"
    size: Annotated[tuple[int, int] | None, MACHINE.rare, AtLeast(1), Option(metavar="WxH", parse=arguments.parse_size),
        "of the window (default: 1280x800)"] = None
    effects: arguments.EffectsOption = field(default_factory=dict)
    background: Annotated[Background | None, LOOKS, Option(metavar="#rrggbb|FILE", parse=arguments.parse_background),
        "colour (default #2b2d33), a picture, film or panorama (.hdr)"] = None
    budget: Annotated[float | None, TIME, Option(metavar="8ms", parse=parse_budget),
        "view mode and level are the most exact whose frames take no longer on this machine, and follow how "
        "busy it is"] = None
    floor: Annotated[bool, LOOKS, Option(("--no-floor",)),
        "without a scene: no floor, shadow and contact shadow at first"] = True
    gui: Annotated[bool, MACHINE.rare, Option(("--no-gui",)),
        "panels are hidden at first: keys and a line of text"] = True
    platform: Annotated[str, MACHINE.rare, OneOf(("auto", "null")),
        "null: no display, drawn by OSMesa in memory (for tests)"] = "auto"
    script: Annotated[str | None, MACHINE.rare, Option(metavar="WORDS"),
        "words done one a frame, as 'space . click:300:200'; then the window closes"] = None
    screenshot: Annotated[str | None, MACHINE.rare, Option(metavar="FILE"),
        "write the last frame shown to a .png"] = None
    source: Annotated[LiveCommand, "live poses"] = field(default_factory=LiveCommand)

    @property
    def people(self) -> tuple[str, ...]:
        """Who is shown where no scene file says it: without a word, the person that travels with the program."""
        return self.avatar or (BUILTIN,)

    def __post_init__(self):
        if self.screenshot and not self.screenshot.lower().endswith(".png"):
            raise ValueError(f"--screenshot: expected a name that ends in .png, found {self.screenshot!r}")
        if self.scene and self.avatar:
            raise ValueError("give AVATAR or --scene, one of them")
        live = self.source.live
        given = self.motion or live or self.at or self.body or self.speech
        if self.scene and (given or (self.hands, self.ground) != ("file", "auto")):
            raise ValueError("--motion, --live, --speech, --at, --body, --hands and --ground are in the scene file")
        if live is None and self.scene is None and self.source != LiveCommand():
            raise ValueError("--smooth, --calibrate and --record go with --live")
        if live is not None and (self.capture or (self.motion and live.kind not in FACE_SENDERS)):
            raise ValueError("give --motion or --capture or --live; a motion goes with a sender of a face alone")
        count = len(self.people)
        if self.motion and len(self.motion) not in (1, count):
            raise ValueError(f"--motion: expected one, or one for each of {count} avatars, found {len(self.motion)}")
        if self.at and len(self.at) != count:
            raise ValueError(f"--at: expected one for each of {count} avatars, found {len(self.at)}")


PLAY = Help(
    "selfscan play",
    "Avatars in a window: orbit, scrub, pick, film, compare with the video.",
    f"{EXAMPLES}\nh in the window lists keys and gestures; docs/play.md has more",
    command_line_help(),
)


def play_main(argv: list[str]) -> int:
    command = parse(PlayCommand, argv, PLAY)
    if command.screenshot:
        check_file(command.screenshot)
    try:
        return play_scene(scene_of(command), command)
    except ValueError as error:
        raise AssetError(str(error)) from None


def scene_of(command: PlayCommand) -> Scene:
    """The scene that the command asks for; its options override what a scene file says."""
    if command.scene:
        from player.scene.scene_file import read_scene

        scene = read_scene(command.scene)
    else:
        # the video of a capture has a floor of its own; what is behind would be hidden by one
        floor = command.floor and not command.capture
        ground = Ground(kind="shadow" if command.background and command.background.path else "plane")
        effects = Effects(ground=ground, contact=Contact()) if floor else Effects()
        scene = Scene(_avatars(command), effects=effects)
    cameras = list(scene.cameras)
    if command.camera_path:
        cameras.insert(0, SceneCamera("path", command.camera_path))
    if command.capture:
        cameras.insert(0, SceneCamera("capture", command.capture, command.part))
    scene, effects = replace(scene, cameras=tuple(cameras)), arguments.with_effects(scene.effects, command.effects)
    return arguments.with_options(scene, effects, command.size, command.background)


def _avatars(command: PlayCommand) -> tuple[SceneAvatar, ...]:
    motions = command.motion or (None if command.capture or command.source.live else "counting",)
    live = str(command.source.live) if command.source.live else None
    like = SceneAvatar(
        BUILTIN, live=live, hands=command.hands, ground=command.ground, body=command.body, speech=command.speech
    )
    return side_by_side(command.people, motions, command.at, like=like)


def play_scene(scene: Scene, command: PlayCommand) -> int:
    """Open the scene's files and sources, then the window.

    Raises:
        AssetError: a file cannot be read, or imgui-bundle is not installed.
    """
    from player.live.session import live_session
    from player.scene.opened import notes_of, opened_avatars, still_faces
    from player.window.recent import keep_recent
    from player.window.show import file_stamps, opened_show

    # an exception from a signal handler inside the initialisation of imgui-bundle would abort the process
    with deferred_stop() as stop:
        try:
            from player.window.window import play
        except ModuleNotFoundError as error:
            if (error.name or "").split(".")[0] != "imgui_bundle":
                raise
            raise missing_package("imgui-bundle", "gui", "selfscan play") from None
    stop.check()
    stamps = file_stamps(scene) if command.follow else None
    avatars = opened_avatars(scene)
    scene = with_life(scene, avatars, command.life and not command.capture)
    with ExitStack() as sources:
        live = [
            (sources.enter_context(live_session(address, command.source, [avatars[k] for k in indices])), indices)
            for address, indices in _addresses(scene, command)
        ]
        show = opened_show(scene, avatars, live, stamps)
        # a script is a test, or a film of the window
        opened = [command.scene] if command.scene else [*command.motion, *command.avatar]
        for path in opened if command.script is None else ():
            keep_recent(path)
        for note in (*notes_of(show.playback.tracks), *still_faces(show.playback.tracks, avatars)):
            print(note)
        return play(
            show, size=scene.size or (1280, 800), null=command.platform == "null", panels=command.gui,
            script=None if command.script is None else command.script.split(), screenshot=command.screenshot,
            budget=command.budget,
        )  # fmt: skip


def with_life(scene: Scene, avatars: Sequence[Avatar], wanted: bool) -> Scene:
    """The scene with life in every face, of those that a scene file leaves still too; unwanted, with none at all."""
    entries = enumerate(zip(scene.avatars, avatars, strict=True), 1)
    seeds = [entry.life if entry.life is not None else k if avatar.eyes else None for k, (entry, avatar) in entries]
    lives = [replace(entry, life=seed if wanted else None) for entry, seed in zip(scene.avatars, seeds, strict=True)]
    return replace(scene, avatars=tuple(lives))


def _addresses(scene: Scene, command: PlayCommand) -> list[tuple[Address, list[int]]]:
    """Each live source with the avatars it poses."""
    found: dict[Address, list[int]] = {}
    for index, entry in enumerate(scene.avatars):
        if entry.live is not None:
            found.setdefault(parse_address(entry.live, tuple(PORTS)), []).append(index)
    if len(found) > 1 and command.source.record:
        raise ValueError(f"--record writes one file; the scene has {len(found)} live sources")
    return list(found.items())
