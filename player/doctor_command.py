"""`selfscan doctor`: what this machine can draw with."""

import argparse
import json
from pathlib import Path

from avatar.files import whole_file


def doctor_main(argv: list[str]) -> int:
    """Print what this machine can draw with."""
    parser = argparse.ArgumentParser(
        prog="selfscan doctor",
        description="Which OpenGL contexts work here, which one wins and why, and what is missing.",
    )
    parser.add_argument(
        "--compare",
        nargs="?",
        const="mannequin",
        metavar="AVATAR",
        help="draw one frame (of the built-in body) on EGL, on OSMesa and in a window, and compare them",
    )
    parser.add_argument("--json", metavar="FILE", help="write the findings to a file")
    options = parser.parse_args(argv)
    from player.doctor import compare, findings, report

    found = findings()
    print(report(found))
    worked = found["winner"] is not None
    if options.compare:
        result = compare(options.compare)
        found["compare"] = result
        print(result["text"])
        worked = worked and result["equal"]
    if options.json:
        with whole_file(Path(options.json), "w") as file:
            json.dump(found, file, indent=1)
    return 0 if worked else 1
