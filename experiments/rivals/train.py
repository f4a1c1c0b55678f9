"""Train one rival on a capture for so many processor seconds: python -m experiments.rivals.train CAPTURE -o RUN ...

The same command goes on where it was stopped, and a finished run stays. Fields of train/ learn in steps, as many as fit
the seconds by STEP_SECONDS; run.json says what they took.
"""

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import torch

from experiments.program import end_with, note
from experiments.rivals import aninerf, anisdf, neuralbody
from experiments.rivals.density import DensityField, Scene, read_scene
from experiments.rivals.learning import Budget, learn_run, on_one_frame
from experiments.rivals.overfit import field_on_one_frame
from experiments.rivals.single import single_preset, single_untrained, train_alone
from experiments.short_training import begun
from train.command import TrainOptions
from train.preset import PRESETS

# processor seconds of a step of size demo, as rivals.json has them (seconds / steps) of two people learning side by
# side on two cores; one of ours is a step of each part, of stage 2 and of Eq. 8
STEP_SECONDS = {"ours": 0.39, "single": 0.175, "anisdf": 0.24}
PUBLISHED_STEPS = 100_000
RAYS_PER_FRAME = 3000
DENSITIES: dict[str, Callable[[Scene, str], DensityField]] = {
    "aninerf": aninerf.untrained, "neuralbody": neuralbody.untrained
}  # fmt: skip
TRAINED_HERE = ("single", "anisdf", *DENSITIES)


def steps_for(system: str, seconds: float) -> int:
    """Steps of a field of train/ that take so many processor seconds; of none at all the published number."""
    return PUBLISHED_STEPS if seconds == float("inf") else max(int(seconds / STEP_SECONDS[system]), 10)


def train_rival(system: str, options: TrainOptions, seconds: float, head_from: Path) -> None:
    """Train one of TRAINED_HERE into options.out, whose preset is the size."""
    preset = replace(PRESETS[options.preset], rays_per_frame=RAYS_PER_FRAME)
    if system not in DENSITIES:
        resumed = replace(options, resume=begun(options.out))
        alone = anisdf.anisdf_preset(preset) if system == "anisdf" else single_preset(preset)
        alone = replace(alone, parts=(replace(alone.parts[0], iterations=steps_for(system, seconds)),))
        make = anisdf.untrained if system == "anisdf" else single_untrained
        after = anisdf.without_width if system == "anisdf" and options.preset == "demo" else (lambda part: None)
        train_alone(resumed, preset, alone, make, head_from, after)
        return
    scene, budget = read_scene(options.capture, head_from, preset, options.seed), budget_of(options, seconds)
    if scene.said:
        note(scene.said)
    torch.manual_seed(options.seed)
    field = DENSITIES[system](scene, options.preset)
    facts = {"system": system, "size": options.preset, "capture": str(options.capture), "head_from": str(head_from)}
    learn_run(field, scene, budget, options.out, facts)


def budget_of(options: TrainOptions, seconds: float) -> Budget:
    """Of a density field; without seconds the published steps."""
    if options.preset == "demo":
        return Budget(seconds=seconds, seed=options.seed)
    return Budget(seconds=seconds, steps=PUBLISHED_STEPS, rate=5e-4, last_rate=0.1, norm=True, seed=options.seed)


def overfit(system: str, options: TrainOptions, seconds: float, head_from: Path) -> dict[str, float]:
    """How soon a system shows the body video's first frame to 30 dB."""
    preset = PRESETS[options.preset]
    if system not in DENSITIES:
        return field_on_one_frame(system, options, preset, head_from, steps_for(system, seconds))
    scene = read_scene(options.capture, head_from, preset, options.seed, 1)
    torch.manual_seed(options.seed)
    return on_one_frame(DENSITIES[system](scene, options.preset), scene, budget_of(options, seconds))


def main(argv: list[str] | None = None) -> int:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.rivals.train", description=(__doc__ or "").split(":")[0]
    )
    parser.add_argument("capture", metavar="CAPTURE", type=Path)
    parser.add_argument("-o", "--out", metavar="RUN", type=Path, required=True)
    parser.add_argument("--system", choices=TRAINED_HERE, required=True)
    parser.add_argument("--size", choices=("demo", "paper"), default="demo")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="of the processor, for learning alone")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--head-from", metavar="RUN", type=Path, required=True, help="a finished run of four parts")
    parser.add_argument("--overfit", action="store_true", help="one frame alone, until it is shown to 30 dB")
    given = parser.parse_args(argv)
    if not given.seconds > 0:
        parser.error(f"--seconds should be positive, is {given.seconds:g}")
    torch.set_num_threads(1)
    options = TrainOptions(capture=given.capture, out=given.out, preset=given.size, seed=given.seed)
    if given.overfit:
        found = overfit(given.system, options, given.seconds, given.head_from)
        print(f"{given.system}: {found}", flush=True)
        return 0 if found["psnr_db"] >= 30 else 1
    if (given.out / "run.json").exists():
        print(f"{given.out}: finished already", flush=True)
        return 0
    given.out.parent.mkdir(parents=True, exist_ok=True)
    train_rival(given.system, options, given.seconds, given.head_from)
    return 0


if __name__ == "__main__":
    end_with(main)
