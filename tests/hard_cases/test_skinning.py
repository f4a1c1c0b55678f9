"""Hard cases: skinning and its inverse, where blends collapse, flip or touch."""

import numpy as np
import pytest
from dual_quaternions import skin_points_dual_quaternion
from limb_sections import fine_mannequin, posed, section_areas, turned

from avatar.body import builtin_body
from avatar.rotation import matrix_from_axis_angle, quaternion_from_matrix
from avatar.skeleton import BIG_POSE, PARENTS, joint_transforms, rigid_inverse, skin_transforms
from avatar.skinning import (
    SkinWeights,
    blended_rotations,
    blended_transforms,
    dense_weights,
    skin_points,
    strongest_four,
    unskin_points,
)
from bake.twist import with_twist


@pytest.fixture(scope="module")
def body():
    return builtin_body("male")


@pytest.fixture(scope="module")
def twisted():
    return with_twist(fine_mannequin())


def two_bones(angle: float, axis=(1.0, 0, 0)) -> np.ndarray:
    """52 transforms: bone 0 still, bone 1 turned by `angle` about `axis` through the origin."""
    B = np.tile(np.eye(4), (52, 1, 1))
    B[1, :3, :3] = matrix_from_axis_angle(np.asarray(axis, float) / np.linalg.norm(axis) * angle)
    return B


def half_and_half(count: int) -> SkinWeights:
    return SkinWeights(np.tile([0, 1, 0, 0], (count, 1)), np.tile(np.float32([0.5, 0.5, 0, 0]), (count, 1)))


RING = np.stack([np.zeros(32), *(0.04 * f(np.linspace(0, 2 * np.pi, 32, endpoint=False)) for f in (np.cos, np.sin))], 1)


@pytest.mark.parametrize("degrees", [0, 30, 90, 120, 150, 170, 179, 180])
def test_twist_collapses_under_lbs_by_the_cosine_and_keeps_its_radius_under_dual_quaternions(degrees, within):
    B, skin = two_bones(np.radians(degrees)), half_and_half(len(RING))
    lbs = np.linalg.norm(skin_points(RING, skin, B), axis=1) / 0.04
    np.testing.assert_allclose(lbs, np.cos(np.radians(degrees) / 2), atol=1e-6)
    dual = np.linalg.norm(skin_points_dual_quaternion(RING, skin, B), axis=1) / 0.04
    within(dual - 1, 0.05, "of the radius")


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("degrees", [-180, -90, 45, 90, 135, 179.999, 180])
def test_a_forearm_with_twist_joints_keeps_its_volume_under_lbs_when_the_wrist_turns(side, degrees, within, twisted):
    pose, places = turned(twisted, side, degrees)
    faces = twisted.levels[0].faces.astype(np.int64)
    rest = section_areas(posed(twisted, 0 * pose, "twist"), faces, places)
    kept = {kind: section_areas(posed(twisted, pose, kind), faces, places) / rest for kind in ("lbs", "dual", "twist")}
    within(np.average(kept["twist"], weights=rest) - 1, 0.05, "of the volume")
    assert kept["twist"].min() > 0.9 and kept["twist"].max() < 1.02
    if abs(degrees) in (90, 179.999):
        # and without: the thinnest section is a tenth at half a turn
        assert kept["lbs"].min() < (0.2 if abs(degrees) > 100 else 0.65)
        assert kept["lbs"].min() < kept["dual"].min()


@pytest.mark.parametrize("degrees", [179.999, 180.0])
def test_the_inverse_at_the_singular_blend_is_a_flag_and_not_an_infinity(degrees):
    back, ok = unskin_points(RING, half_and_half(len(RING)), two_bones(np.radians(degrees)))
    assert not ok.any()
    np.testing.assert_array_equal(back, RING)


@pytest.mark.parametrize("degrees", [90, 135, 180])
def test_unit_vectors_stay_unit_through_a_half_and_half_blend(degrees, within):
    R = blended_rotations(half_and_half(1), two_bones(np.radians(degrees), (1, 2, -1)))
    within(R @ R.transpose(0, 2, 1) - np.eye(3), 1e-12)
    np.testing.assert_allclose(np.linalg.det(R), 1, atol=1e-12)


def test_direction_rule_jumps_only_where_a_heavy_pair_passes_half_a_turn(within):
    degrees = np.arange(0, 360.5, 0.5)
    skin = SkinWeights(np.array([[0, 1, 0, 0]]), np.float32([[0.6, 0.4, 0, 0]]))
    R = np.stack([blended_rotations(skin, two_bones(np.radians(d)))[0] for d in degrees])
    relative = np.einsum("nij,nkj->nik", R[1:], R[:-1])
    step = np.degrees(np.arccos(np.clip((np.trace(relative, axis1=1, axis2=2) - 1) / 2, -1, 1)))
    jumps = np.flatnonzero(step > 2)
    assert len(jumps) == 1 and abs(degrees[jumps[0]] - 180) <= 0.5
    assert step[jumps[0]] < 2 * np.degrees(np.arctan2(0.4, 0.6)) + 67.5  # bounded: twice the blend's own angle
    assert np.delete(step, jumps).max() < 1.0


