"""The avatar as VRM 1.0 and 0.x: bones and feet where VRM wants them, expressions that do what they say."""

import numpy as np
import pytest
from chromium import chromium, three_frames
from faced_avatar import faced
from loose_avatar import dressed
from node_packages import package_folder, run_node
from tiny_avatar import split_glb, tiny_avatar

from avatar.camera import orbit_camera
from avatar.face import SHAPES, FaceFrame
from avatar.face_names import PRESETS, shapes_called, weights_of
from avatar.gltf.avatar_file import write_avatar
from avatar.gltf.document import read_gltf
from avatar.gltf.humanoid import find_joints
from avatar.gltf.scene import read_primitive, read_skin, world_from_node
from avatar.skeleton import JOINTS
from player.draw.drawing import Pose
from player.export_command import export_main
from player.scene.framing import pelvis_height
from player.scene.renderer import Renderer


@pytest.fixture
def exported(tmp_path):
    write_avatar(tmp_path / "a.glb", faced())
    assert export_main([str(tmp_path / "a.glb"), "-o", str(tmp_path / "a.vrm"), "--author", "Anna"]) == 0
    return tmp_path / "a.vrm"


@pytest.fixture
def earlier(exported):
    """The same as VRM 0.x."""
    out = exported.with_name("earlier.vrm")
    assert export_main([str(exported.with_name("a.glb")), "-o", str(out), "--vrm0", "--author", "Anna"]) == 0
    return out


def test_the_khronos_validator_finds_no_error_in_a_vrm(exported, earlier, hanging):
    prefix = ["INVALID_EXTENSION_NAME_FORMAT"]  # VRM has none of a vendor
    for path, warnings in ((exported, []), (earlier, prefix), (hanging / "a.vrm", []), (hanging / "a0.vrm", prefix)):
        issues = run_node("validate_gltf.mjs", path, package_folder("gltf-validator"))["issues"]
        assert issues["numErrors"] == 0, issues["messages"]
        assert [issue["code"] for issue in issues["messages"] if issue["severity"] == 1] == warnings


def test_a_vrm_stands_on_its_feet_with_all_bones_and_says_that_only_the_person_may_use_it(exported, capsys):
    gltf = read_gltf(exported)
    nodes, vrm = gltf.items("nodes"), gltf.json["extensions"]["VRMC_vrm"]
    joints, naming = find_joints(exported, gltf.json)
    assert naming == "VRM 1.0" and [nodes[joint]["name"] for joint in joints] == list(JOINTS)
    assert nodes[joints[0]]["translation"][1] == pytest.approx(pelvis_height(faced()))
    assert vrm["meta"]["avatarPermission"] == "onlyAuthor" and vrm["meta"]["authors"] == ["Anna"]
    assert not any(value is True for value in vrm["meta"].values())
    eyes = [nodes[vrm["humanoid"]["humanBones"][bone]["node"]]["name"] for bone in ("leftEye", "rightEye")]
    assert eyes == ["left_eye", "right_eye"] and vrm["lookAt"]["type"] == "bone"
    names = gltf.items("meshes")[0]["primitives"][0]["attributes"]
    assert not any(name.startswith("_") for name in names) and "SELFSCAN_avatar" not in gltf.json["extensions"]


def test_expressions_are_the_presets_and_the_52_bound_to_their_targets(exported):
    gltf = read_gltf(exported)
    mesh, vrm = gltf.items("meshes")[0], gltf.json["extensions"]["VRMC_vrm"]
    targets = mesh["primitives"][0]["targets"]
    assert mesh["extras"]["targetNames"] == list(SHAPES) and len(targets) == 52
    preset, custom = (vrm["expressions"][kind] for kind in ("preset", "custom"))
    assert preset.keys() == PRESETS.keys() and list(custom) == list(SHAPES)
    assert [custom[name]["morphTargetBinds"][0]["index"] for name in SHAPES] == list(range(52))
    bound = {SHAPES[bind["index"]]: bind["weight"] for bind in preset["aa"]["morphTargetBinds"]}
    assert bound == {"jawOpen": 0.45, "mouthLowerDownLeft": 0.2, "mouthLowerDownRight": 0.2}
    face = faced().levels[0].face
    moved = gltf.accessor(targets[SHAPES.index("jawOpen")]["POSITION"], field="target")
    assert np.array_equal(moved[face.vertices], face.offsets[SHAPES.index("jawOpen")])


def resting(gltf):
    """The mesh as it is skinned when nothing moves, in the world."""
    arrays, skin = read_primitive(gltf, 0).attributes, read_skin(gltf, 0)
    bones = (world_from_node(gltf)[list(skin.nodes)] @ skin.joint_from_mesh)[arrays["JOINTS_0"]]
    blended = (arrays["WEIGHTS_0"][..., None, None] * bones).sum(1)
    return np.einsum("vij,vj->vi", blended[:, :3, :3], arrays["POSITION"]) + blended[:, :3, 3]


