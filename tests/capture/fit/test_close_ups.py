"""A hand and a head that turn before a camera are found again from their points; derivatives by differences."""

from dataclasses import replace

import numpy as np
import pytest

from avatar.kinematics import pose_rows, posed, shape_rows, skinned
from avatar.limits import axis_angle_from_joint_angles
from avatar.rotation import axis_angle_from_matrix, matrix_from_axis_angle
from avatar.skeleton import JOINTS, joint_transforms, skin_transforms
from avatar.skinning import dense_weights
from capture.fit import hand, head
from capture.fit.body import CUTS, MOVING, body_names
from capture.fit.contours import Silhouette
from capture.fit.face import same_size, with_own_face
from capture.fit.outline_term import Outlines
from capture.fit.person import person_of
from capture.fit.picture import fit_pose
from capture.fit.points import body_points
from capture.fit.priors import NECK, shared_layout, standing
from capture.fit.refusals import check_footage
from capture.fit.scan import STEPS, template_of
from capture.fit.solve import assemble, moved, posed_frames, solve
from capture.fit.trunk import SHOULDERS, trunk_angles
from capture.keypoints.record import Keypoints
from capture.raw.outline import HANGING
from capture.template.eyes import body_sockets
from tests.turning_twin import (
    FRAMES,
    SIZE,
    in_clothes,
    pictured,
    pixels_of,
    shown,
    truth_of,
    turned_hand,
    turning_head,
    turning_twin,
)


def degrees(a, b):
    return np.degrees(np.linalg.norm(axis_angle_from_matrix(np.swapaxes(a, -1, -2) @ b), axis=-1))


def joints_off(truth, found, side):
    """Metres from joints of the hand to where they are."""
    own = hand.hand_joints(side)
    return posed_frames(found).place[:, own] - posed_frames(truth).place[:, own]


@pytest.mark.parametrize("side", ["left", pytest.param("right", marks=pytest.mark.slow)])
def test_hand_that_turns_is_found(side):
    truth, footage = turned_hand(side)
    found = hand.first_guess(truth.person, truth.g, footage, side)
    assert np.median(degrees(truth.heading, found.heading)) < 25
    priors = hand.holding(found, footage, side)
    found = solve(found, footage, priors, cuts=(hand.FIRST, *CUTS), rounds=12)
    assert np.linalg.norm(joints_off(truth, found, side), axis=2).mean(1).max() < 0.008


@pytest.mark.slow
def test_outlines_of_thicker_fingers_do_not_draw_the_hand_nearer():
    truth, footage = turned_hand("left")
    told: list[str] = []
    found = hand.fit_hand(truth.person, truth.g, in_clothes(truth, footage, 0.002), "left", told.append)
    assert len(told) == STEPS["hand_left"]
    # .2 cm; 5.5 of 50 cm where fingers' lengths and poses moved before offsets
    assert np.linalg.norm(joints_off(truth, found, "left"), axis=2).mean() < 0.006


def once_round():
    """A head that turns once, whether its face is behind, and footage in which none is seen from there."""
    turn = 2 * np.pi * np.arange(FRAMES) / FRAMES
    truth, footage = turning_head(turn)
    behind = np.cos(turn) < -0.3
    return truth, behind, replace(footage, sure=np.where(behind[:, None], 0.0, footage.sure))


def test_head_is_followed_through_frames_that_show_no_face():
    truth, behind, footage = once_round()
    found, _ = head.fit_keypoints(truth.person, truth.g, footage)
    off = degrees(truth.heading, found.heading)
    assert off[~behind].max() < 1.5 and off[behind].max() < 8
    cameras = head.camera_from_head(found)
    # a point of the head lands where the person has it
    neck = truth.person.body.joints[head.HEAD]
    x = cameras[0, :3, :3] @ neck + cameras[0, :3, 3]
    np.testing.assert_allclose(x, [0, 0, 0.7], atol=0.01)


def test_nose_eyes_and_ears_alone_follow_a_head_all_round():
    """What detectors of 17 points see of a head: of the far side neither eye nor ear, from behind nothing."""
    truth, _, footage = once_round()
    five, turn = [footage.names.index(name) for name in head.NAMES[:5]], 2 * np.pi * np.arange(FRAMES) / FRAMES
    front, near, left, right = np.cos(turn) > -0.2, np.cos(turn) > 0.2, np.sin(turn) > 0.3, np.sin(turn) < -0.3
    seen = np.stack([front, near | (left & front), near | (right & front), ~right, ~left], 1) & front[:, None]
    few = replace(footage, names=head.NAMES[:5], pixels=footage.pixels[:, five], sure=2.0 * seen)
    check_footage("head", in_clothes(replace(truth, bias=truth.bias[five]), few, 0.0))
    found, _ = head.fit_keypoints(truth.person, truth.g, few)
    off = degrees(truth.heading, found.heading)
    assert off[front].max() < 4 and off[~front].max() < 8  # 180 where the way through the front is taken


