"""MediaPipe's landmarks and SAM 3D Body's results: limbs keep their directions, hinges and fingers their limits."""

import json
from functools import reduce

import numpy as np
import pytest
from pose_twins import (
    FINGERS,
    LIMBS,
    SIDES,
    J,
    degrees_between,
    directions,
    estimated,
    from_text,
    landmarks,
    natural_poses,
    placed,
    points,
    sam3d_fields,
    world,
)
from refusals import refused

from avatar.body import builtin_body
from avatar.limits import axis_angle_from_joint_angles, joint_angles
from avatar.limits import within as inside
from avatar.motion.clip import rest_skeleton
from avatar.motion.landmark_pose import curl_sign
from avatar.motion.mediapipe import read_mediapipe
from avatar.motion.mhr_rig import NUMBERS
from avatar.motion.read import read_motion
from avatar.motion.sam3d_body import read_sam3d_body
from avatar.rotation import axis_angle_from_matrix, matrix_from_axis_angle
from avatar.skeleton import JOINTS
from command.errors import AssetError

MALE = builtin_body("male").joints


def poses(frames, seed=0):
    """Natural poses without turns of the fingers about themselves, and with collar bones and spine at rest."""
    angles = joint_angles(natural_poses(frames, seed, share=0.6))
    angles[:, 22:, 2] = 0
    angles[:, [J[n] for n in ("spine1", "spine2", "spine3", "neck", "left_collar", "right_collar")]] = 0
    return axis_angle_from_joint_angles(angles)


def frame(body, left=None, right=None, visibility=0.99):
    out = {"pose_world_landmarks": points(body, visibility)}
    for side, hand in (("left", left), ("right", right)):
        if hand is not None:
            out[f"{side}_hand_world_landmarks"] = points(hand)
    return out


def written(path, content, **facts):
    """A file of frames, or of one."""
    path.write_text(json.dumps(facts | {"frames": content if isinstance(content, list) else [content]}))
    return path


@pytest.mark.parametrize("gender", ["male", "female"])
def test_limbs_point_where_the_landmarks_do_and_fingers_as_far_as_they_may(tmp_path, gender, within):
    body = builtin_body(gender)
    pose = poses(8)
    points33, left, right, at = landmarks(pose, body.joints, np.zeros((8, 3)))
    frames = [frame(*k) for k in zip(points33, left, right, strict=True)]
    path = written(tmp_path / "a.json", frames)
    motion = read_motion(path, skeleton=rest_skeleton(body))
    _, mine = placed(motion, body.joints)
    within(degrees_between(directions(mine, LIMBS), directions(at, LIMBS)), 0.05, "degrees")
    within(degrees_between(directions(mine, FINGERS), directions(at, FINGERS)), 3.0, "degrees")
    assert inside(motion.read().axis_angle, 1e-6)[:, 20:].all()


def test_bent_limbs_turn_about_themselves_as_they_did(tmp_path, within):
    """Knees and elbows bent by 60 degrees and more say how thigh and upper arm are turned; palms say it of the hand."""
    angles = joint_angles(poses(6, seed=4))
    hinges = [J[f"{s}_{n}"] for s in SIDES for n in ("knee", "elbow")]
    angles[:, hinges] = [np.radians(75), 0, 0]
    wrists = [J[f"{s}_wrist"] for s in SIDES]
    angles[:, wrists, 2] = 0
    # how a foot is rolled about its length, heel and toe do not say
    angles[:, [J[f"{s}_ankle"] for s in SIDES], 1:] = 0
    pose = axis_angle_from_joint_angles(angles)
    points33, left, right, _ = landmarks(pose, MALE, np.zeros((6, 3)))
    frames = [frame(*k) for k in zip(points33, left, right, strict=True)]
    path = written(tmp_path / "a.json", frames)
    G, _ = world(pose, MALE, np.zeros((6, 3)))
    ours, _ = placed(read_motion(path), MALE)
    turned = [J[f"{s}_{n}"] for s in SIDES for n in ("hip", "knee", "shoulder", "ankle", "wrist")] + [J["head"], 0]
    off = axis_angle_from_matrix(np.swapaxes(G[:, turned], -1, -2) @ ours[:, turned])
    within(np.degrees(np.linalg.norm(off, axis=-1)), 1.5, "degrees")


