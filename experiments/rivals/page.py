"""The page of the rivals' table: who wins in its first sentence, means and deviations over people, and a sign test."""

from collections.abc import Sequence
from math import comb
from statistics import mean, stdev
from typing import Any

from bench.score.metrics import METRICS
from command.progress import plural
from experiments.paper_numbers import PAPER_GEOMETRY, PAPER_IMAGE, QUOTED_GEOMETRY, QUOTED_IMAGE

TITLES = {
    "ours": "ours, the field", "ours_baked": "ours, baked, textures from the videos",
    "zero": "0 steps, textures from the videos", "single": "single network", "anisdf": "AniSDF", "aninerf": "AniNeRF",
    "neuralbody": "NeuralBody",
}  # fmt: skip
RIVALS = ("single", "anisdf", "aninerf", "neuralbody")
REGIONS = ("head", "hands", "total")
SETS = {"novel_pose": "Novel poses", "novel_view": "Novel views"}
LINES = {m.key: m for m in METRICS if m.key in ("p2s_cm", "chamfer_cm", "psnr_db", "psnr_mask_db", "ssim", "flip")}
Rows = Sequence[dict[str, Any]]


def by_person(rows: Rows, system: str, kind: str, name: str, region: str, key: str) -> dict[str, float]:
    """A score of each person, the mean over seeds."""
    found: dict[str, list[float]] = {}
    for row in rows:
        if (row["system"], row["input"]) == (system, kind) and row[name][region][key] is not None:
            found.setdefault(row["person"], []).append(row[name][region][key])
    return {person: mean(values) for person, values in found.items()}


def cell(rows: Rows, system: str, kind: str, name: str, region: str, key: str) -> str:
    """Mean over people, and deviation where there are two or more."""
    values = list(by_person(rows, system, kind, name, region, key).values())
    if not values:
        return "-"
    digits = LINES[key].digits
    return f"{mean(values):.{digits}f}" + (f" ± {stdev(values):.{digits}f}" if len(values) > 1 else "")


def sign_test(wins: int, losses: int) -> float:
    """Chance that a fair coin would be as one-sided or more (two-sided, ties left out)."""
    n = wins + losses
    if n == 0:
        return 1.0
    return min(1.0, 2 * sum(comb(n, k) for k in range(max(wins, losses), n + 1)) / 2**n)


def compared(rows: Rows, system: str, kind: str, name: str, region: str, key: str) -> tuple[int, int]:
    """On how many people the field of four parts is better than a system, and worse."""
    ours = by_person(rows, "ours", kind, name, region, key)
    theirs = by_person(rows, system, kind, name, region, key)
    sign = -1 if LINES[key].better == "lower" else 1
    apart = [sign * (ours[person] - theirs[person]) for person in ours.keys() & theirs.keys()]
    return sum(d > 0 for d in apart), sum(d < 0 for d in apart)


def best_of(rows: Rows, kind: str, name: str, region: str, key: str, among: Sequence[str]) -> str:
    """The system with the best mean over the people that all of them have; "": there are none."""
    each = {system: by_person(rows, system, kind, name, region, key) for system in among}
    each = {system: values for system, values in each.items() if values}
    shared = set.intersection(*(set(values) for values in each.values())) if each else set()
    if not shared:
        return ""
    sign = -1 if LINES[key].better == "lower" else 1
    return max(each, key=lambda system: sign * mean(each[system][person] for person in shared))


def first_sentence(rows: Rows, kind: str) -> str:
    """Who wins what on novel poses."""
    wins: dict[str, list[str]] = {}
    for key in LINES:
        for region in REGIONS:
            winner = best_of(rows, kind, "novel_pose", region, key, list(TITLES))
            if winner:
                wins.setdefault(winner, []).append(f"{region} {LINES[key].title}")
    if not wins:
        return "Nothing was measured."
    ordered = sorted(wins, key=lambda name: -len(wins[name]))
    total = sum(map(len, wins.values()))
    top = f"{TITLES[ordered[0]]} is best in {len(wins[ordered[0]])} of {total} scores of novel poses"
    others = [f"{TITLES[name]} in {len(wins[name])} ({', '.join(wins[name])})" for name in ordered[1:]]
    return f"**{kind.capitalize()}: {top}{'; ' if others else ''}{'; '.join(others)}.**"


def table(rows: Rows, kind: str, name: str) -> list[str]:
    """One set of held-out pictures: a row a system, a column a score of a region."""
    heads = [f"{region} {metric.title}" for metric in LINES.values() for region in REGIONS]
    lines = ["| system | " + " | ".join(heads) + " |", "|-" * (len(heads) + 1) + "|"]
    for system, title in TITLES.items():
        cells = [cell(rows, system, kind, name, region, key) for key in LINES for region in REGIONS]
        if set(cells) != {"-"}:
            lines.append(f"| {title} | " + " | ".join(cells) + " |")
    return lines


