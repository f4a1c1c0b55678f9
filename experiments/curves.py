"""Quality against seconds of training: one capture trained with few steps, with more, and with all of its preset's.

    python -m experiments.curves out/cap/white_m -o out/curves --steps 10 40 150 500 whole --without eyes hair+clothes

Each training is a whole one (`selfscan train --iterations N`): its schedules end with it, so that a point of the curve
is the avatar one gets for these seconds, not an unfinished one. Its clocks run from reading the capture to the written
run: rays, template distances, fusion and surface included. `selfscan eval` then compares it with held-out true pictures
and surfaces. A RUN among the arguments adds itself to the curve of its capture, with the seconds that it recorded.

What exists in OUT is not made again; a training that was interrupted begins anew, or its seconds would not be all. Then
OUT/curves.json, curves.md and curves.png are written from all points in OUT, whatever call made them.
"""

import argparse
import json
import os
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from bench.ladder.machine import cpu_name
from capture.folder import read_capture_facts
from capture.held_out import SETS
from command.command_line import Help, Option, parse
from command.errors import AssetError
from command.settings import AtLeast, OneOf
from command.stages import command
from experiments.curve_page import markdown, plot
from experiments.program import end_with, note, written
from experiments.short_training import begun, read_kept, share_in_words, total_steps, training_words
from experiments.table_row import digest
from files.whole import write_json, write_text
from train.preset import ITEMS, PRESETS
from train.run import read_facts

FORMAT = "selfscan-curve-point"
REGIONS = ("total", "head", "hands")
SCORES = ("psnr_db", "psnr_mask_db", "ssim", "flip", "p2s_cm")


@dataclass(frozen=True)
class Planned:
    """One training of a curve."""

    capture: Path
    run: Path
    preset: str
    # of every part; None: the preset's
    steps: int | None
    # items of the preset that are left out
    without: tuple[str, ...]
    # a finished run that was named on the command line: never trained here
    given: bool = False

    @property
    def label(self) -> str:
        left_out = f", without {' and '.join(self.without)}" if self.without else ""
        return f"{self.capture.name}: {share_in_words(self.preset, self.steps)}{left_out}"


def left_out(text: str) -> tuple[str, ...]:
    """Items of a word such as hair+clothes."""
    items = tuple(text.split("+"))
    unknown = [item for item in items if item not in ITEMS]
    if unknown or len(set(items)) < len(items):
        raise argparse.ArgumentTypeError(f"should be of {', '.join(ITEMS)}, joined by +, is {text!r}")
    return tuple(sorted(items))


def step_count(text: str) -> int | None:
    """Steps of every part; None: the preset's own."""
    if text == "whole":
        return None
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"should be a positive number or whole, is {text!r}")
    return int(text)


@dataclass(frozen=True)
class Options:
    """What the command is asked for."""

    subjects: Annotated[tuple[Path, ...], Option(positional=True, metavar="CAPTURE_OR_RUN", several=True),
        "a capture with truth/ (selfscan synth), or a finished run, which becomes one more point of its capture"]
    out: Annotated[Path, Option(("-o", "--out"), "OUT"), "gets runs, points, curves.json, curves.md and curves.png"]
    steps: Annotated[tuple[int | None, ...], Option(metavar="N", parse=step_count, several=True),
        "steps of every part, one training each; whole: the preset's own"] = (10, 40, 150, 500, None)
    presets: Annotated[tuple[str, ...], OneOf(tuple(sorted(PRESETS))), Option(several=True)] = ("demo",)
    # each entry: items that one more training leaves out
    without: Annotated[tuple[tuple[str, ...], ...], Option(metavar="ITEM[+ITEM]", parse=left_out, several=True),
        f"trainings that leave out items of the preset: {', '.join(ITEMS)}"] = ()
    without_steps: Annotated[int | None, Option(metavar="N", parse=step_count),
        "steps of these, and of the whole preset beside them"] = 150
    poses: Annotated[int, AtLeast(1), "of each held-out set"] = 2
    device: Annotated[str, OneOf(("cpu", "cuda"))] = "cpu"
    seed: int = 0


