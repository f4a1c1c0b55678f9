"""glTF animations: sampled as the specification says, and on our skeleton as the file's own bones stand."""

import numpy as np
import pytest
import rigs
from pose_twins import FINGERS, LIMBS, J, degrees_between, directions

from avatar.body import builtin_body
from avatar.gltf.document import read_gltf
from avatar.gltf.humanoid import find_naming, mixamo_names, vrm_names
from avatar.gltf.scene import node_parents, parents_first
from avatar.gltf.write import GltfBuilder
from avatar.motion.gltf import Channel, read_gltf_motion
from avatar.motion.read import builtin_motion, read_motion
from avatar.rotation import (
    matrix_from_axis_angle,
    matrix_from_quaternion,
    normalised_quaternion,
    quaternion_from_axis_angle,
    quaternion_product,
)
from avatar.skeleton import JOINTS, joint_transforms
from command.errors import AssetError


def add_animation(document, tracks, name="dance"):
    """Tracks (node, path, interpolation, times, values) as one animation with a buffer of its own."""
    buffers, views, accessors = (document.setdefault(key, []) for key in ("buffers", "bufferViews", "accessors"))
    built, samplers, channels = GltfBuilder(), [], []
    for node, path, interpolation, times, values in tracks:
        refs = [len(accessors) + built.add_accessor(np.asarray(array, "<f4")) for array in (times, values)]
        samplers.append({"input": refs[0], "output": refs[1], "interpolation": interpolation})
        channels.append({"sampler": len(samplers) - 1, "target": {"node": node, "path": path}})
    accessors += [one | {"bufferView": one["bufferView"] + len(views)} for one in built.accessors]
    views += [view | {"buffer": len(buffers)} for view in built.views]
    buffers.append(rigs.buffer_of(built))
    document.setdefault("animations", []).append({"name": name, "samplers": samplers, "channels": channels})
    return document


def pose_tracks(axis_angle, rate, root=None):
    """Tracks that turn every joint of a rig of ours as a pose says, and move its root."""
    times, q = np.arange(len(axis_angle)) / rate, quaternion_from_axis_angle(axis_angle)
    tracks = [(k, "rotation", "LINEAR", times, q[:, k]) for k in range(52)]
    return tracks if root is None else [*tracks, (0, "translation", "LINEAR", times, root)]


RADIAN = quaternion_from_axis_angle(np.array([[0.0, 0, 0], [0, 0, 1.0]]))


def turning(joint, times, keys=RADIAN, interpolation="LINEAR"):
    """A rig of ours one of whose joints turns, by a radian about z."""
    return add_animation(rigs.rig()[0], [(J[joint], "rotation", interpolation, times, keys)])


def skeleton_of(gltf):
    """The file's nodes alone, without what they show."""
    shown = "meshes skins materials textures images buffers bufferViews accessors animations".split()
    document = {key: value for key, value in gltf.json.items() if key not in shown}
    nodes = [{key: value for key, value in node.items() if key not in ("mesh", "skin")} for node in document["nodes"]]
    return document | {"nodes": nodes}


def random_poses(frames, seed=0, size=0.5):
    return np.random.default_rng(seed).normal(0, size, (frames, 52, 3))


def test_a_rig_with_our_joints_is_read_as_it_is(tmp_path, within):
    """pose -> animation -> pose, joint by joint."""
    document, _ = rigs.rig()
    poses, root = random_poses(7), np.random.default_rng(1).normal(0, 1, (7, 3))
    document = add_animation(document, pose_tracks(poses, 24, root))
    motion = read_motion(rigs.write(tmp_path / "a.gltf", document))
    assert (motion.frames, motion.rate) == (7, 24)
    clip = motion.read()
    difference = matrix_from_axis_angle(clip.axis_angle) - matrix_from_axis_angle(poses)
    within(difference, 1e-6)
    within(clip.root - root, 1e-6, "m")
    np.testing.assert_array_equal(motion.read(3, 5).axis_angle, clip.axis_angle[3:5])
    assert any("rotations read as they are" in note for note in motion.notes)


