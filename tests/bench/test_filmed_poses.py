"""Poses of a person's own videos, and those found in held-out pictures, beside the truth of a striped person."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from avatar.camera import Camera, look_at, write_cameras
from avatar.gltf.avatar_file import read_avatar, write_avatar
from avatar.rotation import axis_angle_from_matrix, matrix_from_axis_angle
from avatar.skeleton import JOINTS, PARTS, joint_transforms
from bench.score.filmed_poses import filmed_poses
from bench.score.fitted_poses import fitted_views
from bench.score.pose_distances import JudgedSurfaces
from bench.score.quality import (
    Evaluated,
    evaluate,
    in_filmed_poses,
    measured,
    seen_case,
    template_of_run,
    template_surface,
)
from bench.score.quality_table import table_rows
from bench.score.trained_outline import TrainedOutline
from bench.score.true_mesh import read_true_mesh
from capture.folder import input_kind, read_subject
from capture.held_out import read_held_out
from command.errors import AssetError
from train.session import capture_place

SIZE = (24, 24)
K = np.array([[20.0, 0, 12], [0, 20, 12], [0, 0, 1]])
FILMED = 12
# frames of the twelve that an import took
TAKEN = np.array([1, 2, 5, 6, 9, 11])
WORLD = matrix_from_axis_angle(np.array([0.1, 0.6, -0.2])), np.array([0.3, -0.4, 0.2])


def poses(part):
    """Every frame another pose: the person turns and bends an elbow."""
    axis_angle = np.zeros((FILMED, 52, 3))
    axis_angle[:, 0, 1] = np.linspace(-2, 2, FILMED)
    axis_angle[:, JOINTS.index("left_elbow"), 1] = np.linspace(-1, 0, FILMED) - 0.1 * PARTS.index(part)
    return axis_angle, np.tile([0.1, 0.0, 0.0], (FILMED, 1))


def write_scan(folder, camera):
    for part in ("body", "hand_left", "hand_right"):
        (folder / "truth" / part).mkdir(parents=True)
        axis_angle, root = poses(part)
        np.savez(folder / "truth" / part / "video.npz", poses=axis_angle, root=root, K=camera.K,
                 camera_from_world=camera.camera_from_world, size=np.array(SIZE))  # fmt: skip


def write_capture(folder, camera, subject):
    """What an import says of the frames TAKEN, in a world of its own; pictures are grey."""
    shutil.copy(subject, folder / "subject.npz")
    R, t = WORLD
    moved = np.eye(4)
    moved[:3, :3], moved[:3, 3] = R, t  # theirs from the truth's
    own = Camera(camera.K, camera.camera_from_world @ np.linalg.inv(moved), SIZE)
    for part in PARTS:
        for kind, color in (("images", (90, 90, 90)), ("masks", 255)):
            (folder / part / kind).mkdir(parents=True)
            for i in range(len(TAKEN)):
                Image.new("L" if kind == "masks" else "RGB", SIZE, color).save(folder / part / kind / f"{i:06d}.png")
        write_cameras(folder / part / "cameras.npz", [own] * len(TAKEN))
        if part == "head":
            points = {str(i): [0.01 * i, 0.0, 0.0] for i in range(6)}
            marks = {"points": points, "vertices": {name: int(name) for name in points}}
            (folder / part / "landmarks.json").write_text(json.dumps(marks))
            continue
        axis_angle, root = (array[TAKEN].copy() for array in poses(part))
        axis_angle[:, 0] = axis_angle_from_matrix(R @ matrix_from_axis_angle(axis_angle[:, 0]))
        if part == "body":  # nobody sees fingers in the body's video
            axis_angle[:, 22:] = 0.4
        np.savez(folder / part / "poses.npz", poses=axis_angle.reshape(len(TAKEN), -1), trans=root @ R.T + t)
    facts = {"format": "selfscan-capture", "version": 1, "parts": list(PARTS), "source": "video",
             "frame_numbers": {part: TAKEN.tolist() for part in PARTS}}  # fmt: skip
    (folder / "capture.json").write_text(json.dumps(facts))


@pytest.fixture
def imported(oracle, tmp_path):
    """(run folder, its run.json, scan)"""
    capture, _, _ = oracle
    camera = Camera(K, look_at(np.array([0.0, 0, 3]), np.zeros(3)), SIZE)
    scan, run = tmp_path / "scan", tmp_path / "run"
    (tmp_path / "capture").mkdir()
    run.mkdir()
    write_scan(scan, camera)
    write_capture(tmp_path / "capture", camera, capture / "subject.npz")
    return run, {"capture_at": capture_place(tmp_path / "capture", run)}, scan


@pytest.fixture(scope="module")
def measuring(oracle, drawer):
    truth, template = read_true_mesh(oracle[0]), read_subject(oracle[0] / "subject.npz")
    found, start = (seen_case(drawer, truth, surface) for surface in (drawer.surface, template_surface(template)))
    return JudgedSurfaces(found, start, None, apart=True), template.joints


def test_frames_that_an_import_took_are_found_in_the_truth_and_in_its_world(imported):
    run, facts, scan = imported
    found = filmed_poses(run, facts, scan)
    assert found.reason == ""
    assert [p.truth.pose_index for p in found.some()["hand_left"]] == TAKEN[[0, 1, 3, 4]].tolist()
    for part, placements in found.by_part.items():
        assert [placement.truth.pose_index for placement in placements] == TAKEN.tolist()
        for placement in placements:
            (ours,) = placement.ours.values()
            np.testing.assert_allclose(ours.root, placement.truth.root, atol=1e-12)
            joints = slice(0, 22) if part == "body" else slice(0, 52)
            np.testing.assert_allclose(ours.axis_angle[joints], placement.truth.axis_angle[joints], atol=1e-9)


@pytest.mark.slow
def test_a_perfect_avatar_in_exact_poses_has_no_distance_and_hands_are_those_of_their_own_videos(imported, measuring):
    """Fingers of the body's video are bent wrongly here; only the total holds that."""
    result = in_filmed_poses(measuring[0], filmed_poses(*imported), measuring[1])
    for row in ("filmed", "filmed_aligned", "filmed_zero_steps", "filmed_zero_steps_aligned"):
        assert result[row]["head"]["p2s_cm"] < 0.03 and result[row]["hands"]["p2s_cm"] < 0.03
        assert 0.02 < result[row]["total"]["p2s_cm"] < 0.5
    for row in ("filmed_joints", "filmed_joints_aligned", "filmed_degrees"):
        assert result[row]["total"] < 1e-6 and result[row]["hands"] < 1e-6
    assert result["filmed_frames"] == {"body": 6, "hand_left": 4, "hand_right": 4}
    empty = {"novel_pose": {"head": {}}, "novel_view": {}, "beside": result, "input": "from pixels"}
    assert {"poses of the person's own videos: total", "own videos, ICP-aligned: head"} <= {
        row[0] for row in table_rows(empty)
    }


