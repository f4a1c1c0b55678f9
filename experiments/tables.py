"""The paper's tables on people, one command: ours, its ablations, and the paper's numbers beside them.

    python -m experiments.tables out/tables --captures out/cap/* --runs out/runs

For every capture: the run is trained (or reused from --runs), then each row is measured in a process of its own and
kept as one JSON and one picture in OUT/CAPTURE/seedN. What is finished is not done again. Then OUT/tables.json and
OUT/tables.md are written from all rows in OUT, whatever call made them.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from capture.folder import read_capture_facts
from command.command_line import Help, Option, parse
from command.errors import AssetError
from command.settings import AtLeast, OneOf
from command.stages import command
from experiments.program import distinct, end_with, note, written
from experiments.short_training import begun
from experiments.table_page import page
from experiments.table_row import FORMAT, PARTS_TRAINING, ROWS, SINGLE, Row, Training, finished, stamp
from files.input_file import read_json_object
from files.whole import write_json, write_text
from train.preset import PRESETS

# facts that a run must share
SAME = ("subject", "light", "sheen", "pose_noise_deg", "seed", "size", "frames")


@dataclass(frozen=True)
class Options:
    """What the command is asked for."""

    out: Annotated[Path, Option(positional=True, metavar="OUT"), "gets tables.md, tables.json and a folder a person"]
    captures: Annotated[tuple[Path, ...], Option(metavar="CAP", several=True)]
    # trained runs: CAPTURE, CAPTURE_single, CAPTURE_light_off, with _seedN for seeds other than 0
    runs: Annotated[Path | None, Option(metavar="DIR"), "runs to reuse, by name (default: OUT/runs)"] = None
    rows: Annotated[tuple[str, ...], OneOf(tuple(ROWS)), Option(metavar="ROW", several=True)] = tuple(ROWS)
    seeds: Annotated[tuple[int, ...], Option(several=True), "of the training"] = (0,)
    poses: Annotated[int, AtLeast(1), "novel poses of each row"] = 5
    our_poses: Annotated[int | None, AtLeast(1), "of the evaluation of ours (default: all)"] = None
    preset: Annotated[str, OneOf(tuple(sorted(PRESETS)))] = "demo"
    iterations: Annotated[int | None, AtLeast(1), "steps a part, instead of the preset's"] = None
    lpips: Annotated[tuple[Path, ...], Option(metavar="FILE", several=True), "as in `selfscan eval`"] = ()
    jobs: Annotated[int, AtLeast(1), "rows measured at once"] = 1

    def __post_init__(self):
        distinct([capture.resolve().name for capture in self.captures], "captures")


ABOUT = Help(
    "python -m experiments.tables",
    "The paper's tables on people: ours, ablations, and the paper's numbers beside them.",
    "example: python -m experiments.tables out/tables --captures out/white_m out/asian_f --runs out/runs",
)


def run_of(options: Options, capture: Path, seed: int, training: Training) -> Path:
    name = capture.name + training.suffix + (f"_seed{seed}" if seed else "")
    return (options.runs or options.out / "runs") / name


def train(options: Options, capture: Path, seed: int, training: Training) -> Callable[[], int]:
    """The training of one run, going on where an interrupted one stopped."""
    run = run_of(options, capture, seed, training)
    words: list[str | Path] = [*training.command, capture, "-o", run, "--preset", options.preset]
    words += ["--seed", str(seed), *training.words]
    if training == SINGLE:
        ours = run_of(options, capture, seed, PARTS_TRAINING)
        if (ours / "run.json").exists():
            words += ["--head-from", ours]
    words += ["--iterations", str(options.iterations)] if options.iterations else []
    words += ["--resume"] if begun(run) else []
    return command(*words)


def measure(options: Options, capture: Path, seed: int, row: Row) -> Callable[[], int]:
    words: list[str | Path] = ["experiments.table_row", run_of(options, capture, seed, row.training), capture]
    words += [row.name, folder_of(options, capture, seed), "--poses", str(options.poses)]
    words += ["--our-poses", str(options.our_poses)] if options.our_poses else []
    words += ["--lpips", *options.lpips] if options.lpips else []
    return command(*words)


def folder_of(options: Options, capture: Path, seed: int) -> Path:
    return options.out / capture.name / f"seed{seed}"


def check_run(run: Path, capture: Path, options: Options, seed: int) -> None:
    """Refuse a run of another capture, preset or seed: its numbers would stand in the wrong row.

    Raises:
        AssetError: names the run and what differs.
    """
    facts = read_json_object(run / "run.json", "a trained run")
    filmed, expected = facts.get("capture", {}), read_capture_facts(capture)
    for name in SAME:
        if filmed.get(name) != expected.get(name):
            found = f"{name} {filmed.get(name)!r}"
            raise AssetError(f"{run}: should be trained on {capture} ({name} {expected.get(name)!r}), is {found}")
    for name, value in (("preset", options.preset), ("seed", seed)):
        if facts.get(name) != value:
            raise AssetError(f"{run}: {name} should be {value!r}, is {facts.get(name)!r}")


def ensure_trained(options: Options, capture: Path, seed: int, training: Training) -> bool:
    """Whether the run is there, after training it where it was not."""
    run = run_of(options, capture, seed, training)
    if not (run / "run.json").exists():
        note(f"{run.name}: training, preset {options.preset}")
        if train(options, capture, seed, training)() != 0:
            return False
    check_run(run, capture, options, seed)
    return True


def person(options: Options, capture: Path, seed: int) -> list[str]:
    """All rows of one person and seed; what could not be measured, in words."""
    label = f"{capture.name}, seed {seed}"
    rows = [row for name, row in ROWS.items() if name in options.rows]
    trained = {}
    for training in dict.fromkeys(row.training for row in rows):
        trained[training] = ensure_trained(options, capture, seed, training)
    absent = [f"{label}: {row.title} (training failed)" for row in rows if not trained[row.training]]

    def one(row: Row) -> str | None:
        path = folder_of(options, capture, seed) / f"{row.name}.json"
        run = run_of(options, capture, seed, row.training)
        expected = stamp(run, capture, row, options.poses, options.our_poses, options.lpips)
        if finished(path, expected):
            note(f"{label}: {row.title}: kept")
            return None
        note(f"{label}: {row.title}")
        code = measure(options, capture, seed, row)()
        return f"{label}: {row.title} (failed with status {code})" if code else None

    ready = [row for row in rows if trained[row.training]]
    first = [row for row in ready if row.name == "ours"]  # its close-ups stand beside the other rows'
    with ThreadPoolExecutor(options.jobs) as pool:
        said = [one(row) for row in first] + list(pool.map(one, [row for row in ready if row not in first]))
    return absent + [text for text in said if text is not None]


def collect(out: Path) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Every finished row in OUT, and the whole evaluations of ours."""
    results, quality = [], []
    for path in sorted(out.glob("*/seed*/*.json")):
        found = read_json_object(path, "a finished row")
        seed = int(path.parent.name.removeprefix("seed"))
        named = found | {"name": path.parent.parent.name, "seed": seed}
        if found.get("format") == FORMAT:
            results.append(named | {"picture": path.with_suffix(".png").relative_to(out).as_posix()})
        elif path.stem == "quality":
            quality.append(named)
    return results, quality


def tables(options: Options) -> list[str]:
    """Train and measure what is missing, write the summary; returns what could not be measured."""
    absent = []
    for seed in options.seeds:
        for capture in options.captures:
            absent += person(options, capture, seed)
    results, quality = collect(options.out)
    summary = {"format": "selfscan-tables", "rows": results, "quality": quality, "absent": absent}
    write_json(options.out / "tables.json", summary)
    write_text(options.out / "tables.md", page(results, quality, absent))
    return absent


def main(argv: Sequence[str]) -> int:
    options = parse(Options, argv, ABOUT)
    for folder in (options.out, options.runs or options.out / "runs"):
        folder.mkdir(parents=True, exist_ok=True)
    return written(options.out / "tables.md", tables(options))


if __name__ == "__main__":
    end_with(main)
