"""The table of one evaluation as it is printed, with the paper's numbers beside it."""

from collections.abc import Sequence

from bench.report.writer import Json
from bench.score.metrics import METRICS, Metric, text_of
from capture.held_out import SETS

# TotalSelfScan (Dong et al. 2022) on SynTotalHuman, tables 1 and 2; distances in cm, PSNR in dB. Its crops are unknown:
# PSNR is context, no bar
PAPER: dict[str, dict[str, float | None]] = {
    "head": {"p2s_cm": 0.59, "chamfer_cm": 0.82, "psnr_db": 22.23, "ssim": 0.934, "lpips": 0.084, "flip": None},
    "hands": {"p2s_cm": 0.55, "chamfer_cm": 0.52, "psnr_db": 22.49, "ssim": 0.941, "lpips": 0.076, "flip": None},
    "total": {"p2s_cm": 1.84, "chamfer_cm": 1.89, "psnr_db": 26.15, "ssim": 0.921, "lpips": 0.114, "flip": None},
}

# what the columns of decibels count, under every table
DECIBELS = (
    "box dB: PSNR over the box round the region, its black background included, which nearly always is right: higher",
    "the emptier the box. mask dB: over the true person alone, where a limb beside its place counts in full.",
)


def table_rows(result: Json) -> list[list[str]]:
    """Rows of the table: ours and, beside it, the paper's."""
    rows = []
    for name in SETS:
        for region in ("head", "eyes", "left_hand", "right_hand", "hands", "total"):
            if region not in result[name]:
                continue
            rows.append([f"{name.replace('_', ' ')}: {region.replace('_', ' ')}", *cells(result[name][region])])
            # the paper was given nothing: beside what was, its numbers say nothing
            if name == "novel_pose" and region in PAPER and result.get("input", "given") != "given":
                rows.append([f"  paper: {region}", *cells(PAPER[region])])
    beside = result["beside"]
    labels = {
        "own_weights": "novel pose, our surface under the rig's weights",
        "aligned": "novel pose, ICP-aligned",
        "zero_steps": "novel pose, 0 steps: the template before training",
        "zero_steps_aligned": "0 steps, ICP-aligned",
        "filmed": "poses of the person's own videos",
        "filmed_aligned": "own videos, ICP-aligned",
        "filmed_zero_steps": "own videos, 0 steps",
        "filmed_zero_steps_aligned": "own videos, 0 steps, ICP-aligned",
        "t_pose": "T-pose",
        "t_pose_zero_steps": "T-pose, 0 steps",
        "canonical": "canonical",
    }
    for name, label in labels.items():
        for region in ("head", "hands", "total"):
            if beside.get(name):
                rows.append([f"{label}: {region}", *cells(beside[name][region])])
    for apart in ("without_hair", "hair"):
        if apart in result["novel_pose"]["head"]:
            rows.append([f"novel pose: head {apart.replace('_', ' ')}", *cells(result["novel_pose"]["head"][apart])])
    if "skin_beside_hair" in result["novel_pose"]:
        rows.append(["novel pose: skin beside hair", *cells(result["novel_pose"]["skin_beside_hair"])])
    return rows


def cells(scores: Json, metrics: Sequence[Metric] = METRICS) -> list[str]:
    return [text_of(scores, metric) for metric in metrics]


def print_table(result: Json) -> None:
    rows = [["", *(metric.title for metric in METRICS)], *table_rows(result)]
    wide, *widths = (max(map(len, column)) for column in zip(*rows))
    for first, *rest in rows:
        print(f"{first:{wide}}" + "".join(f"{cell:>{width + 2}}" for cell, width in zip(rest, widths)))
    print(f"input: {result.get('input', 'given')}")
    print("\n".join(DECIBELS))
