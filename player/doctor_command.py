"""`selfscan doctor`: what this machine can draw with."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from command.command_line import Help, Option, parse
from files.whole import write_json


@dataclass(frozen=True)
class DoctorCommand:
    compare: Annotated[str | None, Option(metavar="AVATAR", const="mannequin"),
        "draw one frame (of the built-in body) on EGL, on OSMesa and in a window, and compare them"] = None
    json: Annotated[Path | None, Option(metavar="FILE"), "write the findings to a file"] = None


DOCTOR = Help("selfscan doctor", "Which OpenGL contexts work here, which one wins and why, and what is missing.")


def doctor_main(argv: list[str]) -> int:
    """Print what this machine can draw with."""
    options = parse(DoctorCommand, argv, DOCTOR)
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
        write_json(options.json, found)
    return 0 if worked else 1
