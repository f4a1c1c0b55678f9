"""Accuracy against time as a table, a plot and a sheet of pictures."""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from PIL import Image

from avatar.files import whole_file
from bench.contact import sheet


def number(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def markdown(result: dict[str, Any]) -> str:
    m = result["machine"]
    width, height = result["size"]
    columns = {
        "against_baked": f"FLIP, PSNR against {result['best_baked_rung']}",
        "against_truth": "FLIP, PSNR against truth",
    }
    columns = {key: name for key, name in columns.items() if any(key in row for row in result["rungs"])}
    lines = [
        f"# Accuracy against time: {result['avatar']}",
        "",
        *([f"> **{result['warning']}**", ""] if result["warning"] else []),
        f"{m['cpu']}, {m['cores']} cores, {m['renderer']} ({m['context']}); {width} x {height} px, "
        f"{result['frames']} frames, {result['rounds']} alternating rounds, load {number(m['load_average'], 1)}. "
        f"FLIP (0 is equal), SSIM and PSNR against `{result['best_rung']}` over the person's rectangle, PSNR over the "
        f"person alone beside it; *flicker*: change from frame to frame that `{result['best_baked_rung']}` does not "
        "have, of 255; *start*: until the first frame; *faster*: than that rung, median of the rounds' ratios; "
        "*dominated*: another rung is surely faster and in no picture less exact. `bench.html` shows it.",
        "",
        "| rung | ms median (95 %) | p95 | faster | start ms | MB | FLIP | head | hands | flicker | SSIM | PSNR dB | "
        "person |" + "".join(f" {n} |" for n in columns.values()) + " |",
        "|-|-|-|-|-|-|-|-|-|-|-|-|-|" + "-|" * len(columns) + "-|",
    ]
    for row in result["rungs"]:
        psnr = number(row["psnr_db"], 2) if row["psnr_db"] is not None else "same"
        cells = [
            row["name"],
            f"{number(row['ms_median'], 2)} ({interval_text(row)})",
            number(row["ms_p95"], 2),
            number(row["times_faster"], 2),
            number(row.get("start_ms"), 0),
            number(row["bytes"] / 1e6, 1),
            number(row["flip"], 4),
            *(number(row["parts"].get(part, {}).get("flip"), 4) for part in ("head", "hands")),
            number(row.get("flicker"), 2),
            number(row["ssim"], 3),
            psnr,
            number(row["psnr_mask_db"], 2),
        ]
        cells += [f"{number(row[key]['flip'], 4)}, {number(row[key]['psnr_db'], 2)} dB" for key in columns]
        cells.append("dominated" if row["dominated"] else "")
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n\n![accuracy against time](pareto.png)\n\n![rungs](rungs.png)\n"


def interval_text(row: dict[str, Any]) -> str:
    """The median's interval of confidence; a file of before has none."""
    low, high = row.get("ms_interval", (None, None))
    return f"{number(low, 2)} - {number(high, 2)}"


def plot(result: dict[str, Any], path: Path) -> None:
    """Milliseconds against FLIP, numbered; the rungs that nothing dominates are joined by a line."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib.figure import Figure
    from matplotlib.ticker import FormatStrFormatter, NullFormatter

    rows = result["rungs"]
    figure = Figure(figsize=(9, 4.5), dpi=110, layout="constrained")
    axes, names = figure.subplots(1, 2, gridspec_kw={"width_ratios": [2.2, 1]})
    points = [(row["ms_median"], row["flip"] or 0.0, row) for row in rows]
    front = sorted((x, y) for x, y, row in points if not row["dominated"])
    axes.plot([x for x, _ in front], [y for _, y in front], "-", color="0.6", zorder=1)
    names.axis("off")
    for place, (x, y, row) in enumerate(points, 1):
        color = "0.6" if row["dominated"] else "tab:blue"
        axes.scatter([x], [y], s=28, color=color, zorder=2)
        line = 1 - (place - 0.5) / len(points)
        names.text(0, line, f"{place}  {row['name']}", fontsize=7, color="black" if not row["dominated"] else "0.5",
                   va="center")  # fmt: skip
    axes.set_xscale("log")
    axes.margins(x=0.1, y=0.12)
    # limits and layout are settled before labels are placed in points
    figure.draw_without_rendering()
    taken = axes.transData.transform([(x, y) for x, y, _ in points]) * 72 / figure.dpi
    for place, offset in enumerate(label_offsets(taken), 1):
        axes.annotate(
            str(place),
            points[place - 1][:2],
            xytext=offset,
            textcoords="offset points",
            fontsize=7,
            ha="center",
            va="center",
            arrowprops={"arrowstyle": "-", "color": "0.7", "lw": 0.5, "shrinkA": 3, "shrinkB": 3}
            if np.hypot(*offset) > 10
            else None,
        )
    axes.xaxis.set_major_formatter(FormatStrFormatter("%g"))
    few = 3 * min(x for x, _, _ in points) > max(x for x, _, _ in points)  # under a third of a decade: label all ticks
    axes.xaxis.set_minor_formatter(FormatStrFormatter("%g") if few else NullFormatter())
    axes.set_xlabel("ms per frame (median)")
    axes.set_ylabel(f"FLIP against {result['best_rung']} (0: equal)", fontsize=8)
    axes.invert_yaxis()
    axes.set_title(f"{result['avatar']} on {result['machine']['renderer']}", fontsize=9)
    axes.grid(alpha=0.3)
    with whole_file(path) as file:
        figure.savefig(file, format="png")


def label_offsets(points: Float[np.ndarray, "n 2"]) -> list[tuple[float, float]]:
    """Where to write a number beside each point (typographic points), on none of the points or earlier numbers."""
    size = np.array([11.0, 9.0])
    # a dot is 6 wide
    boxes = [(place, (size + 6) / 2) for place in points]
    offsets = []
    turns = [(radius, turn) for radius in (9, 14, 20, 27, 35, 44, 54) for turn in range(16)]
    for point in points:
        for radius, turn in turns:
            angle = np.pi / 4 + turn * np.pi / 8
            offset = radius * np.array([np.cos(angle), np.sin(angle)])
            if not any((np.abs(point + offset - other) < reach).all() for other, reach in boxes):
                break
        boxes.append((point + offset, size))
        offsets.append((float(offset[0]), float(offset[1])))
    return offsets


def rung_sheet(result: dict[str, Any], pictures: dict, crops: list, truths: list) -> Image.Image:
    """The first frame of every rung side by side."""
    tiles, titles = [], []
    if truths:
        tiles.append([bytes_of(truths[0][crops[0]])])
        titles.append(["truth"])
    for row in result["rungs"]:
        tiles.append([bytes_of(pictures[row["name"]][0][crops[0]])])
        titles.append([f"{row['name']}: {row['ms_median']:.1f} ms"])
    return sheet(tiles, titles, f"{result['avatar']}: rungs of accuracy against time", columns=min(6, len(tiles)))


def bytes_of(picture: Float[np.ndarray, "height width 3"]) -> np.ndarray:
    return np.round(np.clip(picture, 0, 1) * 255).astype(np.uint8)
