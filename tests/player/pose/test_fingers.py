"""Fingers: curls and presets read back on both hands and inside the limits; the mirror in place."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from avatar.body import builtin_body
from avatar.limits import joint_angles, within
from avatar.motion.fingers import FINGERS, relaxed_hands
from avatar.rotation import matrix_from_axis_angle
from avatar.skeleton import JOINTS, LEFT_HAND, PARENTS, RIGHT_HAND, joint_transforms, skin_transforms
from avatar.skinning import skin_points
from player.pose.fingers import PRESETS, HandShape, hand_shape, with_finger, with_hand
from player.pose.mirror import PARTNER, mirrored, mirrored_in_place, onto_other_side

SOME = settings(max_examples=15, deadline=None, derandomize=True)
FLAT = np.zeros((52, 3))


def finger_points(shape, body, side="left"):
    """Straightness of each finger (1 straight: last joint as far from the first as in the flat hand)."""
    joints = body.joints.astype(float)
    at = joint_transforms(with_hand(FLAT, side, shape), joints)[:, :3, 3]
    out = {}
    for finger in FINGERS:
        a, c = (JOINTS.index(f"{side}_{finger}{n}") for n in (1, 3))
        out[finger] = np.linalg.norm(at[c] - at[JOINTS.index(f"{side}_wrist")]) / np.linalg.norm(
            joints[c] - joints[JOINTS.index(f"{side}_wrist")]
        )
    return out


@SOME
@given(
    st.lists(st.floats(-0.1, 0.95), min_size=5, max_size=5),
    st.lists(st.floats(-0.15, 0.15), min_size=5, max_size=5),
    st.sampled_from(["left", "right"]),
)
def test_a_shape_is_read_back_as_it_was_written(curl, spread, side):
    shape = HandShape(tuple(curl), tuple(spread), 0.2)
    pose = with_hand(FLAT, side, shape)
    back = hand_shape(pose, side)
    np.testing.assert_allclose(back.curl, curl, atol=1e-9)
    np.testing.assert_allclose(back.spread, spread, atol=1e-9)
    assert back.opposition == pytest.approx(0.2)
    assert within(pose).all()
    hand = LEFT_HAND if side == "left" else RIGHT_HAND
    assert not np.delete(pose, range(52)[hand], 0).any()


@pytest.mark.parametrize("name", PRESETS)
def test_presets_are_inside_the_limits_untouched_and_the_same_on_both_hands(name):
    left = with_hand(FLAT, "left", PRESETS[name])
    assert np.allclose(mirrored(left), with_hand(FLAT, "right", PRESETS[name]), atol=1e-12)
    assert within(left).all()
    np.testing.assert_allclose(hand_shape(left, "left").curl, PRESETS[name].curl, atol=1e-6)


@pytest.mark.parametrize("sex", ["male", "female"])
def test_presets_do_what_they_are_called(sex):
    body = builtin_body(sex)
    open_, closed = 0.93, 0.8
    wanted = {"flat": "imrpt", "open": "imrpt", "fist": "", "point": "i", "peace": "im", "thumbs up": "t"}
    for name, straight in wanted.items():
        reach = finger_points(PRESETS[name], body)
        for finger, value in reach.items():
            if finger == "thumb":
                continue  # the thumb's last joint hardly comes nearer; its tip is looked at below
            assert value > open_ if finger[0] in straight else value < closed, (name, finger, value)
    thumb = {name: tip(body, name, "thumb") for name in PRESETS}
    index = {name: tip(body, name, "index") for name in PRESETS}
    assert np.linalg.norm(thumb["ok"] - index["ok"]) < 0.005
    assert min(np.linalg.norm(thumb[n] - index[n]) for n in ("flat", "open", "thumbs up")) > 0.06
    middle = body.joints[JOINTS.index("left_middle1")]
    assert np.linalg.norm(thumb["fist"] - middle) < 0.06 < np.linalg.norm(thumb["thumbs up"] - middle)
    # open is wider than flat, from forefinger to little finger
    span = {n: np.linalg.norm(index[n] - tip(body, n, "pinky")) for n in ("flat", "open")}
    assert span["open"] > 1.2 * span["flat"]


def tip(body, preset, finger):
    """The finger's farthest vertex."""
    last, before = JOINTS.index(f"left_{finger}3"), JOINTS.index(f"left_{finger}2")
    heavy = np.argmax(body.skin.weights, 1)
    owned = np.flatnonzero(body.skin.joints[np.arange(len(heavy)), heavy] == last)
    vertex = owned[np.argmax(body.vertices[owned] @ (body.joints[last] - body.joints[before]))]
    transforms = skin_transforms(with_hand(FLAT, "left", PRESETS[preset]), body.joints, rest=FLAT)
    return skin_points(body.vertices, body.skin, transforms)[vertex]


