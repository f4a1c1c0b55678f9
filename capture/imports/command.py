"""`selfscan import`: real captures become capture folders."""

import argparse
from collections.abc import Sequence
from pathlib import Path

from avatar.body import read_body
from avatar.skeleton import PARTS
from capture.imports.easymocap import MOST_FRAMES, import_easymocap
from capture.imports.totalselfscan import import_totalselfscan


def main(argv: Sequence[str]) -> int:
    """The command line; see `selfscan import --help`."""
    parser = argparse.ArgumentParser(
        prog="selfscan import",
        description="Turn real self-scan videos, with the poses, masks and cameras that other tools made of them, "
        "into a capture folder. docs/capture.md says how to film and which tools to run.",
        epilog="then: selfscan check OUT && selfscan train OUT -o RUN",
    )
    kinds = parser.add_subparsers(dest="kind", required=True, metavar="KIND")
    released = kinds.add_parser(
        "totalselfscan",
        help="one subject of the paper's released data",
        description="One subject of the data that "
        "TotalSelfScan's authors released: annots.npy, params, lbs, face, hand/handl, hand/handr.",
    )
    released.add_argument("source", metavar="SRC", type=Path, help="the subject's folder")
    released.add_argument("out", metavar="OUT", type=Path, help="capture folder to write")
    released.add_argument(
        "--body", metavar="MODEL", type=Path, help="the SMPL+H model of the fits (.pkl, .npz), for its skin weights"
    )
    own = kinds.add_parser(
        "easymocap",
        help="your own videos, fitted with EasyMocap",
        description="Your own four videos: SMPL+H fits of body "
        "and hands by EasyMocap, head cameras by COLMAP, landmarks that you marked, masks. Folders: docs/capture.md.",
    )
    own.add_argument("source", metavar="SRC", type=Path, help="folder with body, head, hand_left, hand_right")
    own.add_argument("out", metavar="OUT", type=Path, help="capture folder to write")
    own.add_argument(
        "--body", metavar="MODEL", type=Path, required=True, help="the SMPL+H model of the fits (.pkl, .npz)"
    )
    own.add_argument("--head", metavar="COLMAP_DIR", type=Path, required=True, help="COLMAP model of the head video")
    own.add_argument(
        "--landmarks", metavar="FILE", type=Path, required=True, help="JSON: named pixels of the head video"
    )
    own.add_argument("--masks", metavar="DIR", type=Path, required=True, help="folder with masks of the four videos")
    for kind in (released, own):
        kind.add_argument(
            "--frames", type=int, default=MOST_FRAMES, metavar="N", help="most frames of a video (default %(default)s)"
        )
        kind.add_argument(
            "--select", action="append", default=[], metavar="PART=START:STEP:COUNT", help="the frames of one video, "
            "for example body=500:10:90; may be given for each",
        )  # fmt: skip
    options = parser.parse_args(argv)
    if options.frames < 1:
        parser.error(f"--frames should be at least 1, is {options.frames}")
    select = {}
    for text in options.select:
        part, _, numbers = text.partition("=")
        try:
            start, step, count = (int(number) for number in numbers.split(":"))
            if part not in PARTS or start < 0 or step < 1 or count < 1:
                raise ValueError
        except ValueError:
            parser.error(f"--select should be PART=START:STEP:COUNT with PART of {', '.join(PARTS)}, is {text!r}")
        select[part] = (start, step, count)
    body = read_body(options.body) if options.body else None
    if options.kind == "totalselfscan":
        notes = import_totalselfscan(options.source, options.out, body=body, most=options.frames, select=select)
    else:
        assert body is not None  # argparse requires --body here
        notes = import_easymocap(
            options.source, options.out, body=body, head=options.head, landmarks=options.landmarks, masks=options.masks,
            most=options.frames, select=select,
        )  # fmt: skip
    for note in notes:
        print(note)
    print(f"{options.out}: imported; `selfscan check {options.out}` says whether it can be used")
    return 0
