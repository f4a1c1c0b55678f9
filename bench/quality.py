"""Quality of a trained run or a baked avatar against a capture's ground truth (`selfscan eval`).

Pictures as bench/picture_scores.py says; geometry as P2S and Chamfer in centimetres between posed surfaces,
visible surface only, without alignment. Beside them: the subject's own rig weights in place of ours (what is
left is learning, the difference is skinning), ICP-aligned as the paper's code does, T-pose, canonical, hair, and the
template before training (0 steps). What was told to the reconstruction stands as "input"; the poses of an estimated
skeleton are fitted to each held-out picture (bench/fitted_poses.py).
"""

import json
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from avatar.baked_avatar import Avatar
from avatar.errors import AssetError
from avatar.files import check_file, whole_file
from avatar.input_file import read_json_object
from avatar.progress import progress
from avatar.settings import AtLeast, Help, Option, parse
from avatar.skeleton import BIG_POSE
from bake.truth import IDENTITY, better_mode, scores_by_mode, some_poses
from bench.beside_hair import edges_at_hair, skin_to_surface, stretched_edges
from bench.ceiling import CeilingDrawer
from bench.drawer import Drawer
from bench.eye_region import NO_EYES
from bench.field_view import one_thread
from bench.filmed_poses import FilmedPoses, filmed_poses
from bench.fitted_poses import fitted_views
from bench.lpips import read_perceptual
from bench.machine import machine
from bench.picture_scores import Perceive, is_t_pose, score_images
from bench.pose_distances import (
    BESIDE,
    Measured,
    PoseDistances,
    distinct_poses,
    fitted_poses,
    measure_poses,
    same_poses,
)
from bench.posed_field import PosableSurface
from bench.posed_geometry import (
    SAMPLES,
    Distances,
    GeometryCase,
    alignment,
    geometry_case,
    measure_pose,
    own_weights_surface,
    posed_pair,
)
from bench.quality_table import PAPER, markdown, print_table
from bench.region_scores import regions_of, without_eyes
from bench.remeasure import remeasured
from bench.skeleton_distance import BODY, HANDS, LIMBS, joints_off, posed_skeletons, turned_off
from bench.true_mesh import TrueMesh, read_true_mesh
from capture.folder import CaptureSubject, read_subject
from capture.held_out import SETS, HeldOutView, read_held_out, read_truth_facts
from capture.input_kind import input_kind
from player.context import open_context
from synth.visibility import visible_faces
from train.run import read_run

# of each held-out set on which an avatar is compared with its run's field
FIELD_POSES = 3
CAPTURE_FACTS = ("subject", "light", "sheen", "pose_noise_deg", "seed", "size", "registration")


def print_stage(text: str) -> None:
    """One line about what begins, on standard error."""
    print(f"eval: {text}", file=sys.stderr, flush=True)


