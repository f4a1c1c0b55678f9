"""`selfscan train`: the command line of train/stages.py."""

import argparse
import shlex
import sys
from dataclasses import replace

import torch

from avatar.errors import AssetError
from capture.repair.refine import CHOICES
from train.distributed import leave_ranks
from train.interrupt import Stopped
from train.preset import PRESETS, shortened
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
  RUN.partial/logs/events        the same for `tensorboard --logdir`, with the previews over time
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
    parser = argparse.ArgumentParser(
        prog="selfscan train",
        description=DESCRIPTION,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("capture", metavar="CAPTURE", help="folder made by `selfscan synth` or `selfscan import`")
    parser.add_argument("-o", "--out", metavar="RUN", required=True, help="run folder to write, whole or not at all")
    parser.add_argument("--preset", choices=sorted(PRESETS), default="demo", help="see above (default: demo)")
    parser.add_argument("--device", choices=["cpu", "cuda"], default="cpu", help="where to compute (default: cpu)")
    parser.add_argument("--resume", action="store_true", help="go on from the checkpoints of an interrupted training")
    parser.add_argument(
        "--force",
        action="store_true",
        help="begin anew; an existing RUN is replaced once the new one is complete",
    )
    parser.add_argument("--seed", type=int, default=0, help="of all random numbers (default: 0)")
    parser.add_argument("--iterations", type=int, metavar="N", help="optimiser steps per part, instead of the preset's")
    parser.add_argument(
        "--save-every",
        type=float,
        default=120.0,
        metavar="SECONDS",
        help="between checkpoints (default: 120)",
    )
    parser.add_argument(
        "--preview",
        type=int,
        default=250,
        metavar="STEPS",
        help="between previews, 0 for none (default: 250)",
    )
    parser.add_argument(
        "--refine-poses",
        choices=CHOICES,
        default="auto",
        help="move noisy poses onto the masks first, then learn what is left with the field; "
        "auto: videos whose outlines do not meet (default: auto)",
    )
    parser.add_argument(
        "--single",
        action="store_true",
        help="one network with the four parts' parameters, rays and steps, for comparison",
    )
    arguments = parser.parse_args(argv)
    if arguments.iterations is not None and arguments.iterations < 1:
        parser.error(f"--iterations should be at least 1, is {arguments.iterations}")
    if not arguments.save_every >= 0:
        parser.error(f"--save-every should be 0 or more seconds, is {arguments.save_every}")
    if arguments.preview < 0:
        parser.error(f"--preview should be 0 or more steps, is {arguments.preview}")
    if arguments.resume and arguments.force:
        parser.error("--resume goes on, --force begins anew: choose one")
    if arguments.device == "cuda" and not torch.cuda.is_available():
        raise AssetError("--device cuda: this machine has no CUDA device that torch can use")
    preset = PRESETS[arguments.preset]
    if arguments.iterations is not None:
        preset = shortened(preset, arguments.iterations)
    preset = replace(preset, single=arguments.single)
    try:
        train(arguments.capture, arguments.out, preset, device=arguments.device, seed=arguments.seed,
              resume=arguments.resume, force=arguments.force, save_every=arguments.save_every,
              preview_every=arguments.preview, refine_poses=arguments.refine_poses)  # fmt: skip
    except Stopped as stopped:
        options = [option for option in argv if option not in ("--resume", "--force")]
        again = shlex.join(["selfscan", "train", *options, "--resume"])
        print(f"stopped, nothing is lost; go on with:\n  {again}", file=sys.stderr)
        return 128 + stopped.number
    except FloatingPointError as error:
        raise AssetError(f"training does not converge: {error}") from None
    finally:
        leave_ranks()
    return 0