ABOUT = Help(
    "python -m experiments.curves",
    "Quality against seconds of training: a capture trained short, longer and whole, each scored on held-out pictures.",
    "example: python -m experiments.curves out/cap/white_m -o out/curves --without eyes hair+clothes",
)


def planned(options: Options) -> list[Planned]:
    """Trainings in the order in which they are made: short ones first, so that there soon is a curve."""
    found: dict[Path, Planned] = {}
    for subject in options.subjects:
        if (subject / "run.json").is_file():
            one = given_run(subject, options.out)
            found[one.run] = one
            continue
        read_capture_facts(subject)
        for preset in options.presets:
            asked = [(steps, ()) for steps in options.steps]
            asked += [(options.without_steps, items) for items in ((), *options.without) if options.without]
            for steps, without in asked:
                name = "_".join(
                    [
                        preset,
                        *(() if options.device == "cpu" else (options.device,)),
                        str(steps or "whole"),
                        *(f"no_{item}" for item in without),
                    ]
                )
                run = options.out / subject.name / name / "run"
                found[run] = Planned(subject, run, preset, steps, without)
    return sorted(found.values(), key=lambda one: (not one.given, total_steps(one.preset, one.steps)))


def given_run(run: Path, out: Path) -> Planned:
    """A finished run as a point on its capture's curve."""
    facts = read_facts(run)
    preset = facts.get("preset")
    if preset not in PRESETS:
        raise AssetError(f"{run / 'run.json'}: preset should be one of {', '.join(PRESETS)}, is {preset!r}")
    taken = [part["steps"] for part in facts["parts"].values()]
    steps = None if sum(taken) == total_steps(preset, None) else max(taken)
    capture = (run.resolve() / facts.get("capture_at", {}).get("folder", "capture")).resolve()
    read_capture_facts(capture)
    left_out = tuple(name for name, change in ITEMS.items() if leaves_out(facts["settings"], preset, change))
    return Planned(capture, run, preset, steps, left_out, given=True)


def leaves_out(settings: dict[str, Any], preset: str, change: Any) -> bool:
    """Whether a run's settings have what leaving out an item changes of a preset."""
    whole, less = vars(PRESETS[preset]), vars(change(PRESETS[preset]))
    changed = [name for name in whole if whole[name] != less[name]]
    plain = lambda value: vars(value) if hasattr(value, "__dict__") else value
    return bool(changed) and all(settings.get(name) == plain(less[name]) for name in changed)


def trained(one: Planned, options: Options) -> bool:
    """Whether the run is there, trained now if it was not."""
    if one.given or (one.run / "run.json").exists():
        return True
    words = training_words(one.capture, one.run, one.preset, one.steps)
    words += ["--device", options.device, "--seed", str(options.seed)]
    words += ["--without", *one.without] if one.without else []
    words += ["--force"] if begun(one.run) else []
    one.run.parent.mkdir(parents=True, exist_ok=True)
    return command(*words)() == 0


def scored(one: Planned, options: Options) -> dict[str, Any] | None:
    """The point of a trained run, measured unless that has been done."""
    stamp = {"run": digest(one.run / "run.json"), "poses": options.poses}
    name = f"given_{one.run.name}" if one.given else one.run.parent.name
    path = options.out / one.capture.name / f"{name}.json"
    found = read_kept(path, {"format": FORMAT, "stamp": stamp})
    if found is not None:
        return found
    quality = path.with_name(f"{name}_quality.json")
    path.parent.mkdir(parents=True, exist_ok=True)
    if command("selfscan", "eval", one.run, one.capture, "--poses", str(options.poses), "--json", quality)() != 0:
        return None
    point = {"format": FORMAT, "stamp": stamp, "label": one.label}
    point |= point_of(one, json.loads(quality.read_text("utf-8")))
    write_json(path, point)
    return point