def evaluate(
    path: Path,
    capture: Path,
    *,
    ceiling: bool = False,
    poses: int | None = None,
    few: int | None = None,
    run: Path | None = None,
    lpips: Sequence[Path] = (),
) -> dict[str, Any]:
    """Every number of `selfscan eval` as one JSON-ready dictionary; with `few`, "few_poses" holds the novel poses'
    scores over that many of them as well. `lpips` are the files of its weights."""
    start, cpu_start = time.perf_counter(), time.process_time()
    perceive = read_perceptual(lpips).score if lpips else None
    print_stage(f"reading {path} and {capture}")
    facts = read_truth_facts(capture)
    truth = read_true_mesh(capture)
    held_out = {name: some_poses(read_held_out(capture, name), poses) for name in SETS}
    with one_thread():
        drawer = Drawer(path)
        try:
            kind = input_kind(drawer.provenance.get("capture") or {}, str(path))
            template = template_of_run(drawer, run, kind)
            filmed = held_out
            if kind != "given":
                assert template is not None
                print_stage(f"{kind}: poses fitted to {sum(map(len, held_out.values()))} held-out pictures")
                held_out = fitted_views(template, filmed, drawer.surface, drawer.raster)
            ours = None if kind == "given" else held_out
            own_run = path if drawer.field is not None else run
            run_facts = {} if own_run is None else read_json_object(own_run / "run.json", "the facts of a run")
            videos = filmed_poses(own_run, run_facts, capture)
            result = measured(
                drawer, truth, filmed, few=few, perceive=perceive, ours=ours, template=template, videos=videos
            )
            if drawer.avatar is not None:
                print_stage("every view mode of the avatar beside the true pictures")
                result["view_modes"] = view_modes(drawer.avatar, facts, held_out)
            if run is not None and drawer.avatar is not None:
                print_stage(f"the avatar against the field of {run}: what the file says, and held-out pictures")
                some = {name: some_poses(views, FIELD_POSES) for name, views in held_out.items()}
                result["baked_vs_field"] |= remeasured(drawer.avatar, read_run(run), some)
            if ceiling:
                result["beside"]["ceiling"] = measured_ceiling(
                    drawer, capture, facts, truth, filmed["novel_pose"], perceive
                )
        finally:
            drawer.release()
    source = {
        "name": path.name,
        "kind": "avatar" if drawer.avatar is not None else "run",
        "provenance": drawer.provenance,
    }
    return {
        "format": "selfscan-quality",
        "input": kind,
        "source": source,
        "machine": machine(drawer.context.renderer, drawer.context.kind),
        "capture": {name: facts[name] for name in CAPTURE_FACTS if name in facts},
        **result,
        "paper": PAPER,
        "seconds": round(time.perf_counter() - start, 1),
        "cpu_seconds": round(time.process_time() - cpu_start, 1),
    }


def view_modes(avatar: Avatar, facts: dict[str, Any], held_out: dict[str, list[HeldOutView]]) -> dict[str, Any]:
    """Every view mode of the file side by side: PSNR inside the true person, by set and region, and which is best."""
    recorded = (find_key(avatar.provenance, "default_view") or {}).get("default_view")
    judged = not_chosen_on(recorded, facts, held_out)
    context = open_context()
    try:
        scores = scores_by_mode(context, avatar, judged)
    finally:
        context.release()
    best, reason = better_mode(scores["all"])
    return {"psnr_db": scores, "best": best, "reason": reason, "default": avatar.default_view, "file_says": recorded,
            "pictures": {name: len(views) for name, views in judged.items()}}  # fmt: skip


def not_chosen_on(
    recorded: Any, facts: dict[str, Any], held_out: dict[str, list[HeldOutView]]
) -> dict[str, list[HeldOutView]]:
    """The pictures on which the file's view mode was not chosen; all, where it was chosen on another capture, or where
    none would be left."""
    if not isinstance(recorded, dict) or any(recorded.get(key) != facts.get(key) for key in IDENTITY):
        return held_out
    used = recorded.get("chosen_on", {}).get("poses", {})
    left = {
        name: [view for view in views if view.pose_index not in used.get(name, [])] for name, views in held_out.items()
    }
    return left if any(left.values()) else held_out


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
    """The template of what is evaluated: its own run's, else that of `run`; None: none is at hand, and none needed.

    Raises:
        AssetError: the poses of an estimated skeleton have to be fitted, and no run says with which template.
    """
    if drawer.field is not None:
        return read_subject(drawer.path / "subject.npz")
    if run is not None:
        return read_subject(run / "subject.npz")
    if kind != "given":
        raise AssetError(
            f"{drawer.path}: its skeleton was estimated ({kind}), so held-out poses are fitted to their pictures with "
            f"the template of its run: name it with --run RUN"
        )
    return None