@pytest.mark.slow
def test_a_person_too_far_from_the_camera_is_off_in_place_and_not_aligned(imported, measuring):
    run, facts, scan = imported
    for path in (run.parent / "capture").glob("*/cameras.npz"):
        with np.load(path) as data:
            fields = dict(data)
        fields["camera_from_world"] = fields["camera_from_world"] + [[0] * 4, [0] * 4, [0, 0, 0, 0.03], [0] * 4]
        np.savez(path, **fields)
    facts = {"capture_at": capture_place(run.parent / "capture", run)}
    result = in_filmed_poses(measuring[0], filmed_poses(run, facts, scan), measuring[1])
    assert result["filmed_joints"]["total"] == pytest.approx(3.0, abs=1e-3)
    assert result["filmed_joints_aligned"]["total"] < 1e-6 and result["filmed_degrees"]["total"] < 1e-6
    for region in ("head", "hands"):
        assert result["filmed"][region]["p2s_cm"] > 0.5
        # ICP slides a round head slowly
        assert result["filmed_aligned"][region]["p2s_cm"] < 0.3 * result["filmed"][region]["p2s_cm"]


def test_frames_that_refinement_left_out_are_no_part_and_refined_poses_count(imported):
    run, facts, scan = imported
    kept = np.array([0, 3, 4])
    axis_angle, root = poses("hand_left")
    np.savez(run / "refined_hand_left.npz", frames=kept, masks_off=np.float64(0), axis_angle=axis_angle[TAKEN[kept]],
             root=root[TAKEN[kept]] + 1)  # fmt: skip
    found = filmed_poses(run, facts, scan).by_part["hand_left"]
    assert [placement.truth.pose_index for placement in found] == TAKEN[kept].tolist()
    shift = [next(iter(p.ours.values())).root - p.truth.root for p in found]
    assert np.linalg.norm(shift, axis=1).min() > 0.5


