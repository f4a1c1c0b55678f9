"""`selfscan train` in a process of its own, small: two hands, few steps of few rays, nothing composed.

usage: python tests/hands_training.py CAPTURE -o RUN [options of selfscan train], the project on PYTHONPATH
"""

import os
import shutil
import sys

from tiny import tiny

from selfscan.__main__ import main
from train import preset, stages

STEPS = int(os.environ.get("SELFSCAN_TEST_STEPS", "240"))
HANDS = ("hand_left", "hand_right")
SMALL = tiny(preset.DEMO, iterations=STEPS)


def two_hands() -> None:
    """Leave the rest of a training out."""
    preset.PRESETS["demo"] = SMALL
    os.cpu_count = lambda: 2
    run_jobs = stages.run_jobs
    stages.run_jobs = lambda jobs, *rest: run_jobs({name: jobs[name] for name in HANDS}, *rest)

    def copy_parts(training, *rest):
        session = training.session
        if not training.ranks.writes:
            return
        session.out.mkdir(exist_ok=True)
        for name in (*(f"{hand}.pt" for hand in HANDS), "logs"):
            copy = shutil.copytree if (session.partial / name).is_dir() else shutil.copyfile
            copy(session.partial / name, session.out / name)
        shutil.rmtree(session.partial)

    stages.finish = copy_parts


if __name__ == "__main__":
    two_hands()
    sys.exit(main(["train", *sys.argv[1:]]))