def measured(
    drawer: Drawer,
    truth: TrueMesh,
    held_out: dict[str, list[HeldOutView]],
    *,
    few: int | None,
    perceive: Perceive | None,
    ours: dict[str, list[HeldOutView]] | None = None,
    template: CaptureSubject | None = None,
    videos: FilmedPoses | None = None,
) -> dict[str, Any]:
    """Both sets of held-out pictures and poses, and what stands beside them; `ours`: the views in the poses of an
    estimated skeleton; `videos`: poses of the person's own videos."""
    surface = drawer.surface
    rest = np.zeros((52, 3)), truth.joints[0]
    what = Measured(
        seen_case(drawer, truth, surface),
        None if template is None else seen_case(drawer, truth, template_surface(template)),
        own_weights_surface(truth, surface) if ours is None else None,
        apart=ours is not None,
    )

    out: dict[str, Any] = {}
    beside: dict[str, Any] = {"t_pose": regions_of(measure_once(what, *rest))}
    beside["canonical"] = regions_of(measure_once(what, BIG_POSE, truth.joints[0]))
    for name, views in held_out.items():
        # novel views are of a standing T-pose by design; among novel poses a T-pose frame would flatter
        apart = name == "novel_pose"
        own_views = views if ours is None else ours[name]
        print_stage(f"{name.replace('_', ' ')}: {len(views)} pictures")
        chosen = frozenset(view.pose_index for view in some_poses(views, few)) if apart and few else frozenset()
        images = score_images(
            views, truth, drawer.draw, f"{name} pictures", t_pose_apart=apart, perceive=perceive, few=chosen,
            raster=drawer.raster, ours=own_views,
        )  # fmt: skip
        kept = [i for i, view in enumerate(views) if not (apart and is_t_pose(view))]
        moving = [views[i] for i in kept]
        placements = same_poses(moving) if ours is None else fitted_poses(moving, [own_views[i] for i in kept])
        print_stage(f"{name.replace('_', ' ')}: {len(placements)} posed surfaces")
        distances = measure_poses(what, placements, chosen, f"{name} surfaces", beside=apart)
        out[name] = regions_of(distances.ours, images.scored)
        out[name].setdefault("eyes", without_eyes(NO_EYES))
        if apart and few:
            out["few_poses"] = {"poses": len(chosen), **regions_of(distances.few, images.few)}
        if apart:
            beside["aligned"] = regions_of(distances.aligned)
            beside |= zero_steps(what, distances)
            beside["own_weights"] = None if what.own is None else regions_of(distances.own)
            beside["poses"] = len(placements)
            if ours is not None and template is not None:
                seen = [(p.truth, own) for p in placements for part, own in p.ours.items() if "total" in part]
                posed = posed_skeletons([own for _, own in seen], [true for true, _ in seen], template.joints,
                                        truth.joints)  # fmt: skip
                beside["fitted"] = {"total": round(joints_off(posed, LIMBS, aligned=False), 3)}
            beside["stretched_at_hair"] = stretched_at_hair(truth, surface, [own_views[i] for i in kept])
            away = skin_to_surface(truth, surface.vertices, surface.faces) if ours is None else None
            beside["skin_beside_hair_to_surface_cm"] = None if away is None else round(100 * away, 4)
            if images.t_pose:
                beside["t_pose_frames"] = regions_of({}, images.t_pose)
    if videos is not None:
        joints = surface.joints if template is None else template.joints
        beside |= in_filmed_poses(replace(what, own=None, apart=True), videos, joints)
    out["baked_vs_field"] = baked_vs_field_of(drawer)
    out["beside"] = beside
    return out


def in_filmed_poses(what: Measured, videos: FilmedPoses, joints: np.ndarray) -> dict[str, Any]:
    """The rows of the person's own videos, each region aligned by itself; `joints` are our skeleton's, pose 0."""
    if not videos.by_part:
        return {"filmed": None, "filmed_reason": videos.reason}
    placements = videos.some().placements()
    print_stage(f"the person's own videos: {len(placements)} posed surfaces")
    distances = measure_poses(what, placements, frozenset(), "filmed surfaces", beside=True)
    rows = {
        "filmed": distances.ours,
        "filmed_aligned": distances.aligned,
        "filmed_zero_steps": distances.template,
        "filmed_zero_steps_aligned": distances.template_aligned,
    }
    if what.template is None:
        rows = {name: row for name, row in rows.items() if "zero_steps" not in name}
    return {
        **{name: regions_of(row) for name, row in rows.items()},
        **in_filmed_skeletons(videos, joints, what.truth.joints),
        "filmed_frames": {part: len(found) for part, found in videos.some().by_part.items()},
    }


