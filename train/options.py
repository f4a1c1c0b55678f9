"""What `selfscan train` is asked for, written once: the command line, its help and its checks are read from here."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

from avatar.settings import AtLeast, AtMost, OneOf, Option
from capture.repair.refine import CHOICES
from train.preset import ITEMS, PRESETS, Preset, shortened, without

MOST_STEPS = 100_000_000


@dataclass(frozen=True, kw_only=True)
class TrainOptions:
    """One training: which capture, into which folder, and how."""

    capture: Annotated[
        Path, Option(positional=True, metavar="CAPTURE"), "folder made by `selfscan synth` or `selfscan import`"
    ]
    out: Annotated[Path, Option(("-o", "--out"), metavar="RUN"), "run folder to write, whole or not at all"]
    preset: Annotated[str, OneOf(tuple(sorted(PRESETS))), "see above"] = "demo"
    device: Annotated[Literal["cpu", "cuda"], "where to compute"] = "cpu"
    resume: Annotated[bool, "go on from the checkpoints of an interrupted training"] = False
    force: Annotated[bool, "begin anew; an existing RUN is replaced once the new one is complete"] = False
    seed: Annotated[int, AtLeast(0), AtMost(2**32 - 1), "of all random numbers"] = 0
    iterations: Annotated[
        int | None, AtLeast(1), AtMost(MOST_STEPS), "optimiser steps per part, instead of the preset's"
    ] = None
    save_every: Annotated[float, AtLeast(0), AtMost(1e9), Option(metavar="SECONDS"), "between checkpoints"] = 120.0
    preview: Annotated[int, AtLeast(0), AtMost(MOST_STEPS), Option(metavar="STEPS"), "between previews, 0 for none"] = (
        250
    )
    refine_poses: Annotated[
        str, OneOf(CHOICES),
        "move noisy poses onto the masks first, then learn what is left with the field; "
        "auto: videos whose outlines do not meet",
    ] = "auto"  # fmt: skip
    without: Annotated[
        tuple[str, ...], OneOf(tuple(ITEMS)), Option(several=True),
        "leave out what the preset adds to the paper: light (told from the skin before training, where there is any; "
        "albedo is learnt), hair (its placement, hollows and a layer of its own), clothes (that stand off the body), "
        "eyes (open, with eyeballs, as the template has them)",
    ] = ()  # fmt: skip
    single: Annotated[
        bool, "one network with the four parts' parameters, rays and steps, for comparison; its head lies where the "
        "parts' does: from --head-from, else body and head are trained and placed first",
    ] = False  # fmt: skip
    head_from: Annotated[
        Path | None, Option(metavar="RUN"), "with --single: a finished run of four parts on this capture"
    ] = None

    def __post_init__(self):
        if self.resume and self.force:
            raise ValueError("--resume goes on, --force begins anew: choose one")
        if self.head_from is not None and not self.single:
            raise ValueError("--head-from is of use with --single only: four parts find the head's place themselves")

    def chosen_preset(self) -> Preset:
        """The preset with what the options change of it."""
        preset = PRESETS[self.preset]
        if self.iterations is not None:
            preset = shortened(preset, self.iterations)
        # a single network's rays are of four videos, its light nobody's
        left_out = (*self.without, "light") if self.single else self.without
        return replace(without(preset, left_out), single=self.single)