def nodding(degrees):
    """A person with hanging arms who turns once on a chair and nods: the truth, a stiff one whose head is where theirs
    is, its footage, and what a detector sees of the shoulders, half a pixel off."""
    person, turn = person_of("female"), 2 * np.pi * np.arange(24) / 24
    angles = np.zeros((24, 52, 3))
    for joint in ("left_shoulder", "right_shoulder"):
        angles[:, JOINTS.index(joint), 0] = -HANGING
    nod = np.radians(degrees) * np.sin(turn)
    angles[:, JOINTS.index("neck"), 0], angles[:, head.HEAD, 0] = 0.4 * nod, 0.6 * nod
    heading = matrix_from_axis_angle(turn[:, None] * [0, 1.0, 0])
    truth = truth_of(person, np.zeros((24, 3)), heading, angles)
    truth = replace(truth, root=np.array([0, 0, -0.75]) - posed_frames(truth).place[:, head.HEAD])
    frames, joint = posed_frames(truth), person.body.joints[head.HEAD]
    turned, place = frames.R[:, head.HEAD], frames.place[:, head.HEAD]
    stiff = truth_of(person, place - turned @ joint, turned, np.zeros((24, 52, 3)))
    stiff, footage = shown(stiff, head.NAMES, np.zeros(0, np.int64))
    seen = pictured(truth, SHOULDERS, np.array(NECK), size=SIZE, focal=700.0).footage
    pixels = seen.pixels + 0.5 * np.random.default_rng(1).standard_normal(seen.pixels.shape)
    return truth, stiff, footage, Keypoints(SHOULDERS, pixels, np.full(pixels.shape[:2], 0.9), None)


@pytest.mark.slow
def test_shoulders_are_found_under_a_head_that_nods():
    truth, stiff, footage, points = nodding(12)
    found = trunk_angles(stiff, footage, points)
    true = axis_angle_from_joint_angles(truth.angles)
    joints, moved_by = truth.person.body.joints, []
    for angles in (found, true, 0 * true):
        T = np.stack([skin_transforms(frame, joints, np.zeros(3), rest=np.zeros((52, 3))) for frame in angles])
        beside = np.linalg.inv(T[:, head.HEAD]) @ T[:, JOINTS.index("spine3")]
        places = joints[[JOINTS.index(name) for name in SHOULDERS]]
        moved_by.append(np.einsum("fij,sj->fsi", beside[:, :3, :3], places) + beside[:, None, :3, 3])
    off, stiff_off = (np.linalg.norm(at - moved_by[1], axis=-1) for at in (moved_by[0], moved_by[2]))
    assert off.mean() < 0.002 and off.max() < 0.005 < 0.02 < stiff_off.max()
    # where nobody saw a shoulder nothing is known, nor where they are somebody else's
    assert trunk_angles(stiff, footage, replace(points, confidence=0 * points.confidence)) is None
    wild = points.pixels + 80 * np.random.default_rng(2).standard_normal(points.pixels.shape)
    assert trunk_angles(stiff, footage, replace(points, pixels=wild)) is None


@pytest.mark.slow
@pytest.mark.parametrize(("deviations", "believed"), [(7, True), (13, False)])
def test_a_trunk_is_believed_within_ten_deviations_of_the_shoulders(monkeypatch, deviations, believed):
    _, stiff, footage, points = nodding(12)
    monkeypatch.setattr("capture.fit.trunk.misfits", lambda _, seen: deviations / np.maximum(seen.sure, 1e-9))
    assert (trunk_angles(stiff, footage, points) is not None) == believed


