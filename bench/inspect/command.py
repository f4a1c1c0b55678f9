"""`selfscan inspect NAME.glb -o DIR`: the pictures, the page and the numbers of one avatar."""

import argparse
import json
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from avatar.errors import missing_package
from avatar.files import check_folder, whole_folder
from avatar.gltf.avatar_file import read_avatar
from avatar.progress import progress
from avatar.settings import AtLeast, AtMost, Help, OneOf, Option, parse
from avatar.skeleton import JOINTS
from bench.inspect import accuracy_sections as accuracy
from bench.inspect import drawn_sections as drawn
from bench.inspect import surface_sections as surface
from bench.inspect.face_section import face
from bench.inspect.inspection import Inspection, Inspector, Measured
from bench.inspect.page import Section, page
from bench.inspect.truth_distance import from_run, from_truth
from player.context import opened

EXAMPLES = f"""DIR gets inspect.html, one page with everything in it (mail it, open it anywhere), the same
pictures as files, and inspect.json with the numbers. It needs no display. What the page shows, and what to look for:

  as drawn       six standard views, the paper's colors and with view dependence; strained poses; turntable
  face           at 512 px; --capture: beside true pictures, with the error of the eye region
  parts          body, head and hands            weights      who moves what; --joint NAME: one joint alone
  texels         their size on the surface       seams        chart edges by the step of color across them
  cones          how far color may follow the eye, and what no camera ever saw
  triangles      their size, holes               levels       levels of detail side by side
  field          --run: mesh to field, mm        truth        --capture: mesh to the true surface, mm (P2S)
  accuracy       what baking measured            provenance   where it comes from

A table on top says which numbers are as they should be. The command judges nothing by its exit code.

examples
  selfscan inspect me.glb -o out/inspect
  selfscan inspect me.glb -o out/inspect --run out/run --capture out/capture --joint left_elbow --joint spine3

joints: {", ".join(JOINTS[:22])},
  and left_ right_ with index middle pinky ring thumb 1 2 3"""


ORDER = ("look", "face", "poses", "turntable", "parts", "weights", "texels", "seams", "cones", "triangles", "field",
         "truth", "levels", "accuracy", "provenance")  # fmt: skip


def parse_joint(text: str) -> str:
    """The name of one of the 52 joints."""
    if text not in JOINTS:
        raise argparse.ArgumentTypeError(
            f"no joint is named {text!r}; they are {', '.join(JOINTS[:22])} and the fingers'"
        )
    return text


@dataclass(frozen=True)
class InspectCommand:
    """`selfscan inspect`."""

    avatar: Annotated[Path, Option(positional=True, metavar="NAME.glb"), "avatar file from `selfscan bake`"]
    output: Annotated[Path, Option(("-o", "--output"), "DIR"), "folder to write"]
    run: Annotated[Path | None, Option(metavar="RUN"), "run folder it was baked from: distance of mesh and field"] = (
        None
    )
    capture: Annotated[Path | None, Option(metavar="CAPTURE"), "capture with truth/: distance to the true surface"] = (
        None
    )
    joint: Annotated[
        tuple[str, ...],
        Option(metavar="NAME", parse=parse_joint, repeated=True),
        "show this joint's weight alone; again for more",
    ] = ()
    size: Annotated[int, AtLeast(64), AtMost(2048), "side of the large views, pixels"] = 520
    turns: Annotated[int, AtLeast(2), AtMost(720), "views of the turntable"] = 36
    context: Annotated[str, OneOf(("auto", "egl", "osmesa")), "how to reach OpenGL"] = "auto"


INSPECT = Help("selfscan inspect", "Pictures and one page that a person can judge an avatar by.", EXAMPLES)


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
        raise missing_package(error.name, "inspect,train", "--run") from None
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
            lambda: face(inspector, capture),
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
    options = parse(InspectCommand, argv, INSPECT)
    try:
        import pyvista  # noqa: F401
    except ModuleNotFoundError:
        raise missing_package("pyvista", "inspect") from None
    check_folder(options.output)
    began = time.perf_counter()
    inspection = inspect(
        options.avatar,
        options.output,
        run=options.run,
        capture=options.capture,
        joints=list(options.joint),
        size=options.size // 2 * 2,
        turns=options.turns,
        context_kind=options.context,
    )
    for check in inspection.checks:
        mark = {True: "good", False: "LOOK", None: "    "}[check.good]
        print(f"{mark}  {check.what}: {check.value} (expected: {check.expected})")
    pictures = sum(len(section.pictures) for section in inspection.sections)
    print(f"{options.output}/inspect.html: {pictures} pictures, {time.perf_counter() - began:.0f} s")
    return 0