def test_a_hand_that_is_missing_is_flat_and_impossible_fingers_become_possible(tmp_path):
    pose = poses(2)
    body, left, _, _ = landmarks(pose, MALE, np.zeros((2, 3)))
    path = written(tmp_path / "a.json", [frame(b, hand) for b, hand in zip(body, left, strict=True)])
    motion = read_motion(path)
    clip = motion.read()
    assert not clip.axis_angle[:, 37:].any() and not clip.axis_angle[:, J["right_wrist"]].any()
    assert np.abs(clip.axis_angle[:, 22:37]).max() > 0.1
    assert any("no right hand in the file, flat" in note for note in motion.notes)
    # A finger that is bent back by 90 degrees, as detectors see them, is held by its joints.
    body, left, right, _ = landmarks(np.zeros((1, 52, 3)), MALE, np.zeros((1, 3)))
    for k in (2, 3):
        left[0, 5 + k] = left[0, 5 + k - 1] + [0, -0.03, 0]
    clip = read_motion(written(tmp_path / "a.json", frame(body[0], left[0], right[0]))).read()
    assert inside(clip.axis_angle, 1e-6).all()


def test_results_of_several_people_and_of_one_are_the_same_motion(tmp_path):
    """PoseLandmarker gives a list a person, HolisticLandmarker one list."""
    body, left, right, _ = landmarks(poses(2), MALE, np.zeros((2, 3)))
    one = [frame(body[k], left[k], right[k]) for k in range(2)]
    several = [{key: [value] for key, value in f.items()} for f in one]
    alone = read_motion(written(tmp_path / "one.json", one))
    among = read_motion(written(tmp_path / "several.json", several, fps=25))
    assert alone.rate == 30 and among.rate == 25
    np.testing.assert_array_equal(alone.read().axis_angle, among.read().axis_angle)


def in_picture(body, width, height, focal=1.2, far=4.0):
    """x, y in parts of the picture, z as x; seen from so far that perspective hardly shows."""
    scale = focal / far / 2
    return np.stack([0.5 + scale * body[..., 0] / width, 0.5 + scale * body[..., 1] / height,
                     scale * (body[..., 2] - body[..., 23:25, 2].mean(-1, keepdims=True)) / width], -1)  # fmt: skip


def test_the_root_follows_the_hips_and_hardly_visible_legs_hang_straight(tmp_path, within):
    pose = np.repeat(poses(1), 4, 0)
    steps = np.array([[0, 0, 0], [0.3, 0, 0], [0.3, 0.4, 0], [-0.1, 0.1, 0]])
    body, _, _, at = landmarks(pose, MALE, steps)
    frames = [frame(b) | {"pose_landmarks": points(p)} for b, p in zip(body, in_picture(body, 1.0, 1.5), strict=True)]
    root = read_motion(written(tmp_path / "a.json", frames, image_width=720, image_height=1080)).read().root
    within((root - root[0]) - (at[:, 0] - at[0, 0]), 0.01, "m")
    # of a picture of unknown size nothing is known
    still = read_motion(written(tmp_path / "b.json", frames)).read().root
    assert np.ptp(still[:, 0]) < 1e-9
    with pytest.raises(AssetError, match="no world landmarks"):
        read_motion(written(tmp_path / "c.json", {"pose_landmarks": frames[0]["pose_landmarks"]}))
    body, _, _, _ = landmarks(poses(3), MALE, np.zeros((3, 3)))
    frames = [frame(b) for b in body]
    for one in frames:
        for k in (25, 26, 27, 28, 29, 30, 31, 32):
            one["pose_world_landmarks"][k]["visibility"] = 0.05
    motion = read_motion(written(tmp_path / "a.json", frames))
    legs = [J[f"{s}_{n}"] for s in SIDES for n in ("hip", "knee", "ankle")]
    np.testing.assert_allclose(motion.read().axis_angle[:, legs], 0, atol=1e-9)
    assert any("hardly ever visible" in n and "knee" in n for n in motion.notes)


