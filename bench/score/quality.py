"""Quality of a trained run or a baked avatar against a capture's ground truth (`selfscan eval`).

Pictures as picture_scores.py says; P2S and Chamfer between posed visible surfaces, without alignment. Beside them: the
subject's own rig weights in place of ours (what is left is learning, the difference is skinning), ICP-aligned as the
paper's code does, T-pose, canonical, and the template before training (0 steps). "input": what the reconstruction was
given; the poses of an estimated skeleton are fitted to each held-out picture (fitted_poses.py).
"""

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, compress
from pathlib import Path

import numpy as np

from avatar.skeleton import BIG_POSE
from bake.promises import recorded_loss
from bench.field.drawer import Drawer
from bench.field.posed_field import PosableSurface, one_thread
from bench.ladder.machine import machine
from bench.report.writer import Json
from bench.score.filmed_poses import FilmedPoses, filmed_poses
from bench.score.fitted_poses import fitted_views
from bench.score.lpips import read_perceptual
from bench.score.metrics import Perceive
from bench.score.picture_scores import NO_EYES, PictureJudge, is_t_pose, score_images
from bench.score.pose_distances import JudgedSurfaces, Placement, fitted_poses, measure_once, measure_poses, same_poses
from bench.score.posed_geometry import GeometryCase, geometry_case, own_weights_surface
from bench.score.quality_table import PAPER
from bench.score.region_scores import regions_of, rounded, without_eyes
from bench.score.skeleton_distance import BODY, HANDS, LIMBS, joints_off, posed_skeletons, turned_off
from bench.score.standing import SIDES, face_landmarks_mm, outline_scores
from bench.score.trained_outline import TrainedOutline
from bench.score.true_mesh import TrueMesh, read_true_mesh
from capture.folder import CaptureSubject, input_kind, read_subject
from capture.held_out import SETS, HeldOutView, read_held_out, read_truth_facts, some_poses
from command.errors import AssetError
from command.progress import plural
from files.input_file import read_json_object
from player.draw.raster import Rasteriser
from synth.visibility import visible_faces

CAPTURE_FACTS = ("subject", "light", "sheen", "pose_noise_deg", "seed", "size", "registration")


def print_stage(text: str) -> None:
    """One line about what begins, on standard error."""
    print(f"eval: {text}", file=sys.stderr, flush=True)


@dataclass(frozen=True)
class Evaluated:
    drawer: Drawer
    truth: TrueMesh
    # held-out views by set, in true poses
    filmed: dict[str, list[HeldOutView]]
    # the same in the poses of an estimated skeleton, in which ours is drawn; None: the skeleton was given
    ours: dict[str, list[HeldOutView]] | None = None
    # the template that training began with; None: not at hand
    template: CaptureSubject | None = None
    # poses of the person's own videos; None: not asked for
    videos: FilmedPoses | None = None
    perceive: Perceive | None = None

    @property
    def judge(self) -> PictureJudge:
        return PictureJudge(self.truth, self.drawer.draw, self.perceive, self.drawer.raster)


def evaluate(
    path: Path, capture: Path, *, poses: int | None = None, run: Path | None = None, lpips: Sequence[Path] = ()
) -> Json:
    """Every number of `selfscan eval` as one JSON-ready dictionary; `lpips` are the files of its weights."""
    start, cpu_start = time.perf_counter(), time.process_time()
    perceive = read_perceptual(lpips).score if lpips else None
    print_stage(f"reading {path} and {capture}")
    facts, truth = read_truth_facts(capture), read_true_mesh(capture)
    with one_thread():
        drawer = Drawer(path)
        try:
            kind = input_kind(drawer.provenance.get("capture") or {}, str(path))
            what = prepared(drawer, truth, capture, kind, poses=poses, run=run)
            result = measured(replace(what, perceive=perceive))
        finally:
            drawer.release()
    source = "avatar" if drawer.avatar is not None else "run"
    return {
        "format": "selfscan-quality",
        "input": kind,
        "source": {"name": path.name, "kind": source, "provenance": drawer.provenance},
        "machine": machine(drawer.context),
        "capture": {name: facts[name] for name in CAPTURE_FACTS if name in facts},
        **result,
        "paper": PAPER,
        "seconds": round(time.perf_counter() - start, 1),
        "cpu_seconds": round(time.process_time() - cpu_start, 1),
    }