def in_filmed_skeletons(videos: FilmedPoses, joints: np.ndarray, true_joints: np.ndarray) -> dict[str, Any]:
    """Limb joints of the body's video, fingers of the hands' own, in all frames: cm and degrees."""
    posed = {}
    for part, found in videos.by_part.items():
        ours = [own for placement in found for own in placement.ours.values()]
        posed[part] = posed_skeletons(ours, [placement.truth for placement in found], joints, true_joints)
    body, hands = posed["body"], [(posed[part], which) for part, which in HANDS.items()]
    of_hands = lambda measure: round(float(np.mean([measure(*hand) for hand in hands])), 3)
    return {
        "filmed_joints": {
            "total": round(joints_off(body, LIMBS, aligned=False), 3),
            "hands": of_hands(lambda hand, which: joints_off(hand, which, aligned=False)),
        },
        "filmed_joints_aligned": {
            "total": round(joints_off(body, LIMBS, aligned=True), 3),
            "hands": of_hands(lambda hand, which: joints_off(hand, which, aligned=True)),
        },
        "filmed_degrees": {
            "total": round(turned_off(body, BODY), 3),
            "hands": of_hands(lambda hand, which: turned_off(hand, which[1:])),
        },
    }


def zero_steps(what: Measured, distances: PoseDistances) -> dict[str, Any]:
    """The row of the template before training: it has a surface and no colors."""
    if what.template is None:
        return {"zero_steps": None, "zero_steps_reason": "the avatar file holds no template; give --run"}
    return {
        "zero_steps": regions_of(distances.template),
        "zero_steps_aligned": regions_of(distances.template_aligned),
        "zero_steps_reason": "a template has no colors before training: no pictures",
    }


def measured_ceiling(
    drawer: Drawer,
    capture: Path,
    facts: dict[str, Any],
    truth: TrueMesh,
    views: list[HeldOutView],
    perceive: Perceive | None,
) -> dict[str, Any]:
    """Novel poses of the true mesh under our weights: pictures and distances."""
    print_stage(f"the ceiling: {len(views)} pictures and their poses")
    best = CeilingDrawer(drawer.raster, capture, facts, truth)
    images = score_images(
        views, truth, best.draw, "ceiling pictures", t_pose_apart=True, perceive=perceive, raster=drawer.raster
    )
    case = geometry_case(truth, best.surface, truth.visible)
    distances = {region: Distances() for region in SAMPLES}
    for view in progress(distinct_poses([v for v in views if not is_t_pose(v)]), "ceiling surfaces"):
        pose = view.axis_angle, view.root
        measure_pose(case, posed_pair(case, truth.posed(*pose), best.surface.posed(*pose)), distances)
    return regions_of(distances, images.scored)


def stretched_at_hair(truth: TrueMesh, surface: PosableSurface, poses: list[HeldOutView]) -> dict[str, int] | None:
    """Edges of the reconstruction at hair, and how many of them a pose stretches to more than twice their length;
    None: nobody's hair."""
    edges = edges_at_hair(truth, surface.vertices, surface.faces)
    if not len(edges):
        return None
    posed = (surface.posed(view.axis_angle, view.root) for view in poses)
    return {"edges": len(edges), "stretched": stretched_edges(edges, surface.vertices, posed)}


