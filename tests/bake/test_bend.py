"""Skin for bend joints, how far they are pushed, and how much of a bent limb's volume is kept, here and in three.js."""

from dataclasses import replace

import numpy as np
import pytest
from limb_sections import posed, posed_by_three_js
from tiny_avatar import same

from avatar.baked_avatar import TwistSkin
from avatar.bend import BEND_JOINTS, BENDS
from avatar.gltf.avatar_file import read_avatar, write_avatar
from avatar.helper_joints import BONES, CARRIER
from bake.bend import PUSHES, REACH, TURNS, Piece, flesh, turns_of, with_room
from bake.twist import with_twist
from player.scene.mannequin import mannequin

CASES = [(name, k) for name in BENDS for k in range(len(TURNS[name.split("_")[1]]))]


@pytest.fixture(scope="module")
def bent():
    return with_twist(mannequin(texture=64))


def bent_pose(name, k, degrees=90.0):
    pose = np.zeros((52, 3))
    pose[BENDS[name].joint] = np.radians(degrees) * turns_of(name)[k]
    return pose


def surroundings(avatar, name):
    """A joint's surroundings, and their vertices in pose 0."""
    rest = posed(avatar, np.zeros((52, 3)), "twist")
    faces = avatar.levels[0].faces.astype(np.int64)
    near = flesh(avatar, BENDS[name], rest, REACH[name.split("_")[1]])
    return Piece(avatar.levels[0].positions, faces[near[faces].all(1)]), rest


@pytest.mark.parametrize(("name", "k"), CASES)
def test_a_joint_keeps_its_volume_when_it_bends_by_90_degrees(bent, name, k):
    piece, rest = surroundings(bent, name)
    kept = {kind: piece.volume(posed(bent, bent_pose(name, k), kind)) / piece.volume(rest) for kind in ("lbs", "twist")}
    assert abs(kept["twist"] - 1) < 0.05
    # and without: a fifth is gone
    assert kept["lbs"] < 0.85


def test_pushes_are_found_inside_of_what_is_tried_and_alike_on_both_sides(bent):
    assert (bent.bend > 0).all() and (bent.bend < PUSHES[-1]).all()
    np.testing.assert_allclose(bent.bend[:3], bent.bend[3:], atol=2e-3)


def test_room_is_made_in_few_rows_and_by_little():
    level = mannequin(texture=64).levels[0]
    other = with_room(level)
    changed = (other.weights != level.weights).any(1)
    assert 0 < changed.mean() < 0.02
    assert np.abs(other.weights.astype(int) - level.weights).max() < 0.15 * 255
    np.testing.assert_array_equal(other.weights.sum(1, dtype=int), 255)


def test_a_cut_box_has_the_volume_of_what_is_left():
    """A fan closes each open end."""
    corners = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
    assert Piece(corners, faces).volume(corners) == pytest.approx(1)
    assert Piece(corners, faces[2:]).volume(corners + 5) == pytest.approx(1)
    assert Piece(corners, faces[4:]).volume(corners * 2 - 3) == pytest.approx(8)


def test_a_file_with_twist_joints_alone_is_still_read(bent, tmp_path):
    """As files were before there were bend joints."""
    with pytest.raises(ValueError, match="below 94 without bend"):
        write_avatar(tmp_path / "wrong.glb", replace(bent, bend=None))
    level = bent.levels[0]
    own = np.arange(BONES)
    own[-len(BEND_JOINTS) :] = CARRIER[-len(BEND_JOINTS) :]
    joints, weights = own[level.twist.joints].astype(np.uint8), level.twist.weights.copy()
    for slot in range(1, 4):
        for first in range(slot):
            twice = (joints[:, slot] == joints[:, first]) & (weights[:, first] > 0)
            weights[twice, first] += weights[twice, slot]
            weights[twice, slot] = 0
    joints = np.where(weights > 0, joints, 0).astype(np.uint8)
    old = replace(bent, bend=None, levels=(replace(level, twist=TwistSkin(joints, weights)),))
    write_avatar(tmp_path / "old.glb", old)
    assert same(read_avatar(tmp_path / "old.glb"), old)
    with pytest.raises(ValueError, match="bend should be beside twist"):
        write_avatar(tmp_path / "wrong.glb", replace(mannequin(texture=64), bend=bent.bend))


def test_three_js_keeps_a_bent_joint_as_thick_as_ours(bent, tmp_path):
    names = ["left_elbow", "left_knee", "right_shoulder"]
    poses = [bent_pose(name, 0) for name in names]
    _, found = posed_by_three_js(bent, np.stack(poses), tmp_path)
    for name, pose, points in zip(names, poses, found, strict=True):
        np.testing.assert_allclose(points, posed(bent, pose, "twist"), atol=2e-5)
        piece, rest = surroundings(bent, name)
        assert abs(piece.volume(points) / piece.volume(rest) - 1) < 0.05
