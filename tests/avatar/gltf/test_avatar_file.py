import dataclasses
import io

import numpy as np
import pytest
import rigs
import trimesh
from node_packages import package_folder, run_node
from PIL import Image
from tiny_avatar import same, tiny_avatar, tiny_face, tiny_level, unit

from avatar.gltf import avatar_file
from avatar.gltf.avatar_file import read_avatar, write_avatar
from avatar.gltf.document import read_gltf
from avatar.gltf.scene import read_primitive, read_skin, world_from_node
from avatar.light import CaptureLight, Lamp
from avatar.skeleton import JOINTS, joint_transforms, skin_transforms
from avatar.skinning import SkinWeights, skin_points
from command.errors import AssetError


@pytest.fixture
def path(tmp_path):
    return tmp_path / "tiny.glb"


def oracle(**changes):
    level = tiny_level(features=False)
    nothing = {"levels": (level,), "network": None, "linear": None, "default_view": "off"}
    return tiny_avatar(**(nothing | changes))


# under a light that varies over it, some of it loose
LIGHT = CaptureLight(0.4, (Lamp((0.0, 0.6, 0.8), 0.5),), gloss=0.1, gamma=2.2, frame="world")
LIT = dataclasses.replace(
    tiny_level(features=False),
    light=np.linspace(0.5, 1.5, 16, dtype=np.float32).reshape(8, 2),
    loose=np.linspace(0, 1, 8, dtype=np.float32),
)


@pytest.mark.parametrize(
    "avatar",
    [
        tiny_avatar(),
        oracle(),
        tiny_avatar(network=None, default_view="linear"),
        tiny_avatar(linear=None, default_view="off"),
        oracle(levels=(LIT,), light=LIGHT),
        tiny_face(),
    ],
)
def test_an_avatar_comes_back_to_the_last_bit(path, avatar):
    write_avatar(path, avatar)
    assert same(read_avatar(path), avatar)


def test_of_the_levels_only_those_wanted_are_decoded(path, monkeypatch):
    avatar = tiny_avatar()
    write_avatar(path, avatar)
    decoded = []
    decode = avatar_file.decode_png

    def counted(*arguments):
        decoded.append(arguments)
        return decode(*arguments)

    monkeypatch.setattr(avatar_file, "decode_png", counted)
    read = read_avatar(path, levels=1)
    assert len(read.levels) == 1
    assert same(read, dataclasses.replace(avatar, levels=avatar.levels[:1]))
    few = len(decoded)
    assert same(read_avatar(path, levels=99), avatar)
    assert 0 < few < len(decoded) - few


def test_the_same_avatar_gives_the_same_bytes_and_trimesh_loads_its_finest_level(path):
    write_avatar(path, tiny_avatar())
    first = path.read_bytes()
    write_avatar(path, read_avatar(path))
    assert path.read_bytes() == first
    avatar = tiny_avatar()
    write_avatar(path, avatar)
    scene = trimesh.load_scene(path)
    (name,) = scene.graph.nodes_geometry
    mesh = scene.geometry[scene.graph[name][1]]
    np.testing.assert_array_equal(mesh.faces, avatar.levels[0].faces)
    np.testing.assert_allclose(mesh.vertices, avatar.levels[0].positions)
    texture = mesh.visual.material.baseColorTexture
    np.testing.assert_array_equal(np.array(texture), avatar.levels[0].base_color)


@pytest.mark.parametrize("vertices, width", [(65534, 2), (65536, 4)])
def test_indices_widen_when_the_vertices_ask_for_it(path, vertices, width):
    level = dataclasses.replace(tiny_level(vertices=vertices), faces=np.array([[0, 1, vertices - 1]], dtype=np.uint32))
    write_avatar(path, oracle(levels=(level,)))
    indices = read_gltf(path).json["meshes"][0]["primitives"][0]["indices"]
    assert read_gltf(path).accessor(indices).itemsize == width
    np.testing.assert_array_equal(read_avatar(path).levels[0].faces, level.faces)


def test_a_plain_viewer_opens_the_finest_level_in_pose_zero(path):
    avatar = tiny_avatar()
    write_avatar(path, avatar)
    gltf = read_gltf(path)
    assert gltf.json["scenes"][gltf.json["scene"]]["nodes"] == [0, 52]
    (bearer,) = [node for node in gltf.items("nodes") if "mesh" in node]
    skin, drawn = read_skin(gltf, bearer["skin"]), read_primitive(gltf, bearer["mesh"])
    assert [gltf.items("nodes")[node]["name"] for node in skin.nodes] == list(JOINTS)

    by_joint = world_from_node(gltf)[list(skin.nodes)] @ skin.joint_from_mesh  # glTF 2.0, 3.7.3.3
    level, zero = avatar.levels[0], np.zeros((52, 3))
    weights = level.skin
    posed = skin_points(level.positions.astype(float), weights, skin_transforms(zero, avatar.joint_positions))
    as_viewer = SkinWeights(drawn.attributes["JOINTS_0"].astype(int), drawn.attributes["WEIGHTS_0"])
    found = skin_points(drawn.attributes["POSITION"].astype(float), as_viewer, by_joint)
    np.testing.assert_allclose(found, posed, atol=1e-6)
    world = joint_transforms(zero, avatar.joint_positions)[:, :3, 3]
    np.testing.assert_allclose(world_from_node(gltf)[:52, :3, 3], world, atol=1e-12)


def test_four_features_lie_as_grey_planes_one_below_the_other(path):
    avatar = tiny_avatar()
    write_avatar(path, avatar)
    gltf = read_gltf(path)
    for item, level in zip(gltf.json["extensions"]["SELFSCAN_avatar"]["levels"], avatar.levels, strict=True):
        image = Image.open(io.BytesIO(gltf.image(item["featureImage"])))
        # no color profile, no gamma: nothing for a decoder to apply
        assert image.mode == "L" and not image.info
        np.testing.assert_array_equal(np.array(image), np.concatenate([level.features[..., i] for i in range(4)]))


