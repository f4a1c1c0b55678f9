"""`selfscan train`: the command line of train/stages.py, made from train/options.py."""

import shlex
import sys

import torch

from avatar.errors import AssetError
from avatar.interrupt import Stopped
from avatar.settings import Help, parse
from train.distributed import leave_ranks
from train.options import TrainOptions
from train.stages import train

DESCRIPTION = """\
Learn a person from a capture folder: one signed distance and colour field for each of body, head and hands, fused
into one. Writes a run folder, which `selfscan bake` turns into an avatar.

presets
  demo    2 CPU cores, about 2 GB of memory, minutes. Tri-planes over the body template; no GPU needed.
  fast    a CUDA device: hash grids, more rays, finer in the end. Runs on a CPU too, in hours.
  paper   the supplement's networks and 100 000 steps a part: a CUDA device and hours. For comparison.

while it learns
  RUN.partial/preview/PART.png   observed | rendered | normals, for one frame of each part
  RUN.partial/logs/PART.csv      a row every 10 steps: seconds, learning rate, each loss term, PSNR, |grad|, T_nr
  RUN.partial/logs/events        the same for `tensorboard --logdir`, with the previews over time, where the
                                 package is installed (`pip install tensorboard`)
All of it moves to RUN when the run is complete.

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
  selfscan train out/capture -o out/run
  selfscan train out/capture -o out/run --resume
  selfscan train out/capture -o out/run --preset fast --device cuda
"""


def main(argv: list[str]) -> int:
    """Parse the command line and train; 128 + the signal's number when stopped by one."""
    options = parse(TrainOptions, argv, Help("selfscan train", DESCRIPTION, EPILOG))
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