def sign_tests(rows: Rows, kind: str) -> list[str]:
    """Ours, the field, against each system: people on which it is better : worse, and the sign test's p."""
    keys = [("p2s_cm", region) for region in REGIONS] + [("psnr_mask_db", region) for region in REGIONS]
    heads = [f"{region} {LINES[key].title}" for key, region in keys]
    lines = ["| ours, the field, against | " + " | ".join(heads) + " |", "|-" * (len(heads) + 1) + "|"]
    for system in (name for name in TITLES if name != "ours"):
        pairs = [compared(rows, system, kind, "novel_pose", region, key) for key, region in keys]
        if any(sum(pair) for pair in pairs):
            cells = [f"{w} : {x} (p {sign_test(w, x):.2f})" for w, x in pairs]
            lines.append(f"| {TITLES[system]} | " + " | ".join(cells) + " |")
    return lines


def beside_paper(rows: Rows, kind: str) -> list[str]:
    """How far the systems are from ours, here and in the paper: P2S as a factor, PSNR in dB."""
    paper = {"AniSDF": "anisdf", "AniNeRF": "aninerf", "NeuralBody": "neuralbody"}
    lines = ["| system | head P2S / ours | hands | total | head dB - ours | hands | total |", "|-|-|-|-|-|-|-|"]
    quoted = [(name, QUOTED_GEOMETRY[name], QUOTED_IMAGE[name]) for name in paper]
    quoted.append(("single", PAPER_GEOMETRY["single"], PAPER_IMAGE["single"]))
    for name, distance, picture in quoted:
        system = paper.get(name, name)
        here, there = [], []
        for key, own, theirs in (("p2s_cm", PAPER_GEOMETRY["ours"], distance),
                                 ("psnr_db", PAPER_IMAGE["ours"], picture)):  # fmt: skip
            for region in REGIONS:
                a, b = (by_person(rows, one, kind, "novel_pose", region, key) for one in (system, "ours"))
                shared = a.keys() & b.keys()
                x, y = theirs[region][key], own[region][key]
                there.append(f"{x / y:.2f}" if key == "p2s_cm" else f"{x - y:+.1f}")
                if not shared:
                    here.append("-")
                    continue
                x, y = mean(a[person] for person in shared), mean(b[person] for person in shared)
                here.append(f"{x / y:.2f}" if key == "p2s_cm" else f"{x - y:+.1f}")
        lines += [f"| {TITLES[system]}, here | " + " | ".join(here) + " |",
                  f"| {TITLES[system]}, the paper's | " + " | ".join(there) + " |"]  # fmt: skip
    return lines


def cost(rows: Rows) -> list[str]:
    """What the trainings took."""
    lines = ["| system | steps | processor s, learning | processor s, everything |", "|-|-|-|-|"]
    for system, title in TITLES.items():
        own = [row for row in rows if row["system"] == system]
        if own:
            cells = [f"{mean(row[key] for row in own):.0f}" for key in ("steps", "seconds", "all_seconds")]
            lines.append(f"| {title} | " + " | ".join(cells) + " |")
    return lines


def page(rows: Rows, options: dict[str, Any], absent: Sequence[str], sheet: bool = False) -> str:
    """README.md of a folder of results, with the sheet of pictures if it is there."""
    kinds = [kind for kind in ("given", "from pixels") if any(row["input"] == kind for row in rows)]
    people, places = (sorted({row[name] for row in rows}) for name in ("person", "cpu"))
    commits = sorted({str(row["commit"]) for row in rows})
    out = ["# The systems that the paper compares with, trained here", ""]
    for kind in kinds:
        out += [first_sentence(rows, kind), ""]
    out += [
        f"{len(people)} {'person' if len(people) == 1 else 'people'} ({', '.join(people)}); four videos of "
        f"{options['frames']} frames, {options['pixels']} px, {options['light']} light; networks of size "
        f"`{options['size']}`; {options['seconds']:g} processor seconds of learning asked for, one thread "
        "(what each took stands below); "
        f"{plural(options['poses'], 'pose')} of each held-out set; "
        f"{', '.join(places)}, commit {', '.join(commits)}. That is a small part of a published "
        "training: the table says "
        "what the systems learn in so little time, not where they end. Rivals get our template with its hair, our "
        "poses and the head's place of our finished run; their preparation is not counted, nor is ours. The rays of "
        "a pixel are marched to the same template in the same bands for everyone. How each system differs from its "
        "publication stands at the top of its file (`experiments/rivals/`).",
        "",
    ]
    out += ["![truth, ours, the rivals: face, left hand, whole person in a new pose](sheet.png)", ""] if sheet else []
    for kind in kinds:
        for name, title in SETS.items():
            out += [f"## {title}, {kind}", "", *table(rows, kind, name), ""]
        out += [f"## Over people, novel poses, {kind}", "", *sign_tests(rows, kind), "",
                f"## Beside the paper, {kind}", "",
                "The paper's numbers are of other people, after 100 000 steps; only the distances to its own method "
                "can be compared.", "", *beside_paper(rows, kind), ""]  # fmt: skip
    out += ["## What it took", "", *cost(rows), ""]
    out += ["## Not made", "", *(f"- {line}" for line in absent), ""] if absent else []
    return "\n".join(out)