def test_gaps_are_filled_and_said(tmp_path, within):
    body, left, right, _ = landmarks(np.repeat(poses(1), 30, 0), MALE, np.zeros((30, 3)))
    frames = [frame(*k) for k in zip(body, left, right, strict=True)]
    whole = read_motion(written(tmp_path / "a.json", frames)).read()
    for k in (3, 4, 11):
        frames[k] = None if k == 3 else {"pose_world_landmarks": None, "left_hand_world_landmarks": []}
    del frames[20]["left_hand_world_landmarks"]
    for k in range(10, 30):
        frames[k].pop("right_hand_world_landmarks", None)
    motion = read_motion(written(tmp_path / "b.json", frames))
    within(motion.read().axis_angle[:, :37] - whole.axis_angle[:, :37], 0.6, "rad")
    np.testing.assert_allclose(motion.read().axis_angle[:, 22:37], whole.axis_angle[:, 22:37], atol=1e-6)
    assert any("body: not found in 3 of 30 frames" in n for n in motion.notes)
    assert any("no right hand in" in n and "flat there" in n for n in motion.notes)
    # so long after the last sight of it
    assert not motion.read().axis_angle[-1, 37:].any()


def test_which_hand_it_is_shows_in_how_it_bends(tmp_path):
    """Single hands are labelled as in a mirrored picture by some versions; a bent finger tells."""
    angles = np.zeros((1, 52, 3))
    angles[:, 22:, 0] = np.radians(50)
    _, left, right, _ = landmarks(axis_angle_from_joint_angles(angles), MALE, np.zeros((1, 3)))
    assert curl_sign(left) < -0.2 and curl_sign(right) > 0.2
    wrong = {"hand_world_landmarks": [points(left[0])], "handedness": [[{"category_name": "Right", "score": 0.9}]]}
    motion = read_motion(written(tmp_path / "a.json", wrong))
    assert motion.read().axis_angle[0, 22:37].any() and not motion.read().axis_angle[0, 37:].any()
    assert any("labelled right bends as a left one" in n for n in motion.notes)
    both = {
        "hand_world_landmarks": [points(right[0]), points(left[0])],
        "handedness": [[{"category_name": "Right"}], [{"category_name": "Left"}]],
    }
    clip = read_motion(written(tmp_path / "b.json", both)).read()
    curls = np.degrees(joint_angles(clip.axis_angle[0]))
    np.testing.assert_allclose(curls[[J[f"{s}_index2"] for s in SIDES], 0], 50, atol=2)


def change(key, landmark, **values):
    def apply(content):
        for name, value in values.items():
            content[key][landmark][name] = value
        return content

    return apply


POSE = "pose_world_landmarks"


DEEP = reduce(lambda inner, _: [inner], range(900), [1.0, 2.0])


@pytest.mark.parametrize(
    "spoil, match",
    [
        (change(POSE, 3, x="left"), f"{POSE}: landmark 3: x should be a finite number, is 'left'"),
        (change(POSE, 3, y=1e9), f"{POSE}: landmark 3: y should be a finite number"),
        (lambda c: c | {POSE: c[POSE][:20]}, "pose_world_landmarks should be 33 landmarks, are 20"),
        (
            lambda c: c | {"left_hand_world_landmarks": c[POSE]},
            "left_hand_world_landmarks should be 21 landmarks, are 33",
        ),
        (lambda c: c | {POSE: 7}, f"{POSE} should be a list of landmarks, is '7'"),
        (lambda c: c | {POSE: [1.0] * 33}, f"{POSE}: landmark 0 should be an object with x, y and z, is '1.0'"),
        (lambda c: {POSE: None, "left_hand_world_landmarks": []}, "no landmarks of a body or a hand in 1 frames"),
        (lambda c: {POSE: points(np.zeros((33, 3)))}, "frame 0: hips and shoulders are at one place"),
        (lambda c: c | {"left_hand_world_landmarks": points(np.zeros((21, 3)))}, "the left hand's palm has no area"),
        (lambda c: c | {POSE: DEEP}, "pose_world_landmarks should be 33 landmarks, are 1"),
        (lambda c: c | {"face_landmarks": c[POSE]}, "face_landmarks should be 468 or 478 landmarks, are 33"),
        (lambda c: [c, 5], "frame 1: expected landmarks of MediaPipe, an object, found a int"),
    ],
)
def test_bad_landmarks_are_refused_by_name(tmp_path, spoil, match):
    body, left, right, _ = landmarks(poses(1), MALE, np.zeros((1, 3)))
    path = written(tmp_path / "bad.json", spoil(frame(body[0], left[0], right[0])))
    with pytest.raises(AssetError, match=match) as error:
        read_motion(path)
    assert "\n" not in str(error.value) and "bad.json" in str(error.value)


