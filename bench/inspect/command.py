"""`selfscan inspect NAME.glb -o DIR`: the pictures, the page and the numbers of one avatar."""

import argparse
import json
import time
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

from avatar.errors import AssetError
from avatar.files import whole_folder
from avatar.gltf.avatar_file import read_avatar
from avatar.progress import progress
from avatar.skeleton import JOINTS
from bench.inspect import accuracy_sections as accuracy
from bench.inspect import drawn_sections as drawn
from bench.inspect import surface_sections as surface
from bench.inspect.inspection import Inspection, Inspector, Measured
from bench.inspect.page import Section, page
from bench.inspect.truth_distance import from_run, from_truth
from player.context import opened

EXAMPLES = f"""DIR gets inspect.html, one page with everything in it (mail it, open it anywhere), the same
pictures as files, and inspect.json with the numbers. It needs no display. What the page shows, and what to look for:

  as drawn       six standard views, the paper's colours and with view dependence; strained poses; turntable
  parts          body, head and hands            weights      who moves what; --joint NAME: one joint alone
  texels         their size on the surface       seams        chart edges by the step of colour across them
  cones          how far colour may follow the eye, and what no camera ever saw
  triangles      their size, holes               levels       levels of detail side by side
  field          --run: mesh to field, mm        truth        --capture: mesh to the true surface, mm (P2S)
  accuracy       what baking measured            provenance   where it comes from

A table on top says which numbers are as they should be. The command judges nothing by its exit code.

examples
  selfscan inspect me.glb -o out/inspect
  selfscan inspect me.glb -o out/inspect --run out/run --capture out/capture --joint left_elbow --joint spine3

joints: {", ".join(JOINTS[:22])},
  and left_ right_ with index middle pinky ring thumb 1 2 3"""


ORDER = ("look", "poses", "turntable", "parts", "weights", "texels", "seams", "cones", "triangles", "field", "truth",
         "levels", "accuracy", "provenance")  # fmt: skip


def inspect_parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="selfscan inspect",
        description="Pictures and one page that a person can judge an avatar by.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("avatar", metavar="NAME.glb", type=Path, help="avatar file from `selfscan bake`")
    parser.add_argument("-o", "--output", metavar="DIR", type=Path, required=True, help="folder to write")
    parser.add_argument("--run", type=Path, help="run folder it was baked from: distance of mesh and field")
    parser.add_argument("--capture", type=Path, help="capture with truth/: distance to the true surface")
    parser.add_argument(
        "--joint",
        action="append",
        default=[],
        metavar="NAME",
        help="show this joint's weight alone; again for more",
    )
    parser.add_argument(
        "--size",
        type=_size,
        default=520,
        metavar="N",
        help="side of the large views, pixels (default: %(default)s)",
    )
    parser.add_argument(
        "--turns", type=_turns, default=36, metavar="N", help="views of the turntable (default: %(default)s)"
    )
    parser.add_argument("--context", choices=("auto", "egl", "osmesa"), default="auto", help="how to reach OpenGL")
    return parser


def _size(text: str) -> int:
    if not (text.isdigit() and 64 <= int(text) <= 2048):
        raise argparse.ArgumentTypeError(f"expected 64 to 2048 pixels, found {text!r}")
    return int(text) // 2 * 2


def _turns(text: str) -> int:
    if not (text.isdigit() and 2 <= int(text) <= 720):
        raise argparse.ArgumentTypeError(f"expected 2 to 720 views, found {text!r}")
    return int(text)


def inspect(
    path: Path,
    out: Path,
    *,
    run: Path | None = None,
    capture: Path | None = None,
    joints: list[str] | None = None,
    size: int = 520,
    turns: int = 36,
    context_kind: str = "auto",
) -> Inspection:
    """Write the folder; whole or not at all.

    Raises:
        AssetError: avatar, run or capture cannot be read, or `out` holds other files.
    """
    avatar = read_avatar(path)
    try:
        field = None if run is None else from_run(avatar.levels[0], run)
    except ModuleNotFoundError as error:
        raise AssetError(f"--run needs the package {error.name!r}: pip install 'selfscan[inspect,train]'") from None
    measured = Measured(
        field=field,
        truth=None if capture is None else from_truth(avatar, avatar.levels[0], capture),
    )
    with ExitStack() as stack:
        folder = stack.enter_context(whole_folder(out))
        context = opened(context_kind, None)
        stack.callback(context.release)  # again does nothing
        inspector = Inspector(avatar, path, context, measured, size)
        stack.callback(inspector.release)
        topics: list[Callable[[], Any]] = [
            *(partial(topic, inspector) for topic in (drawn.looks, drawn.posed, drawn.levels)),
            lambda: drawn.turntable(inspector, turns),
            # VTK makes contexts of its own: ours draws before, and is gone then
            context.release,
            lambda: surface.weights(inspector, joints or []),
            *(partial(topic, inspector) for topic in (
                surface.parts, surface.texels, surface.seams, surface.cones, surface.triangles,
                accuracy.field_distance, accuracy.truth_distance, accuracy.provenance,
            )),
        ]  # fmt: skip
        found: dict[str, Section] = {}
        for topic in progress(topics, "topics", len(topics)):
            made = topic()
            found |= {s.key: s for s in (made if isinstance(made, list) else [made]) if s is not None}
        sections = [found[key] for key in ORDER if key in found]
        for picture in (picture for section in sections for picture in section.pictures):
            (folder / f"{picture.name}.{picture.kind}").write_bytes(picture.data)
        inspection = Inspection(inspector.checks, sections, inspector.facts)
        lines = [f"{path.name}, {len(avatar.levels)} levels, view dependence: {avatar.default_view}"]
        lines += [f"{what}: {place.name}" for what, place in (("run", run), ("capture", capture)) if place is not None]
        (folder / "inspect.html").write_text(page(avatar.name, lines, inspection.checks, sections), "utf-8")
        facts = inspection.facts | {"checks": [vars(check) for check in inspection.checks]}
        (folder / "inspect.json").write_text(json.dumps(facts, indent=1, allow_nan=False), "utf-8")
    return inspection


def inspect_main(argv: list[str]) -> int:
    """Inspect one avatar."""
    options = inspect_parser().parse_args(argv)
    unknown = [name for name in options.joint if name not in JOINTS]
    if unknown:
        inspect_parser().error(
            f"--joint: no joint is named {unknown[0]!r}; they are {', '.join(JOINTS[:22])} and the fingers'"
        )
    try:
        import pyvista  # noqa: F401
    except ModuleNotFoundError:
        raise AssetError("needs the package 'pyvista': pip install 'selfscan[inspect]'") from None
    began = time.perf_counter()
    inspection = inspect(
        options.avatar,
        options.output,
        run=options.run,
        capture=options.capture,
        joints=options.joint,
        size=options.size,
        turns=options.turns,
        context_kind=options.context,
    )
    for check in inspection.checks:
        mark = {True: "good", False: "LOOK", None: "    "}[check.good]
        print(f"{mark}  {check.what}: {check.value} (expected: {check.expected})")
    pictures = sum(len(section.pictures) for section in inspection.sections)
    print(f"{options.output}/inspect.html: {pictures} pictures, {time.perf_counter() - began:.0f} s")
    return 0
