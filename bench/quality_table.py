"""The table of one evaluation, printed or as Markdown, with the paper's numbers beside it."""

import sys
from typing import Any, TextIO

from bench.paper_tables import PAPER_GEOMETRY, PAPER_IMAGE, REGIONS
from capture.held_out import SETS

# its crops are unknown: PSNR is context, no bar
PAPER: dict[str, dict[str, float | None]] = {
    region: {**PAPER_GEOMETRY["ours"][region], **PAPER_IMAGE["ours"][region], "flip": None} for region in REGIONS
}

COLUMNS = (
    ("P2S cm", "p2s_cm", 2),
    ("CD cm", "chamfer_cm", 2),
    ("box dB", "psnr_db", 2),
    ("mask dB", "psnr_mask_db", 2),
    ("SSIM", "ssim", 3),
    ("FLIP", "flip", 3),
    ("LPIPS", "lpips", 3),
)

MODES = ("off", "vertex", "linear", "network")

# what the columns of decibels count, under every table
DECIBELS = (
    "box dB: PSNR over the box round the region, its black background included, which nearly always is right: higher",
    "the emptier the box. mask dB: over the true person alone, where a limb beside its place counts in full.",
)
INSIDE = (
    "inside dB: over the pixels inside the true outline, less one, that the avatar covers: color alone, whatever the",
    "outline. It lies several dB above the mask's, which counts every pixel of a limb that is elsewhere.",
)


def table_rows(result: dict[str, Any]) -> list[list[str]]:
    """Rows of the printed and the Markdown table: ours and, beside it, the paper's."""
    rows = []
    for name in SETS:
        for region in ("head", "eyes", "left_hand", "right_hand", "hands", "total"):
            if region not in result[name]:  # results of earlier versions
                continue
            rows.append([f"{name.replace('_', ' ')}: {region.replace('_', ' ')}", *cells(result[name][region])])
            # the paper was given nothing: beside what was, its numbers say nothing
            if name == "novel_pose" and region in PAPER and result.get("input", "given") != "given":
                rows.append([f"  paper: {region}", *cells(PAPER[region])])
    beside = result["beside"]
    labels = {
        "ceiling": "novel pose, true mesh under our weights",
        "own_weights": "novel pose, our surface under the rig's weights",
        "aligned": "novel pose, ICP-aligned",
        "zero_steps": "novel pose, 0 steps: the template before training",
        "zero_steps_aligned": "0 steps, ICP-aligned",
        "filmed": "poses of the person's own videos",
        "filmed_aligned": "own videos, ICP-aligned",
        "filmed_zero_steps": "own videos, 0 steps",
        "filmed_zero_steps_aligned": "own videos, 0 steps, ICP-aligned",
        "t_pose": "T-pose",
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


def cells(scores: dict[str, Any], columns: tuple | list = COLUMNS) -> list[str]:
    out = []
    for _, key, digits in columns:
        value = scores.get(key)
        infinite = "infinite" in scores.get("reasons", {}).get(key, "")
        out.append(f"{value:.{digits}f}" if value is not None else ("inf" if infinite else "-"))
    return out


def markdown(result: dict[str, Any]) -> str:
    """The table as Markdown, with what it was measured on."""
    facts = ", ".join(f"{k} {v}" for k, v in result["capture"].items() if k != "registration")
    told = f"input: {result.get('input', 'given')}"
    lines = [f"{result['source']['kind']} `{result['source']['name']}`; {facts}; {told}", ""]
    lines += ["| | " + " | ".join(c[0] for c in COLUMNS) + " |", "|-|" + "-|" * len(COLUMNS)]
    lines += ["| " + " | ".join(row) + " |" for row in table_rows(result)]
    baked = result["baked_vs_field"]
    if baked.get("paper_db") is not None:
        lines += [
            "",
            f"Baked against field: paper mode {baked['paper_db']} dB, network {baked['network_db']} dB.",
        ]
    if "on_held_out" in baked:
        held = baked["on_held_out"]
        lines += [
            "",
            f"On held-out poses: {held['paper_db']} dB, worst {held['worst_db']} ({held['worst']}).",
        ]
    lines += ["", *DECIBELS]
    lines += [line for part in (view_mode_lines(result), lost_lines(result)) if part for line in ("", *part)]
    return "\n".join(lines) + "\n"


def view_mode_lines(result: dict[str, Any]) -> list[str]:
    """Every view mode of an avatar beside the truth: PSNR inside the true person."""
    modes = result.get("view_modes")
    if modes is None:
        return []
    lines = ["View modes against the truth, inside dB (total, head, hands; all pictures):", *INSIDE]
    for name, by_mode in modes["psnr_db"].items():
        if name == "all":
            continue
        for mode, scores in by_mode.items():
            cells = "  ".join(f"{region} {number(db)}" for region, db in scores.items())
            lines.append(f"- {name.replace('_', ' ')}, {mode}: {cells}")
    return [*lines, f"- default {modes['default']}; best here {modes['best']} ({modes['reason']})"]


def lost_lines(result: dict[str, Any]) -> list[str]:
    """What the file says was lost, and what was found now with its run at hand."""
    baked = result["baked_vs_field"]
    if "found" not in baked:
        return []
    said, found = baked["said"]["against_field"], baked["found"]["against_field"]
    lines = [f"- paper field against paper mode: said {number(said.get('paper_db'))} dB, "
             f"found {number(found['paper_db'])}"]  # fmt: skip
    lines += [
        f"- cone field against {mode}: said {number((said.get('cone_db') or {}).get(mode))} dB, found {number(db)}, "
        f"held-out {number(baked.get('on_held_out', {}).get('cone_db', {}).get(mode))}"
        for mode, db in found["cone_db"].items()
    ]
    levels = baked["said"]["levels"]
    for index, level in enumerate(baked["found"]["levels"]):
        recorded = levels[index].get("field_to_mesh_mm", {}).get("mean") if index < len(levels) else None
        lines.append(f"- level {index}: field to mesh said {number(recorded, 3)} mm, "
                     f"found {number(level['field_to_mesh_mm']['mean'], 3)}")  # fmt: skip
    if baked.get("texture_from") == "videos":
        lines.append("- textures are from the videos: what was found against the field is how much they changed it")
    return ["What was lost in baking, as the file says and as measured now:", *lines]


def number(value: float | None, digits: int = 2) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def print_table(result: dict[str, Any], file: TextIO | None = None) -> None:
    rows = [["", *(c[0] for c in COLUMNS)], *table_rows(result)]
    wide = max(len(row[0]) for row in rows)
    for row in rows:
        print(f"{row[0]:{wide}}" + "".join(f"{cell:>9}" for cell in row[1:]), file=file or sys.stdout)
    print(f"input: {result.get('input', 'given')}", file=file or sys.stdout)
    for line in (*DECIBELS, *view_mode_lines(result), *lost_lines(result)):
        print(line, file=file or sys.stdout)