@pytest.mark.parametrize("fps, match", [(-3, "fps should be a positive number"), (1e-9, "fps should be positive")])
def test_a_bad_rate_is_refused(tmp_path, fps, match):
    body, _, _, _ = landmarks(poses(1), MALE, np.zeros((1, 3)))
    refused(AssetError, match, lambda: read_motion(written(tmp_path / "a.json", frame(body[0]), fps=fps)))


def test_a_real_fist_is_closed_and_a_pointing_hand_points(data, tmp_path):
    for name, straight in (("fist_landmarks", ()), ("pointing_up_landmarks", ("index",))):
        motion = read_mediapipe(from_text(estimated(data, f"mediapipe_{name}.pbtxt"), tmp_path / "a.json"))
        curl = np.degrees(joint_angles(motion.read().axis_angle[0]))[:, 0]
        assert any("T-pose" in note for note in motion.notes)
        for finger in ("index", "middle", "ring", "pinky"):
            bend = curl[[J[f"right_{finger}{n}"] for n in (1, 2, 3)]].sum()
            assert bend < 45 if finger in straight else bend > 170, (name, finger, bend)


def saved(path, fields):
    np.savez(path, **fields)
    return path


@pytest.mark.parametrize("gender", ["male", "female"])
def test_bones_point_where_theirs_do_and_turn_as_theirs_do(tmp_path, gender, within):
    body = builtin_body(gender)
    pose = natural_poses(6)
    root = np.random.default_rng(1).normal(size=(6, 3))
    fields = sam3d_fields(pose, root, body.joints)
    motion = read_motion(saved(tmp_path / "stack.npz", fields), skeleton=rest_skeleton(body))
    pose[:, [J["spine1"], J["spine2"], J["spine3"]]] = 0
    G, at = world(pose, body.joints, root)
    ours, mine = placed(motion, body.joints)
    within(degrees_between(directions(mine, LIMBS), directions(at, LIMBS)), 0.05, "degrees")
    within(degrees_between(directions(mine, FINGERS), directions(at, FINGERS)), 0.05, "degrees")
    # turns about the bones too; the forearm's is shared out anew
    turns = [J[n] for n in JOINTS[:22] if not n.endswith(("elbow", "spine1", "spine2"))]
    off = axis_angle_from_matrix(np.swapaxes(G[:, turns], -1, -2) @ ours[:, turns])
    within(np.degrees(np.linalg.norm(off, axis=-1)), 0.1, "degrees")
    within(mine[:, 0] - at[:, 0], 1e-4, "m")


def test_bones_of_another_person_point_the_same_way(tmp_path, within):
    woman = builtin_body("female")
    pose, root = natural_poses(3, seed=2), np.zeros((3, 3))
    path = saved(tmp_path / "man.npz", sam3d_fields(pose, root))
    pose[:, [J["spine1"], J["spine2"], J["spine3"]]] = 0
    _, at = world(pose, builtin_body("male").joints, root)
    _, mine = placed(read_motion(path, skeleton=rest_skeleton(woman)), woman.joints)
    within(degrees_between(directions(mine, LIMBS), directions(at, LIMBS)), 0.05, "degrees")


