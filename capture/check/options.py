"""`selfscan check`: what it is asked for, and its command line; the work is in capture/check/command.py."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from command.command_line import Help, Option, parse


@dataclass(frozen=True)
class CheckCommand:
    capture: Annotated[
        tuple[Path, ...], Option(positional=True, metavar="CAPTURE", several=True),
        "folder made by `selfscan synth` or `selfscan import`; or videos as filmed: a folder with body.mp4, head.mp4, "
        "left.mp4 and right.mp4 as far as they were filmed, the four files in that order, or the body's alone"
    ]
    out: Annotated[
        Path | None, Option(("-o", "--out"), "DIR"),
        "write DIR/check.json and, of a capture, DIR/overlays.png"
    ] = None
    keypoints: Annotated[
        Path | None, Option(metavar="DIR"),
        "of videos as filmed: keypoints in DIR/body, DIR/head, DIR/hand_left, DIR/hand_right (docs/"
        "capture.md: detectors), one for each frame (default: keypoints in the folder beside them)"
    ] = None
    json: Annotated[Path | None, Option(metavar="FILE"), "write everything measured and the verdict to FILE"] = None


ABOUT = Help(
    "selfscan check",
    """Look at a capture before training: does the posed template lie on the person in the video, are masks, units,
frames, sharpness and view directions sound? Ends in a verdict: usable; usable, but ...; not usable because ...
(exit code 1), each with what to do. Videos as filmed are looked at before any fit: is the person whole, alone and sharp
in them, does the camera stand still, is there an empty second?""",
    "example: selfscan check capture -o checked, then look at checked/overlays.png",
)


def main(argv: list[str]) -> int:
    """Parse the command line, examine, print; 1 when the capture is not usable."""
    arguments = parse(CheckCommand, argv, ABOUT)
    from capture.check.command import check_capture

    return check_capture(arguments)
