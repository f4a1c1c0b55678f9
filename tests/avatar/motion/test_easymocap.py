"""EasyMocap folders: rotation about the origin, people, hands in coefficients, lengths of pose vectors."""

import json

import numpy as np
import pytest
from refusals import refused
from smplh_model import model_body

from avatar.body import shaped
from avatar.motion.easymocap import read_easymocap
from avatar.motion.pose_vector import SMPLX_PELVIS, USUAL_PELVIS
from avatar.motion.read import read_motion
from avatar.rotation import matrix_from_axis_angle
from avatar.skeleton import joint_transforms
from command.errors import AssetError


def person(columns=156, number=0, seed=0, upright=True, **more):
    rng = np.random.default_rng(seed)
    poses = 0.3 * rng.normal(size=columns)
    if columns in (66, 72, 78, 87, 156, 165):
        poses[:3] = 0
    Rh = 0.2 * rng.normal(size=3) if upright else rng.normal(size=3)
    return {
        "id": number, "Rh": [Rh.tolist()], "Th": [rng.normal(size=3).tolist()],
        "poses": [poses.tolist()], "shapes": [(0.5 * rng.normal(size=10)).tolist()], **more,
    }  # fmt: skip


def folder(tmp_path, frames, wrap=lambda people: people):
    tmp_path.mkdir(exist_ok=True)
    for number, people in enumerate(frames):
        (tmp_path / f"{number:06d}.json").write_text(json.dumps(wrap(people)))
    return tmp_path


@pytest.mark.parametrize("wrap", [lambda p: p, lambda p: {"annots": p}, lambda p: p[0]], ids=["list", "annots", "one"])
def test_joints_stand_where_easymocap_puts_them(tmp_path, wrap, within):
    """X = R(Rh) X_pose + Th, with X_pose standard SMPL of the shaped body: its joints, not only its pelvis.

    156 numbers are hands in full: nothing of the model's is added.
    """
    body = model_body(tmp_path)
    frames = [[person(seed=k)] for k in range(4)]
    clip = read_motion(folder(tmp_path / "smplh", frames, wrap), body=body).read()
    for k, (one,) in enumerate(frames):
        own = shaped(body, np.array(one["shapes"][0])[:2])
        rest = own.joints + own.origin
        pose = np.array(one["poses"][0]).reshape(52, 3)
        local = joint_transforms(pose, rest)[:, :3, 3]
        R, t = matrix_from_axis_angle(np.array(one["Rh"][0])), np.array(one["Th"][0])
        theirs = local @ R.T + t
        ours = joint_transforms(clip.axis_angle[k], own.joints, clip.root[k])[:, :3, 3]
        within(ours - theirs, 1e-9, "m")


@pytest.mark.parametrize("numbers, pelvis", [(156, USUAL_PELVIS), (162, SMPLX_PELVIS), (165, SMPLX_PELVIS)])
def test_without_a_model_the_pelvis_is_the_usual_one_and_too_many_coefficients_are_refused(tmp_path, numbers, pelvis):
    one = person(numbers)
    motion = read_easymocap(folder(tmp_path / "a", [[one]]))
    R = matrix_from_axis_angle(np.array(one["Rh"][0]))
    np.testing.assert_allclose(motion.read().root[0], np.array(one["Th"][0]) + R @ pelvis, atol=1e-12)
    for words in ("the usual one of SMPL", "30 frames per second assumed", "betas ignored", "up: +y"):
        assert any(words in note for note in motion.notes), words
    body = model_body(tmp_path, components=6)
    one = person(63, handl=[[0.0] * 12], handr=[[0.0] * 12])
    refused(AssetError, "handl has 12 numbers", lambda: read_easymocap(folder(tmp_path / "a1", [[one]]), body=body))


@pytest.mark.parametrize("axis, Rh", [("+z", [np.pi / 2, 0, 0]), ("-y", [np.pi, 0, 0]), ("-z", [-np.pi / 2, 0, 0])])
def test_bodies_stand_up_whatever_way_their_world_is(tmp_path, axis, Rh):
    one = person() | {"Rh": [Rh]}
    motion = read_easymocap(folder(tmp_path / "a", [[one]]))
    clip = motion.read()
    np.testing.assert_allclose(matrix_from_axis_angle(clip.axis_angle[0, 0]), np.eye(3), atol=1e-12)
    assert any(f"up: {axis}" in note for note in motion.notes)


@pytest.mark.parametrize(
    "columns, full", [(63, 66), (66, 66), (69, 72), (72, 72), (153, 156), (156, 156), (162, 165), (165, 165)]
)
def test_lengths_with_and_without_the_root(tmp_path, columns, full):
    one = person(columns)
    values = np.array(one["poses"][0])
    values = np.concatenate([np.zeros(full - columns), values])
    clip = read_easymocap(folder(tmp_path / "a", [[one]])).read()
    np.testing.assert_allclose(clip.axis_angle[0, 1:22].reshape(-1), values[3:66], atol=1e-15)
    hands = values[-90:] if full > 100 else np.zeros(90)
    np.testing.assert_allclose(clip.axis_angle[0, 22:].reshape(-1), hands, atol=1e-15)


