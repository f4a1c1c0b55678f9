"""`selfscan inspect`: what it is asked for, and its command line; the work is in bench/inspect/command.py."""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from command.command_line import Help, Option, parse
from command.errors import missing_package
from command.settings import AtLeast, AtMost, OneOf
from files.whole import check_folder

EXAMPLES = """DIR gets inspect.html, one page with everything in it (mail it, open it anywhere), the same
pictures as files, and inspect.json with the numbers. It needs no display. The page says what to look for, and
a table on top which numbers are as they should be. The command judges nothing by its exit code.

examples
  selfscan inspect me.glb -o inspected
  selfscan inspect me.glb -o inspected --run run"""


@dataclass(frozen=True)
class InspectCommand:
    avatar: Annotated[Path, Option(positional=True, metavar="NAME.glb"), "avatar file from `selfscan bake`"]
    output: Annotated[Path, Option(("-o", "--output"), "DIR"), "folder to write"]
    run: Annotated[Path | None, Option(metavar="RUN"),
        "run folder it was baked from: distance of mesh and field"] = None
    size: Annotated[int, AtLeast(64), AtMost(2048), "side of the large views, pixels"] = 520
    context: Annotated[str, OneOf(("auto", "egl", "osmesa")), "how to reach OpenGL"] = "auto"


INSPECT = Help("selfscan inspect", "Pictures and one page that a person can judge an avatar by.", EXAMPLES)


def inspect_main(argv: list[str]) -> int:
    """Inspect one avatar."""
    options = parse(InspectCommand, argv, INSPECT)
    try:
        import pyvista  # noqa: F401
    except ModuleNotFoundError:
        raise missing_package("pyvista", "inspect") from None
    check_folder(options.output, options.avatar, options.run)
    from bench.inspect.command import inspect

    began = time.perf_counter()
    inspection = inspect(options)
    for check in inspection.checks:
        mark = {True: "good", False: "LOOK", None: "    "}[check.good]
        print(f"{mark}  {check.what}: {check.value} (expected: {check.expected})")
    pictures = sum(len(section.pictures) for section in inspection.sections)
    print(f"{options.output}/inspect.html: {pictures} pictures, {time.perf_counter() - began:.0f} s")
    return 0