def test_relaxed_is_as_on_the_command_line_and_curls_stop_at_the_limits():
    pose = with_hand(with_hand(FLAT, "left", PRESETS["relaxed"]), "right", PRESETS["relaxed"])
    gap = matrix_from_axis_angle(pose[22:]) @ matrix_from_axis_angle(relaxed_hands()).swapaxes(1, 2)
    angle = np.arccos(np.clip((np.trace(gap, axis1=1, axis2=2) - 1) / 2, -1, 1))
    assert np.degrees(angle.max()) < 2.0
    out = with_finger(FLAT, "left", 0, curl=5.0)
    assert within(out).all() and np.degrees(joint_angles(out)[22, 0]) == pytest.approx(90)
    joints = builtin_body("male").joints.astype(float)
    for finger, sign in ((0, 1), (2, -1), (3, -1)):  # the thumb's side is +z
        pose = with_finger(FLAT, "left", finger, spread=0.2)
        k = 22 + 3 * finger + 2
        way = joint_transforms(pose, joints)[k, :3, 3] - joints[k]
        assert sign * way[2] > 0.004


@SOME
@given(st.integers(0, 2**32 - 1), st.integers(0, 4), st.floats(0, 0.8), st.sampled_from(["left", "right"]))
def test_one_finger_moves_alone_and_keeps_what_is_its_own(seed, finger, curl, side):
    rng = np.random.default_rng(seed)
    pose = with_hand(rng.normal(size=(52, 3)) * 0.3, side, PRESETS["relaxed"])
    first = (22 if side == "left" else 37) + 3 * finger
    joints = np.arange(first, first + 3)
    out = with_finger(pose, side, finger, curl=curl)
    assert hand_shape(out, side).curl[finger] == pytest.approx(curl, abs=1e-9)
    assert np.array_equal(np.delete(out, joints, 0), np.delete(pose, joints, 0))
    np.testing.assert_allclose(joint_angles(out)[joints, 1:], joint_angles(pose)[joints, 1:], atol=1e-9)
    wide = with_finger(out, side, finger, spread=0.1)
    shape = hand_shape(wide, side)
    assert shape.spread[finger] == pytest.approx(0.1, abs=1e-9)
    assert shape.curl[finger] == pytest.approx(curl, abs=1e-9)


seeds = st.integers(0, 2**32 - 1)


def any_pose(seed):
    return np.random.default_rng(seed).normal(size=(52, 3)) * 0.6


def symmetric_joints():
    joints = builtin_body("male").joints.astype(float)
    return 0.5 * (joints + joints[PARTNER] * [-1, 1, 1])


def test_partners_are_pairs_and_one_side_is_put_onto_the_other():
    assert np.array_equal(PARTNER[PARTNER], np.arange(52))
    assert sum(np.arange(52) == PARTNER) == 6  # pelvis, three of the spine, neck, head
    assert JOINTS[PARTNER[JOINTS.index("left_ring2")]] == "right_ring2"
    assert np.array_equal(PARTNER[PARENTS[1:]], PARENTS[PARTNER[1:]])
    pose = any_pose(2)
    arm = [JOINTS.index(f"left_{p}") for p in ("shoulder", "elbow", "wrist")]
    out = onto_other_side(pose, arm)
    assert np.array_equal(out[PARTNER[arm]], pose[arm] * [1, -1, -1])
    rest = np.setdiff1d(np.arange(52), PARTNER[arm])
    assert np.array_equal(out[rest], pose[rest])
    pose = any_pose(1)
    pose[0] = [-np.pi / 2, 0, 0]
    assert np.array_equal(mirrored_in_place(pose), mirrored(pose))


@SOME
@given(seeds)
def test_in_place_the_heading_and_the_height_of_every_joint_stay(seed):
    pose, joints = any_pose(seed), symmetric_joints()
    out = mirrored_in_place(pose)
    back = mirrored_in_place(out)
    np.testing.assert_allclose(matrix_from_axis_angle(back), matrix_from_axis_angle(pose), atol=1e-10)
    a, b = (matrix_from_axis_angle(p[0])[:, 2] for p in (pose, out))
    np.testing.assert_allclose(np.arctan2(a[0], a[2]), np.arctan2(b[0], b[2]), atol=1e-9)
    one, other = (joint_transforms(p, joints)[:, :3, 3] for p in (pose, out))
    np.testing.assert_allclose(other[PARTNER, 1], one[:, 1], atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(other[PARTNER], axis=1), np.linalg.norm(one, axis=1), atol=1e-9)
