"""One HTML page with everything in it: pictures, legends, tables; no script, no other file."""

import base64
import html
import io
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from bench.inspect.colors import Legend

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
th { font-weight: 600 } td.good { color: var(--good) } td.look { color: var(--look); font-weight: 600 }
td.value { overflow-wrap: anywhere; max-width: 70ch }
.legend { max-width: 560px; margin: 6px 0 10px } .bar { height: 14px; border: 1px solid var(--line) }
.ticks { display: flex; justify-content: space-between; font-size: 12.5px; color: var(--soft) }
.named { display: flex; flex-wrap: wrap; gap: 4px 14px; font-size: 13px } .named i { display: inline-block;
 width: 12px; height: 12px;
 margin-right: 5px; border: 1px solid var(--line); vertical-align: -1px }
@media (prefers-color-scheme: dark) { :root { --ink: #e3e5e7; --soft: #9aa2aa; --line: #3a3f45; --paper:
 #1b1e22; --card: #25292e;
 --good: #6cc494; --look: #f0a050 } nav a { color: #83b4ea } }
"""


@dataclass
class PagePicture:
    """One picture of the page; `data` is an encoded PNG or WebP."""

    # file name in the folder, without suffix
    name: str
    data: bytes
    kind: str  # "png" or "webp"
    caption: str
    # pixels on the page, its own where not given
    width: int | None = None


@dataclass
class PageSection:
    """A heading, what to look for, pictures with their legend, and a table."""

    key: str
    title: str
    text: str
    pictures: list[PagePicture] = field(default_factory=list)
    legend: Legend | None = None
    # the first is the head
    rows: list[tuple[str, ...]] = field(default_factory=list)


@dataclass(frozen=True)
class Check:
    """One line of the verdict."""

    what: str
    value: str
    expected: str
    good: bool | None  # None: stated, not judged


def picture(
    name: str, image: UInt8[np.ndarray, "height width 3"], caption: str, width: int | None = None
) -> PagePicture:
    """A picture of the page as PNG."""
    return PagePicture(name, png(image), "png", caption, width)


def png(image: UInt8[np.ndarray, "height width 3"]) -> bytes:
    """Encoded losslessly."""
    out = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(image)).save(out, "PNG", compress_level=6)
    return out.getvalue()


def animation(frames: list[UInt8[np.ndarray, "height width 3"]], seconds: float) -> bytes:
    """An animated WebP that repeats."""
    images, out = [Image.fromarray(np.ascontiguousarray(frame)) for frame in frames], io.BytesIO()
    images[0].save(
        out, "WEBP", save_all=True, append_images=images[1:], duration=round(1000 * seconds / len(images)), loop=0,
        quality=82, method=3,
    )  # fmt: skip
    return out.getvalue()


def page(name: str, lines: list[str], checks: list[Check], sections: list[PageSection]) -> str:
    """The page as text."""
    parts = [
        '<!doctype html><html lang="en"><meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<title>{_text(name)}: inspection</title><style>{STYLE}</style><main>",
        f"<h1>{_text(name)}</h1>",
        *(f'<p class="soft">{_text(line)}</p>' for line in lines),
        "<nav>" + "".join(f'<a href="#{s.key}">{_text(s.title)}</a>' for s in sections) + "</nav>",
        _checks(checks),
    ]
    for section in sections:
        parts.append(f'<section id="{section.key}"><h2>{_text(section.title)}</h2><p>{_text(section.text)}</p>')
        if section.legend is not None:
            parts.append(_legend(section.legend))
        figures = "".join(_figure(picture) for picture in section.pictures)
        parts.append(f'<div class="row">{figures}</div>' if len(section.pictures) > 1 else figures)
        parts.append(_table(section.rows) + "</section>")
    return "\n".join(parts) + "</main></html>\n"


def _text(value: object) -> str:
    return html.escape(str(value))


def _checks(checks: list[Check]) -> str:
    rows = ["<tr><th>What</th><th>Here</th><th>Expected</th><th></th></tr>"]
    for check in checks:
        mark = {True: '<td class="good">good</td>', False: '<td class="look">look</td>', None: "<td></td>"}[check.good]
        cells = "".join(f"<td>{_text(cell)}</td>" for cell in (check.what, check.value, check.expected))
        rows.append(f"<tr>{cells}{mark}</tr>")
    return f"<table>{''.join(rows)}</table>"


def _figure(picture: PagePicture) -> str:
    source = f"data:image/{picture.kind};base64,{base64.b64encode(picture.data).decode()}"
    width = f' style="width:{picture.width}px"' if picture.width else ""
    caption = _text(picture.caption)
    return f'<figure><img src="{source}" alt="{caption}"{width}><figcaption>{caption}</figcaption></figure>'


def _legend(legend: Legend) -> str:
    out = ""
    if legend.stops:
        ticks = "".join(f"<span>{_text(tick)}</span>" for tick in legend.ticks)
        out += f'<div class="bar" style="background:linear-gradient(90deg,{",".join(legend.stops)})"></div>'
        out += f'<div class="ticks">{ticks}</div>'
    named = "".join(f'<span><i style="background:{color}"></i>{_text(name)}</span>' for color, name in legend.named)
    return f'<div class="legend">{out}<div class="named">{named}</div></div>'


def _table(rows: list[tuple[str, ...]]) -> str:
    if not rows:
        return ""
    head = "".join(f"<th>{_text(cell)}</th>" for cell in rows[0])
    body = "".join(
        "<tr>" + "".join(f'<td class="value">{_text(cell)}</td>' for cell in row) + "</tr>" for row in rows[1:]
    )
    return f"<table><tr>{head}</tr>{body}</table>"


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
