"""Where numbers stop being true: `python -m experiments.limits` (make limits) writes docs/limits.md.

Each limit is the largest or the smallest value of one quantity for which a promise holds. From a usual value every
power of ten is tried, outwards; between the last that holds and the first that does not, bisection of the exponent goes
on until the two lie a factor of STEP apart. A value does not hold that is refused, or whose error is above the bound.
"""

import argparse
import re
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import NamedTuple

from bench.report.writer import markdown_table
from command.errors import AssetError
from experiments import limit_measures as measures
from experiments.limit_measures import Measure, Place
from files.whole import write_text
from player.gl.context import open_context

PAGE = Path(__file__).parents[1] / "docs" / "limits.md"
STEP = 1.01
PICTURE, PIXELS = 0.005, "of the person's pixels"
HEAD = ("quantity", "", "limit", "error there", "bound", "beyond it")
INTRODUCTION = """# Where numbers stop being true

Written by `make limits`. The largest and the smallest value of each quantity for which its promise holds, to 1 %: found
by bisection from a usual value, through the file that a user gives. *Error there* is what was measured at the value
itself; *beyond it* is what is said at the next one, one percent on: the refusal, or that nothing is said, and the error
then. Pictures are of 96 pixels and without effects that are not named; a pixel is wrong that differs by more than 16 of
255, an exact picture is drawn in double precision. [Hard cases](hard-cases.md) has what holds inside.
"""


@dataclass(frozen=True)
class Limit:
    name: str
    unit: str
    promise: str
    measure: Measure
    # the error, in its own unit, up to which the promise holds
    bound: float
    of: str
    usual: float
    # as far as is looked; None: that side has no end of interest
    least: float | None = None
    most: float | None = None
    whole: bool = False
    # why nothing needs to be said beyond
    silent: str = ""


@dataclass(frozen=True)
class Edge:
    """Where a promise ends on one side."""

    value: float
    error: float
    # what is said at the next value; None: the promise holds as far as was looked
    beyond: str | None


class Tried(NamedTuple):
    holds: bool
    error: float
    said: str


def tried(limit: Limit, place: Place, value: float) -> Tried:
    """Whether the promise holds at a value, and what is said of it otherwise."""
    try:
        error = limit.measure(place, value)
    except (AssetError, ValueError) as refused:
        text = re.sub(r"\S*/(?=[\w.]+)", "", str(refused)).replace("|", "/")
        return Tried(False, float("nan"), f"`{text}`")
    return Tried(error <= limit.bound, error, f"nothing is said{limit.silent}; {error:.2g} {limit.of}")


def edge(limit: Limit, place: Place, end: float) -> Edge:
    """The last value that holds on the way from the usual one to `end`.

    Raises:
        ValueError: the promise does not hold at the usual value.
    """
    at = partial(tried, limit, place)
    inside, found = limit.usual, at(limit.usual)
    if not found.holds:
        raise ValueError(f"{limit.name}: should hold at {limit.usual:g}, does not: {found.said}")
    larger = end > limit.usual
    while True:
        outside = min(10 * inside, end) if larger else max(inside / 10, end)
        beyond = at(outside)
        if not beyond.holds:
            break
        inside, found = outside, beyond
        if inside == end:
            return Edge(inside, found.error, None)
    while abs(outside - inside) > (1 if limit.whole else (STEP - 1) * min(inside, outside)):
        middle = (inside * outside) ** 0.5
        middle = min(max(round(middle), min(inside, outside) + 1), max(inside, outside) - 1) if limit.whole else middle
        half = at(middle)
        if half.holds:
            inside, found = middle, half
        else:
            outside, beyond = middle, half
    return Edge(inside, found.error, beyond.said)


def edges(limit: Limit, place: Place) -> dict[str, Edge]:
    ends = {"smallest": limit.least, "largest": limit.most}
    return {side: edge(limit, place, end) for side, end in ends.items() if end is not None}


