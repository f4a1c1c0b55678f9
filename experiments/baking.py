"""What the settings of a bake cost in seconds and bring in accuracy: one run baked with one setting changed at a time.

    python -m experiments.baking out/run --capture out/capture -o out/baking

Every bake has the default settings but for what its row names, and is a process of its own: its seconds are those from
reading the run to the written file, of the wall clock and of the processor (all threads; a machine that others use as
well changes those little). Each avatar is then drawn in its own view mode and compared with the field it was baked from
and, where CAPTURE holds truth, with true pictures of held-out poses (experiments/baking_scores.py); frames of all are
timed in turns; and the default is drawn with numbers of other formats (experiments/baking_formats.py).

What exists in OUT is not made again. Then OUT/baking.json, baking.md and baking.png are written from all rows in OUT,
whatever call made them.
"""

import json
import multiprocessing
import re
import resource
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

from bake.options import BakeOptions
from bench.ladder.machine import commit, cpu_name
from command.command_line import Help, Option, parse
from command.errors import AssetError
from command.settings import AtLeast, OneOf, settings_json
from experiments.program import end_with, note, written
from experiments.short_training import read_kept
from experiments.table_row import digest
from files.whole import whole_file, write_json, write_text
from train.run import read_facts

FORMAT = "selfscan-baking-row"
# what is changed of the default, in the order of the tables; rows of one group stand on one line of the plot
ROWS: tuple[tuple[str, Mapping[str, int | str]], ...] = (
    ("default", {}),
    ("triangles", {"faces": 60_000}),
    ("triangles", {"faces": 10_000}),
    ("triangles", {"faces": 3_000}),
    ("texels", {"texture": 4096}),
    ("texels", {"texture": 2048}),
    ("texels", {"texture": 1024}),
    ("texels", {"texture": 512}),
    ("textures", {"texture_from": "field"}),
    ("textures", {"texture_from": "field", "texel_samples": 1}),
    ("view network", {"steps": 4800}),
    ("view network", {"steps": 300}),
    ("view network", {"steps": 30}),
)
WORDS = {
    "faces": "{:,} triangles",
    "texture": "{} x {} texels",
    "texture_from": "textures from the {}",
    "texel_samples": "{} sample a texel",
    "steps": "{} distillation steps",
}
# `[ 12.3 s, + 4.5] what was done: ...`
CLOCK = re.compile(r"^\[\s*[\d.]+ s, \+\s*[\d.]+\] (level \d|[^:]+)")


@dataclass(frozen=True)
class Row:
    """One bake."""

    group: str
    changed: Mapping[str, int | str]
    options: BakeOptions

    @property
    def key(self) -> str:
        """The name of its folder."""
        return "+".join(f"{name}-{value}" for name, value in self.changed.items()) or "default"

    @property
    def words(self) -> str:
        """For people."""
        named = [WORDS[name].format(*[value] * WORDS[name].count("{")) for name, value in self.changed.items()]
        return ", ".join(named) or f"default: {self.options.faces:,} triangles, {self.options.texture} texels a side"


KEYS = tuple(Row(group, changed, BakeOptions()).key for group, changed in ROWS)


@dataclass(frozen=True)
class Options:
    """What the command is asked for."""

    run: Annotated[Path, Option(positional=True, metavar="RUN"), "a finished run (selfscan train)"]
    out: Annotated[Path, Option(("-o", "--out"), "OUT"),
        "gets a folder for each bake, baking.json, baking.md and baking.png"]
    capture: Annotated[Path | None, "its capture: the videos, where run.json does not find them, and the truth, where "
        "it holds some (selfscan synth)"] = None
    rows: Annotated[tuple[str, ...], OneOf(KEYS), Option(metavar="ROW", several=True),
        f"bakes to make now (default: all): {', '.join(KEYS)}"] = KEYS
    texture: Annotated[int, "texels a side of all bakes but those whose row changes them"] = BakeOptions().texture
    poses: Annotated[int, AtLeast(1),
        "held-out poses compared, half a minute of processor time an avatar for four"] = 4
    seconds: Annotated[float, "that frames are timed"] = 20.0

    def __post_init__(self):
        BakeOptions(texture=self.texture)  # refused by its own rules


ABOUT = Help(
    "python -m experiments.baking",
    "What the settings of a bake cost in seconds and bring in accuracy: one run baked again and again, each time with "
    "one setting changed, and compared with its field and with true pictures.",
    "example: python -m experiments.baking out/run --capture out/capture -o out/baking; a bake takes minutes "
    "of processor time, --texture 1024 about halves that, --rows makes only some",
)


def rows_of(default: BakeOptions) -> tuple[Row, ...]:
    """All rows beside these settings; what they have already is no row of its own."""
    rows = [Row(group, changed, replace(default, **changed)) for group, changed in ROWS]
    return tuple(row for row in rows if not row.changed or row.options != default)