def test_what_is_not_at_hand_is_said_and_frames_of_another_scan_are_refused(imported, measuring):
    run, facts, scan = imported
    assert filmed_poses(None, {}, scan).reason == "the avatar file holds no videos; give --run"
    assert "does not say where" in filmed_poses(run, {}, scan).reason
    assert "is not at" in filmed_poses(run, {"capture_at": {"folder": "../capture", "digest": "x"}}, scan).reason
    gone = filmed_poses(run, facts, scan / "elsewhere")
    assert "no truth of the videos' frames" in gone.reason
    row = in_filmed_poses(measuring[0], gone, measuring[1])
    assert row == {"filmed": None, "filmed_reason": gone.reason}
    path = scan / "truth" / "body" / "video.npz"
    with np.load(path) as data:
        fields = dict(data)
    np.savez(path, **{**fields, "poses": fields["poses"][:8], "root": fields["root"][:8]})
    with pytest.raises(AssetError, match="frames should be of 8 filmed ones, are 6 up to number 11"):
        filmed_poses(run, facts, scan)


SEEN = {
    "body": [JOINTS.index(f"{side}_{name}") for side in ("left", "right") for name in ("hip", "elbow", "knee")],
    "head": [JOINTS.index("head")],
    "hand_left": list(range(22, 37)),
    "hand_right": list(range(37, 52)),
}


@pytest.fixture(scope="module")
def fits(oracle):
    """Template, held-out views of one novel pose, and these as fitted without knowing the pose."""
    capture, _, _ = oracle
    template = read_subject(capture / "subject.npz")
    views = [view for view in read_held_out(capture, "novel_pose") if view.pose_index == 0]
    untold = [replace(view, axis_angle=np.zeros((52, 3)), root=np.zeros(3)) for view in views]
    return template, views, fitted_views(template, {"novel_pose": untold})["novel_pose"]


@pytest.mark.parametrize(("part", "near"), [("body", 0.1), ("head", 0.025), ("hand_left", 0.02), ("hand_right", 0.02)])
def test_each_picture_places_what_it_shows_without_being_told_the_pose(fits, part, near):
    """Limbs that point at the camera are foreshortened: the body view knows them worst."""
    template, views, fitted = fits
    for view, found in zip(views, fitted, strict=True):
        if view.view != part:
            continue
        true = joint_transforms(view.axis_angle, template.joints, view.root)[SEEN[part], :3, 3]
        ours = joint_transforms(found.axis_angle, template.joints, found.root)[SEEN[part], :3, 3]
        assert np.linalg.norm(true - ours, axis=1).mean() < near


def test_the_bodys_view_takes_the_fingers_of_the_close_ups(fits):
    _, views, fitted = fits
    bent = JOINTS.index("left_index1")
    first = {view.view: found for view, found in zip(views, fitted, strict=True)}
    body, close = first["body"], first["hand_left"]
    np.testing.assert_array_equal(body.axis_angle[bent], close.axis_angle[bent])
    assert 0.4 < np.linalg.norm(body.axis_angle[bent]) < 1.2  # .8 radians in truth


@pytest.mark.parametrize(
    ("part", "joint", "left"), [("body", "left_elbow", 0.5), ("hand_left", "left_wrist", 0.7), ("head", "pelvis", 0.5)]
)
def test_the_outline_of_what_was_trained_takes_out_small_turns_and_keeps_depth(oracle, fits, drawer, part, joint, left):
    """From the truth, a joint turned by four degrees in the picture's plane, which moves what hangs from it there."""
    view = next(v for v in read_held_out(oracle[0], "novel_pose") if v.view == part)
    R = matrix_from_axis_angle(view.axis_angle)
    joints = fits[0].joints
    k, axis = JOINTS.index(joint), view.camera.camera_from_world[2, :3]
    inwards = joint_transforms(view.axis_angle, joints, view.root)[k, :3, :3].T @ axis
    R[k] = R[k] @ matrix_from_axis_angle(np.radians(4.0 if part != "head" else 1.0) * inwards)
    turned = replace(view, axis_angle=axis_angle_from_matrix(R))
    found = TrainedOutline(drawer.surface, drawer.raster).refined(turned)
    seen = {"body": "left_wrist", "hand_left": "left_middle3", "head": "head"}[part]
    true, before, after = (
        joint_transforms(v.axis_angle, joints, v.root)[JOINTS.index(seen), :3, 3] for v in (view, turned, found)
    )
    assert np.linalg.norm(after - true) < left * np.linalg.norm(before - true)
    assert abs(axis @ (after - before)) < 0.005


def test_a_hand_that_the_fit_put_outside_its_picture_leaves_the_pose_alone(oracle, fits, drawer):
    """The chest is where the hand was: the picture is full, and none of it is the hand's."""
    view = next(v for v in read_held_out(oracle[0], "novel_pose") if v.view == "hand_left")
    G = joint_transforms(view.axis_angle, fits[0].joints, view.root)[:, :3, 3]
    beside = replace(view, root=view.root + G[JOINTS.index("left_middle1")] - G[JOINTS.index("spine3")])
    found = TrainedOutline(drawer.surface, drawer.raster).refined(beside)
    np.testing.assert_allclose(found.root, beside.root, atol=1e-9)
    turned = np.swapaxes(matrix_from_axis_angle(beside.axis_angle), 1, 2) @ matrix_from_axis_angle(found.axis_angle)
    assert np.abs(axis_angle_from_matrix(turned)).max() < 1e-6


