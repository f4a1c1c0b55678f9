"""Poses against keypoints: what follows them passes, what is mirrored or elsewhere is found."""

import json

import numpy as np
import pytest
from painted_capture import write_capture

from avatar.camera import project
from avatar.skeleton import JOINTS, joint_transforms
from capture.check.keypoints import compare_keypoints, keypoint_findings, keypoint_lines
from capture.check.report import examine
from capture.folder import read_capture
from capture.keypoints import openpose
from command.errors import AssetError
from selfscan.__main__ import main


@pytest.fixture(scope="module")
def report(turning):
    return examine(turning)


def written(folder, capture, *, name_of=lambda name: name, shift=0.0, frames=None):
    """OpenPose's files of the body video: its joints as they are projected."""
    video = capture.videos["body"]
    joints = joint_transforms(video.axis_angle, capture.subject.joints, video.root)[:, :, :3, 3]
    (folder / "body").mkdir(parents=True)
    for k in range(len(joints) if frames is None else frames):
        pixels = project(video.cameras[k], joints[k])[0] + shift
        rows = np.zeros((25, 3))
        for row, name in enumerate(openpose.BODY_25):
            if name_of(name) in JOINTS:
                rows[row] = [*(pixels[JOINTS.index(name_of(name))] - 0.5), 0.9]
        content = {"people": [{"pose_keypoints_2d": rows.ravel().tolist()}]}
        (folder / "body" / f"{k:06d}_keypoints.json").write_text(json.dumps(content))
    return folder


def exchanged(name):
    side, _, rest = name.partition("_")
    return {"left": "right", "right": "left"}.get(side, side) + ("_" + rest if rest else "")


def test_poses_that_follow_their_keypoints_are_no_finding(tmp_path, turning, report, within):
    followed = compare_keypoints(turning, written(tmp_path / "a", turning), report)
    within(followed[0].pixels, 1e-6, "px")
    assert followed[0].exchanged == 0 and keypoint_findings(followed) == []
    assert any(line.startswith("body: keypoints 0.0 px") for line in keypoint_lines(followed))


def test_keypoints_of_somewhere_else_are_found(tmp_path, turning, report):
    followed = compare_keypoints(turning, written(tmp_path / "a", turning, shift=25.0), report)
    (finding,) = keypoint_findings(followed)
    assert finding.fatal and "cm off the keypoints" in finding.what
    assert followed[0].pixels == pytest.approx(25 * np.sqrt(2), rel=1e-6)


def test_another_number_of_frames_and_nothing_are_refused(tmp_path, turning, report):
    with pytest.raises(AssetError, match="12 frames, found 5"):
        compare_keypoints(turning, written(tmp_path / "a", turning, frames=5), report)
    with pytest.raises(AssetError, match="expected keypoints in body"):
        compare_keypoints(turning, tmp_path, report)


def test_the_command_compares_prints_and_writes(tmp_path, capsys):
    folder = write_capture(tmp_path / "test", size=32, frames=2)
    points = written(tmp_path / "points", read_capture(folder), name_of=exchanged)
    assert main(["check", str(folder), "--keypoints", str(points), "--json", str(tmp_path / "facts.json")]) == 1
    facts = json.loads((tmp_path / "facts.json").read_text())
    (body,) = facts["keypoints"]
    assert body["part"] == "body" and body["exchanged"] == 1 and body["points"] > 0
    out = capsys.readouterr().out
    assert "body: keypoints" in out and "left and right are exchanged in 100% of the frames" in out
