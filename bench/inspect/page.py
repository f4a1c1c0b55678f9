"""One HTML page with everything in it: pictures, legends, tables; no script, no other file."""

import base64
from collections.abc import Sequence
from dataclasses import astuple, dataclass, field
from html import escape
from typing import Any

import numpy as np
from jaxtyping import UInt8

from bench.inspect.colors import Legend
from files.picture import encode_png

STYLE = """
:root { --ink: #22262b; --soft: #687078; --line: #dcdcd8; --paper: #fbfbfa; --card: #f6f6f4; --good: #2a7d4f;
 --look: #b35a00 }
* { box-sizing: border-box }
body { margin: 0; background: var(--paper); color: var(--ink); font: 15px/1.5 system-ui, sans-serif }
main { max-width: 1240px; margin: 0 auto; padding: 28px 20px 60px }
h1 { font-size: 26px; margin: 0 0 4px } h2 { font-size: 19px; margin: 40px 0 6px; padding-top: 14px; border-top: 1px
solid var(--line) } p { margin: 4px 0 12px; max-width: 78ch } .soft { color: var(--soft) }
nav { display: flex; flex-wrap: wrap; gap: 6px 16px; margin: 14px 0 } nav a { color: #265e9c; text-decoration: none }
img { display: block; max-width: 100%; height: auto; background: var(--card) }
figure { margin: 10px 0 16px } figcaption { color: var(--soft); font-size: 13px; margin-top: 4px }
.row { display: flex; flex-wrap: wrap; gap: 14px; align-items: flex-start } .row figure { margin: 0 }
table { border-collapse: collapse; margin: 8px 0 16px; font-variant-numeric: tabular-nums }
th, td { text-align: left; padding: 4px 14px 4px 0; border-bottom: 1px solid var(--line); vertical-align: top }
th { font-weight: 600 } .good td:last-child { color: var(--good) }
.look td:last-child { color: var(--look); font-weight: 600 } .values td { overflow-wrap: anywhere; max-width: 70ch }
.legend { max-width: 560px; margin: 6px 0 10px } .bar { height: 14px; border: 1px solid var(--line) }
.ticks { display: flex; justify-content: space-between; font-size: 12.5px; color: var(--soft) }
.named { display: flex; flex-wrap: wrap; gap: 4px 14px; font-size: 13px } .named i { display: inline-block;
 width: 12px; height: 12px; margin-right: 5px; border: 1px solid var(--line); vertical-align: -1px }
@media (prefers-color-scheme: dark) { :root { --ink: #e3e5e7; --soft: #9aa2aa; --line: #3a3f45; --paper: #1b1e22;
 --card: #25292e; --good: #6cc494; --look: #f0a050 } nav a { color: #83b4ea } }
"""


@dataclass
class PagePicture:
    """One picture of the page; `data` is an encoded PNG."""

    # file name in the folder, without suffix
    name: str
    data: bytes
    caption: str
    # pixels on the page, its own where not given
    width: int | None = None


# what stands on the page, in its order: headings, and what to look for
SECTIONS = {
    "look": ("As drawn", "The finest level in the pose it is stored in. Look for blur, colors of one part on another, "
             "a line at neck or wrists, fingers grown together."),
    "face": ("Face", "The face filling the picture. Look for whites, irises and pupils that can be made out, nostrils "
             "that are no stripes, a hairline, a collar that is a line."),
    "poses": ("Posed", "Linear blend skinning in poses that strain it. Look for collapsed elbows and knees, armpits "
              "that pull the chest along, fingers that drag each other."),
    "parts": ("Parts", "The part whose joints move a vertex most, with its share of the surface."),
    "weights": ("Skin weights", "Soft borders run round a limb, never along it; left and right, and neighbouring "
                "fingers, do not exchange colors."),
    "seams": ("Chart seams", "Edges where the atlas was cut, colored by the largest difference of color between the "
              "two sides (of 255). Where it is bright a line may be seen; it should not gather on the face, the neck "
              "or the wrists. Our player stops at the mips that the atlas' gutters keep apart; other viewers go on to "
              "coarser ones."),
    "cones": ("Cones and unseen regions", "How far color may follow the eye: the half-angle of directions that "
              "training saw, mean of widest and narrowest, times how well the point was seen. Pink was never seen: "
              "armpits, between fingers, soles. Its color is the field's guess."),
    "triangles": ("Triangles", "The close views show the edges. Slivers and sudden changes of size come out as lines."),
    "field": ("Distance to the field", "Of each triangle's centre and corners the one farthest from the field's "
              "surface. Red stands outside of it, blue inside."),
    "accuracy": ("Measured while baking", "As written into the file; paths are those of its JSON."),
    "provenance": ("Provenance", "Where the avatar comes from."),
}  # fmt: skip