@pytest.mark.slow
def test_long_hair_draws_no_head_down_into_itself():
    truth, behind, footage = once_round()
    x, over = truth.person.body.vertices, head.head_outlined()
    near = dense_weights(truth.person.body.skin)[:, [JOINTS.index("neck"), head.HEAD]].sum(1) > 0.5
    hair = np.where(near & ~over & (x[:, 2] < 0.03), 0.05, 0.0)
    found = head.fit_head(truth.person, truth.g, in_clothes(truth, footage, hair), lambda line: None)
    off = degrees(truth.heading, found.heading)
    assert off[~behind].max() < 2 and off[behind].max() < 12  # 6 and 25 with outlines of the whole head
    crown = np.array([x[:, 1].argmax()])
    at, true = (np.stack([skinned(f, e.skin(crown)) for f in posed_frames(e).each]) for e in (found, truth))
    assert np.linalg.norm(at - true, axis=-1).max() < 0.055


def test_a_head_seen_from_nearer_by_biases_that_draw_inwards_is_put_back_without_a_point_moving():
    estimate, footage = turning_head(np.linspace(-1, 1, 5), face_30=(0.0, 0.004, 0.0))
    at = footage.points
    places = np.stack([point.place(estimate.person.vertices(estimate.g), estimate.person.body.joints) for point in at])
    inwards = replace(estimate, bias=estimate.bias - 0.1 * (places - places.mean(0)))
    found = same_size(inwards, footage)
    np.testing.assert_allclose(pixels_of(found, footage), pixels_of(inwards, footage), atol=1e-6)
    assert np.abs(found.bias - estimate.bias).max() < 0.0015
    assert found.root[2, 2] / inwards.root[2, 2] == pytest.approx(1 / 0.9, abs=0.02)


def test_features_go_where_they_were_seen_and_the_scalp_stays():
    lower = {f"face_{number}": (0.0, -0.004, 0.0) for number in range(48, 68)}
    estimate, footage = turning_head(np.linspace(-1, 1, 5), **lower)
    chosen = head.head_vertices(estimate.person)
    found = with_own_face(estimate, footage, chosen)
    moved, points = found.person.offsets, body_points()
    lips = moved[points["face_54"].vertices].mean(0)
    assert lips[1] == pytest.approx(-0.003, abs=0.0005) and np.abs(lips[[0, 2]]).max() < 1e-3
    crown, nose = estimate.person.body.vertices[:, 1].argmax(), points["face_27"].vertices
    assert np.abs(moved[crown]).max() < 2e-4 > np.abs(moved[~chosen]).max() and np.abs(moved[nose]).max() < 1e-3
    np.testing.assert_allclose(pixels_of(found, footage), pixels_of(estimate, footage), atol=1e-6)


def test_points_of_an_eye_that_err_each_by_itself_leave_its_opening_as_it_is():
    sides = {f"face_{number}": (0.004 * (-1) ** number, 0.003, 0.0) for number in range(42, 48)}
    estimate, footage = turning_head(np.linspace(-1, 1, 5), **sides)
    moved = with_own_face(estimate, footage, head.head_vertices(estimate.person)).person.offsets
    rim = body_sockets()[0].rim
    assert np.ptp(moved[rim], axis=0).max() < 1e-3 < 0.0015 < moved[rim, 1].mean()


def in_one_picture(thickness=0.0):
    """Somebody who poses, in clothes so thick (metres); keypoints and mask."""
    angles = np.zeros((1, 52, 3))
    for side, forwards in (("left", 50), ("right", -10)):
        angles[0, JOINTS.index(f"{side}_shoulder"), :2] = np.radians([-45, forwards])
        angles[0, JOINTS.index(f"{side}_elbow"), 0] = np.radians(70)
    angles[0, JOINTS.index("left_hip"), 0] = angles[0, JOINTS.index("left_knee"), 0] = np.radians(60)
    heading = matrix_from_axis_angle(np.array([[0, np.radians(30), 0]]))
    truth = truth_of(person_of("male"), np.array([[0.1, 0.1, -3.5]]), heading, angles)
    truth, footage = shown(truth, body_names(), MOVING)
    seen = Keypoints(footage.names, footage.pixels, np.ones_like(footage.sure), footage.size)
    return truth, seen, in_clothes(truth, footage, thickness).masks[0], footage.focal


def limbs_in_camera(truth, seen, mask, focal):
    """Joints as fitted and as they are, in the camera's frame."""
    camera, axis_angle, root = fit_pose(template_of(truth), seen, mask, focal=focal)
    ours = joint_transforms(axis_angle, truth.person.joints(truth.g), root)[:22, :3, 3]
    ours = ours @ camera.camera_from_world[:3, :3].T + camera.camera_from_world[:3, 3]
    return ours, posed_frames(truth).place[0, :22] * [1, -1, -1]


