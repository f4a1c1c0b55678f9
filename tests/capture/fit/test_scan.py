"""Four small videos of a known person become a person: the whole path."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from avatar.rotation import matrix_from_axis_angle
from avatar.skeleton import JOINTS, PARTS, joint_transforms
from capture.fit import body, hand, head
from capture.fit.focal import Focal, focal_of_videos
from capture.fit.footage import Estimate
from capture.fit.scan import FOCAL, GUESSED, WRITTEN, fit_scan, footage_in, phone_of, tracked_in
from capture.fit.solve import posed_frames
from capture.keypoints.record import Keypoints
from capture.raw.scan import RawScan, RawVideo
from command.errors import AssetError
from tests.turning_twin import in_clothes, pictured, turning_twin

FRAMES, SIZE = 7, 128
# metres from the camera, and what turns before it
NEAR = {"head": 0.9, "hand_left": 0.6, "hand_right": 0.6}


def close_up(truth, part):
    """Head or hand that turns before the camera, the person in the T-pose."""
    turn = 2 * np.pi * np.arange(FRAMES) / FRAMES
    side = part.removeprefix("hand_")
    joint = JOINTS.index("head" if part == "head" else f"{side}_middle1")
    up = np.zeros(3) if part == "head" else np.array([0, 0, np.pi / 2 * (1 if side == "left" else -1)])
    heading = matrix_from_axis_angle(turn[:, None] * [0, 1.0, 0]) @ matrix_from_axis_angle(up)
    root = np.array([0, 0, -NEAR[part]]) - heading @ truth.person.joints(truth.g)[joint]
    angles = np.zeros((FRAMES, 52, 3))
    return replace(truth, mean=angles[0], angles=angles, root=root, heading=heading)


def video_of(truth, names, part, focal):
    """What a detector and a mask tool make of an estimate."""
    rng = np.random.default_rng(PARTS.index(part))
    truth, footage = pictured(truth, names, np.zeros(0, np.int64), size=SIZE, focal=focal)
    pixels, seen = footage.pixels, footage.sure
    if part == "head":
        # no face from behind
        seen = np.where((truth.heading[:, 2, 2] < -0.3)[:, None], 0.0, seen)
    masks = in_clothes(truth, footage, 0.0).masks
    inside = ((pixels > 0) & (pixels < SIZE)).all(2)
    keypoints = Keypoints(names, pixels + 0.2 * rng.standard_normal(pixels.shape), seen * inside, (SIZE, SIZE))
    pictures = (Path("none"),) * FRAMES
    return RawVideo(part, (SIZE, SIZE), 30.0, 10 * np.arange(FRAMES), pictures, masks, keypoints, focal)


@pytest.fixture(scope="module")
def filmed() -> tuple[Estimate, RawScan]:
    twin = turning_twin(FRAMES, SIZE)
    truth, focal = twin.truth, twin.footage.focal
    videos = {"body": video_of(truth, body.body_names(), "body", focal)}
    for part in ("head", "hand_left", "hand_right"):
        names = head.NAMES if part == "head" else hand.hand_names(part.removeprefix("hand_"))
        videos[part] = video_of(close_up(truth, part), names, part, focal)
    return truth, RawScan(videos)


def test_scan_becomes_a_person(filmed, monkeypatch):
    truth, scan = filmed
    # the shortest fit that takes every step
    for module in (body, hand, head):
        monkeypatch.setattr(module, "WEIGHTS", (0.02,))
    monkeypatch.setattr(head, "ROUNDS", 1)
    fitted = fit_scan(scan, sex="male", stature=1.8)
    video = fitted.videos["body"]
    assert video.axis_angle is not None and video.root is not None and video.usable.all()
    limbs = [JOINTS.index(f"left_{name}") for name in ("hip", "knee", "ankle", "shoulder", "elbow", "wrist")]
    for i, frame in enumerate(posed_frames(truth).each):
        M = video.cameras[i].camera_from_world
        ours = (M @ joint_transforms(video.axis_angle[i], fitted.template.joints, video.root[i]))[limbs, :3, 3]
        assert np.linalg.norm(ours - frame.place[limbs] * [1, -1, -1], axis=1).mean() < 0.05
    # stands upright, with its pelvis where the skeleton begins
    assert video.root.mean(0) == pytest.approx(np.zeros(3), abs=1e-9)
    np.testing.assert_allclose(fitted.template.joints[0], 0, atol=1e-12)
    # head and hands lie where their cameras see them
    wrist = JOINTS.index("left_wrist")
    close = fitted.videos["hand_left"]
    assert close.axis_angle is not None and close.root is not None
    there = posed_frames(close_up(truth, "hand_left")).place[:, wrist] * [1, -1, -1]
    here = [camera.camera_from_world @ joint_transforms(pose, fitted.template.joints, root)[wrist]
            for camera, pose, root in zip(close.cameras, close.axis_angle, close.root)]  # fmt: skip
    assert np.median(np.linalg.norm(np.array(here)[:, :3, 3] - there, axis=1)) < 0.04
    assert len(fitted.landmarks) >= 6
    nose, vertex = fitted.landmarks["nose_tip"]
    np.testing.assert_array_equal(nose, fitted.template.vertices[vertex])


def test_video_without_confident_hand_points_is_refused(filmed):
    _, scan = filmed
    one = scan.videos["body"]
    blind = replace(one.keypoints, confidence=np.zeros_like(one.keypoints.confidence))
    with pytest.raises(AssetError, match="body video: keypoints should show 6 points"):
        fit_scan(RawScan({**scan.videos, "body": replace(one, keypoints=blind)}))


@pytest.mark.slow
def test_four_videos_together_tell_the_focal_length(filmed):
    """Each errs by some per cent; all together err less than the guess, and say by how much."""
    truth, scan = filmed
    true = scan.videos["body"].focal / SIZE
    guess = Focal(1.15 * true, GUESSED)
    found = focal_of_videos(truth.person, {part: tracked_in(video, guess) for part, video in scan.videos.items()},
                            lambda note: None)  # fmt: skip
    away = np.log(found.shorter_sides / true)
    assert abs(away) < 0.07 and abs(away) < 3 * found.sigma < 0.3


@pytest.mark.slow
def test_points_of_more_frames_than_are_kept_serve_the_focal_length(filmed):
    _, scan = filmed
    video = scan.videos["body"]
    few = replace(video.keypoints, pixels=video.keypoints.pixels[:3], confidence=video.keypoints.confidence[:3])
    assert len(tracked_in(video, Focal(1.2, 0.1)).pixels) == FRAMES
    tracked = tracked_in(replace(video, track=few, focal=None), Focal(1.2, 0.1))
    assert tracked.pixels.shape[0] == 3 and tracked.focal == pytest.approx(1.2 * SIZE)
    assert tracked.size == footage_in(video, Focal(1.2, 0.1)).size
    # what the user tells stands
    assert footage_in(video, Focal(1.2, 0.1)).focal == video.focal


def test_what_the_phone_wrote_of_its_lens_is_begun_with(filmed):
    _, scan = filmed
    assert phone_of(scan.videos.values()) == Focal(FOCAL, GUESSED)
    written = {part: replace(video, focal_written=1.3 * SIZE) for part, video in scan.videos.items()}
    found = phone_of(written.values())
    assert found.shorter_sides == pytest.approx(1.3) and found.sigma == WRITTEN < GUESSED
