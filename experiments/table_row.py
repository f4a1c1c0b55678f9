"""One row of the paper's tables for one person: what it changes, its scores over a few novel poses, its picture.

    python -m experiments.table_row RUN CAPTURE ROW FOLDER

A process for every row: a variant may optimise, and torch's optimiser must be loaded before Mesa is.
"""

import argparse
import hashlib
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bake.field import one_thread
from bench.field.drawer import Drawer
from bench.field.posed_field import Directions
from bench.ladder.machine import machine
from bench.score.lpips import read_perceptual
from bench.score.metrics import Perceive
from bench.score.picture_scores import PictureJudge, is_t_pose, score_images
from bench.score.pose_distances import JudgedSurfaces, measure_poses, same_poses
from bench.score.quality import CAPTURE_FACTS, evaluate, seen_case
from bench.score.region_scores import regions_of
from bench.score.true_mesh import TrueMesh, read_true_mesh
from capture.folder import read_capture, read_capture_facts
from capture.held_out import HeldOutView, read_held_out, some_poses
from command.errors import AssetError
from experiments.row_sheet import write_sheet
from experiments.short_training import read_kept
from experiments.variants import VARIANTS, seam_steps, variant
from files.whole import write_json
from train.run import Run, read_run

FORMAT = "selfscan-table-row"


@dataclass(frozen=True)
class Training:
    """One training of a person, as its command is asked for it."""

    # behind the capture's name in the folder of runs
    suffix: str = ""
    words: tuple[str, ...] = ()
    command: tuple[str, ...] = ("selfscan", "train")


PARTS_TRAINING = Training()
SINGLE = Training("_single", command=("experiments.rivals.single",))
LIGHT_OFF = Training("_light_off", ("--without", "light"))


@dataclass(frozen=True)
class Row:
    """A row: how it differs from ours, and the seams that show it where the paper only has pictures."""

    # of the variant (experiments/variants.py), where it is one
    name: str
    title: str
    # seams that should be worse than ours
    places: tuple[str, ...] = ()
    # by this number of them
    measure: str = ""
    # the training it is measured on
    training: Training = PARTS_TRAINING
    directions: Directions = "global"


SEAMS = ("neck", "wrist_left", "wrist_right")
ROWS = {
    row.name: row
    for row in (
        Row("ours", "ours"),
        Row("landmarks_only", "head by landmarks only (without Eq. 5)", ("neck",), "step_mm"),
        Row("no_L_g", "without L_g (Eq. 7)", SEAMS, "step_mm"),
        Row("no_codes_no_fusion", "without codes and fusion (Eq. 8, 9)", SEAMS, "shown_color_step"),
        Row("no_fusion", "without fusion (Eq. 9)", SEAMS, "shown_color_step"),
        Row("filled_eyes", "eyes as the field filled them"),
        Row("one_surface", "hair and body as one surface"),
        Row("light_off", "without light as its own factor", training=LIGHT_OFF),
        Row("single", "single network, as many parameters", training=SINGLE),
        Row("no_ray_transform", "without ray transformation (Eq. 14)", directions="own"),
    )
}


def stamp(
    run: Path, capture: Path, row: Row, poses: int | None, our_poses: int | None, lpips: Sequence[Path]
) -> dict[str, Any]:
    """What the numbers of a row follow from; a finished row with the same stamp is not measured again."""
    return {
        "run": digest(run / "run.json"),
        "capture": digest(capture / "capture.json"),
        "poses": poses,
        "our_poses": our_poses if row.name == "ours" else None,
        "lpips": [path.name for path in lpips],
    }


def digest(path: Path) -> str:
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()[:16]
    except OSError as error:
        raise AssetError(f"{path}: cannot be read: {error}") from None


def finished(path: Path, expected: dict[str, Any]) -> bool:
    """Whether the file is a row measured from exactly this."""
    return read_kept(path, {"format": FORMAT, "stamp": expected}) is not None


