"""Motion written for other programs: BVH, animated GLB and AMASS npz, each read back; the avatar in three.js."""

import dataclasses
from dataclasses import replace

import numpy as np
import pytest
from chromium import chromium, three_frames
from faced_avatar import doing, faced
from node_packages import package_folder, run_node
from pose_twins import angles_between
from scipy import ndimage
from tiny_avatar import join_glb, same, split_glb, tiny_avatar, tiny_face

from avatar.camera import orbit_camera
from avatar.face import eye_turn
from avatar.gltf.animation import rotation_keys, write_animated
from avatar.gltf.avatar_file import read_avatar, write_avatar
from avatar.gltf.document import read_gltf
from avatar.motion.bvh import open_bvh
from avatar.motion.bvh_write import euler_zxy, write_bvh
from avatar.motion.clip import Clip, Motion
from avatar.motion.read import read_motion
from avatar.rotation import matrix_from_axis_angle, matrix_from_quaternion, quaternion_from_axis_angle
from avatar.skeleton import BIG_POSE, JOINTS, PARENTS, joint_transforms, rigid_inverse
from command.errors import AssetError
from player.draw.drawing import Pose
from player.export_command import export_main
from player.scene.framing import pelvis_height
from player.scene.mannequin import mannequin


def wild_clip(frames=40, seed=3) -> Clip:
    """Every joint anywhere: half turns, no turn at all, and a joint that never moves."""
    rng = np.random.default_rng(seed)
    axis_angle = np.cumsum(rng.normal(size=(frames, 52, 3)) * 0.4, axis=0)
    axis_angle /= np.maximum(np.linalg.norm(axis_angle, axis=-1, keepdims=True) / np.pi, 1)
    axis_angle[:, 15] = [0.1, 0.2, 0.3]
    axis_angle[:5, 18] = 0
    axis_angle[7, 16] = [np.pi / 2, 0, 0]  # where Z and Y of Z X Y turn about one axis
    axis_angle[8, 16] = [-np.pi / 2, 0, 0]
    return Clip(axis_angle, rng.normal(size=(frames, 3)), 30.0, (), 0.98)


@pytest.fixture
def avatar_path(tmp_path):
    path = tmp_path / "tiny.glb"
    write_avatar(path, tiny_avatar())
    return path


@pytest.fixture
def tall_path(avatar_path):
    """With soles where a person's legs end, as BVH asks."""
    avatar = tiny_avatar()
    tall = tuple(replace(level, positions=np.float32(0.45) * level.positions) for level in avatar.levels)
    write_avatar(avatar_path, replace(avatar, levels=tall))
    return avatar_path


@pytest.mark.parametrize("unit", [1.0, 0.01])
def test_bvh_comes_back_within_a_thousandth_of_a_degree(tmp_path, unit):
    joints = tiny_avatar().joint_positions * 1.07  # another body than the built-in one
    clip = wild_clip()
    write_bvh(tmp_path / "wild.bvh", clip, joints, unit=unit)
    motion = read_motion(tmp_path / "wild.bvh")
    back = motion.read()
    assert motion.frames == 40 and motion.rate == pytest.approx(30, rel=1e-12)
    assert np.degrees(angles_between(back.axis_angle, clip.axis_angle)).max() < 1e-3
    np.testing.assert_allclose(back.root, clip.root, atol=1e-6)
    assert back.pelvis_height == pytest.approx(clip.pelvis_height, abs=1e-7)


def test_bvh_holds_the_skeleton_in_t_pose_on_the_ground(tmp_path):
    avatar = tiny_avatar()
    write_bvh(tmp_path / "wild.bvh", wild_clip(), avatar.joint_positions)
    bvh = open_bvh(tmp_path / "wild.bvh")
    order = [bvh.names.index(name) for name in JOINTS]
    np.testing.assert_allclose(bvh.rest_positions[order], avatar.joint_positions + [0, 0.98, 0], atol=1e-7)
    rotations, places = bvh.transforms(np.arange(5, 6))
    clip = wild_clip()
    expected = joint_transforms(clip.axis_angle[5], avatar.joint_positions, clip.root[5])
    np.testing.assert_allclose(rotations[0, order], expected[:, :3, :3], atol=1e-6)
    np.testing.assert_allclose(places[0, order], expected[:, :3, 3], atol=1e-6)