@pytest.fixture(scope="module")
def scored(oracle, fits, drawer):
    template, views, fitted = fits
    truth = read_true_mesh(oracle[0])
    return measured(Evaluated(drawer, truth, {"novel_pose": views}, {"novel_pose": fitted}, template))


@pytest.mark.slow
@pytest.mark.parametrize(("region", "near"), [("head", 0.6), ("hands", 0.8), ("total", 5.0)])
def test_regions_are_measured_where_their_own_picture_has_them_and_aligned_by_themselves(scored, region, near):
    placed, aligned = scored["novel_pose"][region]["p2s_cm"], scored["beside"]["aligned"][region]["p2s_cm"]
    assert 0.01 < placed < near and aligned < placed
    assert aligned < (0.12 if region == "head" else near)


@pytest.mark.slow
def test_the_template_stands_beside_as_it_was_before_training(scored):
    """It is the same body here; its pictures are none, since it has no colors."""
    row = scored["beside"]["zero_steps"]
    for region in ("head", "hands", "total"):
        assert row[region]["p2s_cm"] == pytest.approx(scored["novel_pose"][region]["p2s_cm"], rel=0.25)
        assert "psnr_db" not in row[region]
    assert "no colors" in scored["beside"]["zero_steps_reason"]
    assert scored["beside"]["own_weights"] is None
    assert 0.5 < scored["beside"]["fitted"]["total"] < 10


def test_the_kind_of_input_is_found_and_said(oracle, tmp_path, monkeypatch):
    capture, path, _ = oracle
    avatar = read_avatar(path)
    said = replace(avatar, provenance={**avatar.provenance, "capture": {"input": "from_pixels"}})
    write_avatar(tmp_path / "me.glb", said)
    with pytest.raises(AssetError, match=r"me\.glb: its skeleton was estimated \(from pixels\).*--run RUN"):
        evaluate(tmp_path / "me.glb", capture)
    # a capture is no run, and is refused before poses are fitted
    monkeypatch.setattr("bench.score.quality.fitted_views", None)
    with pytest.raises(AssetError, match=r"run\.json: no such file"):
        evaluate(tmp_path / "me.glb", capture, run=capture)
    assert input_kind({}) == input_kind({"input": "given"}) == "given"
    assert input_kind({"source": "easymocap"}) == "from pixels" and input_kind({"input": "shape_only"}) == "shape only"
    with pytest.raises(AssetError, match="input should be one of given, shape only, from pixels, is 'guessed'"):
        input_kind({"input": "guessed"})


def test_the_template_of_an_avatar_is_its_runs_and_the_papers_row_stands_beside_nothing_given(oracle, drawer, scored):
    assert template_of_run(drawer, None, "given") is None
    assert template_of_run(drawer, oracle[0], "from pixels") is not None
    rows = lambda kind: [row[0] for row in table_rows({**scored, "novel_view": {}, "input": kind})]
    assert "  paper: total" in rows("from pixels") and "  paper: total" in rows("shape only")
    assert "  paper: total" not in rows("given")
    assert "novel pose, 0 steps: the template before training: head" in rows("from pixels")


def test_pictures_without_keypoints_are_refused_by_name(oracle, tmp_path):
    capture, _, _ = oracle
    shutil.copytree(capture / "truth", tmp_path / "truth", ignore=shutil.ignore_patterns("keypoints"))
    views = read_held_out(tmp_path, "novel_pose")
    with pytest.raises(AssetError, match=r"000000_body\.json: expected keypoints .* found none.*synth --raw --keyp"):
        fitted_views(read_subject(capture / "subject.npz"), {"novel_pose": views})


@pytest.mark.slow
def test_the_folder_of_a_raw_scan_holds_the_truth(oracle, tmp_path):
    """No capture.json lies there: what was filmed stands in truth/raw.json."""
    capture, path, _ = oracle
    raw = {"format": "selfscan-raw-truth", "subject": "striped", "light": "even", "seed": 0, "size": 224}
    shutil.copytree(capture / "truth", tmp_path / "truth")
    (tmp_path / "truth" / "raw.json").write_text(json.dumps(raw))
    result = evaluate(path, tmp_path, poses=1)
    assert result["input"] == "given" and result["capture"]["subject"] == "striped"
    assert result["novel_pose"]["head"]["p2s_cm"] < 0.03
