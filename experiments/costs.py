"""What each item of making an avatar costs in seconds, beside how to leave it out.

    python -m experiments.costs RUN [RUN ...] [--bake] [-o costs.md]

Training's seconds are those of each run's run.json (wall time; two parts side by side on two cores, so their sum is
more than the whole). --bake bakes each run twice, with textures from the field and from the videos, and takes the
times that `selfscan bake` prints: a quiet machine is needed. Items that the people of these runs do not call for (no
hair that hangs, even light) show what looking for them costs.
"""

import argparse
import re
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from bench.report.writer import markdown_table, number
from files.whole import whole_file
from train.run import read_facts


class Item(NamedTuple):
    """One row: what is paid for, the keys of run.json's seconds that it is made of, and how it is left out."""

    title: str
    keys: tuple[str, ...]
    left_out: str = ""


ITEMS = (
    Item("poses and masks: looked at, refined where outlines do not meet", ("poses and masks",), "--refine-poses off"),
    Item("head placed by its own video", ("head by its own video",), "--without hair"),
    Item("hair carved, hollows included", ("hair carved",), "--without hair"),
    Item("clothes that stand off, carved", ("clothes carved",), "--without clothes"),
    Item("the capture's light", ("light",), "--without light"),
    Item("body (Eq. 10-12)", ("body",), "fewer --iterations"),
    Item("head", ("head",), "fewer --iterations"),
    Item("hands", ("hand_left", "hand_right"), "fewer --iterations"),
    Item("head on body (Eq. 5)", ("registration",)),
    Item("open eyes", ("eyes",), "--without eyes"),
    Item("body meets parts, stage 2 (Eq. 7, 13)", ("union",)),
    Item("surface, with hair's own layer", ("surface",)),
    Item("view directions (Eq. 14)", ("views",)),
    Item("overlap colors (Eq. 8)", ("appearance",)),
    Item("training in all", ("all",)),
)
BAKES = {"bake, textures from the field": "field", "bake, textures from the videos": "videos"}
# `[ 12.3 s, + 4.5] what was done`
CLOCK = re.compile(r"\[\s*([\d.]+) s, \+\s*[\d.]+\]")


def item_seconds(facts: Mapping[str, Any], item: Item) -> float | None:
    """Seconds of an item in a run's facts; None where that run knows nothing of it."""
    found = [facts["seconds"][key] for key in item.keys if key in facts["seconds"]]
    return sum(found) if found else None


def baked_seconds(run: Path, textures: str) -> float:
    """Seconds of one bake of a run, by its own clock."""
    with tempfile.TemporaryDirectory() as folder:
        words = ["selfscan", "bake", str(run), "-o", f"{folder}/avatar.glb", "--texture-from", textures]
        done = subprocess.run([sys.executable, "-m", *words], capture_output=True, text=True, check=True)
    return float(CLOCK.findall(done.stdout + done.stderr)[-1])


def table(columns: Mapping[str, Mapping[str, float | None]], left_out: Mapping[str, str]) -> str:
    """Rows of seconds, a column a person."""
    names = list(columns)
    rows = [
        [title, *(number(columns[name].get(title), 0) for name in names), how and f"`{how}`"]
        for title, how in left_out.items()
    ]
    return "\n".join(markdown_table(["seconds", *names, "left out by"], rows)) + "\n"


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m experiments.costs", description=__doc__)
    parser.add_argument("runs", type=Path, nargs="+", metavar="RUN")
    parser.add_argument("--bake", action="store_true", help="bake each run with both kinds of textures and time it")
    parser.add_argument("-o", "--out", type=Path, help="Markdown file (default: standard output)")
    options = parser.parse_args(argv)
    columns: dict[str, dict[str, float | None]] = {}
    for run in options.runs:
        facts = read_facts(run)
        own = {item.title: item_seconds(facts, item) for item in ITEMS}
        if options.bake:
            own |= {title: baked_seconds(run, textures) for title, textures in BAKES.items()}
        columns[f"{facts['subject']} ({facts['machine']})"] = own
    left_out = {item.title: item.left_out for item in ITEMS}
    if options.bake:
        left_out |= {title: f"--texture-from {textures}" for title, textures in BAKES.items()}
    text = table(columns, left_out)
    if options.out is None:
        print(text, end="")
    else:
        with whole_file(options.out) as file:
            file.write(text.encode())
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
