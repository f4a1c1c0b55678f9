"""`make demo`: the whole path on the built-in person, from four synthetic videos to a film of the avatar.

    python -m bench.demo out/demo

Stages run in order and each prints one line with its seconds. A stage whose output is complete is kept, so an
interrupted demo goes on where it stopped; once a stage has run anew, all after it run anew as well.
"""

import argparse
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from avatar.errors import AssetError


@dataclass(frozen=True)
class Stage:
    name: str
    # written whole or not at all by the stage, last of what it writes
    product: Path
    run: Callable[[], object]


def command(*words: str | Path) -> Callable[[], int]:
    """A command of the project as a process of its own.

    Training must not share a process with drawing: torch's optimiser brings its own LLVM (triton), which crashes
    where Mesa's was loaded first. A person types the commands one by one as well.
    """

    def run() -> int:
        return subprocess.run([sys.executable, "-m", *map(str, words)], check=False).returncode

    return run


def stages(out: Path) -> list[Stage]:
    """The commands of the demo, as a user would type them."""
    capture, run, avatar, film = out / "capture", out / "run", out / "avatar.glb", out / "avatar.mp4"
    contact, report = out / "contact.png", out / "report"
    resume = ["--resume"] if run.with_name(run.name + ".partial").exists() else []
    given = ["--run", run, "--capture", capture]
    return [
        Stage("synth", capture / "capture.json", command("selfscan", "synth", "builtin", capture)),
        Stage(
            "train",
            run / "run.json",
            command("selfscan", "train", capture, "-o", run, "--preset", "demo", *resume),
        ),
        Stage("bake", avatar, command("selfscan", "bake", run, "-o", avatar, "--capture", capture)),
        Stage(
            "film",
            film,
            command("selfscan", "render", avatar, "--motion", "counting", "--size", "640x640", "-o", film),
        ),
        Stage("contact sheet", contact, command("bench.contact", run, avatar, capture, "-o", contact)),
        Stage(
            "accuracy against time",
            report / "bench.json",
            command("selfscan", "bench", avatar, *given, "-o", report, "--frames", "1", "--rounds", "5"),
        ),
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
    options.out.mkdir(parents=True, exist_ok=True)
    try:
        run_stages(stages(options.out))
    except AssetError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    out = options.out
    print(
        f"done in {time.perf_counter() - start:.0f} s: film {out / 'avatar.mp4'}, "
        f"contact sheet {out / 'contact.png'}, report {out / 'report' / 'bench.md'}"
    )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