def test_hands_whose_rotations_are_older_than_their_joints_follow_the_joints(tmp_path, within):
    """Found in both real results: one hand's rotations lie up to 70 degrees off its joints."""
    pose = natural_poses(2, seed=3)
    fields = sam3d_fields(pose, np.zeros((2, 3)))
    good, clean = read_sam3d_body(saved(tmp_path / "a.npz", fields)), read_sam3d_body(tmp_path / "a.npz").read()
    old = matrix_from_axis_angle(np.array([0.5, 0.7, -0.4])).astype("f4")
    stale = [t for n, (t, _) in NUMBERS.items() if n.startswith("right_") and (n[-1] in "123" or n.endswith("wrist"))]
    fields["pred_global_rots"][:, stale] = old @ fields["pred_global_rots"][:, stale]
    motion = read_sam3d_body(saved(tmp_path / "b.npz", fields))
    assert any(n.startswith("hands: rotations are off the joints") and "right" in n for n in motion.notes)
    assert not any("off the joints" in n for n in good.notes)
    hand = [J["right_wrist"], *range(37, 52)]
    a, b = (matrix_from_axis_angle(c.axis_angle[:, hand]) for c in (clean, motion.read()))
    off = axis_angle_from_matrix(np.swapaxes(a, -1, -2) @ b)
    within(np.degrees(np.linalg.norm(off, axis=-1)), 0.2, "degrees")


def test_a_folder_a_stack_and_single_files_are_the_same_frames(tmp_path):
    fields = sam3d_fields(natural_poses(11), np.random.default_rng(0).normal(size=(11, 3)))
    stack = read_motion(saved(tmp_path / "stack.npz", fields)).read()
    (tmp_path / "photos").mkdir()
    for k in range(11):
        single = {key: value[k : k + 1] if k % 2 else value[k] for key, value in fields.items()}
        saved(tmp_path / "photos" / f"img_{k + 1}.npz", single)
    motion = read_motion(tmp_path / "photos")
    assert motion.frames == 11
    np.testing.assert_allclose(motion.read().axis_angle, stack.axis_angle, atol=1e-12)
    # by number: img_2 before img_10
    np.testing.assert_allclose(motion.read(1, 3).axis_angle, stack.axis_angle[1:3], atol=1e-12)


def test_what_is_assumed_is_said_and_a_stranger_among_the_frames_is_named(tmp_path):
    fields = sam3d_fields(natural_poses(2), np.zeros((2, 3)))
    notes = read_motion(saved(tmp_path / "a.npz", fields)).notes
    for words in ("up: the camera's", "the camera at the origin", "30 frames per second assumed", "scale: leg"):
        assert any(words in note for note in notes), words
    del fields["pred_cam_t"]
    assert any("no pred_cam_t" in n for n in read_motion(saved(tmp_path / "b.npz", fields)).notes)
    saved(tmp_path / "0.npz", {k: v[0] for k, v in sam3d_fields(natural_poses(1), np.zeros((1, 3))).items()})
    saved(tmp_path / "1.npz", {"poses": np.zeros((1, 156))})
    refused(AssetError, r"1\.npz: no pred_joint_coords", lambda: read_motion(tmp_path).read())


def spoilt(key, change):
    def apply(fields):
        fields[key] = change(fields[key])
        return fields

    return apply


def put(index, value):
    def change(array):
        array[index] = value
        return array

    return change


@pytest.mark.parametrize(
    "spoil, match",
    [
        (spoilt("pred_joint_coords", put((1, 75, 0), np.nan)), r"pred_joint_coords is not finite.*frame 1, joint 75"),
        (spoilt("pred_cam_t", put((0, 2), np.inf)), "pred_cam_t is not finite.*frame 0"),
        (spoilt("pred_global_rots", put((1, 3), np.zeros((3, 3)))), "should be rotations, joint 3 of frame 1"),
        (spoilt("pred_global_rots", lambda R: R[:, :70]), r"pred_global_rots should be \(127, 3, 3\)"),
        (spoilt("pred_joint_coords", lambda p: p[:1]), "pred_global_rots has 2 frames, expected 1 as in"),
        (spoilt("pred_joint_coords", lambda p: p[:0]), "0 frames, expected at least 1"),
        (spoilt("pred_joint_coords", lambda p: p.astype(str)), "should be.*numbers"),
        (spoilt("pred_joint_coords", np.zeros_like), "are at one place"),
        (spoilt("pred_joint_coords", lambda p: np.random.default_rng(0).normal(size=p.shape)), "should be of one body"),
    ],
)
def test_bad_fields_are_refused_by_name(tmp_path, spoil, match):
    fields = spoil(sam3d_fields(natural_poses(2), np.zeros((2, 3))))
    with pytest.raises(AssetError, match=match) as error:
        read_motion(saved(tmp_path / "bad.npz", fields)).read()
    assert "\n" not in str(error.value) and "bad.npz" in str(error.value)