@pytest.mark.parametrize("avatar", [tiny_avatar(), oracle(), tiny_face()])
def test_the_khronos_validator_finds_no_error_and_no_warning(path, avatar):
    folder = package_folder("gltf-validator")
    write_avatar(path, avatar)
    issues = run_node("validate_gltf.mjs", path, folder)["issues"]
    assert (issues["numErrors"], issues["numWarnings"]) == (0, 0), issues["messages"]


def changed(field, row, value):
    """The tiny avatar with one row of one field of its first level replaced."""
    level = tiny_level()
    values = getattr(level, field).copy()
    values[row] = value
    return oracle(levels=(dataclasses.replace(level, **{field: values}),))


def changed_face(**fields):
    """The tiny face with other fields."""
    level, *others = tiny_face().levels
    face = dataclasses.replace(level.face, **fields)
    return dataclasses.replace(tiny_face(), levels=(dataclasses.replace(level, face=face), *others))


def moved_pelvis():
    joints = tiny_avatar().joint_positions.copy()
    joints[0] = 0, 0.9, 0
    return joints


NETWORK = tiny_avatar().network
BROKEN = [
    (tiny_avatar(network=dataclasses.replace(NETWORK, b2=np.full(3, np.inf, "f4"))), r"network.b2 should be finite"),
    (changed("normals", 2, 0), r"levels\[0\].normals should be of unit length, is .* in row 2"),
    (changed("view_q", 1, [-1, 0, 0, 0, 0, 0]), r"levels\[0\].view_q should be positive semi-definite"),
    (changed("view_q", 1, [1, 2, 0, 1, 0, 0]), r"levels\[0\].view_q should be positive semi-definite"),
    (changed("view_seen", 1, 1.5), r"levels\[0\].view_seen should be from 0 to 1, is 1.5 in row 1"),
    (oracle(levels=(dataclasses.replace(LIT, loose=LIT.loose + 0.5),), light=LIGHT), r"\.loose should be from 0 to 1"),
    (changed("joints", 4, [3, 3, 3, 3]), r"levels\[0\].joints should be each joint once"),
    (oracle(default_view="network"), "default_view is 'network', but the avatar has no network"),
    (tiny_avatar(levels=(tiny_level(features=False),)), r"but levels\[0\] has no features"),
    (tiny_avatar(levels=tiny_avatar().levels[::-1]), r"finest to coarsest, have \[3, 6\] faces"),
    (oracle(levels=(LIT,)), "light should be in the avatar and all of its levels"),
    (changed_face(vertices=np.array([3, 0, 7], np.uint32)), r"levels\[0\].face.vertices should be .* ascending"),
    (changed_face(vertices=np.array([0, 3, 9], np.uint32)), r"face.vertices should be outside of the balls"),
    (changed_face(balls=np.array([[8, 3], [10, 2]], np.uint32)), r"face.balls should be two runs"),
    (changed_face(balls=np.array([[6, 2], [10, 2]], np.uint32)), r"face.vertices should be outside|bound to the head"),
    (changed_face(offsets=np.ones((52, 3, 3), "f4")), r"face.offsets should be below 1.0 m"),
    (dataclasses.replace(tiny_face(), eyes=None), "eyes should be there where a level has a face"),
    (changed_face(offsets=0.5 * tiny_face().levels[0].face.offsets), r"face.follow should be what the offsets are"),
    (dataclasses.replace(tiny_face(), levels=tiny_face().levels[1:]), "face.follow should be below a finest level"),
    (oracle(joint_positions=moved_pelvis()), "pelvis at the origin, has it at"),
    (oracle(provenance={"psnr": float("nan")}), "provenance should be what JSON holds"),
    (oracle(provenance={"psnr": np.float32(1)}), "provenance should be what JSON holds"),
]


@pytest.mark.parametrize("avatar, message", BROKEN)
def test_a_broken_promise_is_named_and_the_old_file_stays(path, avatar, message):
    path.write_bytes(b"old")
    with pytest.raises(ValueError, match=message):
        write_avatar(path, avatar)
    assert path.read_bytes() == b"old" and [p.name for p in path.parent.iterdir()] == ["tiny.glb"]


def test_influences_of_no_weight_name_joint_zero_and_unit_is_kept_by_float32(path):
    level = tiny_level()
    weights = np.tile(np.array([255, 0, 0, 0], np.uint8), (len(level.weights), 1))
    write_avatar(path, oracle(levels=(dataclasses.replace(level, weights=weights),)))
    found = read_avatar(path).levels[0].joints
    np.testing.assert_array_equal(found[:, 0], level.joints[:, 0])
    assert not found[:, 1:].any()
    # Directions normalised in float32 pass the reader's check of their length.
    directions = unit(np.random.default_rng(0).normal(size=(8, 3)) * 1e-20)
    write_avatar(path, oracle(levels=(dataclasses.replace(tiny_level(), view_dir=directions),)))
    np.testing.assert_array_equal(read_avatar(path).levels[0].view_dir, directions)


@pytest.mark.parametrize("extension", ["VRM", "VRMC_vrm"])
def test_a_vrm_is_refused_with_what_can_be_done_with_it(tmp_path, extension):
    document, _ = rigs.rig()
    document["extensions"] = {extension: {"humanoid": {"humanBones": []}}}
    person = rigs.write(tmp_path / "person.vrm", document)
    with pytest.raises(AssetError, match=f"a VRM person, not a baked avatar: `selfscan synth {person} OUT`.*--motion"):
        read_avatar(person)