def random_poses(count: int, seed: int = 0) -> np.ndarray:
    """Poses within the reach of people: shoulders, elbows, knees, spine and fingers moved together."""
    random = np.random.default_rng(seed)
    poses = random.normal(0, 0.15, (count, 52, 3))
    poses[:, 22:, 2] += random.uniform(-0.2, 1.2, (count, 1)) * np.where(np.arange(30) < 15, -1, 1)
    poses[:, [16, 17]] += random.normal(0, 0.5, (count, 2, 3))
    poses[:, [18, 19], 1] += random.uniform(0, 1.8, (count, 1)) * [-1, 1]
    poses[:, [4, 5], 0] += random.uniform(0, 1.5, (count, 1))
    poses[:, 0] = random.normal(0, 1, (count, 3))
    return poses


def test_posed_and_back_is_exact_under_the_same_weights(body, within):
    canonical = skin_points(body.vertices, body.skin, skin_transforms(BIG_POSE, body.joints, rest=np.zeros((52, 3))))
    flagged, worst = 0, 0.0
    for pose in random_poses(100):
        B = skin_transforms(pose, body.joints, root=np.array([0.3, 1.0, -2.0]))
        back, ok = unskin_points(skin_points(canonical, body.skin, B), body.skin, B)
        worst = max(worst, np.abs(back - canonical)[ok].max())
        flagged += (~ok).sum()
    within(worst, 1e-9, "m")
    within(flagged / (100 * len(canonical)), 0.001, "of the points flagged")


def test_canonical_pose_in_canonical_pose_out(body):
    B = skin_transforms(BIG_POSE, body.joints)
    np.testing.assert_allclose(B, np.tile(np.eye(4), (52, 1, 1)), atol=1e-14)


def test_forward_kinematics_against_one_chain_multiplied_by_hand(body):
    pose = random_poses(1, seed=3)[0]
    chain, joint = [], 36  # the last left thumb bone
    while joint >= 0:
        chain.append(joint)
        joint = int(PARENTS[joint])
    T = np.eye(4)
    for joint in reversed(chain):
        local = np.eye(4)
        local[:3, :3] = matrix_from_axis_angle(pose[joint])
        local[:3, 3] = body.joints[joint] - (body.joints[PARENTS[joint]] if joint else 0)
        T = T @ local
    np.testing.assert_allclose(joint_transforms(pose, body.joints)[36], T, atol=1e-13)
    np.testing.assert_allclose(rigid_inverse(T) @ T, np.eye(4), atol=1e-13)


@pytest.mark.parametrize("row, message", [
    (np.zeros(52), "sum to 0"),
    (np.r_[-0.5, 1.5, np.zeros(50)], "negative or not finite"),
    (np.r_[np.nan, 1.0, np.zeros(50)], "negative or not finite"),
])  # fmt: skip
def test_weight_rows_without_a_bone_to_follow_are_refused(row, message):
    dense = np.tile(np.eye(52)[3], (5, 1))
    dense[2] = row
    with pytest.raises(ValueError, match=message):
        strongest_four(dense)


def test_a_row_that_sums_to_0_999_is_scaled_to_one():
    skin = strongest_four(np.eye(52)[[3, 4]] * 0.999)
    np.testing.assert_array_equal(skin.weights.sum(1), 1)
    np.testing.assert_array_equal(dense_weights(skin), np.eye(52)[[3, 4]])


def test_blended_rotation_is_the_rotation_of_the_blend_for_one_bone(body):
    B = skin_transforms(random_poses(1, seed=5)[0], body.joints)
    one = SkinWeights(np.arange(52)[:, None].repeat(4, 1), np.tile(np.float32([1, 0, 0, 0]), (52, 1)))
    np.testing.assert_allclose(blended_rotations(one, B), B[:, :3, :3], atol=1e-12)
    np.testing.assert_allclose(blended_transforms(one, B), B, atol=1e-12)
    assert np.isfinite(quaternion_from_matrix(B[:, :3, :3])).all()


def test_directions_of_bones_on_either_side_of_a_half_turn_turn_by_a_half_turn():
    """170 degrees one way and 170 the other are 20 apart: their mean is a half turn, not none."""
    transforms = np.tile(np.eye(4), (2, 1, 1))
    transforms[:, :3, :3] = matrix_from_axis_angle(np.radians([[170.0, 0, 0], [-170.0, 0, 0]]))
    skin = SkinWeights(np.array([[0, 1, 0, 0]]), np.array([[0.5, 0.5, 0, 0]], np.float32))
    np.testing.assert_allclose(blended_rotations(skin, transforms)[0], np.diag([1.0, -1, -1]), rtol=0, atol=1e-12)


def test_weights_of_single_precision_do_not_move_what_is_ten_kilometres_away():
    """.1 + .2 + .3 + .4 of float32 are 1 + 2.2e-8: of 10 km that is .22 mm."""
    transforms = np.tile(np.eye(4), (4, 1, 1))
    transforms[:, 0, 3] = 1e4
    skin = SkinWeights(np.arange(4)[None], np.array([[0.1, 0.2, 0.3, 0.4]], np.float32))
    assert abs(skin_points(np.zeros((1, 3)), skin, transforms)[0, 0] - 1e4) < 1e-10
