"""The report of experiments/curves.py: tables in Markdown and the plot."""

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from bench.report.writer import markdown_table, number
from experiments.short_training import three
from files.whole import whole_file

Point = dict[str, Any]
# dB on held-out pictures whose price in seconds is told
REACHED = (25.0, 27.0, 28.0)
# a curve whose last seconds are more times its first is drawn over their logarithm
WIDE = 8
SETS = {"novel_pose": "novel poses", "novel_view": "novel views"}
KINDS = {"psnr_db": "box", "psnr_mask_db": "mask"}
COLORS = {"total": "tab:blue", "head": "tab:orange", "hands": "tab:green"}


def clock(point: Point) -> float | None:
    """The seconds that a curve is drawn against: of the processor, or on a GPU of the wall clock."""
    return point["seconds"] if point["device"] == "cuda" else point["cpu_seconds"]


def clock_name(point: Point) -> str:
    return "seconds" if point["device"] == "cuda" else "processor seconds"


def curves(points: Sequence[Point]) -> Iterator[list[Point]]:
    """Points of one capture, preset and device with nothing left out, by seconds; those without seconds are in none."""
    keys = dict.fromkeys((p["capture"], p["preset"], p["device"]) for p in points)
    for key in keys:
        own = [
            p
            for p in points
            if (p["capture"], p["preset"], p["device"]) == key and not p["without"] and clock(p) is not None
        ]
        if own:
            yield sorted(own, key=lambda p: clock(p) or 0)


def seconds_to(curve: Sequence[Point], decibels: float, score: str, chosen: str, region: str = "total") -> str:
    """When a curve first reaches a quality: between two points on a line over the logarithm of seconds, in words."""
    reached = [(clock(p) or 0, p["scores"][chosen][region][score]) for p in curve]
    reached = [(seconds, value) for seconds, value in reached if value is not None]
    if not reached:
        return "-"
    if reached[0][1] >= decibels:
        return f"at most {reached[0][0]:.0f}"
    for (t0, v0), (t1, v1) in pairwise(reached):
        if v1 >= decibels:
            return f"{math.exp(math.log(t0) + (decibels - v0) / (v1 - v0) * math.log(t1 / t0)):.0f}"
    return f"not in {reached[-1][0]:.0f}"


def of_regions(point: Point, chosen: str, score: str) -> dict[str, float | None]:
    return {region: scores[score] for region, scores in point["scores"][chosen].items()}


def title(curve: Sequence[Point]) -> str:
    p = curve[0]
    return f"{p['subject']}, {p['size']} px, {p['light']} light, preset {p['preset']}"


def sentence(curve: Sequence[Point]) -> str:
    """What a curve says, for someone who reads nothing else."""
    first, last = curve[0], curve[-1]
    start, end = (p["scores"]["novel_pose"]["total"]["psnr_db"] for p in (first, last))
    text = (
        f"{title(curve)}: the shortest training ({steps_text(first)}) takes {clock(first):.0f} {clock_name(first)} and "
        f"shows the person in a new pose at {start:.1f} dB; the longest ({steps_text(last)}) takes "
        f"{clock(last):.0f} and reaches {end:.1f} dB."
    )
    if len(curve) > 2:
        near = next(p for p in curve if p["scores"]["novel_pose"]["total"]["psnr_db"] >= end - 0.5)
        if near is not last:
            text += f" Half a decibel below that is reached after {clock(near):.0f}."
    fixed = untrained_seconds(first)
    if fixed is not None:
        text += (
            f" {fixed:.0f} of the first's seconds are no training: rays and template distances before it, fusing the "
            "parts and drawing out their surface after it."
        )
    return text


def untrained_seconds(point: Point) -> float | None:
    """What passes before and after the steps of stage 1, in processor seconds; None: not recorded, or on a GPU."""
    if point["cpu_seconds_in_steps"] is None or point["device"] != "cpu":
        return None
    return point["cpu_seconds"] - point["cpu_seconds_in_steps"]


def steps_text(point: Point) -> str:
    return "all steps" if point["steps"] is None else f"{point['steps']} steps a part"


def markdown(result: dict[str, Any]) -> str:
    """All tables."""
    points, lines = result["points"], ["# Quality against seconds of training", ""]
    lines += ["![quality against seconds](curves.png)", ""]
    for curve in curves(points):
        lines += [sentence(curve), ""]
    commits = sorted({str(p["machine"]["commit"]) for p in points})
    loads = [p["machine"]["load_average"] for p in points if p["machine"]["load_average"] is not None]
    poses = sorted({p["stamp"]["poses"] for p in points})
    load = f"load average {min(loads, default=0):.1f} to {max(loads, default=0):.1f} for {result['cores']} cores"
    lines += [
        f"Made by `python -m experiments.curves`; {result['cpu']}, commits {', '.join(commits)}. Each row is a",
        "training from the capture to the written run, its schedules shortened to its steps. *Processor*: seconds of",
        f"all processes together, which other programs ({load}) change little;",
        "two idle cores take about two thirds of it by the clock. *in steps*: of these, the steps of",
        "stage 1. *Clock*: as it was. Scores: total / head / hands of the field on true pictures that trained nothing,",
        f"{', '.join(map(str, poses))} poses of each set; box and mask as in docs/quality.md.",
    ]
    for chosen, name in SETS.items():
        rows = []
        for p in points:
            left_out = f", without {' and '.join(p['without'])}" if p["without"] else ""
            given = ", a run given" if p["given"] else ""
            times = [number(p[key], 0) for key in ("cpu_seconds", "cpu_seconds_in_steps", "seconds")]
            digits = {"psnr_db": 1, "psnr_mask_db": 1, "flip": 3, "p2s_cm": 2}
            scores = [three(of_regions(p, chosen, key), count) for key, count in digits.items()]
            rows.append([f"{p['subject']}, {p['preset']}{left_out}{given}", str(p["steps"] or "all"), *times, *scores])
        head = ["", "steps", "processor s", "in steps", "clock s", "box dB", "mask dB", "FLIP", "P2S cm"]
        lines += ["", f"## {name.capitalize()}", "", *markdown_table(head, rows)]
    lines += reached_table(points) + items_table(points)
    lines += [f"\nNot measured: {line}" for line in result["absent"]]
    return "\n".join(lines) + "\n"


