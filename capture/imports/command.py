"""`selfscan import`: real captures, read into capture folders."""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from avatar.body import read_body
from avatar.files import check_folder
from avatar.settings import AtLeast, AtMost, Help, Option, parse
from avatar.skeleton import PARTS
from capture.imports.easymocap import MOST_FRAMES, import_easymocap
from capture.imports.totalselfscan import import_totalselfscan


def parse_selection(text: str) -> tuple[str, tuple[int, int, int]]:
    """PART=START:STEP:COUNT."""
    part, _, numbers = text.partition("=")
    try:
        start, step, count = (int(number) for number in numbers.split(":"))
        if part not in PARTS or start < 0 or step < 1 or count < 1:
            raise ValueError
    except ValueError:
        expected = f"expected PART=START:STEP:COUNT with PART of {', '.join(PARTS)}"
        raise argparse.ArgumentTypeError(f"{expected}, found {text!r}") from None
    return part, (start, step, count)


@dataclass(frozen=True)
class Frames:
    """Which frames of the videos are taken."""

    frames: Annotated[int, AtLeast(1), AtMost(1_000_000), "most frames of a video"] = MOST_FRAMES
    select: Annotated[
        tuple[tuple[str, tuple[int, int, int]], ...],
        Option(metavar="PART=START:STEP:COUNT", parse=parse_selection, repeated=True),
        "the frames of one video, for example body=500:10:90; may be given for each",
    ] = ()


@dataclass(frozen=True)
class TotalSelfScanCommand:
    """`selfscan import totalselfscan`."""

    source: Annotated[Path, Option(positional=True, metavar="SRC"), "the subject's folder"]
    out: Annotated[Path, Option(positional=True, metavar="OUT"), "capture folder to write"]
    frames: Annotated[Frames, "which frames are taken"]
    body: Annotated[
        Path | None, Option(metavar="MODEL"), "the SMPL+H model of the fits (.pkl, .npz), for its skin weights"
    ] = None


@dataclass(frozen=True)
class EasyMocapCommand:
    """`selfscan import easymocap`."""

    source: Annotated[Path, Option(positional=True, metavar="SRC"), "folder with body, head, hand_left, hand_right"]
    out: Annotated[Path, Option(positional=True, metavar="OUT"), "capture folder to write"]
    body: Annotated[Path, Option(metavar="MODEL"), "the SMPL+H model of the fits (.pkl, .npz)"]
    head: Annotated[Path, Option(metavar="COLMAP_DIR"), "COLMAP model of the head video"]
    landmarks: Annotated[Path, Option(metavar="FILE"), "JSON: named pixels of the head video"]
    masks: Annotated[Path, Option(metavar="DIR"), "folder with masks of the four videos"]
    frames: Annotated[Frames, "which frames are taken"]


KINDS = """usage: selfscan import KIND ...

Turn real self-scan videos, with the poses, masks and cameras that other tools made of them, into a capture folder.
docs/capture.md says how to film and which tools to run.

  totalselfscan SRC OUT   one subject of the paper's released data
  easymocap SRC OUT       your own videos, fitted with EasyMocap

`selfscan import KIND --help` explains each; then: selfscan check OUT && selfscan train OUT -o RUN
"""
RELEASED = Help(
    "selfscan import totalselfscan",
    """One subject of the data that TotalSelfScan's authors released: annots.npy, params, lbs, face, hand/handl,
hand/handr.""",
)
OWN = Help(
    "selfscan import easymocap",
    """Your own four videos: SMPL+H fits of body and hands by EasyMocap, head cameras by COLMAP, landmarks that you
marked, masks. Folders: docs/capture.md.""",
)


def main(argv: Sequence[str]) -> int:
    """The command line; see `selfscan import --help`."""
    kind, rest = (argv[0], argv[1:]) if argv else ("", ())
    if kind in ("-h", "--help"):
        print(KINDS, end="")
        return 0
    if kind == "totalselfscan":
        command = parse(TotalSelfScanCommand, rest, RELEASED)
        check_folder(command.out)
        body = read_body(command.body) if command.body else None
        notes = import_totalselfscan(
            command.source, command.out, body=body, most=command.frames.frames, select=dict(command.frames.select)
        )
    elif kind == "easymocap":
        command = parse(EasyMocapCommand, rest, OWN)
        check_folder(command.out)
        notes = import_easymocap(
            command.source,
            command.out,
            body=read_body(command.body),
            head=command.head,
            landmarks=command.landmarks,
            masks=command.masks,
            most=command.frames.frames,
            select=dict(command.frames.select),
        )
    else:
        parser = argparse.ArgumentParser(prog="selfscan import", usage="selfscan import KIND ...")
        parser.error(f"KIND: expected totalselfscan or easymocap, found {kind or 'nothing'}")
    for note in notes:
        print(note)
    print(f"{command.out}: imported; `selfscan check {command.out}` says whether it can be used")
    return 0
