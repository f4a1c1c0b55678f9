"""The report of experiments/baking.py: tables in Markdown, and the rows against the axes of the frontier."""

import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bench.report.writer import markdown_table, number
from experiments.short_training import three
from files.whole import whole_file

Row = Mapping[str, Any]
NAMES = {"truth": "true pictures", "field": "the field"}
COLORS = {
    "default": "black",
    "triangles": "tab:blue",
    "texels": "tab:orange",
    "textures": "tab:green",
    "view network": "tab:red",
}
# stages of a bake whose seconds are told apart; smaller ones are put together
LEAST_SHARE = 0.03
# FLIP that the cheapest bake may lose
NEAR = 0.001
# characters a line
WIDTH = 120


def judge(result: Mapping[str, Any]) -> str:
    """What leads: true pictures where they are known."""
    return "truth" if "truth" in result["rows"][0]["scores"] else "field"


def flip(row: Row, reference: str, region: str = "total") -> float:
    return row["scores"][reference][region]["flip"] or 0.0


def change(row: Row, default: Row, reference: str) -> tuple[float, float]:
    """By how much a row's FLIP of the whole person differs from the default's, picture by picture: mean, and twice its
    standard error."""
    own, other = (
        np.array([value or 0.0 for value in one["scores"][reference]["total"]["flip_each"]]) for one in (row, default)
    )
    apart = own - other
    error = float(apart.std(ddof=1) / np.sqrt(len(apart))) if len(apart) > 1 else 0.0
    return float(apart.mean()), 2 * error


def loss(row: Row, default: Row, reference: str) -> float:
    """By how much a row's FLIP is above the default's, over the person, head or hands, whichever loses most."""
    return max(
        flip(row, reference, region) - flip(default, reference, region) for region in default["scores"][reference]
    )


def sentence(result: Mapping[str, Any]) -> str:
    """What the rows say, for someone who reads nothing else."""
    rows, reference = result["rows"], judge(result)
    default = rows[0]
    best = min(rows, key=lambda row: flip(row, reference))
    near = [row for row in rows if loss(row, default, reference) <= NEAR]
    cheapest = min(near, key=lambda row: row["cpu_seconds"])
    text = (
        f"A bake of {result['trained']['subject']} as it is by default takes {default['cpu_seconds']:.0f} processor "
        f"seconds and shows the person FLIP {flip(default, reference):.4f} from {NAMES[reference]}; nearest to them is "
        f"{best['words']} ({flip(best, reference):.4f}, {best['cpu_seconds']:.0f} s)."
    )
    if cheapest is default:
        text += f" Nothing cheaper keeps within {NEAR:g} of the default over the person, head and hands."
    else:
        text += (
            f" The cheapest that loses no more than {NEAR:g} over the person, head and hands is {cheapest['words']}: "
            f"{cheapest['cpu_seconds']:.0f} s, FLIP {flip(cheapest, reference):.4f}."
        )
    trained = result["trained"]["cpu_seconds"]
    if trained is not None:
        text += f" Training that run took {trained:.0f} processor seconds."
    return text


def markdown(result: Mapping[str, Any]) -> str:
    """All tables."""
    rows = result["rows"]
    commits = sorted({str(row["commit"]) for row in rows})
    told = result["references"]["truth"]
    who = f"{result['trained']['subject']}, preset {result['trained']['preset']}"
    if told is not None:
        who += (
            f", synthetic capture of {result['trained']['size']} px, true pictures of {result['references']['size']} px"
        )
        who += f", {told['light']} light, shine {told['sheen']}" if told.get("sheen") else f", {told['light']} light"
    about = (
        f"Made by `python -m experiments.baking` of {who}; {result['cpu']}, commits {', '.join(commits)}. A row "
        "differs from the default in what it names. *Processor*: seconds of all its threads, from reading the run to "
        "the written file, which other programs change little; *clock*: as it was. *Frame*: processor time of a frame "
        f"in the file's own view mode (*view*) as a multiple of the default's, {frame_words(result['frames'])}. Scores "
        f"of {result['references']['poses']} novel poses: total / head / hands. *Change*: FLIP of the whole person "
        "less the default's, mean over the pictures and twice its standard error. PSNR over the person, or the part in "
        "its close-up."
    )
    lines = ["# What the settings of a bake cost and bring", "", "![time against FLIP](baking.png)", ""]
    lines += [textwrap.fill(sentence(result), WIDTH), "", textwrap.fill(about, WIDTH)]
    for reference in rows[0]["scores"]:
        lines += ["", f"## Against {NAMES[reference]}", ""]
        if reference == "field":
            lines += ["Textures from videos are not meant to equal the field's.", ""]
        lines += row_table(rows, reference)
    lines += stage_table(rows) + format_table(result)
    lines += [f"\nNot measured: {line}" for line in result["absent"]]
    return "\n".join(lines) + "\n"


def frame_words(frames: Mapping[str, Any]) -> str:
    others = frames["others_cpu_share"]
    busy = "" if others is None else f", other programs used {100 * others:.0f} % of the machine"
    return f"{frames['size'][0]} x {frames['size'][1]} px, {frames['renderer']}, in alternating rounds{busy}"