pictured = partial(Limit, bound=PICTURE, of=PIXELS)
LIMITS = (
    pictured("distance of an avatar from the origin", "m", "the front camera's picture stays", measures.away,
             usual=1.0, most=1e12),
    pictured("distance of a motion from the origin", "m", "the front camera's picture stays", measures.motion_away,
             usual=1.0, most=1e12),
    pictured("distance of an avatar with its shadow on the ground", "m", "the picture stays", measures.away_in_shadow,
             usual=1.0, most=1e12),
    pictured("distance of another avatar, behind it", "m", "the one in front is whole", measures.one_behind,
             usual=10.0, most=1e12),
    pictured("an avatar's turn on stage", "degrees", "whole turns change nothing", measures.turned_on_stage,
             usual=400.0, most=1e300),
    pictured("size of a person", "of the free body's", "the front camera's picture stays", measures.sized,
             usual=1.0, least=1e-9, most=1e9),
    pictured("distance of the camera, its focal length growing", "m", "the picture is exact", measures.camera_away,
             usual=3.0, most=1e12),
    pictured("vertical field of view", "degrees", "the fitted picture is exact", measures.field_of_view,
             usual=35.0, least=1e-6, most=179.999),
    pictured("width of a picture", "pixels", "it is exact", measures.picture_wide,
             usual=96, most=1e9, whole=True),
    pictured("width of a texture", "texels", "the picture is exact", measures.texture_wide,
             usual=256, most=1e6, whole=True),
    pictured("triangles of an avatar", "", "the picture stays", measures.triangles,
             usual=30_000, most=1 << 22, whole=True),
    pictured("avatars in a scene", "", "the last one is drawn as if alone", measures.avatars,
             usual=2, most=10_000, whole=True),
    Limit("turns of a joint in a pose file", "", "whole turns change nothing", measures.joint_turns,
          0.01, "degrees", usual=1, most=1e18, whole=True),
    Limit("frame rate of a clip", "Hz", "each moment shows its frame", measures.clip_rate,
          0, "frames", usual=30.0, least=1e-6, most=1e9),
    Limit("frames of a clip", "", "each moment shows its frame", measures.clip_length,
          0, "frames", usual=1000, most=1e12, whole=True),
    Limit("moment of a motion at which a scene begins", "s", "each moment shows its frame", measures.scene_start,
          0, "frames", usual=10, most=1e15, whole=True),
    Limit("frame rate of a film", "Hz", "each of a thousand frames is shown at its time", measures.film_rate,
          0.5, "frames", usual=30.0, least=1e-6, most=1e9),
    Limit("time between two keys of a camera path", "s", "the way is the same", measures.key_gap,
          1e-6, "m", usual=1.0, least=1e-12, most=1e15),
    Limit("reach of a face shape in an avatar file", "m", "vertices go where it says", measures.face_offset,
          1e-6, "m", usual=0.01, most=1e9),
    Limit("weight of a face shape", "", "the jaw opens so far", measures.face_weight,
          1e-6, "m", usual=0.5, most=1e9, silent=", trackers overshoot: drawn as 1"),
)  # fmt: skip


def rows(limit: Limit, found: dict[str, Edge]) -> list[Sequence[str]]:
    """A limit's rows of the page."""
    name = f"{limit.name}{', ' * bool(limit.unit)}{limit.unit}: {limit.promise}"
    out = []
    for side, edge in found.items():
        value = f"{edge.value:.0f}" if limit.whole else f"{edge.value:.4g}"
        beyond = "holds as far as was looked" if edge.beyond is None else edge.beyond
        out.append([name, side, value, f"{edge.error:.2g}", f"{limit.bound:g} {limit.of}", beyond])
    return out


def page(measured: Callable[[Limit], dict[str, Edge]]) -> str:
    table = markdown_table(HEAD, [row for limit in LIMITS for row in rows(limit, measured(limit))])
    return "\n".join([INTRODUCTION, *table, ""])


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m experiments.limits", description="Where numbers stop being true.")
    parser.add_argument("-o", "--out", type=Path, default=PAGE, help="the page (default: docs/limits.md)")
    options = parser.parse_args(argv)
    with tempfile.TemporaryDirectory() as folder:
        place = Place(Path(folder), open_context())

        def measured(limit: Limit) -> dict[str, Edge]:
            found = edges(limit, place)
            for row in rows(limit, found):
                print(" | ".join(row), flush=True)
            return found

        write_text(options.out, page(measured))
        place.context.release()
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