def test_the_long_bvh_is_that_of_the_clip_and_its_angles_do_not_jump(tmp_path):
    clip = wild_clip(600)

    def block(start, stop):
        return clip.axis_angle[start:stop], clip.root[start:stop]

    joints = tiny_avatar().joint_positions
    write_bvh(tmp_path / "clip.bvh", clip, joints)
    write_bvh(tmp_path / "motion.bvh", Motion("long", 600, 30.0, (), block, 0.98), joints)
    assert (tmp_path / "clip.bvh").read_bytes() == (tmp_path / "motion.bvh").read_bytes()
    t = np.linspace(0, 6 * np.pi, 721)  # three full turns about an axis, and through both gimbal locks
    turning = np.stack([np.zeros_like(t), np.zeros_like(t), t], -1)
    nodding = np.stack([t, np.zeros_like(t), np.zeros_like(t)], -1)
    R = matrix_from_axis_angle(np.stack([turning, nodding], 1))
    angles = euler_zxy(R, np.zeros((2, 3)))
    np.testing.assert_allclose(angles[:, 0, 0], t, atol=1e-9)
    assert np.abs(np.diff(angles, axis=0)).max() < 0.03  # the step of t is 0.026


@pytest.mark.parametrize("still", [False, True])
def test_the_animated_avatar_is_read_back_as_motion_and_as_the_same_avatar(tmp_path, still):
    """With its face, and as long as it was where nothing moves."""
    avatar_path, out, clip = tmp_path / "tiny.glb", tmp_path / "moving.glb", wild_clip()
    write_avatar(avatar_path, tiny_face())
    face, gaze = np.random.default_rng(4).random((40, 52)), np.random.default_rng(5).normal(0, 0.2, (40, 2, 2))
    clip = replace(clip, face=face, gaze=gaze)
    if still:
        rows = ("axis_angle", "root", "face", "gaze")
        clip = replace(clip, **{name: getattr(clip, name)[:1].repeat(40, 0) for name in rows})
    write_animated(out, avatar_path, clip)
    motion = read_motion(out)
    back = motion.read()
    assert (motion.frames, motion.rate, back.pelvis_height) == (40, 30.0, 0.98)
    assert angles_between(back.axis_angle, clip.axis_angle).max() < 1e-4
    # a metre a frame; float32 seconds put a key up to 4e-6 of a frame beside its time
    np.testing.assert_allclose(back.root, clip.root, atol=1e-5)
    np.testing.assert_allclose(back.face, clip.face, atol=1e-5)
    np.testing.assert_allclose(back.gaze, clip.gaze, atol=1e-5)
    assert same(read_avatar(out), read_avatar(avatar_path))
    before, after = split_glb(avatar_path.read_bytes())[1], split_glb(out.read_bytes())[1]
    assert after[: len(before) - 3] == before[: len(before) - 3]  # less its padding


def test_the_person_who_travels_with_the_program_goes_out_too(tmp_path):
    for words in (["--motion", "counting", "--frames", "0:2", "-o", "me.glb"], ["-o", "me.vrm"]):
        export_main(["builtin", *words[:-1], str(tmp_path / words[-1])])
    assert read_motion(tmp_path / "me.glb").frames == 2
    assert "VRMC_vrm" in read_gltf(tmp_path / "me.vrm").json["extensions"]


def test_a_second_motion_and_too_many_frames_for_float32_are_refused(avatar_path, tmp_path):
    write_animated(tmp_path / "first.glb", avatar_path, wild_clip(seed=1))
    with pytest.raises(AssetError, match=r"first\.glb: holds a motion"):
        write_animated(tmp_path / "second.glb", tmp_path / "first.glb", wild_clip(seed=2))
    clip = Clip(np.zeros((3, 52, 3)), np.zeros((3, 3)), 1e46)  # frames per second
    with pytest.raises(ValueError, match="3 frames at 1e\\+46 per second are more than float32"):
        write_animated(tmp_path / "fast.glb", avatar_path, clip)
    assert not (tmp_path / "fast.glb").exists()


