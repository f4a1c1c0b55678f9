"""One row judged: python -m experiments.rivals.judge SYSTEM RUN_OR_AVATAR TRUTH OUT.json [--pixels RUN]

By the pieces of `selfscan eval`: the same held-out pictures, regions, samples on surfaces and metrics for everyone. A
density is drawn by a ray through the middle of each pixel, as published; surfaces are smoothed by 2 x 2, as by eval.
"""

import argparse
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from PIL import Image

from avatar.texture import bytes_of
from bench.field.drawer import Drawer
from bench.field.posed_field import PosableSurface
from bench.ladder.machine import commit, cpu_name
from bench.ladder.rung_pictures import spread_poses
from bench.score.fitted_poses import fitted_views
from bench.score.picture_scores import Draw, PictureJudge, is_t_pose, score_images
from bench.score.pose_distances import Placement, fitted_poses, same_poses
from bench.score.posed_geometry import Distances, GeometryCase, geometry_case, measure_pose, nothing, posed_pair
from bench.score.region_scores import regions_of
from bench.score.true_mesh import TrueMesh, read_true_mesh
from capture.folder import read_subject
from capture.held_out import SETS, HeldOutView, read_held_out, some_poses
from experiments.program import end_with
from experiments.rivals import aninerf, anisdf, neuralbody
from experiments.row_sheet import square_about
from files.npz import read_npz
from files.whole import whole_file, write_json
from geometry.closest import triangle_index
from player.draw.raster import Rasteriser
from player.gl.context import open_context
from synth.visibility import visible_faces

RIVALS = {"anisdf": anisdf.Shown, "aninerf": aninerf.Shown, "neuralbody": neuralbody.Shown}
REGIONS = ("head", "hands", "total")
SCORES = ("p2s_cm", "chamfer_cm", "psnr_db", "psnr_mask_db", "ssim", "flip")
# views of the sheet of pictures
SHOWN_VIEWS = ("head", "hand_left", "body")


class Judged(NamedTuple):
    """What is asked for pictures and surfaces."""

    draw: Draw
    # of a pose (angles and root)
    surface: Callable[[np.ndarray, np.ndarray], PosableSurface]
    raster: Rasteriser


def judged(system: str, path: Path) -> Judged:
    """A trained person; torch's optimiser is loaded before Mesa is, or both crash."""
    torch.optim.Adam([torch.nn.Parameter(torch.zeros(1))]).step()
    if system not in RIVALS:
        drawer = Drawer(path)
        return Judged(drawer.draw, lambda axis_angle, root: drawer.surface, drawer.raster)
    shown = RIVALS[system](path)
    raster = Rasteriser(open_context())
    draw = partial(shown.draw, raster=raster) if isinstance(shown, anisdf.Shown) else shown.draw
    return Judged(draw, shown.surface, raster)


def distances(what: Judged, truth: TrueMesh, placements: Sequence[Placement]) -> Distances:
    """Of all poses, to the surface that each pose has."""
    into, made = nothing(), dict[int, tuple[PosableSurface, GeometryCase]]()
    for placement in placements:
        posed = truth.posed(placement.truth.axis_angle, placement.truth.root)
        for regions, ours in placement.ours.items():
            surface = what.surface(ours.axis_angle, ours.root)
            if id(surface) not in made:
                standing = surface.posed(np.zeros((52, 3)), truth.joints[0])
                visible = visible_faces(what.raster, standing, surface.faces)
                made[id(surface)] = surface, geometry_case(truth, surface, visible)
            case = made[id(surface)][1]
            index = triangle_index(posed, case.truth_faces)
            pair = posed_pair(case, posed, surface.posed(ours.axis_angle, ours.root), index)
            measure_pose(case, pair, into, regions)
    return into


