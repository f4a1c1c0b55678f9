"""Accuracy against time as a table and a plot."""

import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bench.report.writer import Json, markdown_table, number
from bench.score.metrics import RUNG_METRICS
from files.whole import whole_file

# names in the figure, one line each
MOST_NAMED = 12
# FLIP up to which two pictures are the same to the eye, and what can be seen when they are flicked or side by side
SAME, ROUGHER = 0.005, (0.015, 0.035)


class Column(NamedTuple):
    """A number of a rung as the tables of bench.md and bench.html show it."""

    title: str
    # where a row holds it
    path: tuple[str, ...]
    digits: int
    scale: float = 1.0
    # "lower" or "higher", of scores
    better: str = ""

    def text(self, row: Json) -> str:
        value: Any = row
        for key in self.path:
            value = value.get(key) if isinstance(value, dict) else None
        if value is None and "infinite" in row.get("reasons", {}).get(self.path[0], ""):
            return "same"
        return number(value if value is None else self.scale * value, self.digits)


RUNG_COLUMNS = (
    Column("p95", ("ms_p95",), 2),
    Column("FLIP", ("flip",), 4, better="lower"),
    Column("head", ("parts", "head", "flip"), 4, better="lower"),
    Column("hands", ("parts", "hands", "flip"), 4, better="lower"),
    *(Column(m.title, (m.key,), m.digits, better=m.better) for m in RUNG_METRICS if m.key != "flip"),
    Column("start ms", ("start_ms",), 0),
    Column("MB", ("bytes",), 1, 1e-6),
)


class Point(NamedTuple):
    ms: float
    flip: float
    name: str


def markdown(result: Json) -> str:
    """The page in words: how it was measured, the table of rungs, what time buys."""
    m = result["machine"]
    width, height = result["size"]
    names = {"against_baked": result["best_baked_rung"], "against_truth": "truth"}
    columns = {key: f"FLIP, PSNR against {name}" for key, name in names.items() if key in result["rungs"][-1]}
    lines = [
        f"# Accuracy against time: {result['avatar']}",
        "",
        *([f"> **{result['warning']}**", ""] if result["warning"] else []),
        f"{m['cpu']}, {m['cores']} cores, {m['renderer']} ({m['context']}); {width} x {height} px, "
        f"{result['frames']} frames, {result['rounds']} alternating rounds, load {number(m['load_average'], 1)}. "
        f"FLIP (0 is equal), SSIM and PSNR against `{result['best_rung']}` over the person's rectangle (box dB), PSNR "
        "over the person alone beside it (mask dB); *start*: until the first frame; *faster*: than "
        f"`{result['best_baked_rung']}`, median of the rounds' ratios; "
        "*dominated*: another rung is surely faster and in no picture less exact. `bench.html` shows it.",
        "",
    ]
    head = ["rung", "ms median (95 %)", "faster", *(column.title for column in RUNG_COLUMNS), *columns.values(), ""]
    rows = [
        [
            row["name"],
            "{} ({} - {})".format(*map(number, (row["ms_median"], *row["ms_interval"]))),
            number(row["times_faster"]),
            *(column.text(row) for column in RUNG_COLUMNS),
            *(f"{number(row[key]['flip'], 4)}, {number(row[key]['psnr_db'])} dB" for key in columns),
            "dominated" if row["dominated"] else "",
        ]
        for row in result["rungs"]
    ]
    lines += markdown_table(head, rows)
    lines += ["", "![accuracy against time](pareto.png)", "", trade_sentence(result), ""]
    return "\n".join(lines)


def shown_scores(result: Json) -> str | None:
    """Where rows hold the scores that a figure shows: those against true pictures where these were at hand, else None,
    the row's own against the best rung."""
    return "against_truth" if all("against_truth" in row for row in result["rungs"]) else None


def points_of(result: Json) -> list[Point]:
    """Median milliseconds and FLIP of every rung."""
    key = shown_scores(result)
    scores = [row if key is None else row[key] for row in result["rungs"]]
    rows = zip(result["rungs"], scores, strict=True)
    return [Point(row["ms_median"], score["flip"] or 0.0, row["name"]) for row, score in rows]


def frontier_of(points: Sequence[Point], most: int = MOST_NAMED) -> list[Point]:
    """The points than which none is both faster and more exact, by time. Where they are more than `most`, those go
    first without which a budget gets nearly the same: the area between the steps with and without them is least."""
    front: list[Point] = []
    for point in sorted(points):
        if not front or point.flip < front[-1].flip:
            front.append(point)
    while len(front) > most:
        area = [np.log(c.ms / b.ms) * (a.flip - b.flip) for a, b, c in zip(front, front[1:], front[2:])]
        del front[1 + int(np.argmin(area))]
    return front


