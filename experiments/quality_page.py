"""docs/quality.md: many people beside the paper, from files of `selfscan eval --json`.

python -m experiments.quality_page white_m.json white_f.json ... -o docs/quality.md
"""

import argparse
from pathlib import Path
from typing import Any

from bench.report.writer import markdown_table, number
from bench.score.metrics import METRICS
from bench.score.quality_table import PAPER, cells
from command.errors import AssetError
from experiments.claim_page import FORMAT, page
from files.input_file import read_json_object
from files.whole import write_text
from player.effects.avatar import VIEWS


def light_of_facts(facts: dict[str, Any]) -> str:
    """What a capture was filmed in, and what spoils it: results of unlike ones are never averaged."""
    out = f"{facts.get('light', '?')} light"
    if facts.get("sheen"):
        out += f", sheen {facts['sheen']:g}"
    if facts.get("pose_noise_deg"):
        out += f", pose noise {facts['pose_noise_deg']:g} degrees"
    return out


def section_of(result: dict[str, Any]) -> str:
    """Light and kind of input of a result; numbers of different sections are never averaged."""
    kind = result.get("input", "given")
    return light_of_facts(result["capture"]) + ("" if kind == "given" else f", {kind}")


def lights_order(light: str) -> tuple[int, str]:
    """Even light first, as the easiest; then as the lights harden."""
    names = ("even", "soft", "fixed", "varied", "room")
    name = light.split(" ")[0]
    return (names.index(name) if name in names else len(names)), light


def people_table(results: list[dict[str, Any]]) -> str:
    """Novel poses of many people and their mean, one section for each light, beside the paper's row."""
    lines = [
        "# Quality",
        "",
        "Made by `python -m experiments.quality_page` from files of `selfscan eval --json`. Held-out poses; P2S from",
        "our surface to the truth and Chamfer, both directions' mean, on the surface that can be seen from outside,",
        "without ICP. *back* is the other way, from the true surface to ours, on average and its 95th percentile: what",
        "is missing counts there; F is how much of both lies within 5 mm or 1 cm of the other; *IoU* compares outlines",
        "from eight sides in the T-pose, on average and from the worst. A column stands where a result has it.",
        "PSNR is of the pooled error, twice: *box*, over the rays that meet the region's box, where",
        "black background is nearly always right and lifts the number, the more the emptier the box is; and *mask*,",
        "over the true person alone. SSIM and FLIP on the box's rectangle; head and hands from close-ups. The head's",
        "distances include the hair. Lights are apart: a fixed one is baked into the person. Unless a section says",
        "otherwise everything was *given*: a template registered to the true mesh, its joints, exact poses, cameras.",
        "The paper was given none of that: its numbers stand beside *shape only* and *from pixels* alone; its people",
        "and crops are others. `python -m experiments.claim` makes the three kinds of one person side by side.",
        "",
    ]
    lights = sorted({section_of(result) for result in results}, key=lights_order)
    for light in lights:
        those = [result for result in results if section_of(result) == light]
        lines += [f"## {light[0].upper()}{light[1:]}", ""]
        for region in ("head", "hands", "total"):
            lines += region_table(those, region)
    return "\n".join([*lines, *view_table(sorted(results, key=lambda r: lights_order(light_of_facts(r["capture"]))))])


def region_table(results: list[dict[str, Any]], region: str) -> list[str]:
    """One region of people in one light: each, the mean, the paper, ceilings where they were measured."""
    ours = [result["novel_pose"][region] for result in results]
    shown = [m for m in METRICS if any(scores.get(m.key) is not None for scores in ours)]
    labels = [str(result["capture"]["subject"]) for result in results]
    mean = {}
    for key in (metric.key for metric in METRICS):
        values = [scores[key] for scores in ours if scores.get(key) is not None]
        mean[key] = sum(values) / len(values) if values else None
    rows = [*zip(labels, ours), ("**mean**", mean)]
    if results[0].get("input", "given") != "given":
        rows.append(("paper (SynTotalHuman; crops unknown)", PAPER[region]))
    for label, result in zip(labels, results):
        if result["beside"].get("ceiling"):
            rows.append((f"ceiling: {label}", result["beside"]["ceiling"][region]))
    table = markdown_table(["", *(m.title for m in shown)], [[label, *cells(scores, shown)] for label, scores in rows])
    return [f"### {region.capitalize()}, novel poses", "", *table, ""]


def view_table(results: list[dict[str, Any]]) -> list[str]:
    """View modes of every avatar beside the truth and beside its field, one row for each capture and light."""
    rows = []
    for result in results:
        modes, baked = result.get("view_modes"), result.get("baked_vs_field", {})
        file = baked.get("said", {}).get("against_field") or baked
        if modes is None:
            continue
        true, cone = modes["psnr_db"]["all"], file.get("cone_db") or {}
        cells = [number(true.get(mode)) for mode in VIEWS] + [str(modes["default"])]
        cells += [number(file.get("paper_db"), 1), *(number(cone.get(mode), 1) for mode in VIEWS)]
        rows.append([f"{result['capture']['subject']}, {light_of_facts(result['capture'])}", *cells])
    if not rows:
        return []
    heads = ["", *(f"true: {mode}" for mode in VIEWS), "default", "field: off", *(f"cone: {mode}" for mode in VIEWS)]
    return [
        "## View modes",
        "",
        "*true*: PSNR in dB of held-out pictures, poses and views pooled, each mode on the same pixels: inside the",
        "true outline, less one pixel, where the avatar covers, so color alone; the best one is the file's default.",
        "*field*, *cone*: PSNR of the baked avatar against its own field,",
        "as the paper has it (one direction a point) and inside the cone of directions that training saw.",
        "",
        *markdown_table(heads, rows),
        "",
    ]


def claim_section(path: Path) -> str:
    """The three kinds of input side by side, mean of their people, a heading lower than in a page of its own.

    Raises:
        AssetError: the file is none of experiments.claim.
    """
    told = read_json_object(path, "what experiments.claim found")
    if told.get("format") != FORMAT:
        raise AssetError(f"{path}: format should be {FORMAT!r}, is {told.get('format')!r}")
    return page(told["people"], told["options"], each=False).replace("## ", "### ").replace("# From", "## From", 1)


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m experiments.quality_page", description="Quality of many people.")
    parser.add_argument("results", nargs="+", type=Path, metavar="JSON", help="files of `selfscan eval --json`")
    parser.add_argument("--claim", type=Path, metavar="JSON", help="of experiments.claim: its mean comes last")
    parser.add_argument("-o", dest="out", type=Path, required=True, metavar="TABLE.md")
    options = parser.parse_args(argv)
    text = people_table([read_json_object(path, "a result of `selfscan eval --json`") for path in options.results])
    if options.claim is not None:
        text += "\n" + claim_section(options.claim)
    write_text(options.out, text)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