def point_of(one: Planned, quality: dict[str, Any]) -> dict[str, Any]:
    """What a curve needs of a run and of its evaluation."""
    facts = read_facts(one.run)
    parts = facts["parts"].values()
    # of a training that was interrupted only the last sitting's are recorded
    whole = not facts.get("resumed", False)
    preparing = [part.get("cpu_seconds_preparing") for part in parts]
    in_steps = None
    if whole and None not in preparing:
        in_steps = round(sum(part["cpu_seconds"] for part in parts) - sum(preparing), 1)
    return {
        "capture": one.capture.name,
        "subject": quality["capture"].get("subject", one.capture.name),
        "light": quality["capture"].get("light"),
        "size": quality["capture"].get("size"),
        "preset": one.preset,
        "steps": one.steps,
        "total_steps": total_steps(one.preset, one.steps),
        "without": list(one.without),
        "given": one.given,
        "device": facts["device"],
        "seconds": facts["seconds"]["all"] if whole else None,
        "cpu_seconds": facts.get("cpu_seconds") if whole else None,
        "cpu_seconds_in_steps": in_steps,
        "scores": {
            name: {region: {score: quality[name][region].get(score) for score in SCORES} for region in REGIONS}
            for name in SETS
        },
        "machine": quality["machine"],
    }


def collect(out: Path) -> list[dict[str, Any]]:
    """All points in OUT, along their curves."""
    found = []
    for path in sorted(out.glob("*/*.json")):
        if path.name.endswith("_quality.json"):
            continue
        point = read_kept(path, {"format": FORMAT})
        if point is None:
            raise AssetError(f"{path}: expected a point of format {FORMAT}, found another file")
        found.append(point)
    return sorted(found, key=lambda p: (p["capture"], p["preset"], p["without"], p["total_steps"], p["given"]))


class TimeLeft:
    """How long the rest will take, by the trainings that are done: seconds against steps, on a line between them."""

    def __init__(self, plan: Sequence[Planned]):
        self.rest = list(plan)
        self.known: dict[int, float] = {}

    def done(self, one: Planned, seconds: float | None) -> str:
        """What is said after a point: how many are left and how long they may take."""
        self.rest.remove(one)
        if seconds is not None:
            self.known[total_steps(one.preset, one.steps)] = seconds
        if not self.rest:
            return "all points are there"
        left = sum(self.expected(total_steps(other.preset, other.steps)) for other in self.rest)
        known = f", about {left / 60:.0f} min left" if self.known else ""
        return f"{len(self.rest)} points left{known}"

    def expected(self, steps: int) -> float:
        """Seconds of a training of so many steps; beyond the known ones along the last line."""
        if not self.known:
            return 0.0
        x = sorted(self.known)
        if len(x) > 1 and steps > x[-1]:
            slope = (self.known[x[-1]] - self.known[x[-2]]) / (x[-1] - x[-2])
            return self.known[x[-1]] + max(slope, 0.0) * (steps - x[-1])
        return float(np.interp(steps, x, [self.known[k] for k in x]))


def measure(options: Options) -> list[str]:
    """All points of all curves; what could not be measured, in words."""
    absent, plan = [], planned(options)
    left = TimeLeft(plan)
    for one in plan:
        began = time.monotonic()
        note(one.label)
        if not trained(one, options):
            absent.append(f"{one.label}: training failed")
            left.done(one, None)
            continue
        point = scored(one, options)
        if point is None:
            absent.append(f"{one.label}: evaluation failed")
        # of a point that was there its recorded seconds say more than the moment that reading it took
        seconds = max(time.monotonic() - began, (point or {}).get("seconds") or 0)
        note(left.done(one, seconds))
        write_report(options.out, absent)
    return absent


def write_report(out: Path, absent: list[str]) -> None:
    result = {
        "format": "selfscan-curves",
        "cpu": cpu_name(),
        "cores": os.cpu_count(),
        "points": collect(out),
        "absent": absent,
    }
    write_json(out / "curves.json", result)
    write_text(out / "curves.md", markdown(result))
    plot(result, out / "curves.png")


def main(argv: Sequence[str]) -> int:
    options = parse(Options, argv, ABOUT)
    options.out.mkdir(parents=True, exist_ok=True)
    return written(options.out / "curves.md", measure(options))


if __name__ == "__main__":
    end_with(main)