def test_keys_take_the_shorter_arc_and_a_still_joint_has_one(avatar_path, tmp_path):
    clip = wild_clip()
    keys = rotation_keys(clip.axis_angle)
    assert ((keys[1:] * keys[:-1]).sum(-1) >= 0).all() and (keys[0, :, 3] >= 0).all()
    np.testing.assert_allclose(np.linalg.norm(keys.astype(float), axis=-1), 1, atol=1e-6)
    write_animated(tmp_path / "moving.glb", avatar_path, clip)
    document, _ = split_glb((tmp_path / "moving.glb").read_bytes())
    (animation,) = document["animations"]
    counts = {}
    for channel in animation["channels"]:
        sampler = animation["samplers"][channel["sampler"]]
        assert sampler["interpolation"] == "LINEAR"
        target = document["nodes"][channel["target"]["node"]]["name"], channel["target"]["path"]
        counts[target] = document["accessors"][sampler["output"]]["count"]
    assert counts.pop(("head", "rotation")) == 1
    assert set(counts.values()) == {40} and len(counts) == 52
    assert sum(path == "translation" for _, path in counts) == 1


def test_the_khronos_validator_finds_nothing_and_our_attributes_are_of_one_type_for_blender(avatar_path, tmp_path):
    # Blender up to 5.1 pairs the attributes that begin with _ with each other's types, in another order each start.
    document, _ = split_glb(avatar_path.read_bytes())
    for mesh in document["meshes"]:
        attributes = mesh["primitives"][0]["attributes"]
        own = [document["accessors"][index] for name, index in attributes.items() if name.startswith("_")]
        assert {(a["type"], a["componentType"]) for a in own} == {("VEC3", 5126)} and len(own) == 4
    folder = package_folder("gltf-validator")
    write_animated(tmp_path / "moving.glb", avatar_path, wild_clip())
    issues = run_node("validate_gltf.mjs", tmp_path / "moving.glb", folder)["issues"]
    assert (issues["numErrors"], issues["numWarnings"]) == (0, 0), issues["messages"]


def test_three_js_plays_the_motion_that_was_written(avatar_path, tmp_path):
    """Pose -> GLB animation -> three.js' AnimationMixer -> pose, and the joints' places in the world."""
    folder = package_folder("three")
    avatar, clip = tiny_avatar(), wild_clip()
    write_animated(tmp_path / "moving.glb", avatar_path, clip)
    frames = [0, 1, 7, 8, 23, 39]
    found = run_node("interchange/three_joints.mjs", tmp_path / "moving.glb", folder, *(k / 30 for k in frames))
    quaternions = np.array([frame["quaternions"] for frame in found["frames"]])
    expected = quaternion_from_axis_angle(clip.axis_angle[frames])
    expected *= np.where((expected * quaternions).sum(-1, keepdims=True) < 0, -1, 1)
    assert 2 * np.linalg.norm(quaternions - expected, axis=-1).max() < 1e-4  # radians
    world = np.array([frame["world"] for frame in found["frames"]]).reshape(len(frames), 52, 4, 4)
    G = joint_transforms(clip.axis_angle[frames], avatar.joint_positions, clip.root[frames])
    np.testing.assert_allclose(np.swapaxes(world, -1, -2), G, atol=1e-4)  # metres


def test_other_programs_find_the_skeleton_that_blender_expects(avatar_path):
    """Names, order, tree, T-pose at rest without turned nodes, inverse binds of the pose the mesh is stored in."""
    found = run_node("interchange/three_joints.mjs", avatar_path, package_folder("three"))
    avatar = tiny_avatar()
    assert found["joints"] == list(JOINTS)
    assert found["parents"] == [None, *(JOINTS[parent] for parent in PARENTS[1:])]
    rest = np.swapaxes(np.array(found["rest"]).reshape(52, 4, 4), -1, -2)
    np.testing.assert_allclose(rest[:, :3, 3], avatar.joint_positions, atol=1e-6)
    np.testing.assert_array_equal(rest[:, :3, :3], np.tile(np.eye(3), (52, 1, 1)))
    bound = rigid_inverse(joint_transforms(BIG_POSE, avatar.joint_positions))
    inverse = np.swapaxes(np.array(found["inverse"]).reshape(52, 4, 4), -1, -2)
    np.testing.assert_allclose(inverse, bound, atol=1e-6)


def export(*arguments):
    return export_main([str(a) for a in arguments])