def reached_table(points: Sequence[Point]) -> list[str]:
    """Seconds to each quality, of the whole person."""
    rows = []
    for curve in curves(points):
        for chosen, name in SETS.items():
            for score, kind in KINDS.items():
                found = [seconds_to(curve, level, score, chosen) for level in REACHED]
                rows.append([f"{title(curve)}: {name}, {kind}, {clock_name(curve[0])}", *found])
    return [
        "", "## Seconds to a quality", "",
        "Of the whole person; between two trainings on a line over the logarithm of seconds.", "",
        *markdown_table(["", *(f"{level:g} dB" for level in REACHED)], rows),
    ]  # fmt: skip


def items_table(points: Sequence[Point]) -> list[str]:
    """What each item of a preset costs and gives: the same steps with and without it."""
    rows = []
    for p in points:
        beside = [q for q in points if not q["without"] and same_training(p, q)]
        if not p["without"] or not beside:
            continue
        q = beside[0]
        now, before = clock(q), clock(p)
        cost = "-" if now is None or before is None else f"{now - before:+.0f}"
        gains = [
            three(difference(q, p, chosen, score), digits)
            for chosen in SETS
            for score, digits in (("psnr_db", 1), ("psnr_mask_db", 1), ("p2s_cm", 2))
        ]
        item = f"{p['subject']}: {' and '.join(p['without'])}"
        rows.append([item, str(p["steps"] or "all"), cost, *gains])
    if not rows:
        return []
    return [
        "", "## What items of the preset cost and give", "",
        "With the item less without it, at the same steps, total / head / hands; seconds as above. One seed: tenths of "
        "a decibel mean nothing.", "",
        *markdown_table(["", "steps", "s more", "poses: box dB", "mask dB", "P2S cm", "views: box dB", "mask dB",
                         "P2S cm"], rows),
    ]  # fmt: skip


def same_training(p: Point, q: Point) -> bool:
    return all(p[name] == q[name] for name in ("capture", "preset", "steps", "device", "given"))


def difference(p: Point, q: Point, chosen: str, score: str) -> dict[str, float | None]:
    a, b = of_regions(p, chosen, score), of_regions(q, chosen, score)
    return {
        region: None if value is None or (other := b[region]) is None else value - other for region, value in a.items()
    }


def plot(result: dict[str, Any], path: Path) -> None:
    """For each curve, decibels and distances against seconds."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import FuncFormatter, LogLocator

    drawn = list(curves(result["points"]))
    figure = Figure(figsize=(9, 0.4 + 3.6 * max(len(drawn), 1)), dpi=110, layout="constrained")
    axes = figure.subplots(max(len(drawn), 1), 2, squeeze=False)
    for (left, right), curve in zip(axes, drawn, strict=False):
        x = [clock(p) for p in curve]
        for region, color in COLORS.items():
            values = [p["scores"]["novel_pose"][region] for p in curve]
            left.plot(x, [v["psnr_db"] for v in values], "o-", ms=4, color=color, label=f"{region}, whole picture")
            left.plot(x, [v["psnr_mask_db"] for v in values], "o--", ms=3, lw=1, color=color,
                      label=f"{region}, on the person")  # fmt: skip
            right.plot(x, [10 * v["p2s_cm"] for v in values], "o-", ms=4, color=color, label=region)
        for level in REACHED:
            left.axhline(level, color="0.85", lw=0.8, zorder=0)
        left.set_ylabel("PSNR dB, new poses (higher is better)")
        right.set_ylabel("surface to true surface, mm (lower is better)")
        right.set_ylim(0)
        left.set_title(title(curve), fontsize=9, loc="left")
        fixed = untrained_seconds(curve[0])
        for ax in (left, right):
            if (x[-1] or 0) > WIDE * (x[0] or 1):
                ax.set_xscale("log")
                ax.xaxis.set_major_locator(LogLocator(subs=(1, 2, 3, 5)))
                ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
                ax.xaxis.set_minor_formatter(FuncFormatter(lambda value, _: ""))
            else:
                ax.set_xlim(0)
                if fixed is not None:
                    ax.axvspan(0, fixed, color="0.93", zorder=0)
                    ax.annotate("no training:\npreparing, fusing,\nsurface", (fixed / 2, 0.5), ha="center", fontsize=7,
                                color="0.4", xycoords=("data", "axes fraction"))  # fmt: skip
            ax.set_xlabel(f"{clock_name(curve[0])} from capture to avatar")
            ax.grid(alpha=0.3)
            ax.legend(fontsize=7)
    with whole_file(path) as file:
        figure.savefig(file, format="png")