def measure_row(
    run_path: Path,
    capture: Path,
    row: Row,
    folder: Path,
    *,
    poses: int | None,
    our_poses: int | None,
    lpips: Sequence[Path],
) -> dict[str, Any]:
    """Everything that a row says of one person; its picture is written to `folder`."""
    start, cpu_start = time.perf_counter(), time.process_time()
    trained = read_run(run_path)
    changed = variant(trained, read_capture(capture), row.name) if row.name in VARIANTS else trained
    steps = finite(seam_steps(changed)) if row.places or row.name == "ours" else None
    facts = read_capture_facts(capture)
    truth = read_true_mesh(capture)
    views = read_held_out(capture, "novel_pose")
    with one_thread():
        if row.name == "ours":
            quality = evaluate(run_path, capture, poses=our_poses, lpips=lpips)
            write_json(folder / "quality.json", quality)
        drawer = Drawer(changed, row.directions)
        try:
            perceive = read_perceptual(lpips).score if lpips else None
            measured = row.name == "ours" or row.training != PARTS_TRAINING or not same_surface(changed, trained)
            result = measured_row(drawer, truth, some_poses(views, poses), measured, perceive)
            write_sheet(drawer, truth, capture, facts, views, row.title, folder / row.name, steps)
            measured_on = machine(drawer.context)
        finally:
            drawer.release()
    return {
        "format": FORMAT,
        "row": row.name,
        "stamp": stamp(run_path, capture, row, poses, our_poses, lpips),
        "capture": {name: facts[name] for name in CAPTURE_FACTS if name in facts},
        "seed": trained.provenance.get("seed"),
        "preset": trained.provenance.get("preset"),
        # where its training got the head's place; rows measured before say nothing: Eq. 6 alone
        "head": trained.provenance.get("registration", {}).get("from", "its own parts")
        if row.training == SINGLE
        else None,
        "parameters": sum(p.numel() for p in trained.field.parameters()),
        **result,
        "seams": steps,
        "machine": measured_on,
        "seconds": round(time.perf_counter() - start, 1),
        "cpu_seconds": round(time.process_time() - cpu_start, 1),
    }


def finite(steps: dict[str, dict[str, float]]) -> dict[str, dict[str, float | None]]:
    """Numbers that could not be measured as None: JSON has no NaN."""
    return {
        place: {key: value if np.isfinite(value) else None for key, value in seam.items()}
        for place, seam in steps.items()
    }


def same_surface(one: Run, other: Run) -> bool:
    return np.array_equal(one.surface.vertices, other.surface.vertices)


def measured_row(
    drawer: Drawer, truth: TrueMesh, views: list[HeldOutView], geometry: bool, perceive: Perceive | None
) -> dict[str, Any]:
    """Novel poses only, without what `selfscan eval` puts beside them; distances where the surface is not ours."""
    views = [view for view in views if not is_t_pose(view)]
    images = score_images(PictureJudge(truth, drawer.draw, perceive), views, "pictures")
    if not geometry:
        return {"novel_pose": regions_of({}, images), "geometry": "as ours"}
    surfaces = JudgedSurfaces(seen_case(drawer, truth, drawer.surface))
    return {"novel_pose": regions_of(measure_poses(surfaces, same_poses(views), "surfaces")["ours"], images)}


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m experiments.table_row", description="One row for one person.")
    parser.add_argument("run", metavar="RUN", type=Path)
    parser.add_argument("capture", metavar="CAPTURE", type=Path)
    parser.add_argument("row", choices=ROWS, metavar="ROW", help=", ".join(ROWS))
    parser.add_argument("folder", metavar="FOLDER", type=Path, help="gets ROW.json and ROW.png")
    parser.add_argument("--poses", type=int, metavar="N", help="novel poses (default: all)")
    parser.add_argument("--our-poses", type=int, metavar="N", help="of the whole evaluation of ours")
    parser.add_argument("--lpips", metavar="FILE", type=Path, nargs="+", default=[])
    options = parser.parse_args(argv)
    options.folder.mkdir(parents=True, exist_ok=True)
    row = ROWS[options.row]
    result = measure_row(
        options.run,
        options.capture,
        row,
        options.folder,
        poses=options.poses,
        our_poses=options.our_poses,
        lpips=options.lpips,
    )
    write_json(options.folder / f"{row.name}.json", result)
    print(f"{row.title}: {result['cpu_seconds']:.0f} CPU s", flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
