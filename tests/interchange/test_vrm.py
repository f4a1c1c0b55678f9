"""The avatar as VRM 1.0: valid glTF, bones and feet where VRM wants them, expressions bound to what they say."""

import numpy as np
import pytest
from faced_avatar import faced
from node_packages import package_folder, run_node
from tiny_avatar import split_glb, tiny_avatar

from avatar.face import SHAPES
from avatar.face_names import PRESETS
from avatar.gltf.avatar_file import write_avatar
from avatar.gltf.document import read_gltf
from avatar.gltf.humanoid import find_joints
from avatar.skeleton import JOINTS
from player.export_command import export_main
from player.scene.framing import pelvis_height


@pytest.fixture
def exported(tmp_path):
    write_avatar(tmp_path / "a.glb", faced())
    assert export_main([str(tmp_path / "a.glb"), "-o", str(tmp_path / "a.vrm"), "--author", "Anna"]) == 0
    return tmp_path / "a.vrm"


def test_the_khronos_validator_finds_no_error_in_a_vrm(exported):
    issues = run_node("validate_gltf.mjs", exported, package_folder("gltf-validator"))["issues"]
    assert (issues["numErrors"], issues["numWarnings"]) == (0, 0), issues["messages"]


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


def test_an_avatar_without_a_face_is_a_vrm_without_expressions_and_options_are_checked(tmp_path, capsys):
    write_avatar(tmp_path / "b.glb", tiny_avatar())
    who = ["--who", "everyone"]
    assert export_main([str(tmp_path / "b.glb"), "-o", str(tmp_path / "b.vrm"), *who]) == 0
    vrm = split_glb((tmp_path / "b.vrm").read_bytes())[0]["extensions"]["VRMC_vrm"]
    assert "expressions" not in vrm and vrm["meta"]["avatarPermission"] == "everyone"
    assert "no face in the avatar's file" in capsys.readouterr().out
    for wrong in (
        ["--motion", "counting", "-o", "c.vrm"],
        ["-o", "c.npz"],
        ["--motion", "counting", "-o", "c.npz", *who],
    ):
        with pytest.raises(SystemExit):
            export_main([str(tmp_path / "b.glb"), *wrong])
