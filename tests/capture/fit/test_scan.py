"""Four small videos of a known person become a person, and masks that are too large, too small or elsewhere."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage

from avatar.rotation import matrix_from_axis_angle
from avatar.skeleton import JOINTS, PARTS, joint_transforms
from capture.fit import body, hand, head, outline
from capture.fit.focal import Focal, focal_of_videos
from capture.fit.footage import Estimate
from capture.fit.masks import believed_offset, edge_by_colors, regrown, signed_pixels
from capture.fit.outline import placement
from capture.fit.pixels import compare_pixels
from capture.fit.scan import FOCAL, GUESSED, WRITTEN, fit_scan, footage_in, phone_of, tracked_in
from capture.fit.solve import posed_frames
from capture.fit.trunk import SHOULDERS
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
        names = (*head.NAMES, *SHOULDERS) if part == "head" else hand.hand_names(part.removeprefix("hand_"))
        videos[part] = video_of(close_up(truth, part), names, part, focal)
    return truth, RawScan(videos)


@pytest.mark.slow
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
    # whose shoulders are seen under the head; the hands' videos have the whole pose
    trunk = fitted.videos["head"].trunk
    assert trunk is not None and trunk.shape == (FRAMES, 52, 3) and np.abs(trunk[:, [12, 15]]).max() < np.radians(25)
    assert close.trunk is None
    assert len(fitted.landmarks) >= 6
    nose, vertex = fitted.landmarks["nose_tip"]
    np.testing.assert_array_equal(nose, fitted.template.vertices[vertex])


def test_a_video_without_hand_points_is_refused_and_the_phones_lens_is_begun_with(filmed):
    _, scan = filmed
    one = scan.videos["body"]
    blind = replace(one.keypoints, confidence=np.zeros_like(one.keypoints.confidence))
    with pytest.raises(AssetError, match="body video: keypoints should show 6 points"):
        fit_scan(RawScan({**scan.videos, "body": replace(one, keypoints=blind)}))
    assert phone_of(scan.videos.values()) == Focal(FOCAL, GUESSED)
    written = {part: replace(video, focal_written=1.3 * SIZE) for part, video in scan.videos.items()}
    found = phone_of(written.values())
    assert found.shorter_sides == pytest.approx(1.3) and found.sigma == WRITTEN < GUESSED


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


@pytest.mark.parametrize("pixels", [-3.0, -1.4, 1.4, 3.0])
def test_a_disc_regrown_is_a_disc_of_another_radius(pixels):
    y, x = np.mgrid[:64, :64] + 0.5
    away = np.hypot(x - 32, y - 32)
    grown = regrown((away < 15)[None], pixels)[0]
    assert (grown != (away < 15 + pixels))[abs(away - 15 - pixels) > 1].sum() == 0


@pytest.mark.parametrize("full", [True, False])
def test_masks_without_an_edge_have_no_distance_and_stay_as_they_are(full):
    mask = np.full((20, 20), full)
    assert (signed_pixels(mask[None]) == (-np.inf if full else np.inf)).all()
    found, unsure = edge_by_colors(np.zeros((20, 20, 3), np.uint8), mask, -2.0, np.zeros_like(mask))
    assert np.array_equal(found, mask) and not unsure.any()


def test_clothes_are_no_fault_of_masks_and_a_limb_not_in_the_picture_stays_unsure():
    assert believed_offset({"body": 4.0, "hand_left": 0.2, "hand_right": 0.3}) == 0
    assert believed_offset({"body": -1.7, "hand_left": -1.5, "hand_right": -1.4}) == -1.5
    person, image = _picture("black")
    limb = np.zeros_like(person)
    limb[5:9, 60:70] = True  # the template's, on black
    found, unsure = edge_by_colors(image, _off(person, -2), -2.0, limb)
    assert not found[limb].any() and unsure[limb].all()
    seen = blob(25.3, 20)
    seen[:6, :6] += 5.0
    found = compare_pixels(blob(25, 20), seen, (ROWS.ravel(), COLUMNS.ravel()), 0.2)
    assert found.weight.reshape(ROWS.shape)[:6, :6].max() < 1e-5
    np.testing.assert_allclose(solved(found), (0.3, 0.0), atol=0.02)


def _picture(background: str):
    """A person: two legs five pixels apart, and a finger three pixels wide; light cloth before a background."""
    rng = np.random.default_rng(3)
    person = np.zeros((80, 80), bool)
    person[10:40, 20:50] = True
    person[40:75, 20:32] = person[40:75, 37:50] = True
    person[20:23, 50:62] = True
    cloth = 0.75 + 0.05 * rng.standard_normal((80, 80, 3))
    rough = ndimage.gaussian_filter(rng.random((80, 80, 3)), (4, 4, 0))
    rough = 0.45 * (rough - rough.min()) / (rough.max() - rough.min())
    behind = {"black": np.zeros((80, 80, 3)), "rough": rough, "cloth": cloth}[background]
    image = np.where(person[..., None], cloth, behind)
    return person, (255 * image.clip(0, 1)).astype(np.uint8)


def _off(mask, pixels):
    y, x = np.mgrid[-3:4, -3:4]
    disc = x * x + y * y <= pixels**2
    return ndimage.binary_dilation(mask, disc) if pixels > 0 else ndimage.binary_erosion(mask, disc, border_value=1)


@pytest.mark.parametrize("background", ["black", "rough"])
@pytest.mark.parametrize("pixels", [-2, 2])
def test_the_edge_is_where_the_colours_change(background, pixels):
    """Where the template knows of the finger, the picture gives it back; regrown masks have lost it."""
    person, image = _picture(background)
    given = _off(person, pixels)
    limb = np.asarray(ndimage.binary_dilation(person), bool) if pixels < 0 else np.zeros_like(person)
    found, unsure = edge_by_colors(image, given, 0.9 * pixels, limb)
    assert (found != person).sum() < 0.1 * (given != person).sum()
    assert ((found != person) & ~unsure).sum() < 0.04 * (given != person).sum()
    assert (found[20:23, 52:62] == (True if pixels < 0 else person[20:23, 52:62])).mean() > 0.9
    grown = regrown(given[None], -0.9 * pixels)[0]
    assert (grown != person).sum() > 2 * (found != person).sum()


@pytest.mark.parametrize("pixels", [-2.0, 2.0])
def test_where_colours_say_nothing_the_offset_does_and_the_rim_is_unsure(pixels):
    person, image = _picture("cloth")
    given = _off(person, pixels)
    found, unsure = edge_by_colors(image, given, pixels, np.zeros_like(person))
    straight = np.s_[45:70, 8:26]  # the outer side of a leg
    assert np.abs(signed_pixels(person[None])[0][straight][found[straight] != person[straight]]).max(initial=0) <= 1.5
    assert unsure[straight].any(1).mean() > 0.9  # of the rows; in few the walk turns just between two pixels
    assert not unsure[signed_pixels(given[None])[0] * np.sign(pixels) > 1].any()  # what the mask itself rules out


@pytest.mark.parametrize("value", [0, 200])
def test_a_picture_of_one_colour_leaves_the_rim_unsure_and_the_mask_as_it_was_told(value):
    person = np.zeros((40, 40), bool)
    person[12:28, 12:28] = True
    found, unsure = edge_by_colors(np.full((40, 40, 3), value, np.uint8), person, -2.0, np.zeros_like(person))
    away = signed_pixels(person[None])[0]
    assert found[person].all() and not (found | unsure)[away > 3].any()
    assert unsure.any() and (away[found] < 2.5).all()


def silhouette() -> np.ndarray:
    """On a canvas three times 64 x 48: a bar with a foot to one side, so that every turn and shift shows."""
    canvas = np.zeros((192, 144), bool)
    canvas[76:116, 68:76] = True
    canvas[108:116, 68:92] = True
    return canvas


def test_a_silhouette_in_place_stays_and_is_not_resampled(monkeypatch):
    """At 0 degrees the template itself is correlated: resampled it would be the same, at the cost of a turn."""
    turned = []
    affine = ndimage.affine_transform
    monkeypatch.setattr(outline.ndimage, "affine_transform", lambda *a, **k: turned.append(a) or affine(*a, **k))
    template = silhouette()
    turn, shift = placement(template, template[64:128, 48:96], np.array([72.0, 96.0]), 20.0)
    assert turn == 0 and shift.tolist() == [0, 0]
    assert len(turned) == 4


PLACES = [((0, 0), -16.0), *((shift, turn) for turn in (0.0, 8.0) for shift in ((0, 0), (40, -20), (-60, 30)))]


@pytest.mark.parametrize(("shift", "degrees"), PLACES)
def test_a_silhouette_is_placed_where_it_was_taken_from(shift, degrees):
    h = w = 96
    y, x = np.mgrid[: 3 * h, : 3 * w] + 0.5
    limb = lambda x, y: (abs(x - 144) < 8) & (abs(y - 150) < 30) | (abs(x - 155) < 15) & (abs(y - 130) < 6)
    centre = np.array([144.0, 150.0])
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    back_x, back_y = x - centre[0] - shift[0], y - centre[1] - shift[1]
    moved = limb(c * back_x + s * back_y + centre[0], -s * back_x + c * back_y + centre[1])
    turn, found = placement(limb(x, y), moved[h : 2 * h, w : 2 * w], centre, 1000.0)
    assert abs(np.degrees(turn) - degrees) < 1e-9
    np.testing.assert_allclose(found, shift, atol=2 if degrees else 0)


ROWS, COLUMNS = np.mgrid[:40, :50]


def blob(x, y):
    return np.exp(-((COLUMNS + 0.5 - x) ** 2 / 50 + (ROWS + 0.5 - y) ** 2 / 80))


def solved(found):
    A = found.slope * found.weight[:, None]
    return np.linalg.solve(A.T @ found.slope, A.T @ found.residual)


@pytest.mark.parametrize("move", [(0.0, 0.0), (0.3, -0.2), (-0.1, 0.4)])
def test_a_small_move_is_found(move):
    found = compare_pixels(blob(25, 20), blob(25 + move[0], 20 + move[1]), (ROWS.ravel(), COLUMNS.ravel()), 10.0)
    np.testing.assert_allclose(solved(found), move, atol=0.02)
    assert (found.cost == 0) == (move == (0.0, 0.0))
