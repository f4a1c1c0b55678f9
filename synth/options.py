"""`selfscan synth`: what it is asked for, and its command line; the work is in synth/command.py."""

import shlex
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from command.command_line import Help, Option, parse
from command.settings import AtLeast, AtMost, OneOf, settings

MODES = ("even", "soft", "fixed", "varied", "room")


@settings
class SynthConfig:
    """How a self-scan is filmed."""

    size: Annotated[int | None, AtLeast(32), AtMost(4096),
        "pixels, both sides of every video (default: 256); with --raw the shorter side (1080)"] = None
    frames: Annotated[int, AtLeast(4), AtMost(100_000), "frames in each of the four videos"] = 40
    light: Annotated[str | None, OneOf(MODES),
        "even: base colour; soft: .75 ambient + .25 key; fixed: .45 + .55 and a highlight; varied: another light in "
        "each video; room: a window, a lamp, shadows and a camera's exposure (default: even; with --raw room)"] = None
    sheen: Annotated[float, AtLeast(0), AtMost(1), Option(metavar="0..1"), "view-dependent shine"] = 0.0
    pose_noise: Annotated[float, AtLeast(0), AtMost(30), Option(metavar="DEG"),
        "noise on the poses as written, degrees"] = 0.0
    seed: Annotated[int, AtLeast(0), AtMost(2**32 - 1), "of everything drawn by chance"] = 0
    template: Annotated[str, OneOf(("registered", "shape")),
        "registered: the free body laid onto the person's surface, with the person's joints and hair; shape: its shape "
        "coefficients alone, with the joints that they have"] = "registered"
    truth: Annotated[bool, Option(("--no-truth",)), "leave out held-out pictures and the subject's mesh"] = True
    truth_every: Annotated[int, AtLeast(1), AtMost(10), Option(metavar="N"),
        "of the 20 held-out poses and 10 views film only every N-th"] = 1


@settings
class RawConfig:
    """How a phone films it."""

    raw: Annotated[bool, "four videos as a phone writes them, and nothing else; the truth apart in OUT/truth"] = False
    keypoints: Annotated[bool, "with --raw: OpenPose's keypoints of every frame, with a detector's mistakes"] = False
    face_film: Annotated[bool,
        "with --raw: a fifth film, face.mp4, of a built-in person who says ah, smiles, moves brows, blinks, looks aside"
        ] = False
    held_out: Annotated[bool,
        "with --raw: film the 120 held-out pictures too, which selfscan eval measures against"] = False
    seconds: Annotated[float, AtLeast(1), AtMost(600), Option(metavar="S"),
        "with --raw: of the turn in each video; 2.4 s come before"] = 20.0
    keypoint_noise: Annotated[float, AtLeast(0), AtMost(100), Option(metavar="PX"),
        "deviation of a keypoint, pixels of 1080"] = 4.0
    keypoint_bias: Annotated[float, AtLeast(0), AtMost(10), Option(metavar="CM"),
        "how far off its joint a body's keypoint stays"] = 1.0
    sway: Annotated[float, AtLeast(0), AtMost(3), Option(metavar="0..3"), "how much the person sways; 0: stiff"] = 1.0
    camera_noise: Annotated[float, AtLeast(0), AtMost(5), Option(metavar="0..5"),
        "noise and rolling exposure of the phone; 0: none"] = 1.0


@dataclass(frozen=True)
class SynthCommand:
    """`selfscan synth`."""

    subject: Annotated[str, Option(positional=True, metavar="SUBJECT"),
        "builtin, builtin:female, builtin:SEED (a dressed person drawn from that number), or a rigged humanoid .glb, "
        ".gltf, .vrm"]
    out: Annotated[Path, Option(positional=True, metavar="OUT"),
        "capture folder to write; replaced if synth wrote it before"]
    config: Annotated[SynthConfig, "how it is filmed"]
    raw: Annotated[RawConfig, "how a phone films it"]

    def __post_init__(self):
        if self.raw != RawConfig() and not self.raw.raw:
            raise ValueError("--keypoints, --face-film, --held-out, --seconds and what follows it go with --raw")
        if self.raw.raw and (self.config.frames, self.config.pose_noise, self.config.template) != (40, 0, "registered"):
            raise ValueError("--frames, --pose-noise and --template are of a capture: leave --raw out")


ABOUT = Help(
    "selfscan synth",
    """Film a self-scan of a person whose mesh is known: four videos (body turning in a T-pose, head, each hand) with
masks, cameras and poses, the registered template, and held-out pictures to measure with. With --raw four video files
as a phone writes them, for `selfscan import video`: a room behind, noise, a person who sways.""",
    "example: selfscan synth builtin capture && selfscan train capture -o run",
)


def main(argv: Sequence[str]) -> int:
    """The command line; see `selfscan synth --help`."""
    command = parse(SynthCommand, argv, ABOUT)
    from synth.command import synth, synth_raw

    began = time.monotonic()
    if command.raw.raw:
        synth_raw(command.subject, command.out, command.config, command.raw)
    else:
        synth(command.subject, command.out, command.config)
    videos = "five" if command.raw.raw and command.raw.face_film else "four"
    print(f"{command.out}: {videos} videos in {time.monotonic() - began:.0f} s")
    verb, product = ("make", "NAME.glb") if command.raw.raw else ("train", "RUN")
    print(f"then: {shlex.join(['selfscan', verb, str(command.out), '-o', product])}")
    return 0
