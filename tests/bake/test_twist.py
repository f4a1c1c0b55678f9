"""Skin for twist and bend joints: the same skin divided, the file that holds it, and how thick limbs stay."""

import json
from dataclasses import replace

import numpy as np
import pytest
from limb_sections import fine_mannequin, posed, posed_by_three_js, section_areas, turned
from tiny_avatar import join_glb, same, split_glb, tiny_avatar

from avatar.baked_avatar import TwistSkin
from avatar.bend import BEND_JOINTS, BENDS
from avatar.gltf.animation import write_animated
from avatar.gltf.avatar_file import read_avatar, write_avatar
from avatar.helper_joints import BONES, CARRIER, HELPER_JOINTS
from avatar.motion.clip import Clip
from avatar.motion.read import read_motion
from avatar.skeleton import JOINTS
from bake.bake import bake_run
from bake.bend import PUSHES, REACH, TURNS, Piece, flesh, turns_of, with_room
from bake.twist import with_twist
from command.errors import AssetError
from player.scene.mannequin import mannequin


@pytest.fixture(scope="module")
def twisted():
    return with_twist(fine_mannequin())


@pytest.fixture
def path(tmp_path):
    write_avatar(tmp_path / "twist.glb", with_twist(mannequin(texture=64)))
    return tmp_path / "twist.glb"


@pytest.mark.parametrize("avatar", [mannequin(texture=64), tiny_avatar()], ids=["mannequin", "any skin"])
def test_the_skin_of_the_52_joints_is_the_one_before_to_the_last_bit(avatar):
    levels = with_twist(avatar).levels
    for before, level in zip(map(with_room, avatar.levels), levels, strict=True):
        assert same(replace(level, twist=None), before)
        joints, weights = level.twist.folded()
        np.testing.assert_array_equal(weights, before.weights)
        np.testing.assert_array_equal(joints, np.where(before.weights > 0, before.joints, 0))
    if avatar.name != "tiny":
        assert (levels[0].twist.joints >= 52).any(1).mean() > 0.1


def test_room_is_made_of_the_weakest_weight_also_where_three_are_alike():
    level = mannequin(texture=64).levels[0]
    joints, weights = level.joints.copy(), level.weights.copy()
    shoulder = JOINTS.index("left_shoulder")
    joints[0], weights[0] = [shoulder, *(JOINTS.index(f"spine{k}") for k in (1, 2, 3))], [249, 2, 2, 2]
    made = with_room(replace(level, joints=joints, weights=weights))
    assert made.weights[0].tolist() == [249, 0, 4, 2]


def test_in_the_pose_of_the_mesh_nothing_moves(twisted):
    points = posed(twisted, twisted.canonical_pose, "twist")
    np.testing.assert_allclose(points, twisted.levels[0].positions, atol=1e-6)


def test_the_file_comes_back_and_a_skin_that_is_not_the_skin_divided_is_refused(path, tmp_path):
    avatar = with_twist(mannequin(texture=64))
    assert same(read_avatar(path), avatar)
    write_avatar(tmp_path / "again.glb", read_avatar(path))
    assert (tmp_path / "again.glb").read_bytes() == path.read_bytes()
    write_avatar(tmp_path / "plain.glb", mannequin(texture=64))
    document, _ = split_glb((tmp_path / "plain.glb").read_bytes())
    assert len(document["nodes"]) == 53 and len(document["skins"][0]["joints"]) == 52
    assert "twist" not in document["extensions"]["SELFSCAN_avatar"]
    level = avatar.levels[0]
    other = np.where(level.twist.joints == 3, 6, level.twist.joints).astype(np.uint8)
    wrong = replace(level, twist=TwistSkin(other, level.twist.weights))
    with pytest.raises(ValueError, match="those of the 52 joints, divided"):
        write_avatar(tmp_path / "wrong.glb", replace(avatar, levels=(wrong,)))


def test_files_whose_twist_joints_are_not_ours_are_refused(path, tmp_path):
    def spoilt(change):
        document, binary = split_glb(path.read_bytes())
        change(document)
        (tmp_path / "spoilt.glb").write_bytes(join_glb(json.dumps(document), bytes(binary)))
        return tmp_path / "spoilt.glb"

    def renamed(document):
        document["nodes"][60]["name"] = "elsewhere"

    def moved(document):
        document["nodes"][60]["translation"][0] += 0.01

    with pytest.raises(AssetError, match=r"skin joint 59 .*then the eyes, here left_forearm_twist7"):
        read_avatar(spoilt(renamed))
    with pytest.raises(AssetError, match="default nodes of left_forearm_twist7"):
        read_avatar(spoilt(moved))
    with pytest.raises(AssetError, match="joints should be below 52"):
        read_avatar(spoilt(lambda document: document["extensions"]["SELFSCAN_avatar"].pop("twist")))
    with pytest.raises(AssetError, match="twist should be true or absent"):
        read_avatar(spoilt(lambda document: document["extensions"]["SELFSCAN_avatar"].update(twist=3)))


def test_an_exported_motion_turns_the_twist_joints_and_is_read_back_as_it_was(path, tmp_path):
    avatar = read_avatar(path)
    poses = np.random.default_rng(2).normal(size=(6, 52, 3)) * 0.5
    clip = Clip(poses, np.zeros((6, 3)), 30.0, (), 0.98)
    write_animated(tmp_path / "moving.glb", path, clip)
    document, _ = split_glb((tmp_path / "moving.glb").read_bytes())
    turned_nodes = {channel["target"]["node"] for channel in document["animations"][0]["channels"]}
    assert len(turned_nodes) == BONES
    np.testing.assert_allclose(read_motion(tmp_path / "moving.glb").read().axis_angle, poses, atol=1e-6)
    assert same(read_avatar(tmp_path / "moving.glb"), avatar)


def test_three_js_keeps_a_forearm_as_thick_as_ours(twisted, tmp_path):
    pose, places = turned(twisted, "left", 179.9)
    joints, points = posed_by_three_js(twisted, np.stack([np.zeros((52, 3)), pose]), tmp_path)
    assert joints == [*JOINTS, *HELPER_JOINTS]
    np.testing.assert_allclose(points[1], posed(twisted, pose, "twist"), atol=1e-5)
    areas = [section_areas(one, twisted.levels[0].faces.astype(np.int64), places).sum() for one in points]
    assert abs(areas[1] / areas[0] - 1) < 0.05


@pytest.mark.slow
def test_the_bake_writes_twist_joints_where_it_is_asked_to(run, small, tmp_path):
    quick = replace(small, faces=600, texture=64, body_step=0.02, fine_step=0.01, steps=2, samples=500, image=32)
    bake_run(run, tmp_path / "twist.glb", replace(quick, twist=True), lambda line: None)
    avatar = read_avatar(tmp_path / "twist.glb")
    assert avatar.provenance["baked"]["twist"] is True
    assert all((level.twist.joints >= 52).any() for level in avatar.levels)


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


def test_pushes_are_found_inside_of_what_is_tried_and_room_is_made_in_few_rows_and_by_little(bent):
    assert (bent.bend > 0).all() and (bent.bend < PUSHES[-1]).all()
    np.testing.assert_allclose(bent.bend[:3], bent.bend[3:], atol=2e-3)
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