def test_npz_out_and_in_is_exact_and_exporting_again_changes_nothing(avatar_path, tmp_path, capsys):
    source = read_motion("counting").read(20, 60)
    assert export(avatar_path, "--motion", "counting", "--frames", "20:60", "-o", tmp_path / "a.npz") == 0
    back = read_motion(tmp_path / "a.npz").read()
    np.testing.assert_array_equal(back.axis_angle[:, 1:], source.axis_angle[:, 1:])
    np.testing.assert_allclose(back.axis_angle[:, 0], source.axis_angle[:, 0], atol=1e-15)
    height = pelvis_height(read_avatar(avatar_path))
    assert back.pelvis_height == height
    np.testing.assert_allclose(back.root, source.root * (height / source.pelvis_height), atol=1e-15)
    assert export(avatar_path, "--motion", tmp_path / "a.npz", "-o", tmp_path / "b.npz") == 0
    again = read_motion(tmp_path / "b.npz").read()
    np.testing.assert_array_equal(again.axis_angle[:, 1:], back.axis_angle[:, 1:])
    np.testing.assert_allclose(again.root, back.root, atol=1e-15)
    assert "40 frames at 30 per second (1.3 s)" in capsys.readouterr().out


def test_every_kind_says_the_same_and_fits_the_avatar_it_was_made_for(tall_path, tmp_path, capsys):
    clips = {}
    for kind in ("npz", "bvh", "glb"):
        out = tmp_path / f"out.{kind}"
        assert export(tall_path, "--motion", "walking", "--frames", ":30", "--hands", "relaxed", "-o", out) == 0
        clips[kind] = read_motion(out).read()
    for kind in ("bvh", "glb"):
        assert np.degrees(angles_between(clips[kind].axis_angle, clips["npz"].axis_angle)).max() < 1e-3
        np.testing.assert_allclose(clips[kind].root, clips["npz"].root, atol=1e-6)
        assert clips[kind].pelvis_height == pytest.approx(clips["npz"].pelvis_height, abs=1e-7)
    # fitted again to the same avatar nothing is scaled
    capsys.readouterr()
    assert export(tall_path, "--motion", tmp_path / "out.bvh", "-o", tmp_path / "again.glb") == 0
    assert "root: scaled by 1.000" in capsys.readouterr().out


def test_a_motion_of_an_unknown_body_is_not_scaled_when_its_export_is_read_back(tall_path, tmp_path, capsys):
    pose = np.zeros((4, 156))
    pose[:, 0] = np.pi / 2
    np.savez(tmp_path / "in.npz", poses=pose, trans=np.tile([0.2, 0.3, 0.9], (4, 1)), mocap_framerate=30.0)
    for kind in ("bvh", "npz", "glb"):
        capsys.readouterr()
        assert export(tall_path, "--motion", tmp_path / "in.npz", "-o", tmp_path / f"out.{kind}") == 0
        assert "root: not scaled" in capsys.readouterr().out
        assert export(tall_path, "--motion", tmp_path / f"out.{kind}", "-o", tmp_path / "again.npz") == 0
        assert "root: scaled by 1.000" in (said := capsys.readouterr().out) and "ground:" not in said


def test_bad_input_is_refused_and_nothing_is_written(avatar_path, tmp_path, capsys):
    with pytest.raises(SystemExit) as stop:
        export(avatar_path, "--motion", "counting", "-o", avatar_path)
    assert stop.value.code == 2 and "is the avatar itself" in capsys.readouterr().err
    with pytest.raises(AssetError, match=r"frames 10:400 asked for, it has 300"):
        export(avatar_path, "--motion", "counting", "--frames", "10:400", "-o", tmp_path / "out.npz")
    with pytest.raises(AssetError, match="an avatar comes from `selfscan bake`"):
        (tmp_path / "not.glb").write_bytes(_without_extension(avatar_path))
        write_animated(tmp_path / "out.glb", tmp_path / "not.glb", wild_clip())
    assert not list(tmp_path.glob("out.*"))


def _without_extension(path):
    document, binary = split_glb(path.read_bytes())
    del document["extensions"]
    return join_glb(document, binary)


BLACK = (0.0, 0.0, 0.0, 1.0)


def painted():
    """The built-in body in soft stripes a few centimetres wide: no texel finer than a pixel, where filters differ."""
    avatar = mannequin()
    y, x = np.mgrid[:512, :512] / 512
    waves = [np.sin(2 * np.pi * (a * x + b * y) + c) for a, b, c in ((9, 2, 0), (-3, 11, 1), (7, 7, 2))]
    color = (128 + 100 * np.stack(waves, -1)).astype(np.uint8)
    return dataclasses.replace(avatar, levels=(dataclasses.replace(avatar.levels[0], base_color=color),))