@pytest.mark.parametrize("person", ["White_M_1_Casual", "Asian_F_2_Casual"])
@pytest.mark.parametrize("blocks", [1, 3])
def test_limbs_point_where_the_characters_own_rig_points_them(tmp_path, data, within, person, blocks):
    """Local turns in the bones' own frames, which are not parallel to the world; against the rig's kinematics."""
    gltf = read_gltf(data / "characters" / f"{person}.glb")
    document = skeleton_of(gltf)
    naming = find_naming(gltf.path, gltf.json)
    frames, rng = 6, np.random.default_rng(3)
    times = np.arange(frames) / 30
    tracks, rotations = [], {}
    for node in naming.nodes.values():
        turn = quaternion_from_axis_angle(rng.normal(0, 0.35, (frames, 3)))
        rest = np.array(document["nodes"][node].get("rotation", [0, 0, 0, 1.0]))
        rotations[node] = quaternion_product(np.broadcast_to(rest, turn.shape), turn).astype(np.float32)
        tracks.append((node, "rotation", "LINEAR", times, rotations[node]))
    motion = read_gltf_motion(rigs.write(tmp_path / "a.gltf", add_animation(document, tracks)))
    assert motion.frames == frames

    parents = node_parents(gltf)
    world = np.tile(np.eye(4), (frames, len(parents), 1, 1))
    for node in parents_first(parents):
        item = document["nodes"][node]
        local = np.tile(np.eye(4), (frames, 1, 1))
        q = rotations.get(node, np.tile(item.get("rotation", [0, 0, 0, 1.0]), (frames, 1)))
        local[:, :3, :3] = matrix_from_quaternion(normalised_quaternion(q)) * np.array(item.get("scale", [1.0] * 3))
        local[:, :3, 3] = item.get("translation", [0, 0, 0])
        if "matrix" in item:
            local[:] = np.array(item["matrix"]).reshape(4, 4).T
        world[:, node] = local if parents[node] < 0 else world[:, parents[node]] @ local
    cuts = [round(k * frames / blocks) for k in range(blocks + 1)]
    parts = [motion.read(a, b) for a, b in zip(cuts[:-1], cuts[1:], strict=True)]
    pose, root = (np.concatenate([getattr(p, n) for p in parts]) for n in ("axis_angle", "root"))
    ours = joint_transforms(pose, builtin_body("male").joints, root)[..., :3, 3]
    theirs = np.stack([world[:, naming.nodes[j], :3, 3] for j in JOINTS], 1)
    bones = [*LIMBS, *FINGERS]
    within(degrees_between(directions(ours, bones), directions(theirs, bones)), 0.1, "degrees")


def test_one_turned_bone_turns_that_bone_alone(tmp_path, data):
    gltf = read_gltf(data / "characters" / "White_M_1_Casual.glb")
    document = skeleton_of(gltf)
    node = find_naming(gltf.path, gltf.json).nodes["left_elbow"]
    rest = np.array(document["nodes"][node].get("rotation", [0, 0, 0, 1.0]))
    turn = quaternion_from_axis_angle(np.array([[0, 0, 0], [0.3, -0.2, 0.9]]))
    values = quaternion_product(np.broadcast_to(rest, (2, 4)), turn)
    document = add_animation(document, [(node, "rotation", "LINEAR", [0, 1 / 30], values)])
    clip = read_gltf_motion(rigs.write(tmp_path / "a.gltf", document)).read()
    R = matrix_from_axis_angle(clip.axis_angle)
    relative = np.swapaxes(R[0], -1, -2) @ R[1]
    angle = np.arccos(np.clip((np.trace(relative, axis1=-2, axis2=-1) - 1) / 2, -1, 1))
    assert angle[J["left_elbow"]] == pytest.approx(np.linalg.norm([0.3, -0.2, 0.9]), abs=1e-4)
    assert np.delete(angle, J["left_elbow"]).max() < 1e-5