def trade_sentence(result: Json) -> str:
    """What time gains, in numbers of the figure: the fastest rung that is as exact as any, beside the slowest one,
    and the fastest ones with up to a quarter more and twice its error, or up to ROUGHER where it has none."""
    points = points_of(result)
    front, slowest = frontier_of(points), max(points)
    exact = front[-1]
    enough = next(point for point in front if point.flip <= max(1.05 * exact.flip, SAME))
    parts = [f"FLIP is least, {exact.flip:.3f}, at {duration(exact.ms)}"]
    if 2 * enough.ms < slowest.ms:
        how = "as exact as" if slowest.flip <= max(1.05 * enough.flip, SAME) else "more exact than"
        errors = f"FLIP {enough.flip:.3f} and {slowest.flip:.3f}"
        parts = [f"{duration(enough.ms)} is {how} {duration(slowest.ms)} ({errors})"]
    last = enough
    for most in ROUGHER if exact.flip < SAME else (1.25 * exact.flip, 2 * exact.flip, np.inf):
        point = next(point for point in front if point.flip <= most)
        if point.ms < 0.8 * last.ms:
            times = f"{point.flip / exact.flip:.1f} times the error" if exact.flip >= SAME else f"FLIP {point.flip:.3f}"
            parts.append(f"{times} at {duration(point.ms)}")
            last = point
    return "; ".join(parts) + "."


def duration(ms: float) -> str:
    """Milliseconds, or seconds from one on, to two digits."""
    value, unit = (ms / 1e3, "s") if ms >= 1e3 else (ms, "ms")
    return f"{value:.0f} {unit}" if value >= 9.95 else f"{value:.{1 if value >= 0.995 else 2}f} {unit}"


def plot(result: Json, path: Path) -> None:
    """Milliseconds against FLIP: the frontier with its names beside it, every other rung a faint dot, and a sentence
    that says what time buys."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import FormatStrFormatter, NullFormatter

    points = points_of(result)
    front = frontier_of(points)
    figure = Figure(figsize=(10, 4.8), dpi=110)
    axes = figure.add_axes((0.07, 0.2, 0.5, 0.7))
    rest = [point for point in points if point not in front]
    axes.scatter([p.ms for p in rest], [p.flip for p in rest], s=12, color="0.85", zorder=1)
    axes.plot([p.ms for p in front], [p.flip for p in front], "o-", color="tab:blue", markersize=5, zorder=3)
    axes.set_xscale("log")
    axes.margins(x=0.06, y=0.06)
    axes.invert_yaxis()
    figure.draw_without_rendering()
    # the frontier rises to the right, so lines to names at the right, in its order, cross neither it nor one another
    heights = [axes.transAxes.inverted().transform(axes.transData.transform((p.ms, p.flip)))[1] for p in front]
    for point, height in zip(front, label_heights(heights), strict=True):
        axes.annotate(
            f"{duration(point.ms)}, {point.flip:.3f}:  {point.name}",
            (point.ms, point.flip),
            xytext=(1.04, height),
            textcoords="axes fraction",
            fontsize=7.5,
            va="center",
            annotation_clip=False,
            arrowprops={"arrowstyle": "-", "color": "0.8", "lw": 0.6, "shrinkA": 0, "shrinkB": 3, "relpos": (0, 0.5)},
            zorder=2,
        )
    axes.xaxis.set_major_formatter(FormatStrFormatter("%g"))
    few = 3 * min(points).ms > max(points).ms  # under a third of a decade: label all ticks
    axes.xaxis.set_minor_formatter(FormatStrFormatter("%g") if few else NullFormatter())
    axes.set_xlabel("ms per frame (median)")
    reference = result["best_rung"] if shown_scores(result) is None else "true pictures"
    axes.set_ylabel(f"FLIP against {reference} (0: equal)", fontsize=8)
    axes.set_title(f"{result['avatar']} on {result['machine']['renderer']}", fontsize=9)
    axes.grid(alpha=0.2)
    sentence = textwrap.fill(trade_sentence(result), 120)
    figure.text(0.5, 0.06, sentence, ha="center", va="center", fontsize=8.5)
    with whole_file(path) as file:
        figure.savefig(file, format="png")


def label_heights(wanted: Sequence[float]) -> list[float]:
    """Heights of labels, shares of the figure's axes: in the order of the wanted ones, which rise, one line apart."""
    apart, placed = 1 / MOST_NAMED, np.asarray(wanted, np.float64).copy()
    for i in range(1, len(placed)):
        placed[i] = max(placed[i], placed[i - 1] + apart)
    placed[-1] = min(placed[-1], 1.0)
    for i in reversed(range(len(placed) - 1)):
        placed[i] = min(placed[i], placed[i + 1] - apart)
    return placed.tolist()
