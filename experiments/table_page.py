"""Markdown of the paper's tables from finished rows: ours beside the paper's numbers,
and whether the order is the same.

People of one light are one section: light costs more than any ablation, so lights are never averaged.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.report.writer import markdown_table
from bench.report.writer import number as rounded
from experiments.claim_page import number_of
from experiments.paper_numbers import (
    GEOMETRY,
    PAPER_GEOMETRY,
    PAPER_IMAGE,
    QUOTED_GEOMETRY,
    QUOTED_IMAGE,
    REGIONS,
)
from experiments.quality_page import light_of_facts, lights_order
from experiments.table_row import ROWS, SEAMS, SINGLE

# label, digits of ours, digits in the paper
SHOWN = {"p2s_cm": ("P2S", 3, 2), "chamfer_cm": ("CD", 3, 2), "psnr_db": ("PSNR", 2, 2), "ssim": ("SSIM", 3, 3),
         "flip": ("FLIP", 3, 3), "lpips": ("LPIPS", 3, 3)}  # fmt: skip
OUR_IMAGE = ("psnr_db", "ssim", "flip", "lpips")
SEAM_SHOWN = {"step_mm": ("mm", 2), "color_step": ("colour", 1), "shown_color_step": ("shown colour", 1)}


@dataclass(frozen=True)
class Mean:
    """Mean over people, and over seeds its deviation (one seed has none)."""

    value: float
    deviation: float | None

    def text(self, digits: int) -> str:
        if self.deviation is None:
            return f"{self.value:.{digits}f}"
        return f"{self.value:.{digits}f} ± {self.deviation:.{digits}f}"


def mean_of(results: Iterable[dict[str, Any]], *keys: str) -> Mean | None:
    """Mean over people of each one's mean over seeds; the deviation, over the seeds that several people's results
    (or one's) have in common, is that of the mean over those people."""
    people: dict[str, dict[int, float]] = {}
    for result in results:
        value = number_of(result, keys)
        if value is not None:
            people.setdefault(result["name"], {})[result["seed"]] = value
    if not people:
        return None
    value = float(np.mean([np.mean(list(seeds.values())) for seeds in people.values()]))
    several = [seeds for seeds in people.values() if len(seeds) > 1]
    common = set.intersection(*(set(seeds) for seeds in several)) if several else set()
    means = [float(np.mean([seeds[seed] for seeds in several])) for seed in sorted(common)]
    return Mean(value, float(np.std(means, ddof=1)) if len(means) > 1 else None)


def light_of_result(result: dict[str, Any]) -> str:
    """The section a result belongs to."""
    return light_of_facts(result["capture"])


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    return [*markdown_table(head, rows), ""]


def columns(metrics: Sequence[str]) -> list[str]:
    return [f"{region} {SHOWN[metric][0]}" for region in REGIONS for metric in metrics]


def paper_cells(scores: dict[str, dict[str, float]], metrics: Sequence[str]) -> list[str]:
    return [rounded(scores[region].get(metric), SHOWN[metric][2]) for region in REGIONS for metric in metrics]


def our_cells(results: list[dict[str, Any]], metrics: Sequence[str], part: str = "novel_pose") -> list[str]:
    out = []
    for region in REGIONS:
        for metric in metrics:
            mean = mean_of(results, part, region, metric)
            out.append("-" if mean is None else mean.text(SHOWN[metric][1]))
    return out


def comparable(
    ours: list[dict[str, Any]], others: list[dict[str, Any]]
) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """The results of both that are of the same people and seeds."""

    def key(result: dict[str, Any]) -> tuple[str, int]:
        return result["name"], result["seed"]

    both = {key(r) for r in ours} & {key(r) for r in others}
    return [r for r in ours if key(r) in both], [r for r in others if key(r) in both]


def as_in_paper(
    name: str,
    ours: list[dict[str, Any]],
    row: list[dict[str, Any]],
    paper: dict[str, dict[str, dict[str, float]]],
) -> str:
    """ "yes" where ours is better than the row in all that the paper's is, else what is not."""
    ours, row = comparable(ours, row)
    compared, otherwise = [], []
    for region in REGIONS:
        for metric, theirs in paper["ours"][region].items():
            difference = theirs - paper[name][region][metric]
            a, b = (mean_of(results, "novel_pose", region, metric) for results in (ours, row))
            if difference == 0 or a is None or b is None:
                continue
            label = f"{region} {SHOWN[metric][0]}"
            compared.append(label)
            if (a.value - b.value) * difference <= 0:
                otherwise.append(label)
    return verdict(compared, otherwise)


def verdict(compared: list[str], otherwise: list[str]) -> str:
    if not compared:
        return "not measured"
    return "no: " + ", ".join(otherwise) if otherwise else f"yes ({len(compared)} of {len(compared)})"


def seams_as_in_paper(name: str, ours: list[dict[str, Any]], row: list[dict[str, Any]]) -> str:
    """ "yes" where the seams that the row should spoil are worse than ours."""
    ours, row = comparable(ours, row)
    spec = ROWS[name]
    compared, otherwise = [], []
    for place in spec.places:
        a, b = (mean_of(results, "seams", place, spec.measure) for results in (ours, row))
        if a is None or b is None:
            continue
        compared.append(place)
        if b.value <= a.value:
            otherwise.append(f"{place.replace('_', ' ')} {SEAM_SHOWN[spec.measure][0]}")
    return verdict(compared, otherwise)


def title_of(name: str, results: list[dict[str, Any]], people: int) -> str:
    count = len({result["name"] for result in results})
    title = ROWS[name].title + (f" ({count} of {people} people)" if count < people else "")
    # measured before the single network had the parts' place of the head
    earlier = ROWS[name].training == SINGLE and any(result.get("head") is None for result in results)
    return title + (" (its head by landmarks only, Eq. 6)" if earlier else "")


def comparison(results: list[dict[str, Any]], quality: list[dict[str, Any]]) -> list[str]:
    """Tables 1 and 2: ours over all held-out poses beside the quoted methods and the paper."""
    lines = []
    for number, what, metrics, quoted, paper in (
        (1, "reconstruction, cm, less is better", GEOMETRY, QUOTED_GEOMETRY, PAPER_GEOMETRY),
        (2, "novel poses, pictures", OUR_IMAGE, QUOTED_IMAGE, PAPER_IMAGE),
    ):
        rows = [[f"{name} (quoted from the paper)", *paper_cells(scores, metrics)] for name, scores in quoted.items()]
        rows.append(["TotalSelfScan (the paper's)", *paper_cells(paper["ours"], metrics)])
        for name in sorted({q["name"] for q in quality}):
            those = [q for q in quality if q["name"] == name]
            rows.append([f"ours: {those[0]['capture'].get('subject', name)}", *our_cells(those, metrics)])
        rows.append(["**ours, mean**", *our_cells(quality, metrics)])
        if number == 2:
            rows.append(["ours, novel views (T-pose)", *our_cells(quality, metrics, "novel_view")])
        else:
            for part, label in (
                ("aligned", "ICP-aligned as in the paper's code"),
                ("canonical", "canonical pose"),
            ):
                aside = [q | {"novel_pose": q["beside"].get(part, {})} for q in quality]
                rows.append([f"ours, {label}", *our_cells(aside, metrics)])
        lines += [f"### Table {number}: {what}", "", *table(["", *columns(metrics)], rows)]
    return lines


def ablations(results: list[dict[str, Any]]) -> list[str]:
    """Tables 3 and 4 with the other rows below the paper's two, over the few poses that all rows share."""
    by_row = {name: [r for r in results if r["row"] == name] for name in ROWS}
    ours, people = by_row["ours"], len({r["name"] for r in results})
    lines = []
    for number, what, metrics, paper in (
        (3, "ablations, reconstruction", GEOMETRY, PAPER_GEOMETRY),
        (4, "ablations, pictures", OUR_IMAGE, PAPER_IMAGE),
    ):
        rows = []
        for name, those in by_row.items():
            if not those:
                continue
            if name in paper:
                rows.append([f"the paper's: {ROWS[name].title}", *paper_cells(paper[name], metrics), ""])
            same = number == 3 and all(r.get("geometry") == "as ours" for r in those)
            cells = ["as ours"] + [""] * (3 * len(metrics) - 1) if same else our_cells(those, metrics)
            judged = as_in_paper(name, ours, those, paper) if name in paper and name != "ours" else ""
            rows.append([title_of(name, those, people), *cells, judged])
        lines += [f"### Table {number}: {what}", "", *table(["", *columns(metrics), "as in the paper"], rows)]
    return lines


def seams(results: list[dict[str, Any]]) -> list[str]:
    """Figure 6 as numbers: the step at each seam in millimetres and in colour (0 to 255)."""
    with_seams = [r for r in results if r.get("seams")]
    shown = [key for key in SEAM_SHOWN if mean_of(with_seams, "seams", "neck", key) is not None]
    head = [""]
    head += [f"{place.replace('_', ' ')} {SEAM_SHOWN[key][0]}" for place in SEAMS for key in shown]
    ours, people = [r for r in with_seams if r["row"] == "ours"], len({r["name"] for r in results})
    rows = []
    for name in ROWS:
        those = [r for r in with_seams if r["row"] == name]
        if not those:
            continue
        cells = []
        for place in SEAMS:
            for key in shown:
                mean = mean_of(those, "seams", place, key)
                cells.append("-" if mean is None else mean.text(SEAM_SHOWN[key][1]))
        judged = seams_as_in_paper(name, ours, those) if name != "ours" else ""
        rows.append([title_of(name, those, people), *cells, judged])
    if not rows:
        return []
    return ["### Figure 6 in numbers: the seams", "", *table([*head, "as in the paper"], rows)]


def cost(results: list[dict[str, Any]]) -> list[str]:
    rows = []
    for name in ROWS:
        those = [r for r in results if r["row"] == name]
        if those:
            seconds = [r["cpu_seconds"] for r in those]
            rows.append(
                [
                    ROWS[name].title,
                    str(len(those)),
                    f"{np.mean(seconds):.0f}",
                    f"{max(seconds):.0f}",
                    f"{np.mean([r['parameters'] for r in those]) / 1e6:.2f}",
                    " ".join(f"[{r['name']}]({r['picture']})" for r in those if r["seed"] == those[0]["seed"]),
                ]
            )
    head = ["", "measured", "CPU s, mean", "CPU s, most", "million parameters", "pictures"]
    return ["### Cost and pictures", "", *table(head, rows)]


def page(results: list[dict[str, Any]], quality: list[dict[str, Any]], absent: list[str]) -> str:
    """The whole page; `absent` are the rows asked for that could not be measured."""
    commits = sorted({str(r["machine"].get("commit")) for r in results})
    machines = sorted({f"{r['machine']['cpu']}, {r['machine']['cores']} cores" for r in results})
    lines = [
        "# The paper's tables",
        "",
        "Made by `python -m experiments.tables`. Held-out poses; distances are P2S and Chamfer in cm on the surface "
        "seen from",
        "outside, without ICP; PSNR of the pooled error over the rays that meet the region's box, SSIM, FLIP and "
        "LPIPS on",
        "its rectangle, head and hands from close-ups. The paper's people and crops are others: its numbers are "
        "context,",
        "the order of its rows is what is compared, on the same people and poses. "
        "Rows of other methods are quoted from it.",
        "Seams, over the overlap of a part with the body: mm is the mean |s_part - s_body| at the surface, colour the",
        "mean |c_part - c_body| of 255, shown colour the change of what is displayed from 1 mm before to 1 mm behind "
        "the",
        "overlap's middle. The paper shows these four rows in pictures only: here a row is as in the paper where the "
        "seam",
        "it should spoil is worse than ours.",
        "Means over people; ± is the deviation over training seeds of the people that have several.",
        "",
        f"Commit {', '.join(commits)}; {', '.join(machines)}.",
        "",
    ]
    for light in sorted({light_of_result(r) for r in results}, key=lights_order):
        those = [r for r in results if light_of_result(r) == light]
        theirs = [q for q in quality if light_of_result(q) == light]
        people, seeds = sorted({r["name"] for r in those}), sorted({r["seed"] for r in those})
        poses = sorted({r["stamp"]["poses"] or 0 for r in those})
        lines += [f"## {light[0].upper()}{light[1:]}", ""]
        lines += [
            f"{', '.join(people)}; seed {', '.join(map(str, seeds))}; presets "
            f"{', '.join(sorted({str(r['preset']) for r in those}))}; ablations over "
            f"{', '.join(str(n) if n else 'all' for n in poses)} poses.",
            "",
        ]
        if theirs:
            lines += comparison(those, theirs)
        lines += ablations(those) + seams(those) + cost(those)
    if absent:
        lines += ["## Not measured", "", *(f"- {text}" for text in absent), ""]
    return "\n".join(lines)