def row_table(rows: Sequence[Row], reference: str) -> list[str]:
    default = rows[0]
    table = []
    for row in rows:
        scores = row["scores"][reference]
        values = {key: {region: one[key] for region, one in scores.items()} for key in ("flip", "psnr_mask_db", "ssim")}
        mean, error = change(row, default, reference)
        table.append([
            row["words"],
            f"{row['cpu_seconds']:.0f}",
            f"{row['seconds']:.0f}",
            f"{row['bytes'] / 1e6:.1f}",
            row["view"],
            frame_cell(row["frame"]),
            three(values["flip"], 4),
            "" if row is default else f"{mean:+.4f} ± {error:.4f}",
            three(values["psnr_mask_db"], 2),
            three(values["ssim"], 3),
        ])  # fmt: skip
    head = ["", "processor s", "clock s", "MB", "view", "frame", "FLIP", "change", "PSNR dB", "SSIM"]
    return markdown_table(head, table)


def frame_cell(frame: Mapping[str, Any]) -> str:
    """Processor time as a multiple of the first, its interval, and milliseconds."""
    low, high = frame["cpu_times_first_interval"]
    return f"{frame['cpu_times_first']:.2f} ({low:.2f} - {high:.2f}), {frame['cpu_ms_median']:.1f} ms"


def stage_table(rows: Sequence[Row]) -> list[str]:
    """Where the processor seconds of each bake go; stages that are small everywhere are one column."""
    names = list(dict.fromkeys(name for row in rows for name in row["stages"]))
    large = [
        name for name in names if any(row["stages"].get(name, 0) > LEAST_SHARE * row["cpu_seconds"] for row in rows)
    ]
    table = []
    for row in rows:
        own = [row["stages"].get(name) for name in large]
        rest = row["cpu_seconds"] - sum(value or 0 for value in own)
        table.append([row["words"], *(number(value, 0) for value in own), f"{rest:.0f}"])
    lines = ["", "## Where the seconds go", "", "Processor seconds of stages as `selfscan bake` reports them.", ""]
    return lines + markdown_table(["", *large, "the rest"], table)


def format_table(result: Mapping[str, Any]) -> list[str]:
    """Numbers of other formats: time of a frame and difference of the picture."""
    formats = result["formats"]
    about = (
        f"The default's finest level, view mode {formats['view']}, {frame_words(formats['times'])}. FLIP, PSNR over "
        "the person and the largest difference of a byte beside the picture as shipped: bodies and close-ups of the "
        "head. Rows without a time run the programs of another row."
    )
    lines = ["", "## Number formats of what is drawn", "", textwrap.fill(about, WIDTH), ""]
    rows = []
    for row in formats["rows"]:
        frame = "" if row["frame"] is None else frame_cell(row["frame"])
        scores = ["", "", ""]
        if "flip" in row:
            psnr = "same" if row["largest"] == 0 else number(row["psnr_mask_db"], 1)
            scores = [number(row["flip"] or 0.0, 5), psnr, str(row["largest"])]
        rows.append([row["name"], frame, *scores])
    return lines + markdown_table(["", "frame", "FLIP", "PSNR dB", "largest"], rows)


def plot(result: Mapping[str, Any], path: Path) -> None:
    """The rows on the frontier's axes: time to the right, logarithmic, nearer upwards; of the bake and of a frame."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import FuncFormatter, LogLocator

    rows, reference = result["rows"], judge(result)
    figure = Figure(figsize=(11, 4.8), dpi=110, layout="constrained")
    times = {
        "processor seconds of the bake": lambda row: row["cpu_seconds"],
        "processor ms a frame, in the file's own view mode": lambda row: row["frame"]["cpu_ms_median"],
    }
    for axes, (label, time_of) in zip(figure.subplots(1, 2, sharey=True), times.items(), strict=True):
        for group, color in COLORS.items():
            own = [row for row in rows if row["group"] == group]
            if not own:
                continue
            # the default has its place on each line
            line = sorted((time_of(row), flip(row, reference)) for row in [rows[0], *own])
            axes.plot(*zip(*line, strict=True), "-", color=color, lw=0.8, alpha=0.5)
            axes.plot([time_of(row) for row in own], [flip(row, reference) for row in own], "o", ms=5, color=color,
                      label=group)  # fmt: skip
            for row in own:
                axes.annotate(row["words"].split(":")[0], (time_of(row), flip(row, reference)), xytext=(5, 3),
                              textcoords="offset points", fontsize=6.5, color=color)  # fmt: skip
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(LogLocator(subs=(1, 1.5, 2, 3, 4, 5, 7)))
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.xaxis.set_minor_formatter(FuncFormatter(lambda value, _: ""))
        axes.margins(x=0.18, y=0.1)
        axes.set_xlabel(label)
        axes.grid(alpha=0.3)
    left = figure.axes[0]
    left.invert_yaxis()
    left.set_ylabel(f"FLIP from {NAMES[reference]} (0: equal), nearer upwards")
    left.legend(fontsize=7, loc="lower right")
    with whole_file(path) as file:
        figure.savefig(file, format="png")
