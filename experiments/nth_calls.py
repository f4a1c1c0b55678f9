"""By night: every call that writes fails in the commands that take long, and nothing is lost (tests/nth_call.py).

    python -m experiments.nth_calls [NAME ...] [--most 9] [-o out/nth_calls]

`synth`, `train --resume` and `bake` at their smallest: an error, Ctrl-C and SIGKILL at --most of their calls, the
first, the last and a seeded choice between; at all calls of those that tests try at a few. OUT/nth_calls.json has
calls, trials, and what was lost, left over or stray of each; exit code 1 where there is any. What the commands start
from is made in OUT once.
"""

import argparse
import json
import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
TESTS = ROOT / "tests"
FOUND = ("lost", "litter", "strays")


def inputs(out: Path) -> dict[str, Path]:
    """A capture of a few pixels and a run of a few steps on it, by the names in the commands' words."""
    from painted_capture import write_capture
    from tiny import tiny_training

    from selfscan.__main__ import main

    capture, run = out / "capture", out / "run"
    if not capture.exists():
        write_capture(capture)
    if not run.exists():
        tiny_training(capture, run, "--seed", "1", command=lambda words: main(["train", *words]))
    return {"{capture}": capture, "{run}": run}


def swept(spec: dict, folder: Path) -> dict:
    """The outcome of all trials of a command, in a process of its own, which forks for each."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), str(TESTS)])}
    words = [sys.executable, "-m", "nth_call", json.dumps(spec | {"folder": str(folder)})]
    done = subprocess.run(words, env=environment, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(done.stderr[-3000:])
    return json.loads(done.stdout)


def main() -> int:
    sys.path.insert(0, str(TESTS))
    from nth_call_commands import LONG, SLOW

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", choices=[[], *LONG, *SLOW], metavar="NAME")
    parser.add_argument("--most", type=int, default=9, help="calls of each of the three")
    parser.add_argument("-o", "--out", type=Path, default=Path("out/nth_calls"))
    asked = parser.parse_args()
    out = asked.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    outcomes, bad = {}, 0
    places = inputs(out)
    for name in asked.names or [*LONG, *SLOW]:
        text = json.dumps(LONG[name] | {"most": asked.most} if name in LONG else SLOW[name])
        for place, path in places.items():
            text = text.replace(place, str(path))
        folder = out / f"trials of {name}"
        folder.mkdir()
        outcomes[name] = found = swept(json.loads(text), folder)
        bad += sum(len(found[kind]) for kind in FOUND)
        counts = ", ".join(f"{len(found[kind])} {kind}" for kind in FOUND)
        print(f"{name}: {found['trials']} trials at {found['calls']} calls; {counts}", flush=True)
        (out / "nth_calls.json").write_text(json.dumps(outcomes, indent=1))
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