def baked(row: Row, options: Options) -> dict[str, Any] | None:
    """The row's bake, made unless that has been done; None where it failed."""
    folder = options.out / row.key
    path, stamp = folder / "bake.json", {"run": digest(options.run / "run.json"), "options": settings_json(row.options)}
    found = read_kept(path, {"format": FORMAT, "stamp": stamp})
    if found is not None and (folder / "avatar.glb").is_file():
        return found
    folder.mkdir(parents=True, exist_ok=True)
    stages = folder / "stages.json"
    stages.unlink(missing_ok=True)
    start, used = time.perf_counter(), children_seconds()
    child = multiprocessing.get_context("spawn").Process(
        target=bake_apart, args=(options.run, options.capture, folder / "avatar.glb", row.options, stages)
    )
    child.start()
    child.join()
    if child.exitcode != 0 or not stages.is_file():
        return None
    result = {
        "format": FORMAT,
        "stamp": stamp,
        "key": row.key,
        "group": row.group,
        "words": row.words,
        "seconds": round(time.perf_counter() - start, 1),
        "cpu_seconds": round(children_seconds() - used, 1),
        **json.loads(stages.read_text("utf-8")),
        "bytes": (folder / "avatar.glb").stat().st_size,
        "cpu": cpu_name(),
        "commit": commit(),
    }
    write_json(path, result)
    return result


def children_seconds() -> float:
    """Processor seconds of ended children and theirs."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def bake_apart(run: Path, capture: Path | None, out: Path, options: BakeOptions, stages: Path) -> None:
    """One bake in a process of its own; leaves what its stages took, and what the file says of it, in `stages`."""
    from bake.bake import bake_run
    from bake.run_capture import run_videos
    from train.run import read_run

    clock = StageClock()
    trained = read_run(run)
    videos = None if options.texture_from == "field" else run_videos(run, trained.provenance, capture)
    clock.ended("reading the run")
    avatar = bake_run(trained.bake_source, out, options, clock, videos=videos)
    facts = avatar.provenance["baked"]
    told = {"stages": clock.stages, "view": avatar.default_view, "distilled_db": facts["distilled_db"]}
    told |= {"field_to_mesh_mm": facts["levels"][0]["field_to_mesh_mm"]["mean"]}
    told |= {"texel_mm": facts["levels"][0]["texel_mm_by_part"]}
    with whole_file(stages, "w") as file:
        json.dump(told, file)


class StageClock:
    """Called with each line that a bake reports: keeps the processor seconds of its stages, by their names."""

    def __init__(self, report: Callable[[str], None] = note):
        self.report, self.stages, self.last = report, {}, own_seconds()

    def __call__(self, line: str) -> None:
        self.report(line)
        found = CLOCK.match(line)
        if found is not None:
            # the last stage is named after the file
            self.ended("writing" if ".glb" in found[1] else found[1])

    def ended(self, stage: str) -> None:
        now = own_seconds()
        self.stages[stage] = round(self.stages.get(stage, 0.0) + now - self.last, 2)
        self.last = now


def own_seconds() -> float:
    """Processor seconds of this process and its ended children."""
    return time.process_time() + children_seconds()


def measure(options: Options) -> list[str]:
    """All rows, their scores and the report; what could not be measured, in words."""
    from experiments.baking_formats import format_rows
    from experiments.baking_page import markdown, plot
    from experiments.baking_scores import frame_times, read_references, scored

    absent: list[str] = []
    done: list[float] = []
    rows = [row for row in rows_of(BakeOptions(texture=options.texture)) if row.key in options.rows]
    for number, row in enumerate(rows):
        known = (options.out / row.key / "bake.json").is_file()
        left = len(rows) - number
        expected = f", about {left * sum(done) / len(done) / 60:.0f} min left" if done else ""
        note(f"[{number + 1}/{len(rows)}] {row.words}{expected}")
        start = time.perf_counter()
        if baked(row, options) is None:
            absent.append(f"{row.words}: the bake failed")
        elif not known:
            done.append(time.perf_counter() - start)
    folders = [path.parent for path in sorted(options.out.glob("*/bake.json"))]
    if not (options.out / "default" / "bake.json").is_file():
        raise AssetError(f"{options.out}: expected a bake of the default, found none: name it in --rows")
    references = read_references(options.run, options.capture, options.poses)
    for folder in folders:
        note(f"{folder.name}: compared with {references.names}")
        scored(folder, references)
    note("frames, in turns")
    times = frame_times({folder.name: folder / "avatar.glb" for folder in folders}, references, options.seconds)
    formats = format_rows(options.out / "default" / "avatar.glb", references, options.seconds)
    trained = read_facts(options.run)
    result = {
        "format": "selfscan-baking",
        "cpu": cpu_name(),
        "commit": commit(),
        "trained": {
            **{key: trained.get(key) for key in ("subject", "preset", "cpu_seconds", "device")},
            "size": trained.get("capture", {}).get("size"),
        },
        "references": references.facts,
        "rows": collected(folders, times),
        "frames": times,
        "formats": formats,
        "absent": absent,
    }
    write_json(options.out / "baking.json", result)
    write_text(options.out / "baking.md", markdown(result))
    plot(result, options.out / "baking.png")
    return absent


def collected(folders: Sequence[Path], times: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Rows of the report in the order of the tables."""
    rows = []
    for folder in folders:
        row = json.loads((folder / "bake.json").read_text("utf-8"))
        row["scores"] = json.loads((folder / "scores.json").read_text("utf-8"))["scores"]
        row["frame"] = times["rows"][folder.name]
        rows.append(row)
    order = [Row(group, changed, BakeOptions()).key for group, changed in ROWS]
    return sorted(rows, key=lambda row: order.index(row["key"]))


def main(argv: Sequence[str]) -> int:
    options = parse(Options, argv, ABOUT)
    if not (options.run / "run.json").is_file():
        raise AssetError(f"{options.run}: expected a run folder made by `selfscan train`, found no run.json")
    options.out.mkdir(parents=True, exist_ok=True)
    return written(options.out / "baking.md", measure(options))


if __name__ == "__main__":
    end_with(main)