@pytest.mark.parametrize("columns", [75, 78, 84, 87])
def test_hand_coefficients_are_expanded_and_the_mean_is_added_once(tmp_path, columns):
    body = model_body(tmp_path)
    one = person(columns)
    clip = read_motion(folder(tmp_path / "a", [[one]]), body=body).read()
    values = np.array(one["poses"][0])
    start = 66 if columns in (78, 87) else 63
    for side in (0, 1):
        c = values[start + 6 * side : start + 6 * side + 6]
        expected = c @ body.hands.components[side, :6] + body.hands.mean[side]
        np.testing.assert_allclose(
            clip.axis_angle[0, 22 + 15 * side : 37 + 15 * side].reshape(-1), expected, atol=1e-12
        )
    refused(AssetError, r"000000\.json: poses has .* hands_componentsl/r .* --body", read_motion, tmp_path / "a")
    refused(AssetError, "--body", lambda: read_motion(tmp_path / "a", body=model_body(tmp_path, hands=False)))


@pytest.mark.parametrize("count", [6, 12, 45])
def test_hands_apart(tmp_path, count):
    body = model_body(tmp_path)
    left, right = np.random.default_rng(1).normal(size=(2, count))
    one = person(63, handl=[left.tolist()], handr=[right.tolist()])
    motion = read_easymocap(folder(tmp_path / "a", [[one]]), body=body)
    got = motion.read().axis_angle[0, 22:].reshape(2, 45)
    for side, c in enumerate((left, right)):
        change = c if count == 45 else c @ body.hands.components[side, :count]
        np.testing.assert_allclose(got[side], change + body.hands.mean[side], atol=1e-12)
    assert any("mean added" in note for note in motion.notes)
    refused(AssetError, rf"handl has {count} numbers: hand PCA", read_easymocap, tmp_path / "a")


def test_the_lowest_of_several_people_is_read(tmp_path):
    frames = [[person(number=7, seed=1), person(number=3, seed=2)], [person(number=3, seed=4)]]
    motion = read_easymocap(folder(tmp_path / "a", frames))
    assert any("[3, 7] in the first frame, 3 is read" in note for note in motion.notes)
    np.testing.assert_allclose(motion.read(1, 2).axis_angle[0, 1], frames[1][0]["poses"][0][3:6], atol=1e-15)


def test_a_frame_without_the_person_and_one_of_another_length_are_named(tmp_path):
    motion = read_easymocap(folder(tmp_path / "a", [[person()], [person()], [person(number=5)]]))
    motion.read(0, 2)
    refused(AssetError, r"000002\.json: no person 0; there are \[5\]", motion.read, 1, 3)
    frames = [[person()]] * 40 + [[person(72)]] + [[person()]] * 40
    motion = read_easymocap(folder(tmp_path / "a1", frames))
    refused(AssetError, r"000040\.json: poses should have 156 numbers as in frame 0, has 72", motion.read)


def test_frames_are_read_by_their_numbers_and_one_file_is_one_frame(tmp_path):
    (tmp_path / "a").mkdir()
    for number in (0, 1, 9, 10):
        (tmp_path / "a" / f"{number:06d}.json").write_text(json.dumps([person(seed=number)]))
    (tmp_path / "a" / "notes.json").write_text("{}")
    motion = read_easymocap(tmp_path / "a")
    assert motion.frames == 4 and any("0 to 10 skip 7" in note for note in motion.notes)
    np.testing.assert_allclose(motion.read(3, 4).axis_angle[0, 1], person(seed=10)["poses"][0][3:6], atol=1e-15)
    path = folder(tmp_path / "a1", [[person()]]) / "000000.json"
    assert read_motion(path).frames == 1
    (tmp_path / "out" / "smpl").mkdir(parents=True)
    refused(AssetError, r"found none; its folder smpl/ may be meant", read_motion, tmp_path / "out")


@pytest.mark.parametrize(
    "change, message",
    [
        ({"poses": [[0.0] * 100]}, "poses should have 63, 66, .* has 100"),
        ({"poses": [[0.0] * 156, [0.0] * 156]}, "poses should be one row"),
        ({"Rh": [[0.0, 0]]}, "Rh should be 3 numbers, is 2"),
        ({"Th": None}, "Th should be one row"),
        ({"Rh": [[0.0, 0, 1e300]]}, "Rh should be one row of finite numbers"),
        ({"Rh": [[0.0, 0, float("nan")]]}, r"expected a frame of EasyMocap \(JSON\), found: NaN"),
        ({"handl": [[0.0] * 6], "handr": [[0.0] * 6]}, "hands twice"),
        ({"handl": [[0.0] * 6]}, "handl has 6 numbers, handr 0"),
        ({"id": "a"}, "id should be a whole number"),
    ],
)
def test_what_a_frame_holds_wrongly_is_named(tmp_path, change, message):
    with pytest.raises(AssetError, match=rf"000000\.json: {message}"):
        read_easymocap(folder(tmp_path / "a", [[person() | change]]))


@pytest.mark.parametrize("key", ["Rh", "Th", "poses"])
def test_what_a_frame_lacks_is_named(tmp_path, key):
    one = person()
    one.pop(key)
    refused(AssetError, f"no {key}; the person has", lambda: read_easymocap(folder(tmp_path / "a", [[one]])))
