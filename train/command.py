"""`selfscan train`: the command line of train/stages.py."""

import argparse
import sys
from dataclasses import replace

import numpy as np
import torch

from avatar.errors import AssetError
from train.preset import PRESETS
from train.stages import train

Array = np.ndarray


def main(argv: list[str]) -> int:
    """Parse the command line and train."""
    parser = argparse.ArgumentParser(
        prog="selfscan train",
        description="Learn a person from a capture folder: one signed distance and colour field for each of body, "
        "head and hands, fused into one. Writes a run folder, which `selfscan bake` turns into an avatar.",
        epilog="example: selfscan train out/capture -o out/run",
    )
    parser.add_argument(
        "capture", metavar="CAPTURE", help="folder made by `selfscan synth` or `selfscan import`"
    )
    parser.add_argument(
        "-o", "--out", metavar="RUN", required=True, help="run folder to write, whole or not at all"
    )
    parser.add_argument(
        "--preset", choices=sorted(PRESETS), default="demo", help="demo: minutes on two CPU cores"
    )
    parser.add_argument(
        "--device", choices=["cpu", "cuda"], default="cpu", help="where to compute (default: cpu)"
    )
    parser.add_argument(
        "--resume", action="store_true", help="go on from the checkpoints of an interrupted training"
    )
    parser.add_argument("--seed", type=int, default=0, help="of all random numbers (default: 0)")
    parser.add_argument(
        "--iterations", type=int, metavar="N", help="optimiser steps per part, instead of the preset's"
    )
    arguments = parser.parse_args(argv)
    if arguments.iterations is not None and arguments.iterations < 1:
        parser.error(f"--iterations should be at least 1, is {arguments.iterations}")
    if arguments.device == "cuda" and not torch.cuda.is_available():
        raise AssetError("--device cuda: this machine has no CUDA device that torch can use")
    preset = PRESETS[arguments.preset]
    if arguments.iterations is not None:
        preset = replace(
            preset, parts=tuple(replace(p, iterations=arguments.iterations) for p in preset.parts)
        )
    try:
        train(arguments.capture, arguments.out, preset, device=arguments.device, seed=arguments.seed,
              resume=arguments.resume)  # fmt: skip
    except KeyboardInterrupt:
        print(
            f"stopped; `selfscan train {arguments.capture} -o {arguments.out} --resume` goes on",
            file=sys.stderr,
        )
        return 130
    return 0