@dataclass
class PageSection:
    """One of SECTIONS as it is found: pictures with their legend, and a table."""

    key: str
    pictures: list[PagePicture] = field(default_factory=list)
    legend: Legend | None = None
    # the first is the head
    rows: list[tuple[str, ...]] = field(default_factory=list)
    # what is to be said of this avatar beside
    more: str = ""

    @property
    def title(self) -> str:
        return SECTIONS[self.key][0]

    @property
    def text(self) -> str:
        return f"{SECTIONS[self.key][1]} {self.more}".rstrip()


@dataclass(frozen=True)
class Check:
    what: str
    value: str
    expected: str
    good: bool | None  # None: stated, not judged


def picture(
    name: str, image: UInt8[np.ndarray, "height width 3"], caption: str, width: int | None = None
) -> PagePicture:
    return PagePicture(name, encode_png(np.ascontiguousarray(image)), caption, width)


def page(name: str, lines: list[str], checks: list[Check], sections: list[PageSection]) -> str:
    """The page as text."""
    marks = {True: "good", False: "look", None: ""}
    verdict = [("What", "Here", "Expected", ""), *((*astuple(check)[:3], marks[check.good]) for check in checks)]
    parts = [
        '<!doctype html><html lang="en"><meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<title>{escape(name)}: inspection</title><style>{STYLE}</style><main>",
        f"<h1>{escape(name)}</h1>",
        *(f'<p class="soft">{escape(line)}</p>' for line in lines),
        "<nav>" + "".join(f'<a href="#{s.key}">{escape(s.title)}</a>' for s in sections) + "</nav>",
        _table(verdict, "verdict"),
    ]
    for section in sections:
        parts.append(f'<section id="{section.key}"><h2>{escape(section.title)}</h2><p>{escape(section.text)}</p>')
        if section.legend is not None:
            parts.append(_legend(section.legend))
        figures = "".join(_figure(picture) for picture in section.pictures)
        parts.append(f'<div class="row">{figures}</div>' if len(section.pictures) > 1 else figures)
        parts.append((_table(section.rows, "values") if section.rows else "") + "</section>")
    return "\n".join(parts) + "</main></html>\n"


def _figure(picture: PagePicture) -> str:
    source = f"data:image/png;base64,{base64.b64encode(picture.data).decode()}"
    width = f' style="width:{picture.width}px"' if picture.width else ""
    caption = escape(picture.caption)
    return f'<figure><img src="{source}" alt="{caption}"{width}><figcaption>{caption}</figcaption></figure>'


def _legend(legend: Legend) -> str:
    out = ""
    if legend.stops:
        ticks = "".join(f"<span>{escape(tick)}</span>" for tick in legend.ticks)
        out += f'<div class="bar" style="background:linear-gradient(90deg,{",".join(legend.stops)})"></div>'
        out += f'<div class="ticks">{ticks}</div>'
    named = "".join(f'<span><i style="background:{color}"></i>{escape(name)}</span>' for color, name in legend.named)
    return f'<div class="legend">{out}<div class="named">{named}</div></div>'


def _table(rows: Sequence[Sequence[str]], kind: str) -> str:
    """A table under its head; the last cell of a row of the verdict is its mark."""
    lines = []
    for tag, row in zip(["th", *["td"] * (len(rows) - 1)], rows, strict=True):
        mark = f' class="{row[-1]}"' if kind == "verdict" else ""
        lines.append(f"<tr{mark}>" + "".join(f"<{tag}>{escape(cell)}</{tag}>" for cell in row) + "</tr>")
    return f'<table class="{kind}">{"".join(lines)}</table>'


def flattened(tree: Any, prefix: str = "") -> list[tuple[str, str]]:
    """A JSON tree as rows of (path, value); short lists of numbers stay in one row."""
    if isinstance(tree, dict):
        rows = []
        for key, value in tree.items():
            rows += flattened(value, f"{prefix}.{key}" if prefix else str(key))
        return rows or [(prefix, "{}")]
    if isinstance(tree, list):
        if all(not isinstance(value, dict | list) for value in tree) and len(tree) <= 16:
            return [(prefix, ", ".join(_plain(value) for value in tree))]
        if any(isinstance(value, dict) for value in tree):
            return [row for i, value in enumerate(tree) for row in flattened(value, f"{prefix}[{i}]")]
        return [(prefix, f"{len(tree)} values")]
    return [(prefix, _plain(tree))]


def _plain(value: object) -> str:
    return f"{value:.5g}" if isinstance(value, float) else str(value)
