"""What light in a capture costs: a person filmed under even, soft, fixed and room light, trained alike, compared.

    python -m experiments.light PERSON.glb builtin -o out/light --steps 400

PERSON is what `selfscan synth` takes. For each person and light OUT/PERSON/LIGHT gets the capture (the same seed), the
run and scores.json (experiments/light_scores.py); what exists is not made again. Then OUT/light.json and OUT/light.md
are written from all scores in OUT, whatever call made them: dB lost against the same person under even light, beside
what is allowed.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

# before any GL context: it loads an LLVM that crashes when Mesa's came first
import torch._dynamo  # noqa: F401

from bench.report.writer import markdown_table
from command.command_line import Help, Option, parse
from command.settings import AtLeast, OneOf
from command.stages import command
from experiments.light_scores import FORMAT, REGIONS, measured, stamp
from experiments.program import distinct, end_with, note, written
from experiments.short_training import begun, read_kept, share_in_words, three, training_words
from files.input_file import read_json_object
from files.whole import write_json, write_text
from synth.options import MODES
from train.preset import PRESETS

# dB that a light may cost on held-out pictures, total, head and hands
ALLOWED = {"fixed": (0.8, 0.5, 1.0), "soft": (0.2, 0.2, 0.2), "room": (1.0, 1.5, 3.5)}
LIGHTS = ("even", "soft", "fixed", "room")


@dataclass(frozen=True)
class Options:
    """What the command is asked for."""

    people: Annotated[tuple[str, ...], Option(positional=True, metavar="PERSON", several=True),
        "builtin, builtin:female or a rigged .glb"]
    out: Annotated[Path, Option(("-o", "--out"), "OUT"), "gets light.md and light.json"]
    lights: Annotated[tuple[str, ...], OneOf(MODES), Option(several=True),
        "even, which the others are compared with, is always among them"] = LIGHTS
    preset: Annotated[str, OneOf(tuple(sorted(PRESETS)))] = "demo"
    steps: Annotated[int | None, AtLeast(1), "of every part, instead of the preset's"] = None
    size: Annotated[int, "pixels of the videos"] = 256
    frames: Annotated[int, "of each video"] = 40
    seed: Annotated[int, "of the captures and trainings"] = 0
    poses: Annotated[int, AtLeast(1), "of each held-out set"] = 3
    without: Annotated[bool, "also train with light as no factor of its own"] = False

    def __post_init__(self):
        distinct([folder_name(person) for person in self.people], "people")


ABOUT = Help(
    "python -m experiments.light",
    "What light in a capture costs, against the same person under even light.",
    "example: python -m experiments.light builtin White_M.glb -o out/light --steps 400 --poses 2",
)


def folder_name(person: str) -> str:
    return person.replace(":", "_") if person.startswith("builtin") else Path(person).stem


def filmed(options: Options, person: str, light: str) -> Path | None:
    """The capture of a person under a light; the held-out poses of all of them are in the even one."""
    capture = options.out / folder_name(person) / light / "capture"
    if not (capture / "capture.json").exists():
        note(f"{folder_name(person)}, {light}: filming")
        words = ["--light", light, "--size", options.size, "--frames", options.frames, "--seed", options.seed]
        words += [] if light == "even" else ["--no-truth"]
        capture.parent.mkdir(parents=True, exist_ok=True)
        if command("selfscan", "synth", person, capture, *map(str, words))() != 0:
            return None
    return capture


def trained(options: Options, capture: Path, light_factor: bool) -> Path | None:
    """The run of a capture, going on where an interrupted training stopped."""
    run = capture.with_name("run" if light_factor else "run_light_off")
    if not (run / "run.json").exists():
        note(f"{run}: training, {share_in_words(options.preset, options.steps)}")
        words = training_words(capture, run, options.preset, options.steps)
        words += [] if light_factor else ["--without", "light"]
        words += ["--resume"] if begun(run) else []
        if command(*words)() != 0:
            return None
    return run


def person_scores(options: Options, person: str) -> list[str]:
    """All lights of one person; what could not be measured, in words."""
    absent = []
    # even first: the held-out poses are there
    for light in ("even", *(light for light in MODES if light in options.lights and light != "even")):
        label = f"{folder_name(person)}, {light}"
        capture = filmed(options, person, light)
        if capture is None:
            absent.append(f"{label}: filming failed")
            continue
        for factor in (True, False)[: 1 + options.without]:
            run = trained(options, capture, factor)
            if run is None:
                absent.append(f"{label}: training failed")
                continue
            path = capture.with_name("scores.json" if factor else "scores_light_off.json")
            expected = stamp(run, options.poses)
            if read_kept(path, {"format": FORMAT, "stamp": expected}) is not None:
                note(f"{label}: kept")
                continue
            note(f"{label}: measuring")
            even = options.out / folder_name(person) / "even" / "capture"
            found = measured(run, person, even, light, options.seed, options.poses)
            facts = {"format": FORMAT, "person": folder_name(person), "light": light, "light_factor": factor}
            facts |= {"share": share_in_words(options.preset, options.steps), "stamp": expected}
            write_json(path, facts | found)
    return absent


def collect(out: Path) -> list[dict[str, Any]]:
    """All scores in OUT."""
    found = []
    for path in sorted(out.glob("*/*/scores*.json")):
        scores = read_json_object(path, "scores")
        if scores.get("format") == FORMAT:
            found.append(scores)
    order = {light: number for number, light in enumerate(MODES)}
    return sorted(found, key=lambda one: (one["person"], order[one["light"]], not one["light_factor"]))


def lost(scores: dict[str, Any], even: dict[str, Any]) -> dict[str, float]:
    """dB lost against the even light, by region."""
    both = [region for region in REGIONS if scores.get(region) is not None and even.get(region) is not None]
    return {region: even[region] - scores[region] for region in both}


def page(found: Sequence[dict[str, Any]]) -> str:
    """The table in Markdown."""
    lines = [
        "# Light as a factor of its own",
        "",
        "Written by `python -m experiments.light`. Inside the true mask, total / head / hands, the field on pictures",
        "that nothing was trained on. *lost*: dB against the same person under even light; *allowed*: the bar. *key*:",
        "all lit by a lamp that no video had, beside the truth so lit. *albedo*: of 255, beside the true texture; both",
        "after one gain, which nobody can know. *turned away*: pixels whose normals face no video's camera (their",
        "share), where the light was never seen. *mean light*: shown as the paper does, in the mean of what was seen.",
        "",
    ]
    head = ["person, light", "steps", "novel poses, dB", "lost", "allowed", "turned away (share)", "lost there"]
    head += ["mean light", "novel views, lost", "key, lost", "albedo rms", "light found"]
    rows = []
    even = {one["person"]: one for one in found if one["light"] == "even" and one["light_factor"]}
    for one in found:
        lost_to = lambda *keys, one=one: _lost_to(one, even.get(one["person"]), keys)
        allowed = ALLOWED.get(one["light"])
        away = one["novel_pose"]["turned_away"]
        shares = " / ".join(f"{away['share'][region]:.0%}" for region in REGIONS)
        rows.append(
            [
                f"{one['person']}, {one['light']}{'' if one['light_factor'] else ', no factor'}",
                one["share"],
                three(one["novel_pose"]["captured"]),
                lost_to("novel_pose", "captured"),
                " / ".join(f"{value:g}" for value in allowed) if allowed else "-",
                f"{three(away['captured'])} ({shares})",
                lost_to("novel_pose", "turned_away", "captured"),
                three(one["novel_pose"]["mean_light"]),
                lost_to("novel_view", "captured"),
                lost_to("novel_pose", "key"),
                three(one["novel_pose"]["albedo_rms"]),
                str(one["found"]),
            ]
        )
    return "\n".join([*lines, *markdown_table(head, rows)]) + "\n"


def _lost_to(one: dict[str, Any], even: dict[str, Any] | None, keys: Sequence[str]) -> str:
    return "-" if even is None else three(lost(_at(one, keys), _at(even, keys)))


def _at(scores: dict[str, Any], keys: Sequence[str]) -> dict[str, Any]:
    for key in keys:
        scores = scores[key]
    return scores


def main(argv: Sequence[str]) -> int:
    options = parse(Options, argv, ABOUT)
    options.out.mkdir(parents=True, exist_ok=True)
    absent = [line for person in options.people for line in person_scores(options, person)]
    found = collect(options.out)
    write_json(options.out / "light.json", {"format": "selfscan-light", "scores": found, "absent": absent})
    write_text(options.out / "light.md", page(found))
    return written(options.out / "light.md", absent)


if __name__ == "__main__":
    end_with(main)
