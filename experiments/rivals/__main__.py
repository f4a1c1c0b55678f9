"""The paper's table, run: python -m experiments.rivals [PEOPLE...] -o OUT [--systems ...] [--inputs given pixels] ...

Every person is filmed once for each kind of input (OUT/PERSON/INPUT/capture), every system is trained on it for the
same processor seconds (.../seedN/SYSTEM), and judged on the same held-out pictures (.../seedN/SYSTEM.json). What is
there stays: the same command goes on where it stopped. OUT/rivals.json and OUT/README.md are made of all rows in OUT
and of those that rivals.json had: films and runs of finished people may be removed.
"""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

from command.command_line import Help, Option, parse
from command.errors import AssetError
from command.settings import Above, AtLeast, OneOf
from command.stages import Stage, command, run_stages
from experiments.claim import folder_of, person_and_sex, settle, stature_of
from experiments.program import end_with, note, written
from experiments.rivals.page import TITLES, page
from experiments.rivals.sheet import write_sheet
from experiments.rivals.train import TRAINED_HERE, steps_for
from experiments.short_training import begun
from files.input_file import read_json_object
from files.whole import write_json, write_text

KINDS = {"given": "given", "pixels": "from pixels"}
# minutes on a quiet core beside the learning: of an import, of what comes before and after learning, of baking and of
# judging a pose
IMPORT, AROUND, BAKE, POSE = 8.0, 2.5, 3.0, 0.5


@dataclass(frozen=True)
class Options:
    """What decides the numbers; a folder holds those of one of them."""

    seconds: Annotated[float, Above(0), "of the processor, of learning"] = 60.0
    size: Annotated[str, OneOf(("demo", "paper")), "of the networks"] = "demo"
    pixels: Annotated[int, AtLeast(1), "of the videos' sides"] = 256
    frames: Annotated[int, AtLeast(1), "of each video"] = 24
    poses: Annotated[int, AtLeast(1), "of each held-out set, which has 20"] = 20
    light: Annotated[str, "of everything that is filmed"] = "soft"


@dataclass(frozen=True)
class RivalsCommand:
    out: Annotated[Path, Option(("-o", "--out"), "OUT"), "gets rivals.json and README.md"]
    options: Annotated[Options, "what decides the numbers"]
    people: Annotated[tuple[str, ...], Option(positional=True, metavar="PERSON", several=True),
        "builtin, builtin:female or a rigged .glb[:female] (default: builtin)"] = ("builtin",)
    systems: Annotated[tuple[str, ...], OneOf(tuple(TITLES)), Option(several=True)] = tuple(TITLES)
    inputs: Annotated[tuple[str, ...], OneOf(tuple(KINDS)), Option(several=True)] = ("given",)
    seeds: Annotated[tuple[int, ...], Option(several=True)] = (0,)
    sheet: Annotated[bool, "the sheet of pictures of the first person too"] = False


def capture_stages(options: Options, person: str, kind: str, folder: Path) -> tuple[list[Stage], Path]:
    """What films a person, and the folder of the truth."""
    who, sex = person_and_sex(person)
    capture, raw = folder / "capture", folder / "raw"
    same = ["--size", str(options.pixels), "--light", options.light]
    if kind == "given":
        film = command("selfscan", "synth", who, capture, "--frames", str(options.frames), *same)
        return [Stage("film", capture / "capture.json", film, 2.0)], capture
    film = command("selfscan", "synth", who, raw, "--raw", "--keypoints", "--held-out", "--seconds", "12", *same)

    def imported() -> int:
        told = ["--sex", sex, "--stature", f"{stature_of(who):.3f}", "--frames", str(options.frames)]
        return command("selfscan", "import", "video", raw, "-o", capture, *told)()

    return [Stage("film four raw videos", raw / "truth" / "raw.json", film, 5.0),
            Stage("import", capture / "capture.json", imported, IMPORT)], raw  # fmt: skip


def row_stages(options: Options, system: str, seed: int, folder: Path, truth: Path) -> list[Stage]:
    """What trains and judges one system; `folder` is that of a person's input."""
    own, capture = folder / f"seed{seed}", folder / "capture"
    ours, minutes = own / "ours", options.seconds / 60
    base = {"zero": own / "zero", "ours_baked": ours}.get(system, own / system)

    def train() -> int:
        """Ours and 0 steps by the program itself, the others by train.py."""
        if system in TRAINED_HERE:
            words = ["experiments.rivals.train", capture, "-o", base, "--system", system, "--size", options.size,
                     "--seconds", f"{options.seconds:g}", "--seed", str(seed), "--head-from", ours]  # fmt: skip
            return command(*words)()
        words = ["selfscan", "train", capture, "-o", base, "--seed", str(seed)]
        words += ["--preset", "preview" if system == "zero" else options.size]
        if system != "zero" and options.seconds < float("inf"):
            words += ["--iterations", str(steps_for("ours", options.seconds))]
        return command(*words, *(["--resume"] if begun(base) else []))()

    found = [Stage(f"{system}: train", base / "run.json", train, AROUND + minutes)]
    shown = base
    if system in ("zero", "ours_baked"):
        shown = own / f"{system}.glb"
        bake = command("selfscan", "bake", base, "-o", shown, "--capture", capture)
        found.append(Stage(f"{system}: bake", shown, bake, BAKE))
    fitted = ["--pixels", ours] if folder.name != "given" else []
    words = ["experiments.rivals.judge", system, shown, truth, own / f"{system}.json", "--poses", str(options.poses)]
    judge = command(*words, *fitted)
    return [*found, Stage(f"{system}: judge", own / f"{system}.json", judge, 2 * POSE * options.poses)]