def test_a_vrm_0_is_the_same_person_looking_the_other_way(exported, earlier):
    now, before = read_gltf(exported), read_gltf(earlier)
    np.testing.assert_allclose(resting(before), resting(now) * [-1, 1, -1], atol=1e-6)
    joints, naming = find_joints(earlier, before.json)
    assert naming == "VRM 0.x" and [before.items("nodes")[joint]["name"] for joint in joints] == list(JOINTS)
    primitive = before.items("meshes")[0]["primitives"][0]
    kinds = {name: before.items("accessors")[k]["componentType"] for name, k in primitive["attributes"].items()}
    assert kinds == {"POSITION": 5126, "NORMAL": 5126, "TEXCOORD_0": 5126, "JOINTS_0": 5123, "WEIGHTS_0": 5126}
    vrm, offset = before.json["extensions"]["VRM"], now.json["extensions"]["VRMC_vrm"]["lookAt"]["offsetFromHeadBone"]
    assert list(vrm["firstPerson"]["firstPersonBoneOffset"].values()) == [-offset[0], *offset[1:]]
    assert (vrm["meta"]["allowedUserName"], vrm["meta"]["author"]) == ("OnlyAuthor", "Anna")


def test_both_versions_have_the_same_expressions_in_their_own_words(exported, earlier):
    groups = read_gltf(earlier).json["extensions"]["VRM"]["blendShapeMaster"]["blendShapeGroups"]
    expressions = read_gltf(exported).json["extensions"]["VRMC_vrm"]["expressions"]
    both = [*expressions["preset"].values(), *expressions["custom"].values()]
    for group, now in zip(groups, both, strict=True):
        binds = now.get("morphTargetBinds", [])
        assert group["binds"] == [{"mesh": 0, "index": b["index"], "weight": 100 * b["weight"]} for b in binds]
        assert shapes_called(group["name"]) == {b["index"]: b["weight"] for b in binds}
    words = "joy angry sorrow fun a i u e o blink blink_l blink_r lookup lookdown lookleft lookright neutral unknown"
    assert {group["presetName"] for group in groups} == set(words.split())
    assert {"Joy", "Blink_L", "LookUp", "Surprised", "EyeBlinkLeft"} < {group["name"] for group in groups}


@pytest.fixture(scope="module")
def hanging(tmp_path_factory):
    """A woman in a skirt with long hair, her avatar file and both versions of VRM."""
    folder = tmp_path_factory.mktemp("hanging")
    write_avatar(folder / "a.glb", dressed())
    for name, more in (("a.vrm", []), ("a0.vrm", ["--vrm0"])):
        assert export_main([str(folder / "a.glb"), "-o", str(folder / name), *more]) == 0
    return folder


def test_hair_and_skirt_hang_on_chains_and_lie_at_rest_as_they_did(hanging):
    ours, vrm = read_gltf(hanging / "a.glb"), read_gltf(hanging / "a.vrm")
    springs = vrm.json["extensions"]["VRMC_springBone"]
    nodes = vrm.items("nodes")
    for spring in springs["springs"]:
        chain = [joint["node"] for joint in spring["joints"]]
        assert [nodes[a]["children"] for a in chain[:-1]] == [[b] for b in chain[1:]]
    roots = [spring["joints"][0]["node"] for spring in springs["springs"]]
    held_by = {node["name"] for node in nodes if set(roots) & set(node.get("children", []))}
    assert held_by == {"pelvis", "head"}
    lift = [0, vrm.items("nodes")[0]["translation"][1] - ours.items("nodes")[0]["translation"][1], 0]
    off = np.linalg.norm(resting(vrm) - lift - resting(ours), axis=1)
    # between the thighs a skirt's own skin shears, its chains do not
    assert np.percentile(off, 99) < 0.01 and off.max() < 0.04
    assert off[dressed().levels[0].loose == 0].max() < 1e-6
    np.testing.assert_allclose(resting(read_gltf(hanging / "a0.vrm")), resting(vrm) * [-1, 1, -1], atol=1e-6)


