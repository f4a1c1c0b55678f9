"""The table of experiments/claim.py: three kinds of input side by side, and the paper's numbers."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from bench.report.writer import markdown_table
from bench.score.quality_table import PAPER
from capture.folder import INPUTS
from experiments.short_training import three

FORMAT = "selfscan-claim"
REGIONS = ("total", "head", "hands")

Result = dict[str, Any]


def number_of(result: Result, keys: Sequence[str]) -> float | None:
    """result[keys[0]][keys[1]]..., None where any of them is absent."""
    found: Any = result
    for key in keys:
        found = found.get(key) if isinstance(found, dict) else None
    return found


# heading; where the number is, the region's name in place of *; digits; key in the paper's table
ROWS = (
    ("own videos: P2S aligned, cm", ("beside", "filmed_aligned", "*", "p2s_cm"), 2, "p2s_cm"),
    ("own videos: P2S in place, cm", ("beside", "filmed", "*", "p2s_cm"), 2, None),
    ("own videos: Chamfer aligned, cm", ("beside", "filmed_aligned", "*", "chamfer_cm"), 2, "chamfer_cm"),
    ("own videos, 0 steps: P2S aligned, cm", ("beside", "filmed_zero_steps_aligned", "*", "p2s_cm"), 2, None),
    ("own videos, 0 steps: P2S in place, cm", ("beside", "filmed_zero_steps", "*", "p2s_cm"), 2, None),
    ("own videos: joints of limbs / of fingers in place, cm", ("beside", "filmed_joints", "*"), 1, None),
    ("own videos: joints of limbs / of fingers aligned, cm", ("beside", "filmed_joints_aligned", "*"), 2, None),
    ("own videos: turns of body / of fingers, degrees", ("beside", "filmed_degrees", "*"), 1, None),
    ("held-out poses: P2S in place, cm", ("novel_pose", "*", "p2s_cm"), 2, None),
    ("held-out poses: P2S aligned, cm", ("beside", "aligned", "*", "p2s_cm"), 2, "p2s_cm"),
    ("held-out poses: Chamfer aligned, cm", ("beside", "aligned", "*", "chamfer_cm"), 2, "chamfer_cm"),
    ("held-out poses, 0 steps: P2S in place, cm", ("beside", "zero_steps", "*", "p2s_cm"), 2, None),
    ("held-out poses, 0 steps: P2S aligned, cm", ("beside", "zero_steps_aligned", "*", "p2s_cm"), 2, None),
    ("limb joints of the fitted poses, cm", ("beside", "fitted", "*"), 1, None),
    ("PSNR box, novel poses, dB", ("novel_pose", "*", "psnr_db"), 1, "psnr_db"),
    ("PSNR mask, novel poses, dB", ("novel_pose", "*", "psnr_mask_db"), 1, None),
    ("PSNR box, novel views, dB", ("novel_view", "*", "psnr_db"), 1, None),
    ("PSNR mask, novel views, dB", ("novel_view", "*", "psnr_mask_db"), 1, None),
)


def value(results: Sequence[Result], keys: tuple[str, ...], region: str) -> float | None:
    """Mean of a number over people; None where one of them has none."""
    found = [number_of(result, [region if key == "*" else key for key in keys]) for result in results]
    known = [x for x in found if x is not None]
    return float(np.mean(known)) if known and len(known) == len(found) else None


def table(by_kind: dict[str, list[Result]]) -> list[str]:
    """One line for each number, total / head / hands; a column for each kind of input."""
    rows = []
    for heading, keys, digits, in_paper in ROWS:
        cells = [numbers({r: value(by_kind.get(kind, []), keys, r) for r in REGIONS}, digits) for kind in INPUTS]
        paper = numbers({r: PAPER[r].get(in_paper) if in_paper else None for r in REGIONS}, digits)
        rows.append([heading, *cells, paper])
    return markdown_table(["total / head / hands", *INPUTS, "paper"], rows)


def numbers(values: dict[str, float | None], digits: int) -> str:
    """Total / head / hands; a dash where there is none of them."""
    return "-" if all(x is None for x in values.values()) else three(values, digits)


def page(found: dict[str, dict[str, Result]], facts: dict[str, Any], *, each: bool = True) -> str:
    """The tables of everybody, the mean first where there are several; without `each`, the mean alone."""
    results = [result for person in found.values() for result in person.values()]
    commits = sorted({str(_machine(result, "commit")) for result in results})
    machines = sorted({f"{_machine(result, 'cpu')}, {_machine(result, 'cores')} cores" for result in results})
    lines = [
        "# From pixels, beside what is given",
        "",
        "Written by `python -m experiments.claim`. One person filmed once, trained alike, judged on the same held-out",
        "pictures. *given*: template registered to the true mesh, its joints, exact poses and cameras. *shape only*:",
        "a free body's shape coefficients fitted, its joints estimated, no hair label; masks and cameras exact.",
        "*from pixels*: four raw videos and a detector's keypoints with noise and a bias, nothing else but one's own",
        "height.",
        "",
        "*Own videos*: the avatar in poses of its own videos, which were estimated from all frames together, against",
        "the truth of the same frames; total and head in the body's video, hands in theirs. In place: in the world of",
        "that video's camera. *Held-out poses*: poses of estimated skeletons are fitted to each held-out picture,",
        "from its keypoints and mask, never told: first the template's outline, then that of what was trained.",
        "One picture leaves the depth of limbs open: those of the true skeleton end 3.5 cm from the truth there, so",
        "these totals measure that fit more than the avatar. Aligned: after ICP, head and hands by themselves",
        "(held-out poses of *given*: with the whole person). Joints and turns of own videos: all frames; limbs stand",
        "as total, fingers as hands; turns with each joint's own mean removed. *0 steps*: the template before",
        "training, which has no colors. PSNR of the field. The paper's people and crops are others, and it was given",
        "nothing: its numbers stand beside the last two columns alone.",
        "",
        f"{facts['share']}; {facts['frames']} frames of each video, {facts['size']} px, {facts['light']} light, seed",
        f"{facts['seed']}; {facts['poses']} poses of each held-out set. {'; '.join(machines)},",
        f"commit {', '.join(commits)}.",
        "",
    ]  # fmt: skip
    if len(found) > 1:
        # people who lack a column are missing from none of the others: there is no mean then
        whole = {kind: [p[kind] for p in found.values()] for kind in INPUTS if all(kind in p for p in found.values())}
        lines += [f"## Mean of {len(found)} people", "", *table(whole), ""]
    for name, person in found.items() if each or len(found) == 1 else ():
        lines += [f"## {name}", "", *table({kind: [result] for kind, result in person.items()}), ""]
    return "\n".join(lines).rstrip("\n") + "\n"


def _machine(result: Result, key: str) -> Any:
    return result.get("machine", {}).get(key)
