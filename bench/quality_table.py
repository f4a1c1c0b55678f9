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
        for region in ("head", "left_hand", "right_hand", "hands", "total"):
            rows.append([f"{name.replace('_', ' ')}: {region.replace('_', ' ')}", *cells(result[name][region])])
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
            rows.append([f"novel pose: head {apart.replace('_', ' ')}", *cells(result["novel_pose"]["head"][apart])])
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
    lines = [f"{result['source']['kind']} `{result['source']['name']}`; {facts}", ""]
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
    return ["What was lost in baking, as the file says and as measured now:", *lines]


def number(value: float | None, digits: int = 2) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def print_table(result: dict[str, Any], file: TextIO | None = None) -> None:
    rows = [["", *(c[0] for c in COLUMNS)], *table_rows(result)]
    wide = max(len(row[0]) for row in rows)
    for row in rows:
        print(f"{row[0]:{wide}}" + "".join(f"{cell:>9}" for cell in row[1:]), file=file or sys.stdout)
    for line in (*DECIBELS, *view_mode_lines(result), *lost_lines(result)):
        print(line, file=file or sys.stdout)


def light_of_facts(facts: dict[str, Any]) -> str:
    """What a capture was filmed in, and what spoils it: results of unlike ones are never averaged."""
    out = f"{facts.get('light', '?')} light"
    if facts.get("sheen"):
        out += f", sheen {facts['sheen']:g}"
    if facts.get("pose_noise_deg"):
        out += f", pose noise {facts['pose_noise_deg']:g} degrees"
    return out


def people_table(results: list[dict[str, Any]]) -> str:
    """Novel poses of many people and their mean, one section for each light, beside the paper's row."""
    lines = [
        "# Quality",
        "",
        "Made by `python -m bench.quality_table` from files of `selfscan eval --json`. Held-out poses; P2S from our",
        "surface to the truth and Chamfer, both directions' mean, on the surface that can be seen from outside,",
        "without ICP. PSNR is of the pooled error, twice: *box*, over the rays that meet the region's box, where",
        "black background is nearly always right and lifts the number, the more the emptier the box is; and *mask*,",
        "over the true person alone. SSIM and FLIP on the box's rectangle; head and hands from close-ups. The head's",
        "distances include the hair. The paper's people and crops are others: its distances are the bar, its PSNR and",
        "SSIM are context. Lights are apart: a fixed one is baked into the person.",
        "",
    ]
    lights = sorted({light_of_facts(result["capture"]) for result in results}, key=lights_order)
    for light in lights:
        those = [result for result in results if light_of_facts(result["capture"]) == light]
        lines += [f"## {light[0].upper()}{light[1:]}", ""]
        for region in ("head", "hands", "total"):
            lines += region_table(those, region)
    return "\n".join([*lines, *view_table(sorted(results, key=lambda r: lights_order(light_of_facts(r["capture"]))))])


def view_table(results: list[dict[str, Any]]) -> list[str]:
    """View modes of every avatar beside the truth and beside its field, one row for each capture and light."""
    rows = []
    for result in results:
        modes, baked = result.get("view_modes"), result.get("baked_vs_field", {})
        file = baked.get("said", {}).get("against_field") or baked
        if modes is None:
            continue
        true, cone = modes["psnr_db"]["all"], file.get("cone_db") or {}
        cells = [number(true.get(mode)) for mode in MODES] + [str(modes["default"])]
        cells += [number(file.get("paper_db"), 1), *(number(cone.get(mode), 1) for mode in MODES)]
        rows.append([f"{result['capture']['subject']}, {light_of_facts(result['capture'])}", *cells])
    if not rows:
        return []
    heads = ["", *(f"true: {mode}" for mode in MODES), "default", "field: off", *(f"cone: {mode}" for mode in MODES)]
    return [
        "## View modes",
        "",
        "*true*: PSNR in dB of held-out pictures, poses and views pooled, each mode on the same pixels: inside the",
        "true outline, less one pixel, where the avatar covers, so color alone; the best one is the file's default.",
        "*field*, *cone*: PSNR of the baked avatar against its own field,",
        "as the paper has it (one direction a point) and inside the cone of directions that training saw.",
        "",
        *("| " + " | ".join(row) + " |" for row in (heads, ["-"] * len(heads), *rows)),
        "",
    ]


def lights_order(light: str) -> tuple[int, str]:
    """Even light first, as the easiest; then as the lights harden."""
    names = ("even", "soft", "fixed", "varied")
    name = light.split(" ")[0]
    return (names.index(name) if name in names else len(names)), light


def region_table(results: list[dict[str, Any]], region: str) -> list[str]:
    """One region of people in one light: each, the mean, the paper, ceilings where they were measured."""
    keys = ("p2s_cm", "chamfer_cm", "psnr_db", "psnr_mask_db", "ssim", "flip", "lpips")
    ours = [result["novel_pose"][region] for result in results]
    shown = [c for c in COLUMNS if c[1] in keys and (c[1] != "lpips" or any(o.get("lpips") for o in ours))]
    lines = [f"### {region.capitalize()}, novel poses", "", "| | " + " | ".join(c[0] for c in shown) + " |"]
    lines += ["|-|" + "-|" * len(shown)]
    labels = [str(result["capture"]["subject"]) for result in results]
    mean = {}
    for key in keys:
        values = [scores[key] for scores in ours if scores.get(key) is not None]
        mean[key] = sum(values) / len(values) if values else None
    rows = [*zip(labels, ours), ("**mean**", mean), ("paper (SynTotalHuman; crops unknown)", PAPER[region])]
    for label, result in zip(labels, results):
        if result["beside"].get("ceiling"):
            rows.append((f"ceiling: {label}", result["beside"]["ceiling"][region]))
    return lines + ["| " + " | ".join([label, *cells(scores, shown)]) + " |" for label, scores in rows] + [""]


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m bench.quality_table", description="Quality of many people.")
    parser.add_argument("results", nargs="+", type=Path, metavar="JSON", help="files of `selfscan eval --json`")
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