@pytest.mark.parametrize("version", ["a.vrm", "a0.vrm"])
def test_three_vrm_swings_hair_after_a_turn_of_the_head_and_lets_the_skirt_hang(hanging, version):
    found = run_node("interchange/three_springs.mjs", hanging / version, package_folder("@pixiv/three-vrm"))
    rest, still, turned, after = (np.array(found[key]) for key in ("rest", "still", "turned", "after"))
    assert np.linalg.norm(still - rest, axis=1).max() < 0.02
    hair = rest[:, 1] > 1
    assert 0 < hair.sum() < len(hair) and found["colliders"] > 0
    first, whole = (np.linalg.norm(moved - still, axis=1) for moved in (turned, after))
    assert (whole[hair] > 0.1).all() and (first[hair] < 0.5 * whole[hair]).all()
    assert whole[~hair].max() < 1e-3


def test_more_joints_than_a_byte_counts_are_two_bytes(hanging, tmp_path, monkeypatch):
    monkeypatch.setattr("avatar.gltf.spring_bones.LINKS", 24)
    assert export_main([str(hanging / "a.glb"), "-o", str(tmp_path / "many.vrm")]) == 0
    gltf = read_gltf(tmp_path / "many.vrm")
    joints = read_primitive(gltf, 0).attributes["JOINTS_0"]
    assert len(gltf.items("skins")[0]["joints"]) > joints.max() > 255
    assert np.linalg.norm(resting(gltf) - resting(read_gltf(hanging / "a.vrm")), axis=1).max() < 0.04


def test_an_avatar_that_wears_nothing_loose_has_no_springs(exported):
    gltf = read_gltf(exported)
    assert "VRMC_springBone" not in gltf.json["extensions"] and len(gltf.items("skins")[0]["joints"]) == 54


@pytest.mark.slow
@pytest.mark.parametrize("version", ["exported", "earlier"])
def test_three_vrm_poses_blinks_speaks_and_looks_as_we_do(version, request, context, tmp_path, pose):
    folder, avatar = package_folder("@pixiv/three-vrm"), faced()
    chromium()
    root = np.array([0, pelvis_height(avatar), 0])
    camera = orbit_camera(avatar.eyes[0].center * [0, 1, 1] + root, 0.6, 0.3, 0.1, (480, 480), 0.6)
    still, moving = (np.zeros((52, 3)), root), (pose[0], root)
    arkit = "eyeBlinkLeft" if version == "exported" else "EyeBlinkLeft"
    asked = [{}, {"blink": 1.0}, {"aa": 1.0}, {arkit: 0.5}]
    looks, bodies = np.array([[0, 0], [0, 0], [0, 0], [20, 10]]), [still, still, moving, still]
    vrm = [{"expressions": values, "look": look} for values, look in zip(asked, looks.tolist(), strict=True)]
    (tmp_path / "browser").mkdir()
    theirs = three_frames(request.getfixturevalue(version), bodies, camera, folder, tmp_path / "browser", vrm=vrm)
    renderer = Renderer(context, [avatar], camera.size, view="off", background=(0.0, 0.0, 0.0, 1.0))
    ours = []
    for body, values, (yaw, pitch) in zip(bodies, asked, np.radians(looks), strict=True):
        face = FaceFrame(weights_of(values), np.array([[yaw, -pitch]] * 2))
        ours.append(renderer.draw([Pose(*body, face)], camera)[..., :3])
    renderer.release()
    decibels = [[-10 * np.log10(np.square((a - b.astype(float)) / 255).mean()) for b in theirs] for a in ours]
    assert min(np.diag(decibels)) >= 35
    assert (np.argmax(decibels, 1) == np.arange(4)).all()  # and the measure tells faces apart


def test_an_avatar_without_a_face_is_a_vrm_without_expressions_and_options_are_checked(tmp_path, capsys):
    write_avatar(tmp_path / "b.glb", tiny_avatar())
    who = ["--who", "everyone"]
    assert export_main([str(tmp_path / "b.glb"), "-o", str(tmp_path / "b.vrm"), *who]) == 0
    vrm = split_glb((tmp_path / "b.vrm").read_bytes())[0]["extensions"]["VRMC_vrm"]
    assert "expressions" not in vrm and vrm["meta"]["avatarPermission"] == "everyone"
    assert export_main([str(tmp_path / "b.glb"), "-o", str(tmp_path / "c.vrm"), "--vrm0", *who]) == 0
    vrm = split_glb((tmp_path / "c.vrm").read_bytes())[0]["extensions"]["VRM"]
    assert vrm["blendShapeMaster"]["blendShapeGroups"] == [] and vrm["meta"]["allowedUserName"] == "Everyone"
    assert "no face in the avatar's file" in capsys.readouterr().out
    for wrong in (
        ["--motion", "counting", "-o", "c.vrm"],
        ["-o", "c.npz"],
        ["--motion", "counting", "-o", "c.npz", *who],
        ["--motion", "counting", "-o", "c.npz", "--vrm0"],
    ):
        with pytest.raises(SystemExit):
            export_main([str(tmp_path / "b.glb"), *wrong])
