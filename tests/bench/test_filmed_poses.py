"""Poses of a person's own videos beside the truth: a striped person, filmed in one world and told in another."""

import json
import shutil

import numpy as np
import pytest
from PIL import Image

from avatar.camera import Camera, look_at, write_cameras
from avatar.rotation import axis_angle_from_matrix, matrix_from_axis_angle
from avatar.skeleton import JOINTS, PARTS
from bench.score.filmed_poses import filmed_poses
from bench.score.pose_distances import JudgedSurfaces
from bench.score.quality import in_filmed_poses, seen_case, template_surface
from bench.score.quality_table import table_rows
from bench.score.true_mesh import read_true_mesh
from capture.folder import read_subject
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
    assert [p.truth.pose_index for p in found.some().by_part["hand_left"]] == TAKEN[[0, 1, 3, 4]].tolist()
    for part, placements in found.by_part.items():
        assert [placement.truth.pose_index for placement in placements] == TAKEN.tolist()
        for placement in placements:
            (ours,) = placement.ours.values()
            np.testing.assert_allclose(ours.root, placement.truth.root, atol=1e-12)
            joints = slice(0, 22) if part == "body" else slice(0, 52)
            np.testing.assert_allclose(ours.axis_angle[joints], placement.truth.axis_angle[joints], atol=1e-9)


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


def test_what_is_not_at_hand_is_said(imported, measuring):
    run, facts, scan = imported
    assert filmed_poses(None, {}, scan).reason == "the avatar file holds no videos; give --run"
    assert "does not say where" in filmed_poses(run, {}, scan).reason
    assert "is not at" in filmed_poses(run, {"capture_at": {"folder": "../capture", "digest": "x"}}, scan).reason
    gone = filmed_poses(run, facts, scan / "elsewhere")
    assert "no truth of the videos' frames" in gone.reason
    row = in_filmed_poses(measuring[0], gone, measuring[1])
    assert row == {"filmed": None, "filmed_reason": gone.reason}


def test_frames_of_another_scan_are_refused(imported):
    run, facts, scan = imported
    path = scan / "truth" / "body" / "video.npz"
    with np.load(path) as data:
        fields = dict(data)
    np.savez(path, **{**fields, "poses": fields["poses"][:8], "root": fields["root"][:8]})
    with pytest.raises(AssetError, match="frames should be of 8 filmed ones, are 6 up to number 11"):
        filmed_poses(run, facts, scan)