@pytest.mark.parametrize("stacked", [True, False])
def test_a_signalling_nan_is_one_line_as_well(tmp_path, stacked):
    fields = {k: v if stacked else v[0] for k, v in sam3d_fields(natural_poses(1), np.zeros((1, 3))).items()}
    fields["pred_cam_t"].view("<u4").reshape(-1)[1] = 0x7FA00000
    refused(AssetError, "pred_cam_t is not finite", read_motion, saved(tmp_path / "a.npz", fields))


# MHR's hinges bend about their own axis, so a right alignment leaves our hinges nothing but flexion: not circular
@pytest.mark.parametrize("name", ["sam3d_body_subj00", "sam3d_body_subj01"])
def test_a_real_result_bends_as_joints_do(data, name, within):
    path = estimated(data, f"{name}.npz")
    clip = read_motion(path).read()
    angles = np.degrees(joint_angles(clip.axis_angle[0]))
    within([angles[J[f"{s}_{n}"], 1] for s in SIDES for n in ("knee", "elbow")], 3, "degrees sideways")
    assert inside(clip.axis_angle[0])[:22].sum() >= 20
    stored = np.load(path)
    keypoints = stored["pred_keypoints_3d"] * [1, -1, -1]
    # its own list of points: shoulders 5, 6, hips 9, 10, knees 11, 12, wrists 62, 41
    theirs = {"left_hip": 9, "right_hip": 10, "left_knee": 11, "right_knee": 12, "left_wrist": 62, "right_wrist": 41}
    _, at = world(clip.axis_angle, builtin_body("male").joints, clip.root)
    for side in SIDES:
        bone = keypoints[theirs[f"{side}_knee"]] - keypoints[theirs[f"{side}_hip"]]
        thigh = directions(at, [(f"{side}_hip", f"{side}_knee")])[0, 0]
        within(degrees_between(thigh, bone / np.linalg.norm(bone)), 0.1, "degrees")
        first = 49 if side == "left" else 28
        for finger, start in (("index", first), ("middle", first + 4), ("ring", first + 8), ("pinky", first + 12)):
            for n in (1, 2):
                bone = keypoints[start - n] - keypoints[start - n + 1]
                mine = directions(at, [(f"{side}_{finger}{n}", f"{side}_{finger}{n + 1}")])[0, 0]
                within(degrees_between(mine, bone / np.linalg.norm(bone)), 0.1, "degrees")


@pytest.mark.parametrize("name", ["sam3d_body_subj00", "sam3d_body_subj01"])
def test_a_real_result_lies_over_its_picture(data, name, within):
    """Through the camera of the photo, joints lie where its keypoints do, as far as two people's lengths differ."""
    path = estimated(data, f"{name}.npz")
    stored = np.load(path)
    pixels, points = stored["pred_keypoints_2d"], stored["pred_keypoints_3d"] + stored["pred_cam_t"]
    focal, centre = np.polyfit(points[:, 0] / points[:, 2], pixels[:, 0], 1)
    middle = np.polyfit(points[:, 1] / points[:, 2], pixels[:, 1], 1)[1]
    clip = read_motion(path).read()
    _, at = world(clip.axis_angle, builtin_body("male").joints, clip.root)
    seen = at[0] * [1, -1, -1]
    ours = focal * seen[:, :2] / seen[:, 2:] + [centre, middle]
    height = np.ptp(pixels[:, 1])
    for joint, k in (("left_hip", 9), ("right_hip", 10), ("left_knee", 11), ("right_knee", 12), ("left_shoulder", 5),
                     ("right_shoulder", 6), ("left_wrist", 62), ("right_wrist", 41)):  # fmt: skip
        within(np.linalg.norm(ours[J[joint]] - pixels[k]) / height, 0.09, "of the person's height")
