"""Arguments that several commands share: sizes, frame ranges, colours, hands."""

import argparse
import os
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

from avatar.motion.hands import HANDS
from command.command_line import Option, OptionGroup, Several
from command.settings import OneOf, color_of, rule_of, settings_of
from player.effects.background import Background
from player.effects.background_source import PICTURES
from player.scene.effects import Effects
from player.scene.scene import GROUNDS, Scene

# what is read as a picture; those of other formats are refused as one
PICTURE_ENDINGS = (*PICTURES, ".bmp", ".tif", ".tiff")

MOST_WORKERS = 256
QUALITIES = ("draft", "good", "best")


def refused(expected: str, found: str) -> argparse.ArgumentTypeError:
    """What a command line says of a text that is no value of an option."""
    return argparse.ArgumentTypeError(f"expected {expected}, found {found}")


def parse_size(text: str) -> tuple[int, int]:
    """WxH in pixels."""
    try:
        width, height = (int(part) for part in text.lower().split("x"))
    except ValueError:
        raise refused("WIDTHxHEIGHT, as 640x640", repr(text)) from None
    if not (1 <= width <= 16384 and 1 <= height <= 16384):
        raise refused("1 to 16384 pixels a side", text)
    return width, height


def parse_frames(text: str) -> tuple[int | None, int | None]:
    """A:B, either end may be left out; B is not drawn."""
    parts = text.split(":")
    try:
        start, stop = (int(part) if part else None for part in parts)
    except ValueError:
        raise refused("FIRST:END, as 0:120", repr(text)) from None
    if (start or 0) < 0 or (stop is not None and stop <= (start or 0)):
        raise refused("a first frame before the end", repr(text))
    return start, stop


def parse_background(text: str) -> Background:
    """#rrggbb, #rrggbbaa, transparent, or a file: a picture, a film or folder of frames, a panorama (.hdr)."""
    path = Path(text)
    if not text.startswith("#") and os.path.exists(path):
        suffix = path.suffix.lower()
        kind = "hdr" if suffix == ".hdr" else "image" if suffix in PICTURE_ENDINGS else "video"
        return Background(kind, path=text)
    color = color_of("#00000000" if text == "transparent" else f"#{text.removeprefix('#')}")
    if color is None:
        raise refused("#rrggbb, transparent or a file that is there", repr(text))
    return Background("transparent") if color[3] == 0 else Background("color", color)


def parse_gpu(text: str) -> int | str:
    """A number as CUDA counts, or a DRM node."""
    if text.startswith("/"):
        return text
    if not text.isdigit():
        raise refused("a number from 0 or a DRM node as /dev/dri/renderD128", repr(text))
    return int(text)


def parse_workers(text: str) -> str:
    """The address of a scheduler, its file, or a number of processes."""
    if text.isdecimal() and not (len(text) < 5 and 1 <= int(text) <= MOST_WORKERS):
        raise refused(f"1 to {MOST_WORKERS} processes, or an address", repr(text[:20]))
    return text


# groups in the help of render and play
WHO, FILM, CAMERA = OptionGroup("who and what"), OptionGroup("the film"), OptionGroup("the camera")
LOOKS, TIME, LIVE = OptionGroup("how it looks"), OptionGroup("how exact, and how fast"), OptionGroup("live poses")
MACHINE = OptionGroup("the machine and the window")

# options that several commands have
AvatarOption = Annotated[str, Option(positional=True, metavar="AVATAR"), "avatar file (.glb), or builtin"]
MotionOption = Annotated[str, Option(metavar="FILE"),
    "pose file (.npz, .pkl, .bvh, .glb, .json ...), folder of frames, or: counting, walking"]
FramesOption = Annotated[tuple[int | None, int | None] | None, Option(metavar="A:B", parse=parse_frames),
    "only frames A to B-1"]
BodyOption = Annotated[str | None, Option(metavar="MODEL"),
    "SMPL+H model (.npz, .pkl) that the pose file was made for"]
HandsOption = Annotated[str, OneOf(HANDS),
    "the motion's hands: file as they are (flat where there are none), flat, relaxed, or mean, the mean hands of "
    "--body"]
GroundOption = Annotated[str, OneOf(GROUNDS),
    "find: the motion is moved up or down so that the soles touch the ground; keep: the file's heights; auto: keep "
    "before a camera file or a capture, else find"]


def add_effects(add: Callable[..., None]) -> None:
    """An option for each field of the scene's effects that takes a word, and --effect for those that are tables."""
    tables = []
    for setting in settings_of(Effects):
        if setting.table is not None:
            tables.append(setting)
            continue
        known = rule_of(setting, OneOf)
        assert known is not None, f"effects.{setting.name} is a word of a list, or a table"
        group = LOOKS if setting.name == "view" else LOOKS.rare
        add(group, f"--{setting.name}", choices=known.values, help=f"{setting.means} (default: {setting.default})")
    names = [setting.name for setting in tables]
    means = "may be given several times; docs/scenes.md has their settings\n"
    means += "\n".join(f"{setting.name}: {setting.means}" for setting in tables)
    add(LOOKS, "--effect", action="append", choices=names, metavar="NAME", default=[], help=means)


def asked_effects(given: Mapping[str, Any]) -> dict[str, Any]:
    """What a command line asks of the effects, by field; an effect asked for by name has its usual settings."""
    words = {setting.name: given[setting.name] for setting in settings_of(Effects) if setting.table is None}
    tables = {setting.name: setting.table() for setting in settings_of(Effects) if setting.name in given["effect"]}
    return {name: value for name, value in (words | tables).items() if value is not None}


def with_effects(effects: Effects, asked: Mapping[str, Any]) -> Effects:
    """The effects with what is asked for; an effect that a scene has set up stays as it is."""
    tables = [setting for setting in settings_of(Effects) if setting.table is not None]
    set_up = {setting.name for setting in tables if setting.value_in(effects) is not None}
    return replace(effects, **{name: value for name, value in asked.items() if name not in set_up})


def with_options(scene: Scene, effects: Effects, size: tuple[int, int] | None, background: Background | None) -> Scene:
    """The scene with what a command says over it; a None is left to the scene."""
    return replace(scene, effects=effects, size=size or scene.size, background=background or scene.background)


EffectsOption = Annotated[
    Mapping[str, Any], LOOKS, Several(add_effects, asked_effects), "what is asked of the effects, by field"
]