def prepared(
    drawer: Drawer, truth: TrueMesh, capture: Path, kind: str, *, poses: int | None, run: Path | None
) -> Evaluated:
    """The truth, held-out views and, of an estimated skeleton, their fitted poses; at most `poses` of each set."""
    held_out = {name: some_poses(read_held_out(capture, name), poses) for name in SETS}
    run = drawer.path if drawer.field is not None else run
    # all of a run is read before minutes of fitting: it may be none
    run_facts = {} if run is None else read_json_object(run / "run.json", "the facts of a run")
    videos = filmed_poses(run, run_facts, capture, poses)
    template, ours = template_of_run(drawer, run, kind), None
    if kind != "given":
        assert template is not None
        print_stage(f"{kind}: poses fitted to {sum(map(len, held_out.values()))} held-out pictures")
        ours = fitted_views(template, held_out, TrainedOutline(drawer.surface, drawer.raster))
    return Evaluated(drawer, truth, held_out, ours, template, videos)


def seen_case(drawer: Drawer, truth: TrueMesh, surface: PosableSurface) -> GeometryCase:
    """What is measured on both surfaces: what can be seen from outside in pose 0."""
    print_stage(f"which of {len(surface.faces)} faces can be seen from outside")
    posed = surface.posed(np.zeros((52, 3)), truth.joints[0])
    visible = visible_faces(drawer.raster, posed, surface.faces)
    try:
        return geometry_case(truth, surface, visible)
    except ValueError as error:  # other units, no faces: the file's fault, not the caller's
        raise AssetError(f"{drawer.path}: {error}") from None


def template_surface(subject: CaptureSubject) -> PosableSurface:
    """The template that training began with, hair and clothes that were carved included."""
    return PosableSurface(subject.vertices, subject.faces, subject.skin, subject.joints, BIG_POSE)


def template_of_run(drawer: Drawer, run: Path | None, kind: str) -> CaptureSubject | None:
    """The template of the run of what is evaluated; None: none is at hand, and none needed.

    Raises:
        AssetError: the poses of an estimated skeleton have to be fitted, and no run says with which template.
    """
    if run is not None:
        return read_subject(run / "subject.npz")
    if kind != "given":
        raise AssetError(
            f"{drawer.path}: its skeleton was estimated ({kind}), so held-out poses are fitted to their pictures with "
            f"the template of its run: name it with --run RUN"
        )
    return None


def measured(what: Evaluated) -> Json:
    """The table of one evaluation, row by row, each with its regions and their metrics: the held-out sets, and what
    stands beside them."""
    drawer, truth, given, out = what.drawer, what.truth, what.ours is None, Json()
    surfaces = JudgedSurfaces(
        seen_case(drawer, truth, drawer.surface),
        None if what.template is None else seen_case(drawer, truth, template_surface(what.template)),
        own_weights_surface(truth, drawer.surface) if given else None,
        apart=not given,
    )
    beside: Json = {
        **standing_rows(surfaces, drawer.raster, what.template),
        "canonical": regions_of(measure_once(surfaces.case, BIG_POSE, surfaces.apart)[0]),
    }
    for name in what.filmed:
        rows, more = held_out_rows(what, surfaces, name)
        out |= rows
        beside |= more
    if what.videos is not None:
        joints = drawer.surface.joints if what.template is None else what.template.joints
        beside |= in_filmed_poses(replace(surfaces, own=None, apart=True), what.videos, joints)
    return {**out, "baked_vs_field": baked_vs_field_of(drawer), "beside": beside}


def held_out_rows(what: Evaluated, surfaces: JudgedSurfaces, name: str) -> tuple[Json, Json]:
    """The rows of one set of held-out pictures, and what stands beside novel poses. Novel views are of a standing
    T-pose by design; among novel poses a T-pose frame would flatter, and stands by itself."""
    views, own_views, novel = what.filmed[name], (what.ours or what.filmed)[name], name == "novel_pose"
    text = name.replace("_", " ")
    print_stage(f"{text}: {plural(len(views), 'picture')}")
    still = [novel and is_t_pose(view) for view in views]
    moving, own_moving = (list(compress(one, np.logical_not(still))) for one in (views, own_views))
    images = score_images(what.judge, moving, f"{name} pictures", own_moving)
    placements = same_poses(moving) if what.ours is None else fitted_poses(moving, own_moving)
    print_stage(f"{text}: {len(placements)} posed surfaces")
    distances = measure_poses(surfaces, placements, f"{name} surfaces", beside=novel)
    rows: Json = {name: {"eyes": without_eyes(NO_EYES)} | regions_of(distances["ours"], images)}
    if not novel:
        return rows, {}
    beside = {name: regions_of(found) for name, found in distances.items() if name != "ours"}
    beside = beside_novel_poses(what, placements, beside)
    if any(still):
        t_pose, own_t_pose = (list(compress(one, still)) for one in (views, own_views))
        beside["t_pose_frames"] = regions_of({}, score_images(what.judge, t_pose, f"{name} T-poses", own_t_pose))
    return rows, beside


