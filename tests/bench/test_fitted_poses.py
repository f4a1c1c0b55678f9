"""Poses of estimated skeletons, found in held-out pictures: the striped person's own body as the template."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from avatar.gltf.avatar_file import read_avatar, write_avatar
from avatar.rotation import axis_angle_from_matrix, matrix_from_axis_angle
from avatar.skeleton import JOINTS, joint_transforms
from bench.score.fitted_poses import fitted_views
from bench.score.quality import Evaluated, evaluate, measured, template_of_run
from bench.score.quality_table import table_rows
from bench.score.trained_outline import TrainedOutline
from bench.score.true_mesh import read_true_mesh
from capture.folder import input_kind, read_subject
from capture.held_out import read_held_out
from command.errors import AssetError

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


def test_the_kind_of_input_is_found_and_said(oracle, tmp_path):
    capture, path, _ = oracle
    avatar = read_avatar(path)
    said = replace(avatar, provenance={**avatar.provenance, "capture": {"input": "from_pixels"}})
    write_avatar(tmp_path / "me.glb", said)
    with pytest.raises(AssetError, match=r"me\.glb: its skeleton was estimated \(from pixels\).*--run RUN"):
        evaluate(tmp_path / "me.glb", capture)
    assert input_kind({}) == input_kind({"input": "given"}) == "given"
    assert input_kind({"source": "easymocap"}) == "from pixels" and input_kind({"input": "shape_only"}) == "shape only"
    with pytest.raises(AssetError, match="input should be one of given, shape only, from pixels, is 'guessed'"):
        input_kind({"input": "guessed"})


def test_the_template_of_an_avatar_is_its_runs(oracle, drawer):
    assert template_of_run(drawer, None, "given") is None
    assert template_of_run(drawer, oracle[0], "from pixels") is not None


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


def test_the_papers_row_stands_beside_nothing_that_was_given(scored):
    rows = lambda kind: [row[0] for row in table_rows({**scored, "novel_view": {}, "input": kind})]
    assert "  paper: total" in rows("from pixels") and "  paper: total" in rows("shape only")
    assert "  paper: total" not in rows("given")
    assert "novel pose, 0 steps: the template before training: head" in rows("from pixels")