def decibels(ours, theirs, pixels):
    return -10 * np.log10(np.square((ours[pixels].astype(float) - theirs[pixels]) / 255).mean())


def compared(ours, theirs):
    """dB in the rectangle round the person, outlines and the black around included; and inside the outlines."""
    drawn = (ours.max(-1) > 0) | (theirs.max(-1) > 0)
    assert 0.05 < drawn.mean() < 0.6
    rows, columns = np.flatnonzero(drawn.any(1)), np.flatnonzero(drawn.any(0))
    box = np.zeros_like(drawn)
    box[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1] = True
    both = (ours.max(-1) > 0) & (theirs.max(-1) > 0)
    return decibels(ours, theirs, box), decibels(ours, theirs, ndimage.binary_erosion(both, iterations=2))


def drawn_by_both(render, avatar, poses, middle, distance, folder):
    """Each pose as we draw it in paper mode, and as three.js does."""
    modules = package_folder("three")
    chromium()
    write_avatar(folder / "avatar.glb", avatar)
    camera = orbit_camera(middle, distance, 0.3, 0.1, (480, 480), np.radians(45))
    (folder / "browser").mkdir()
    theirs = three_frames(folder / "avatar.glb", poses, camera, modules, folder / "browser")
    renderer = render(avatar, camera.size, view="off", background=BLACK)
    return [renderer.draw([pose], camera)[..., :3] for pose in poses], theirs


@pytest.mark.slow
def test_three_js_draws_the_same_frame_as_paper_mode(render, tmp_path, pose):
    poses = [(np.zeros((52, 3)), np.zeros(3)), pose]
    ours, theirs = drawn_by_both(render, painted(), poses, np.array([0.0, -0.1, 0.0]), 2.6, tmp_path)
    for mine, other in zip(ours, theirs, strict=True):
        box, inside = compared(mine, other)
        assert box >= 35 and inside >= 39
    assert compared(ours[1], theirs[0])[0] < 20  # and the measure tells poses apart


@pytest.mark.slow
def test_three_js_moves_a_face_as_we_do(render, tmp_path):
    avatar = replace(faced(), levels=(replace(faced().levels[0], base_color=painted().levels[0].base_color),))
    faces = (None, doing((0.4, -0.2), jawOpen=0.7))
    poses = [Pose(np.zeros((52, 3)), np.zeros(3), face) for face in faces]
    ours, theirs = drawn_by_both(render, avatar, poses, avatar.eyes[0].center * [0, 1, 1], 0.7, tmp_path)
    everywhere = np.ones((480, 480), bool)
    assert all(decibels(mine, other, everywhere) >= 35 for mine, other in zip(ours, theirs, strict=True))
    assert decibels(ours[1], theirs[0], everywhere) < 30


def test_an_exported_face_is_keys_of_weights_and_eyes_for_any_program(tmp_path):
    write_avatar(tmp_path / "face.glb", tiny_face())
    face, gaze = np.linspace(0, 1, 40 * 52).reshape(40, 52), np.linspace(-0.4, 0.4, 160).reshape(40, 2, 2)
    write_animated(tmp_path / "talk.glb", tmp_path / "face.glb", replace(wild_clip(), face=face, gaze=gaze))
    issues = run_node("validate_gltf.mjs", tmp_path / "talk.glb", package_folder("gltf-validator"))["issues"]
    assert (issues["numErrors"], issues["numWarnings"]) == (0, 0), issues["messages"]
    assert same(read_avatar(tmp_path / "talk.glb"), tiny_face())
    gltf = read_gltf(tmp_path / "talk.glb")
    (animation,) = gltf.items("animations")
    keys = {(channel["target"]["node"], channel["target"]["path"]): animation["samplers"][channel["sampler"]]["output"]
            for channel in animation["channels"]}  # fmt: skip
    np.testing.assert_allclose(gltf.accessor(keys[52, "weights"]).reshape(40, 52), face, atol=1e-7)
    for eye, node in enumerate((53, 54)):
        expected = [eye_turn(*gaze[frame, eye]) for frame in range(40)]
        turned = matrix_from_quaternion(gltf.accessor(keys[node, "rotation"]).astype(np.float64))
        np.testing.assert_allclose(turned, expected, atol=1e-6)