def in_fitted_poses(views: dict[str, list[HeldOutView]], run: Path, kept: Path) -> dict[str, list[HeldOutView]]:
    """The views in poses fitted with the template alone, which are everyone's; once, in the file `kept`."""
    if not kept.exists():
        found = fitted_views(read_subject(run / "subject.npz"), views)
        rows = {f"{name}/axis_angle": np.stack([view.axis_angle for view in own]) for name, own in found.items()}
        rows |= {f"{name}/root": np.stack([view.root for view in own]) for name, own in found.items()}
        with whole_file(kept) as file:
            np.savez(file, allow_pickle=False, **rows)
    poses = read_npz(kept, "fitted poses", [f"{name}/{key}" for name in views for key in ("axis_angle", "root")])
    return {
        name: [replace(view, axis_angle=a, root=r)
               for view, a, r in zip(own, poses[f"{name}/axis_angle"], poses[f"{name}/root"], strict=True)]
        for name, own in views.items()
    }  # fmt: skip


def held_out(folder: Path, poses: int) -> dict[str, list[HeldOutView]]:
    """The views of so many poses of each set, evenly spread; novel poses that are T-poses are none."""
    views = {name: read_held_out(folder, name) for name in SETS}
    views["novel_pose"] = [view for view in views["novel_pose"] if not is_t_pose(view)]
    return {name: some_poses(own, poses) for name, own in views.items()}


def scores(what: Judged, folder: Path, poses: int, fitted: tuple[Path, Path] | None) -> dict[str, Any]:
    """{"novel_pose": {region: {metric: number}}, "novel_view": ...}; `fitted`: the run whose template poses are fitted
    with, and the file that keeps them."""
    truth, views = read_true_mesh(folder), held_out(folder, poses)
    ours = views if fitted is None else in_fitted_poses(views, *fitted)
    out: dict[str, Any] = {}
    for name, true in views.items():
        judge = PictureJudge(truth, what.draw)
        images = score_images(judge, true, f"{name} pictures", ours[name])
        placements = same_poses(true) if fitted is None else fitted_poses(true, ours[name])
        found = regions_of(distances(what, truth, placements), images)
        out[name] = {region: {key: found[region].get(key) for key in SCORES} for region in REGIONS}
    return out


def write_pictures(what: Judged, folder: Path, out: Path, fitted: tuple[Path, Path] | None, poses: int) -> None:
    """Face, left hand and the whole person in one new pose, truth and drawn: OUT_VIEW.png and OUT_VIEW_truth.png."""
    views = held_out(folder, poses)
    ours = views if fitted is None else in_fitted_poses(views, *fitted)
    for part in SHOWN_VIEWS:
        (view,) = spread_poses(views["novel_pose"], part, 1)
        own = next(o for v, o in zip(views["novel_pose"], ours["novel_pose"], strict=True) if v.name == view.name)
        where = square_about(view)
        drawn = what.draw(own.axis_angle, own.root, view.camera, 2, np.ones(view.camera.size[::-1], bool)).color
        for suffix, picture in (("", drawn), ("_truth", view.image())):
            with whole_file(out.with_name(f"{out.stem}_{part}{suffix}.png")) as file:
                Image.fromarray(bytes_of(picture[where])).resize((512, 512)).save(file, "PNG")


def main(argv: list[str] | None = None) -> int:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.rivals.judge", description=(__doc__ or "").split(":")[0]
    )
    parser.add_argument("system", metavar="SYSTEM")
    parser.add_argument("path", metavar="RUN_OR_AVATAR", type=Path)
    parser.add_argument("truth", metavar="TRUTH", type=Path)
    parser.add_argument("out", metavar="OUT.json", type=Path)
    parser.add_argument("--poses", type=int, default=20)
    parser.add_argument("--pixels", metavar="RUN", type=Path, help="an estimated skeleton: fit poses with its template")
    given = parser.parse_args(argv)
    torch.set_num_threads(1)
    began = time.process_time()
    fitted = None if given.pixels is None else (given.pixels, given.out.parent / "fitted.npz")
    what = judged(given.system, given.path)
    found = scores(what, given.truth, given.poses, fitted)
    write_pictures(what, given.truth, given.out, fitted, given.poses)
    facts = {"cpu": cpu_name(), "commit": commit(), "judging_seconds": round(time.process_time() - began, 1)}
    write_json(given.out, {**found, "poses": given.poses, **facts})
    return 0


if __name__ == "__main__":
    end_with(main)