def learning_seconds(run: Path) -> dict[str, Any]:
    """Processor seconds of learning and of everything, and the steps, as a run says.

    Of ours learning is the parts' steps, and stage 2 and Eq. 8 by the wall clock.
    """
    facts = read_json_object(run / "run.json", "the facts of a run")
    if "parts" not in facts:
        return {"seconds": facts["cpu_seconds"], "all_seconds": facts["cpu_seconds_process"], "steps": facts["steps"]}
    parts = facts["parts"].values()
    learned = sum(part.get("cpu_seconds", 0.0) - part.get("cpu_seconds_preparing", 0.0) for part in parts)
    learned += sum(facts["seconds"].get(name, 0.0) for name in ("union", "appearance"))
    steps = sum(part.get("steps", 0) for part in parts)
    return {"seconds": round(learned, 1), "all_seconds": facts["cpu_seconds"], "steps": steps}


def collect(out: Path) -> list[dict[str, Any]]:
    """Every row that is there, in folders or in rivals.json alone."""
    kept = out / "rivals.json"
    before = read_json_object(kept, "rows of rivals")["rows"] if kept.exists() else []
    rows = {name_of(row): row for row in before}
    for path in sorted(out.glob("*/*/seed*/*.json")):
        system, seed, kind, person = path.stem, path.parent.name[4:], path.parents[1].name, path.parents[2].name
        if system not in TITLES:
            continue
        run = {"ours_baked": "ours"}.get(system, system)
        found = json.loads(path.read_text("utf-8"))
        row = {"system": system, "person": person, "input": KINDS[kind], "seed": int(seed),
               **learning_seconds(path.parent / run), **found}  # fmt: skip
        rows[name_of(row)] = row
    return [rows[name] for name in sorted(rows)]


def name_of(row: dict[str, Any]) -> tuple[str, str, int, str]:
    """Person, input, seed and system."""
    return row["person"], row["input"], row["seed"], row["system"]


def run_all(given: RivalsCommand) -> list[str]:
    """Every row that was asked for; what could not be made, in words."""
    options, absent, there = given.options, [], {name_of(row) for row in collect(given.out)}
    # the others take the head's place from ours
    systems = sorted(given.systems, key=list(TITLES).index)
    for person in given.people:
        for kind in given.inputs:
            folder = given.out / folder_of(person) / kind
            for seed in given.seeds:
                wanted = [name for name in systems if (folder_of(person), KINDS[kind], seed, name) not in there]
                if not wanted:
                    continue
                (folder / f"seed{seed}").mkdir(parents=True, exist_ok=True)
                films, truth = capture_stages(options, person, kind, folder)
                run_stages(films)
                if wanted[0] != "ours":
                    run_stages(row_stages(options, "ours", seed, folder, truth)[:1])
                for system in wanted:
                    note(f"{folder_of(person)}, {KINDS[kind]}, seed {seed}: {system}")
                    try:
                        run_stages(row_stages(options, system, seed, folder, truth))
                    except AssetError as error:
                        absent.append(f"{folder_of(person)}, {KINDS[kind]}, seed {seed}: {error}")
                    report(given.out, options, absent)
    return absent


def report(out: Path, options: Options, absent: list[str]) -> None:
    """rivals.json and the page, of what is there."""
    rows = collect(out)
    write_json(out / "rivals.json", {"options": asdict(options), "rows": rows, "absent": absent})
    write_text(out / "README.md", page(rows, asdict(options), absent, (out / "sheet.png").exists()))


def main(argv: Sequence[str]) -> int:
    given = parse(RivalsCommand, argv, Help("python -m experiments.rivals", (__doc__ or "").split(":")[0]))
    options, out = given.options, given.out
    settle(out, asdict(options))
    absent = run_all(given)
    if given.sheet:
        first = out / folder_of(given.people[0]) / given.inputs[0] / f"seed{given.seeds[0]}"
        write_sheet(first, out / "sheet.png")
    report(out, options, absent)
    return written(out / "README.md", absent, "made")


if __name__ == "__main__":
    end_with(main)