def beside_novel_poses(what: Evaluated, placements: list[Placement], rows: Json) -> Json:
    """Novel poses after alignment, of the template before training and under the rig's weights; joints of fitted
    poses."""
    out: Json = {
        "zero_steps": None,
        "own_weights": None,
        **rows,
        "zero_steps_reason": "a template has no colors before training: no pictures",
        "poses": len(placements),
    }
    if what.template is None:
        out["zero_steps_reason"] = "the avatar file holds no template; give --run"
    if what.ours is not None and what.template is not None:
        seen = [(p.truth, own) for p in placements for part, own in p.ours.items() if "total" in part]
        ours, true = [own for _, own in seen], [view for view, _ in seen]
        posed = posed_skeletons(ours, true, what.template.joints, what.truth.joints)
        out["fitted"] = {"total": round(joints_off(posed, LIMBS, aligned=False), 3)}
    return out


def in_filmed_poses(what: JudgedSurfaces, videos: FilmedPoses, joints: np.ndarray) -> Json:
    """The rows of the person's own videos, each region aligned by itself; `joints` are our skeleton's, pose 0."""
    if not videos.by_part:
        return {"filmed": None, "filmed_reason": videos.reason}
    few = videos.some()
    placements = list(chain(*few.values()))
    print_stage(f"the person's own videos: {len(placements)} posed surfaces")
    distances = measure_poses(what, placements, "filmed surfaces", beside=True)
    rows = {"filmed" if name == "ours" else f"filmed_{name}": found for name, found in distances.items()}
    return {
        **{name: regions_of(row) for name, row in rows.items()},
        **in_filmed_skeletons(videos, joints, what.truth.joints),
        "filmed_frames": {part: len(found) for part, found in few.items()},
    }


def in_filmed_skeletons(videos: FilmedPoses, joints: np.ndarray, true_joints: np.ndarray) -> Json:
    """Limb joints of the body's video, fingers of the hands' own, in all frames: cm and degrees."""
    posed = {}
    for part, found in videos.by_part.items():
        ours = [own for placement in found for own in placement.ours.values()]
        posed[part] = posed_skeletons(ours, [placement.truth for placement in found], joints, true_joints)
    out = {}
    for name, of_body, first, measure in (
        ("filmed_joints", LIMBS, 0, partial(joints_off, aligned=False)),
        ("filmed_joints_aligned", LIMBS, 0, partial(joints_off, aligned=True)),
        # the wrist's turn is no finger's
        ("filmed_degrees", BODY, 1, turned_off),
    ):
        hands = [measure(posed[part], which[first:]) for part, which in HANDS.items()]
        out[name] = {"total": round(measure(posed["body"], of_body), 3), "hands": round(float(np.mean(hands)), 3)}
    return out


def standing_rows(what: JudgedSurfaces, raster: Rasteriser, template: CaptureSubject | None) -> Json:
    """The T-pose: distances, outlines from eight sides and the face's features, of ours and of the template before
    training."""
    rows: Json = {}
    for name, case in (("t_pose", what.case), ("t_pose_zero_steps", what.template)):
        if case is None:
            continue
        print_stage(f"{name.replace('_', ' ')}: distances, and outlines from {SIDES} sides")
        distances, pair, T = measure_once(case, np.zeros((52, 3)), what.apart)
        rows[name], standing = regions_of(distances), outline_scores(raster, case, pair, T)
        standing["head"] = standing.get("head", {}) | face_landmarks_mm(template, case, pair)
        for region, scores in standing.items():
            rows[name][region] |= {key: rounded(score) for key, score in scores.items()}
    return rows


def baked_vs_field_of(drawer: Drawer) -> Json:
    """What the bake measured against its field, from the avatar's provenance; null for a run."""
    if drawer.avatar is None:
        return {"paper_db": None, "network_db": None, "reason": "a run is not baked; evaluate its avatar"}
    found = recorded_loss(drawer.avatar)
    if "paper_db" not in found:
        return {"paper_db": None, "network_db": None, "reason": "the avatar file does not say"}
    return {"paper_db": found["paper_db"], "network_db": (found.get("cone_db") or {}).get("network")}
