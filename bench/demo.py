"""`make demo`: the whole path on the built-in person, from four synthetic videos to a film of the avatar.

    python -m bench.demo out/demo

Stages run in order and each prints one line with its seconds. A stage whose output is complete is kept, so an
interrupted demo goes on where it stopped; once a stage has run anew, all after it run anew as well.
"""

import argparse
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from avatar.errors import AssetError


@dataclass(frozen=True)
class Stage:
    name: str
    product: Path  # written whole or not at all by the stage, last of what it writes
    run: Callable[[], object]


def stages(out: Path) -> list[Stage]:
    """The commands of the demo, as a user would type them. Each is imported when it runs."""
    capture, run, avatar, film = out / "capture", out / "run", out / "avatar.glb", out / "avatar.mp4"

    def synth() -> object:
        from bench.synth.command import main

        return main(["builtin", str(capture)])

    def train() -> object:
        from train.command import main

        resume = ["--resume"] if run.with_name(run.name + ".partial").exists() else []
        return main([str(capture), "-o", str(run), "--preset", "demo", *resume])

    def bake() -> object:
        from bake.command import main

        return main([str(run), "-o", str(avatar)])

    def render() -> object:
        from player.command import render_main

        return render_main([str(avatar), "--motion", "counting", "--size", "640x640", "-o", str(film)])

    def contact() -> object:
        from bench.contact import contact_sheet

        return contact_sheet(run, avatar, capture, out / "contact.png")

    def report() -> object:
        from bench.report import bench_main

        return bench_main(
            [str(avatar), "--run", str(run), "--capture", str(capture), "-o", str(out / "report")]
        )

    return [
        Stage("synth", capture / "capture.json", synth),
        Stage("train", run / "run.json", train),
        Stage("bake", avatar, bake),
        Stage("film", film, render),
        Stage("contact sheet", out / "contact.png", contact),
        Stage("accuracy against time", out / "report" / "bench.json", report),
    ]


def run_stages(todo: list[Stage]) -> None:
    """Run what is not there yet, and everything after it.

    Raises:
        AssetError: a stage ended without its product.
    """
    fresh = False
    for number, stage in enumerate(todo, 1):
        label = f"[{number}/{len(todo)}] {stage.name}"
        if stage.product.exists() and not fresh:
            print(f"{label}: kept {stage.product}", flush=True)
            continue
        fresh = True
        print(f"{label} ...", flush=True)
        start = time.perf_counter()
        code = stage.run()
        if code not in (None, 0) or not stage.product.exists():
            raise AssetError(f"{stage.product}: the stage {stage.name!r} ended without writing it")
        print(f"{label}: {time.perf_counter() - start:.0f} s, {stage.product}", flush=True)


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m bench.demo", description="The whole path on the built-in person.")
    parser.add_argument("out", type=Path, nargs="?", default=Path("out/demo"), help="folder (%(default)s)")
    options = parser.parse_args(argv)
    start = time.perf_counter()
    try:
        run_stages(stages(options.out))
    except AssetError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    print(
        f"done in {time.perf_counter() - start:.0f} s: {options.out}/avatar.mp4, contact.png, report/bench.md"
    )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