def measure_once(what: Measured, axis_angle: np.ndarray, root: np.ndarray) -> dict[str, Distances]:
    """One pose of both; an estimated skeleton, whose pelvis is elsewhere, after rigid ICP."""
    into, case = {region: Distances() for region in SAMPLES}, what.case
    pair = posed_pair(case, case.truth.posed(axis_angle, root), case.surface.posed(axis_angle, root))
    T = alignment(case, pair) if what.apart else None
    measure_pose(case, pair, into, every=BESIDE, truth_from_surface=T)
    return into


def baked_vs_field_of(drawer: Drawer) -> dict[str, Any]:
    """What the bake measured against its field, from the avatar's provenance; null for a run."""
    if drawer.avatar is None:
        return {"paper_db": None, "network_db": None, "reason": "a run is not baked; evaluate its avatar"}
    found = find_key(drawer.provenance, "paper_db")
    if found is None:
        return {"paper_db": None, "network_db": None, "reason": "the avatar file does not say; give --run"}
    network = found.get("network_db", (found.get("cone_db") or {}).get("network"))
    return {"paper_db": found["paper_db"], "network_db": network}


def find_key(tree: Any, key: str) -> dict[str, Any] | None:
    """The first dictionary, at any depth, that has `key`."""
    if isinstance(tree, dict):
        if key in tree:
            return tree
        for value in tree.values():
            found = find_key(value, key)
            if found is not None:
                return found
    return None


@dataclass(frozen=True)
class EvalCommand:
    """`selfscan eval`."""

    subject: Annotated[Path, Option(positional=True, metavar="RUN_OR_AVATAR"), "run folder, or avatar file (.glb)"]
    capture: Annotated[
        Path,
        Option(positional=True, metavar="CAPTURE"),
        "capture folder with truth/ (selfscan synth), or of a raw scan (synth --raw --keypoints)",
    ]
    json: Annotated[Path | None, Option(metavar="FILE"), "write every number here as well"] = None
    markdown: Annotated[Path | None, Option(metavar="FILE"), "write the table here as Markdown"] = None
    ceiling: Annotated[bool, "also score the true mesh under our skin weights: the best to be had"] = False
    poses: Annotated[int | None, AtLeast(1), "a quick look: only N poses of each set"] = None
    lpips: Annotated[
        tuple[Path, ...],
        Option(metavar="FILE", several=True),
        "LPIPS's weights, which are not shipped: one file of the whole network's state dictionary, or torchvision's "
        "AlexNet and the lpips package's linear layers (bench/lpips.py says how)",
    ] = ()
    run: Annotated[
        Path | None,
        Option(metavar="RUN"),
        "run the avatar was baked from: measures again what the file says was lost, and on held-out pictures; avatars "
        "from pixels need it, since their poses are fitted to those pictures with its template",
    ] = None


EVAL = Help(
    "selfscan eval",
    """Measure a trained run or a baked avatar against the ground truth of a synthetic capture: P2S and Chamfer (cm),
PSNR, SSIM, FLIP for head, hands and the whole person, novel poses and views; of an avatar every view mode side by
side. What comes from raw videos is measured against the folder of `synth --raw --keypoints`: its poses are fitted to
the held-out pictures, never told.""",
    "example: selfscan eval out/run out/capture --json quality.json",
)


def eval_main(argv: list[str]) -> int:
    """`selfscan eval RUN_OR_AVATAR CAPTURE [--json FILE]`."""
    command = parse(EvalCommand, argv, EVAL)
    if not command.subject.exists():
        raise AssetError(f"{command.subject}: expected a run folder or an avatar file, found nothing")
    for output in filter(None, (command.json, command.markdown)):
        check_file(output)
    result = evaluate(
        command.subject,
        command.capture,
        ceiling=command.ceiling,
        poses=command.poses,
        run=command.run,
        lpips=list(command.lpips),
    )
    print_table(result)
    if command.json:
        with whole_file(command.json, "w") as file:
            json.dump(result, file, indent=1)
    if command.markdown:
        with whole_file(command.markdown, "w") as file:
            file.write(markdown(result))
    return 0
