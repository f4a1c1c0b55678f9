"""Quality tables: one evaluation printed or as Markdown, and many people beside the paper.

python -m bench.quality_table white_m.json white_f.json ... -o docs/quality.md
"""

import argparse
import json
import sys
from pathlib import Path
from typing import Any, TextIO

from avatar.errors import AssetError
from avatar.files import whole_file
from bench.held_out import SETS

# TotalSelfScan (Dong et al. 2022), tables 1 and 2, SynTotalHuman; its crops are unknown: PSNR is context, no bar
PAPER = {
    "head": {
        "p2s_cm": 0.59,
        "chamfer_cm": 0.82,
        "psnr_db": 22.23,
        "ssim": 0.934,
        "flip": None,
        "lpips": 0.084,
    },
    "hands": {
        "p2s_cm": 0.55,
        "chamfer_cm": 0.52,
        "psnr_db": 22.49,
        "ssim": 0.941,
        "flip": None,
        "lpips": 0.076,
    },
    "total": {
        "p2s_cm": 1.84,
        "chamfer_cm": 1.89,
        "psnr_db": 26.15,
        "ssim": 0.921,
        "flip": None,
        "lpips": 0.114,
    },
}

COLUMNS = (
    ("P2S cm", "p2s_cm", 2),
    ("CD cm", "chamfer_cm", 2),
    ("PSNR dB", "psnr_db", 2),
    ("mask dB", "psnr_mask_db", 2),
    ("SSIM", "ssim", 3),
    ("FLIP", "flip", 3),
    ("LPIPS", "lpips", 3),
)


def table_rows(result: dict[str, Any]) -> list[list[str]]:
    """Rows of the printed and the Markdown table: ours and, beside it, the paper's."""
    rows = []
    for name in SETS:
        for region in ("head", "left_hand", "right_hand", "hands", "total"):
            rows.append(
                [f"{name.replace('_', ' ')}: {region.replace('_', ' ')}", *cells(result[name][region])]
            )
            if name == "novel_pose" and region in PAPER:
                rows.append([f"  paper: {region}", *cells(PAPER[region])])
    beside = result["beside"]
    labels = {
        "ceiling": "novel pose, true mesh under our weights",
        "own_weights": "novel pose, our surface under the rig's weights",
        "aligned": "novel pose, ICP-aligned",
        "t_pose": "T-pose",
        "canonical": "canonical",
    }
    for name, label in labels.items():
        for region in ("head", "hands", "total"):
            if beside.get(name):
                rows.append([f"{label}: {region}", *cells(beside[name][region])])
    for apart in ("without_hair", "hair"):
        if apart in result["novel_pose"]["head"]:
            rows.append(
                [f"novel pose: head {apart.replace('_', ' ')}", *cells(result["novel_pose"]["head"][apart])]
            )
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
    lines = [f"{result['source']['kind']} `{Path(result['source']['path']).name}`; {facts}", ""]
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
    return "\n".join(lines) + "\n"


def print_table(result: dict[str, Any], file: TextIO | None = None) -> None:
    rows = [["", *(c[0] for c in COLUMNS)], *table_rows(result)]
    wide = max(len(row[0]) for row in rows)
    for row in rows:
        print(f"{row[0]:{wide}}" + "".join(f"{cell:>9}" for cell in row[1:]), file=file or sys.stdout)


def people_table(results: list[dict[str, Any]]) -> str:
    """Novel poses of many people, their mean, and the paper's row, by region; P2S and CD against the paper's bar."""
    lines = [
        "# Quality",
        "",
        "Made by `python -m bench.quality_table` from files of `selfscan eval --json`. Held-out poses; P2S from our",
        "surface to the truth and Chamfer, both directions' mean, on the surface that can be seen from outside, without",
        "ICP; PSNR of the pooled error over the rays that meet the region's box, SSIM and FLIP on its rectangle, head",
        "and hands from close-ups. The head's distances include the hair. The paper's people and crops are others: its",
        "distances are the bar, its PSNR and SSIM are context.",
        "",
    ]
    keys = ("p2s_cm", "chamfer_cm", "psnr_db", "ssim", "flip")
    names = [column for column in COLUMNS if column[1] in keys]
    for region in ("head", "hands", "total"):
        lines += [
            f"## {region.capitalize()}, novel poses",
            "",
            "| | " + " | ".join(c[0] for c in names) + " |",
        ]
        lines += ["|-|" + "-|" * len(names)]
        ours = [result["novel_pose"][region] for result in results]
        labels = [f"{r['capture']['subject']}, {r['capture'].get('light', '?')}" for r in results]
        mean = {}
        for key in keys:
            values = [scores[key] for scores in ours if scores.get(key) is not None]
            mean[key] = sum(values) / len(values) if values else None
        rows = [
            *zip(labels, ours),
            ("**mean**", mean),
            ("paper (SynTotalHuman; crops unknown)", PAPER[region]),
        ]
        for label, scores in rows:
            lines.append("| " + " | ".join([label, *cells(scores, names)]) + " |")
        ceilings = [r["beside"]["ceiling"][region] for r in results if r["beside"].get("ceiling")]
        for label, scores in zip(
            [n for n, r in zip(labels, results) if r["beside"].get("ceiling")], ceilings
        ):
            lines.append("| " + " | ".join([f"ceiling: {label}", *cells(scores, names)]) + " |")
        lines.append("")
    return "\n".join(lines)


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m bench.quality_table", description="Quality of many people."
    )
    parser.add_argument(
        "results", nargs="+", type=Path, metavar="JSON", help="files of `selfscan eval --json`"
    )
    parser.add_argument("-o", dest="out", type=Path, required=True, metavar="TABLE.md")
    options = parser.parse_args(argv)
    results = []
    for path in options.results:
        try:
            results.append(json.loads(path.read_text("utf-8")))
        except (OSError, ValueError) as error:
            raise AssetError(f"{path}: expected a result of `selfscan eval --json`, found: {error}") from None
    with whole_file(options.out, "w") as file:
        file.write(people_table(results))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
