"""`selfscan train`: its options, written once for command line, help and checks, and the command itself.

torch is imported only after the command line was read.
"""

import shlex
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from command.command_line import Help, Option, parse
from command.errors import AssetError
from command.interrupt import Stopped
from command.settings import AtLeast, AtMost, OneOf
from files.whole import check_apart

MOST_STEPS = 100_000_000
# the presets of train/preset.py, which needs torch: a command line is read without it
PRESET_NAMES = ("demo", "fast", "paper", "preview", "head")
ITEM_NAMES = ("light", "hair", "clothes", "eyes")


@dataclass(frozen=True, kw_only=True)
class TrainOptions:
    """One training: which capture, into which folder, and how."""

    capture: Annotated[
        Path, Option(positional=True, metavar="CAPTURE"), "folder made by `selfscan synth` or `selfscan import`"
    ]
    out: Annotated[Path, Option(("-o", "--out"), metavar="RUN"), "run folder to write, whole or not at all"]
    preset: Annotated[str, OneOf(PRESET_NAMES), "see above"] = "demo"
    device: Annotated[Literal["cpu", "cuda"], "where to compute"] = "cpu"
    resume: Annotated[bool, "go on from the checkpoints of an interrupted training"] = False
    force: Annotated[bool, "begin anew; an existing RUN is replaced once the new one is complete"] = False
    seed: Annotated[int, AtLeast(0), AtMost(2**32 - 1), "of all random numbers"] = 0
    iterations: Annotated[
        int | None, AtLeast(1), AtMost(MOST_STEPS), "optimiser steps per part, instead of the preset's"
    ] = None
    save_every: Annotated[float, AtLeast(0), AtMost(1e9), Option(metavar="SECONDS"), "between checkpoints"] = 120.0
    refine_poses: Annotated[
        str, OneOf(("auto", "on", "off")),
        "move noisy poses onto the masks first, then learn what is left with the field; "
        "auto: videos whose outlines do not meet, but for those that `import video` fitted",
    ] = "auto"  # fmt: skip
    without: Annotated[
        tuple[str, ...], OneOf(ITEM_NAMES), Option(several=True),
        "leave out what the preset adds to the paper: light (fitted on the skin before training, where there is any; "
        "albedo is learned), hair (its placement, hollows and a layer of its own), clothes (that stand off the body), "
        "eyes (open, with eyeballs, as the template has them)",
    ] = ()  # fmt: skip

    like: Annotated[
        Path | None, Option(metavar="RUN"),
        "take hair, clothes and light as that run of the same capture found them, a preview's for instance",
    ] = None  # fmt: skip

    def __post_init__(self):
        if not self.out.name:
            raise ValueError(f"-o should name a run folder to make, is {self.out}")
        if self.resume and self.force:
            raise ValueError("--resume goes on, --force begins anew: choose one")
        if self.preset == "preview" and self.iterations is not None:
            raise ValueError("--iterations: the preset preview learns nothing, it has no steps")


DESCRIPTION = """\
Learn a person from a capture folder: one signed distance and color field for each of body, head and hands, fused
into one. Writes a run folder, which `selfscan bake` turns into an avatar.

presets
  preview nothing is learned: the fitted template with hair and clothes as carved, in the colors that the videos show.
          Seconds; a run like any other.
  head    the preview with the head's field learned, in a minute or two of 2 CPU cores.
  demo    2 CPU cores, about 2 GB of memory, minutes. Tri-planes over the body template; no GPU needed.
  fast    a CUDA device: hash grids, more rays, finer in the end. Runs on a CPU too, in hours.
  paper   the supplement's networks and 100 000 steps a part: a CUDA device and hours. For comparison.

while it learns
  RUN.partial/logs/PART.csv      a row every 10 steps: seconds, learning rate, each loss term, PSNR, |grad|, T_nr
They move to RUN when the run is complete.

stopping and going on
  Ctrl-C or SIGTERM saves a checkpoint and stops; the same command with --resume goes on, and on one thread (the
  default on two cores) gives the very bits that it would have given without the stop. A checkpoint is also
  written every --save-every seconds, so that a power loss costs little. A finished run or an interrupted
  training at RUN is never replaced unless --force asks for it.

several devices
  torchrun --nproc-per-node 2 -m selfscan train CAPTURE -o RUN --device cuda
"""

EPILOG = """\
examples:
  selfscan train capture -o run
  selfscan train capture -o run --resume
  selfscan train capture -o run --preset fast --device cuda
"""


def main(argv: list[str]) -> int:
    """Parse the command line and train; 128 + the signal's number when stopped by one."""
    options = parse(TrainOptions, argv, Help("selfscan train", DESCRIPTION, EPILOG))
    check_apart(options.out, options.capture, options.like)
    import torch

    from train.distributed import leave_ranks
    from train.stages import train

    if options.device == "cuda" and not torch.cuda.is_available():
        raise AssetError("--device cuda: this machine has no CUDA device that torch can use")
    try:
        train(options)
    except Stopped as stopped:
        kept = [option for option in argv if option not in ("--resume", "--force")]
        again = shlex.join(["selfscan", "train", *kept, "--resume"])
        print(f"stopped, nothing is lost; go on with:\n  {again}", file=sys.stderr)
        return 128 + stopped.number
    except FloatingPointError as error:
        raise AssetError(f"training does not converge: {error}") from None
    finally:
        leave_ranks()
    return 0