@pytest.mark.parametrize("kind", ["mixamo", "vrm1", "vrm0", "vrma"])
def test_other_names_give_the_same_motion(tmp_path, kind, within):
    """The same bones under other names go through the retargeting; on the body they came from nothing changes."""
    names = {"mixamo": mixamo_names(), "vrm1": vrm_names(1), "vrma": vrm_names(1), "vrm0": vrm_names(0)}[kind]
    mixamo = kind == "mixamo"
    document, _ = rigs.rig([f"mixamorig:{names[j]}" if mixamo else f"bone {j}" for j in JOINTS])
    bones = {names[j]: {"node": J[j]} for j in JOINTS}
    if kind == "vrm0":
        listed = [{"bone": b, **n} for b, n in bones.items()] + [{"bone": "jaw", "node": -1}]
        document["extensions"] = {"VRM": {"humanoid": {"humanBones": listed}}}
    elif not mixamo:
        extension = {"vrm1": "VRMC_vrm", "vrma": "VRMC_vrm_animation"}[kind]
        document["extensions"] = {extension: {"humanoid": {"humanBones": bones}}}
    clip = builtin_motion("walking").read(0, 12)
    document = add_animation(document, pose_tracks(clip.axis_angle, 30, clip.root))
    suffix = {"vrma": "vrma", "mixamo": "gltf"}.get(kind, "vrm")
    motion = read_motion(rigs.write(tmp_path / f"a.{suffix}", document))
    assert motion.rate == 30 and motion.frames == 12
    back = motion.read()
    # the spine is blended along its length, everything else is the file's
    a, b = (joint_transforms(c.axis_angle, builtin_body("male").joints, c.root) for c in (back, clip))
    limbs = [J[f"{s}_{n}"] for s in ("left", "right") for n in ("knee", "ankle", "elbow", "wrist", "index2", "thumb3")]
    within(np.abs((a - b)[:, limbs, :3, :3]), 1e-5)
    drop = (back.root - clip.root)[:, 1]
    within(drop - drop[0], 1e-5, "m")


def test_step_linear_and_spline_are_the_specifications():
    times = np.array([0.0, 1.0, 3.0])
    values = np.array([[0.0, 1, 2], [4.0, 1, 0], [0.0, 0, 0]], np.float32)
    at = np.array([-1.0, 0.5, 1.0, 2.0, 9.0])
    step = Channel(times, values, "STEP", False).at(at)
    np.testing.assert_array_equal(step, values[[0, 0, 1, 1, 2]])
    linear = Channel(times, values, "LINEAR", False).at(at)
    np.testing.assert_allclose(linear, [[0, 1, 2], [2, 1, 1], [4, 1, 0], [2, 0.5, 0], [0, 0, 0]])
    # a spline whose tangents are the derivative of t^2 + 1 is that parabola
    curve, slope = times**2 + 1, 2 * times
    keys = np.stack([slope, curve, slope], 1)[:, :, None] * np.ones(3)
    fine = np.linspace(0, 3, 31)
    np.testing.assert_allclose(
        Channel(times, keys, "CUBICSPLINE", False).at(fine), (fine**2 + 1)[:, None] * np.ones(3), atol=1e-12
    )
    # half of the float32 times lie behind those of the frames
    many = np.arange(200, dtype=np.float32)[:, None]
    frames = Channel((np.arange(200) / 30).astype(np.float32).astype(np.float64), many, "STEP", False)
    np.testing.assert_array_equal(frames.at(np.arange(200) / 30), many)
    one = Channel(np.array([2.0]), values[:1], "LINEAR", False)
    np.testing.assert_array_equal(one.at(at), values[[0] * 5])


def test_linear_rotations_take_the_short_way_whatever_the_sign():
    a = Channel(np.array([0.0, 1]), RADIAN, "LINEAR", True).at(np.array([0.5]))
    b = Channel(np.array([0.0, 1]), RADIAN * [[1], [-1]], "LINEAR", True).at(np.array([0.5]))
    half = matrix_from_axis_angle(np.array([[0, 0, 0.5]]))
    np.testing.assert_allclose(matrix_from_quaternion(a), half, atol=1e-12)
    np.testing.assert_allclose(matrix_from_quaternion(b), half, atol=1e-12)


