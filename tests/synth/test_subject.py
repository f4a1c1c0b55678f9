"""Reading rigged humanoids: the rig is reproduced, names are found, what is missing is named."""

import numpy as np
import pytest
import rigs

from avatar.gltf.document import read_gltf
from avatar.gltf.humanoid import find_joints, mixamo_names, vrm_names
from avatar.gltf.scene import node_parents, parent_from_node, parents_first, read_primitive, read_skin, world_from_node
from avatar.rotation import matrix_from_axis_angle
from avatar.skeleton import JOINTS, skin_transforms
from avatar.skinning import skin_points
from command.errors import AssetError
from synth.subject import read_subject

MIXAMO = ["mixamorig:" + mixamo_names()[joint] for joint in JOINTS]


@pytest.mark.parametrize("person", ["White_M_1_Casual", "Asian_F_2_Casual"])
def test_skinning_is_the_files_own_rig(data, person):
    """Node by node with the file's bones, scales and inverse binds, against 52 joints and four weights."""
    path = data / "characters" / f"{person}.glb"
    subject = read_subject(path)
    gltf = read_gltf(path)
    nodes, _ = find_joints(path, gltf.json)
    pose = 0.5 * np.random.default_rng(0).standard_normal((52, 3))

    rest = world_from_node(gltf)
    world = rest.copy()
    parents = node_parents(gltf)
    for node in parents_first(parents):
        local = parent_from_node(gltf, node)
        if node in nodes:
            A = rest[node, :3, :3] / np.linalg.norm(rest[node, :3, :3], axis=0)
            local[:3, :3] = local[:3, :3] @ A.T @ matrix_from_axis_angle(pose[nodes.index(node)]) @ A
        world[node] = local if parents[node] < 0 else world[parents[node]] @ local
    posed = []
    for node in gltf.items("nodes"):
        if "mesh" in node:
            skin, primitive = read_skin(gltf, node["skin"]), read_primitive(gltf, node["mesh"])
            M = np.stack([world[n] @ b for n, b in zip(skin.nodes, skin.joint_from_mesh, strict=True)])
            weights = primitive.attributes["WEIGHTS_0"].astype(np.float64)
            weights /= weights.sum(1, keepdims=True)
            blended = np.einsum("vk,vkij->vij", weights, M[primitive.attributes["JOINTS_0"].astype(int)])
            points = np.c_[primitive.attributes["POSITION"], np.ones(len(weights))]
            posed.append(np.einsum("vij,vj->vi", blended, points)[:, :3])
    # White_M's head has vertices with more than four bones once merged; the strongest four are 4 micrometres off
    ours = skin_points(subject.vertices, subject.skin, skin_transforms(pose, subject.joints, rest=np.zeros((52, 3))))
    expected = np.concatenate(posed) - rest[nodes[0], :3, 3]
    np.testing.assert_allclose(ours, expected, rtol=0, atol=2e-5)


@pytest.mark.parametrize(
    "names", [JOINTS, MIXAMO, [name[10:] for name in MIXAMO]], ids=["smplh", "mixamorig", "mixamo"]
)
def test_joints_are_found_by_name(tmp_path, names):
    document, vertices = rigs.rig(names)
    subject = read_subject(rigs.write(tmp_path / "a.gltf", document))
    np.testing.assert_allclose(subject.vertices, vertices, rtol=0, atol=1e-6)


@pytest.mark.parametrize("version", [0, 1])
def test_joints_are_found_by_the_vrm_humanoid_whatever_their_names(tmp_path, version):
    document, vertices = rigs.rig([f"bone {i}" for i in range(52)])
    bones = {name: JOINTS.index(joint) for joint, name in vrm_names(version).items()}
    if version == 1:
        humanoid = {"humanBones": {name: {"node": node} for name, node in bones.items()}}
        document["extensions"] = {"VRMC_vrm": {"humanoid": humanoid}}
    else:
        humanoid = {"humanBones": [{"bone": name, "node": node} for name, node in bones.items()]}
        document["extensions"] = {"VRM": {"humanoid": humanoid}}
    subject = read_subject(rigs.write(tmp_path / "a.vrm", document))
    np.testing.assert_allclose(subject.vertices, vertices, rtol=0, atol=1e-6)


def test_a_rig_that_rests_in_an_a_pose_is_skinned_to_the_t_pose(tmp_path):
    pose = np.zeros((52, 3))
    pose[JOINTS.index("left_shoulder"), 2], pose[JOINTS.index("right_shoulder"), 2] = -0.7, 0.7
    document, _ = rigs.rig(pose=pose)
    subject = read_subject(rigs.write(tmp_path / "a.gltf", document))
    for side in ("left", "right"):
        arm = [subject.joints[JOINTS.index(f"{side}_{joint}")] for joint in ("shoulder", "elbow", "wrist", "middle1")]
        assert np.ptp([joint[1] for joint in arm]) < 1e-6
    assert any("skinned to a T-pose" in note for note in subject.notes)


def test_a_rig_that_faces_backwards_is_turned_and_said(tmp_path):
    document, vertices = rigs.rig(turn=np.diag([-1.0, 1, -1]))
    subject = read_subject(rigs.write(tmp_path / "a.gltf", document))
    np.testing.assert_allclose(subject.vertices, vertices, rtol=0, atol=1e-6)
    assert any("turned to face +z" in note for note in subject.notes)


def _without_skin(document):
    document["nodes"][52].pop("skin")
    document["skins"] = []


def _in_centimetres(document):
    _without_skin(document)
    document["nodes"][52]["scale"] = [100, 100, 100]


def _lying(document):
    _without_skin(document)
    document["nodes"].append({"rotation": [0.3826834, 0, 0, 0.9238795], "children": [0]})


@pytest.mark.parametrize(
    "spoil, message",
    [
        (lambda d: d["nodes"][JOINTS.index("left_pinky3")].update(name="stump"), r"missing left_pinky3"),
        (lambda d: [node.pop("name") for node in d["nodes"]], r"expected a humanoid rig .* found 0 of 52"),
        (lambda d: d.update(extensionsRequired=["EXT_meshopt_compression"]), r"EXT_meshopt_compression"),
        (_in_centimetres, r"0\.5 to 3 metres tall"),
        (lambda d: d["meshes"][0]["primitives"][0]["attributes"].pop("WEIGHTS_0"), r"JOINTS_0 and WEIGHTS_0"),
        (_lying, r"standing along the axes"),
    ],
)
def test_what_cannot_be_read_is_refused_by_name(tmp_path, spoil, message):
    document, _ = rigs.rig()
    spoil(document)
    path = rigs.write(tmp_path / "spoilt.gltf", document)
    with pytest.raises(AssetError, match=message) as error:
        read_subject(path)
    assert "spoilt.gltf" in str(error.value)