def test_pose_of_a_known_person_in_one_picture():
    ours, theirs = limbs_in_camera(*in_one_picture())
    assert np.linalg.norm(ours - ours.mean(0) - theirs + theirs.mean(0), axis=1).mean() < 0.03


@pytest.mark.slow
def test_clothes_that_the_template_lacks_do_not_draw_it_nearer_to_one_picture():
    ours, theirs = limbs_in_camera(*in_one_picture(thickness=0.015))
    assert abs((ours - theirs)[:, 2].mean()) < 0.06


def gradient_of(estimate, footage, priors, terms, own, shared):
    """Slope of half the cost along a step: from differences, and as the equations tell."""
    equations = assemble(estimate, footage, priors, 1e6, terms)[0]
    told = -((equations.b * own).sum() + (equations.b_shared * shared).sum())
    h = 1e-6
    ahead, behind = (
        assemble(moved(estimate, footage, s * h * own, s * h * shared), footage, priors, 1e6, terms)[1] for s in (1, -1)
    )
    return 0.5 * (ahead - behind) / (2 * h), told


@pytest.mark.parametrize("what", ["root", "pelvis", "angles", "g", "bias", "focal", "mean"])
def test_cost_changes_as_the_equations_say(what):
    rng = np.random.default_rng(3)
    truth, footage = turning_twin(5)
    priors = standing(truth, footage)
    estimate = replace(truth, angles=truth.angles + rng.normal(0, 0.1, truth.angles.shape),
                       bias=rng.normal(0, 0.01, truth.bias.shape), log_focal=0.03)  # fmt: skip
    chosen = rng.integers(0, len(truth.person.body.vertices), 40)
    normals = rng.standard_normal((40, 2))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    pairs = [Silhouette(chosen, rng.uniform(90, 160, (40, 2)), normals)] * 5
    outlines = Outlines(footage)
    layout = shared_layout(estimate, footage)
    own, shared = np.zeros((5, 6 + 3 * len(footage.moving))), np.zeros(layout.count)
    where = {"root": slice(0, 3), "pelvis": slice(3, 6), "angles": slice(6, None)}
    if what in where:
        own[:, where[what]] = rng.standard_normal(own[:, where[what]].shape)
    else:
        at = {"g": layout.g, "bias": layout.bias, "focal": layout.focal, "mean": layout.mean}[what]
        shared[at] = rng.standard_normal(np.shape(shared[at]))
    # outlines are robust as well: their pairs stay within the flat part of the weight only for a tiny weight
    for terms, tolerance in (((), 1e-4), ((outlines.term(pairs, 1e-9),), 1e-4)):
        seen, told = gradient_of(estimate, footage, priors, terms, own, shared)
        assert told == pytest.approx(seen, rel=tolerance)


def test_an_outline_none_of_whose_points_is_near_says_nothing():
    estimate, footage = turning_twin(3)
    priors = standing(estimate, footage)
    nothing = Silhouette(np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros((0, 2)))
    cost = assemble(estimate, footage, priors, 1e6, ())[1]
    equations, with_outline = assemble(estimate, footage, priors, 1e6, (Outlines(footage).term([nothing] * 3, 1.0),))
    assert with_outline == cost
    assert np.isfinite(equations.solve(1.0)[0]).all()


def test_points_of_the_skin_move_with_pose_and_shape_as_told():
    rng = np.random.default_rng(1)
    truth, footage = turning_twin(3)
    vertices = rng.integers(0, len(truth.person.body.vertices), 30)
    c = rng.standard_normal((30, 3))

    def at(estimate):
        points = estimate.skin(vertices)
        frame = posed(estimate.skeleton(), estimate.root[1], estimate.heading[1], estimate.angles[1])
        return frame, points, (c * skinned(frame, points)).sum(1)

    frame, points, _ = at(truth)
    rows = pose_rows(frame, points, c, footage.turning), shape_rows(frame, points, c)
    layout = shared_layout(truth, footage)
    own, shared = np.zeros((3, rows[0].shape[1])), np.zeros(layout.count)
    own[1], shared[layout.g] = rng.standard_normal(rows[0].shape[1]), rng.standard_normal(rows[1].shape[1])
    ahead, behind = (at(moved(truth, footage, s * 1e-6 * own, s * 1e-6 * shared))[2] for s in (1, -1))
    expected = rows[0] @ own[1] + rows[1] @ shared[layout.g]
    np.testing.assert_allclose((ahead - behind) / 2e-6, expected, rtol=1e-5, atol=1e-6)