def test_keys_far_apart_are_sampled_and_a_spline_through_zero_is_refused(tmp_path):
    motion = read_gltf_motion(rigs.write(tmp_path / "a.gltf", turning("left_elbow", [0.5, 2.5])))
    assert (motion.frames, motion.rate) == (61, 30)
    assert any("starts at 0.500 s" in n for n in motion.notes) and any("far apart" in n for n in motion.notes)
    elbow = motion.read().axis_angle[:, J["left_elbow"], 2]
    np.testing.assert_allclose(elbow, np.linspace(0, 1, 61), atol=1e-6)
    q, zero = np.array([0.0, 0, 0, 1]), np.zeros(4)
    document = turning("head", [0.0, 2.0], np.array([zero, q, zero, zero, -q, zero]), "CUBICSPLINE")
    with pytest.raises(AssetError, match="rotation of head passes zero"):
        read_gltf_motion(rigs.write(tmp_path / "a.gltf", document)).read()


def test_the_bind_pose_is_the_rest_pose_where_the_nodes_stand_in_another(tmp_path):
    """An exporter that left the nodes in the first frame of the dance."""
    document, _ = rigs.rig([f"mixamorig:{mixamo_names()[j]}" for j in JOINTS])
    poses = random_poses(5, 4, 0.3)
    poses[:, J["left_shoulder"], 2] = -1.2
    poses[:, J["right_shoulder"], 2] = 1.2
    for node, q in zip(document["nodes"], quaternion_from_axis_angle(poses[0]), strict=False):
        node["rotation"] = q.tolist()
    document = add_animation(document, pose_tracks(poses, 30))
    motion = read_gltf_motion(rigs.write(tmp_path / "a.gltf", document))
    assert any("the skin's bind pose" in n for n in motion.notes)
    joints = builtin_body("male").joints
    a = joint_transforms(motion.read().axis_angle, joints)
    b = joint_transforms(poses, joints)
    limbs = [J[f"{s}_{n}"] for s in ("left", "right") for n in ("knee", "ankle", "elbow", "wrist", "index2")]
    np.testing.assert_allclose(a[:, limbs, :3, :3], b[:, limbs, :3, :3], atol=1e-5)


FIRST = ("animations", 0)
SPOILT = {
    "no animation": ({("animations",): []}, "animations should be one at least"),
    "no humanoid": ({("nodes", k, "name"): "thing" for k in range(52)}, "no joint was found for left_hip"),
    "far node": ({(*FIRST, "channels", 0, "target", "node"): 9999}, r"channels\[0\].target.node should be an index"),
    # JOINTS_0
    "whole numbers": ({(*FIRST, "samplers", 0, "input"): 2}, r"samplers\[0\].input should be floats"),
    "interpolation": ({(*FIRST, "samplers", 0, "interpolation"): "SMOOTH"}, "STEP or CUBICSPLINE"),
    "short output": ({("accessors", -3, "count"): 1}, r"samplers\[0\].output should be \(2, 4\)"),
    "one node twice": ({(*FIRST, "channels", 1, "target", "node"): 0}, "the only one for its node"),
    "mirrored": ({("nodes", J["spine1"], "scale"): [-1, 1, 1]}, "a mirrored bone"),
    "huge": ({("nodes", J[f"spine{n}"], "scale"): [1e5] * 3 for n in (1, 2, 3)}, "below 1e9"),
    "listless": ({(*FIRST, "channels"): {"0": 1}}, "channels should be a list"),
}


@pytest.mark.parametrize("changes, message", SPOILT.values(), ids=SPOILT)
def test_what_cannot_be_played_is_refused_by_field(tmp_path, changes, message):
    tracks = [(k, "rotation", "LINEAR", [0.0, 0.5], RADIAN) for k in (0, J["left_knee"])]
    document = add_animation(rigs.rig()[0], tracks)
    for (*way, key), value in changes.items():
        holder = document
        for step in way:
            holder = holder[step]
        holder[key] = value
    with pytest.raises(AssetError, match=message) as error:
        read_gltf_motion(rigs.write(tmp_path / "bad.gltf", document))
    assert "bad.gltf" in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize("times", [[0.5, 0.0], [0.5, 0.5], [-1.0, 0.0], [0.0, 1e9]])
def test_times_that_do_not_run_forward_are_refused(tmp_path, times):
    with pytest.raises(AssetError, match="increasing seconds"):
        read_gltf_motion(rigs.write(tmp_path / "a.gltf", turning("head", times)))
