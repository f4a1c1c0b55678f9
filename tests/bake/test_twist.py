"""Skin for twist joints: the same skin divided, the file that holds it, and how thick limbs stay."""

import json
from dataclasses import replace

import numpy as np
import pytest
from limb_sections import fine_mannequin, posed, posed_by_three_js, section_areas, turned
from tiny_avatar import join_glb, same, split_glb, tiny_avatar

from avatar.baked_avatar import TwistSkin
from avatar.gltf.animation import write_animated
from avatar.gltf.avatar_file import read_avatar, write_avatar
from avatar.helper_joints import BONES, HELPER_JOINTS
from avatar.motion.clip import Clip
from avatar.motion.read import read_motion
from avatar.skeleton import JOINTS
from bake.bake import bake_run
from bake.bend import with_room
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


def test_in_the_pose_of_the_mesh_nothing_moves(twisted):
    points = posed(twisted, twisted.canonical_pose, "twist")
    np.testing.assert_allclose(points, twisted.levels[0].positions, atol=1e-6)


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("degrees", [90.0, 179.9, -179.9])
def test_a_forearm_keeps_its_volume_when_the_wrist_turns(twisted, side, degrees, within):
    pose, places = turned(twisted, side, degrees)
    faces = twisted.levels[0].faces.astype(np.int64)
    rest = section_areas(posed(twisted, np.zeros((52, 3)), "twist"), faces, places)
    kept = {kind: section_areas(posed(twisted, pose, kind), faces, places) / rest for kind in ("lbs", "dual", "twist")}
    within(np.average(kept["twist"], weights=rest) - 1, 0.05, "of the volume")
    assert kept["twist"].min() > 0.9 and kept["twist"].max() < 1.02
    # and without: the thinnest section is a tenth at half a turn
    assert kept["lbs"].min() < (0.2 if abs(degrees) > 100 else 0.65)
    assert kept["lbs"].min() < kept["dual"].min()


def test_the_file_comes_back_and_one_without_is_as_it_was(path, tmp_path):
    avatar = with_twist(mannequin(texture=64))
    assert same(read_avatar(path), avatar)
    write_avatar(tmp_path / "again.glb", read_avatar(path))
    assert (tmp_path / "again.glb").read_bytes() == path.read_bytes()
    write_avatar(tmp_path / "plain.glb", mannequin(texture=64))
    document, _ = split_glb((tmp_path / "plain.glb").read_bytes())
    assert len(document["nodes"]) == 53 and len(document["skins"][0]["joints"]) == 52
    assert "twist" not in document["extensions"]["SELFSCAN_avatar"]


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

    with pytest.raises(AssetError, match=r"skin joint 59 .*then the helper joints, here left_forearm_twist7"):
        read_avatar(spoilt(renamed))
    with pytest.raises(AssetError, match="default nodes of left_forearm_twist7"):
        read_avatar(spoilt(moved))
    with pytest.raises(AssetError, match="joints should be below 52"):
        read_avatar(spoilt(lambda document: document["extensions"]["SELFSCAN_avatar"].pop("twist")))
    with pytest.raises(AssetError, match="twist should be true or absent"):
        read_avatar(spoilt(lambda document: document["extensions"]["SELFSCAN_avatar"].update(twist=3)))


def test_a_twist_skin_that_is_not_the_skin_divided_is_refused(tmp_path):
    avatar = with_twist(mannequin(texture=64))
    level = avatar.levels[0]
    other = np.where(level.twist.joints == 3, 6, level.twist.joints).astype(np.uint8)
    wrong = replace(level, twist=TwistSkin(other, level.twist.weights))
    with pytest.raises(ValueError, match="those of the 52 joints, divided"):
        write_avatar(tmp_path / "wrong.glb", replace(avatar, levels=(wrong,)))


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


def test_the_bake_writes_twist_joints_where_it_is_asked_to(run, small, tmp_path):
    quick = replace(small, faces=600, texture=64, body_step=0.02, fine_step=0.01, steps=2, samples=500, image=32)
    bake_run(run, tmp_path / "twist.glb", replace(quick, twist=True), lambda line: None)
    avatar = read_avatar(tmp_path / "twist.glb")
    assert avatar.provenance["baked"]["twist"] is True
    assert all((level.twist.joints >= 52).any() for level in avatar.levels)
