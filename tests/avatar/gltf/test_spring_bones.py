"""Spring bones of a .vrm as the file tells them, both versions alike, and what of it is refused or left out."""

import json

import numpy as np
import pytest
import rigs
from spring_vrm import LINKS, PONYTAIL, SETTINGS, TAIL, spring_vrm

from avatar.errors import AssetError
from avatar.gltf.avatar_file import read_avatar
from avatar.gltf.spring_bones import TIP
from avatar.gltf.vrm_avatar import RIM, texture_atlas
from avatar.skeleton import JOINTS
from avatar.springs import MOST_BONES

SPHERE = ("spine3", (0.01, 0.02, 0.03), (0.01, 0.02, 0.03), 0.1)
OWN = SETTINGS | {"stiffness": 1.7, "gravityPower": 0.3, "dragForce": 0.25, "hitRadius": 0.03}


def read(tmp_path, document):
    return read_avatar(rigs.write(tmp_path / "a.vrm", document))


@pytest.mark.parametrize("turn", [None, np.diag([-1.0, 1, -1])], ids=["to +z", "to -z"])
@pytest.mark.parametrize("version", [0, 1])
def test_both_versions_tell_the_same_bones_in_the_same_place(tmp_path, version, turn):
    document = spring_vrm(version, (PONYTAIL,), OWN, colliders=[SPHERE], center="head", turn=turn)
    avatar = read(tmp_path, document)
    springs, head = avatar.levels[0].springs, JOINTS.index("head")
    assert springs is not None and len(springs) == LINKS
    begins, step = np.array(PONYTAIL[1]), np.array(PONYTAIL[2])
    heads = avatar.joint_positions[head] + begins + np.arange(LINKS)[:, None] * step
    np.testing.assert_allclose(springs.heads, heads, rtol=0, atol=1e-6)
    np.testing.assert_allclose(springs.tails[:-1], heads[1:], rtol=0, atol=1e-6)
    # the last: a joint of its own, or 7 cm beyond
    last = step if version == 1 else TIP * step / np.linalg.norm(step)
    np.testing.assert_allclose(springs.tails[-1], heads[-1] + last, rtol=0, atol=1e-6)
    assert springs.parents.tolist() == [-1, 0, 1, 2, 3] and set(springs.joints.tolist()) == {head}
    assert (springs.stiffness == 1.7).all() and (springs.drag == 0.25).all() and (springs.radii == 0.03).all()
    np.testing.assert_allclose(springs.gravity, np.tile([0, -0.3, 0], (LINKS, 1)), rtol=0, atol=1e-12)
    assert set(springs.centers.tolist()) == {head} and springs.heeds.all()
    place = avatar.joint_positions[JOINTS.index("spine3")] + SPHERE[1]
    np.testing.assert_allclose(springs.collider_ends[:, 0], np.tile(place, (2, 1)), rtol=0, atol=1e-6)
    assert springs.collider_radii == pytest.approx([0.1])
    # the tube follows, the body does not; the head of the first bone stays
    follows = springs.follows.sum(1)
    assert (follows > 0.9).any() and (np.abs(follows).max(0) <= 1 + 1e-6)
    assert len(follows) == len(avatar.levels[0].positions)


def test_a_vrm_without_springs_has_none_and_is_drawn(tmp_path):
    document = spring_vrm(1)
    del document["extensions"]["VRMC_springBone"]
    avatar = read(tmp_path, document)
    assert avatar.levels[0].springs is None and avatar.default_view == "off"
    # both sides of what has two: the tube
    assert len(avatar.levels[0].positions) > sum(
        document["accessors"][mesh["primitives"][0]["attributes"]["POSITION"]]["count"] for mesh in document["meshes"]
    )
    assert any("VRM 1.0 joint names" in note for note in avatar.notes)


def broken(change, version=1):
    document = json.loads(json.dumps(spring_vrm(version, colliders=[SPHERE])))
    extensions = document["extensions"]
    told = extensions["VRMC_springBone"] if version == 1 else extensions["VRM"]["secondaryAnimation"]
    change(told, document)
    return document


def setter(*path):
    *above, last, value = path

    def change(told, document):
        for key in above:
            told = told[key]
        told[last] = value

    return change


JOINT = ("springs", 0, "joints", 1)
SHAPE = ("colliders", 0, "shape", "capsule")
REFUSED = [
    (setter(*JOINT, "node", 9999), r"springs\[0\].joints\[1\].node should be an index below"),
    (setter(*JOINT, "node", -1), r"joints\[1\].node should be an index below"),
    (setter(*JOINT, "node", "hair"), r"joints\[1\].node should be an index below"),
    (setter(*JOINT, "node", 3), r"joints\[1\].node should be below node"),
    (setter(*JOINT, "stiffness", -1), r"joints\[1\].stiffness should be a number from 0 to 10000, is -1"),
    (setter(*JOINT, "stiffness", True), "stiffness should be a number"),
    (setter(*JOINT, "dragForce", 1.5), "dragForce should be a number from 0 to 1"),
    (setter(*JOINT, "gravityDir", [0, -1]), "gravityDir should be three numbers"),
    (setter(*JOINT, "gravityDir", [0, -1, 1e30]), "gravityDir should be three numbers"),
    (setter(*JOINT, "hitRadius", -0.1), "hitRadius should be a number from 0"),
    (setter("springs", 0, "joints", 1, 7), r"joints\[1\] should be an object"),
    (setter("springs", 0, "joints", {}), "joints should be a list"),
    (setter("springs", 0, "colliderGroups", [3]), "colliderGroups should be indices below 1"),
    (setter("springs", 0, "center", 10**6), "center should be an index below"),
    (setter("springs", 5), "springs should be a list"),
    (setter("colliders", 0, "node", 12345), r"colliders\[0\].node should be an index below"),
    (setter(*SHAPE, "radius", -1), r"shape.capsule.radius should be a number from 0"),
    (setter(*SHAPE, "offset", "here"), r"shape.capsule.offset should be three numbers"),
    (setter("colliders", 0, "shape", {}), r"shape.sphere should be an object"),
    (setter("colliderGroups", 0, "colliders", [0, 99]), r"colliderGroups\[0\].colliders should be indices below 1"),
]


@pytest.mark.parametrize(("change", "line"), REFUSED, ids=[line for _, line in REFUSED])
def test_what_cannot_be_is_refused_in_one_line(tmp_path, change, line):
    with pytest.raises(AssetError, match=line) as error:
        read(tmp_path, broken(change))
    assert "\n" not in str(error.value) and "a.vrm" in str(error.value)


@pytest.mark.parametrize(
    ("change", "line"),
    [
        (setter("boneGroups", 0, "bones", [777]), r"boneGroups\[0\].bones should be indices below"),
        (setter("boneGroups", 0, "dragForce", None), r"boneGroups\[0\].dragForce should be a number"),
        (setter("boneGroups", 0, "gravityDir", {"x": "no"}), "gravityDir should be three numbers"),
        (setter("colliderGroups", 0, "colliders", 0, "radius", -2), r"colliders\[0\].radius should be a number"),
        (setter("colliderGroups", 0, "node", -3), r"colliderGroups\[0\].node should be an index"),
    ],
)
def test_so_is_what_cannot_be_in_version_0(tmp_path, change, line):
    with pytest.raises(AssetError, match=line):
        read(tmp_path, broken(change, 0))


def test_numbers_that_are_none_and_nodes_in_a_circle_are_refused(tmp_path):
    path = rigs.write(tmp_path / "a.vrm", spring_vrm(1))
    text = path.read_text()
    path.write_text(text.replace('"stiffness": 1.0', '"stiffness": NaN'))
    with pytest.raises(AssetError, match="NaN"):
        read_avatar(path)
    document = spring_vrm(1)
    chain = [joint["node"] for joint in document["extensions"]["VRMC_springBone"]["springs"][0]["joints"]]
    document["nodes"][chain[-1]]["children"] = [chain[1]]
    with pytest.raises(AssetError, match=r"child of one node|cycle"):
        read(tmp_path, document)


def test_silence_means_what_the_specification_says(tmp_path):
    def silent(told, document):
        told["springs"][0]["joints"] = [{"node": joint["node"]} for joint in told["springs"][0]["joints"]]

    springs = read(tmp_path, broken(silent)).levels[0].springs
    assert (springs.stiffness == 1).all() and (springs.drag == 0.5).all()
    assert not springs.gravity.any() and not springs.radii.any()


def test_what_cannot_swing_is_left_out_and_said(tmp_path):
    def body(told, document):
        # the head and its neck as springs, and a chain named twice
        head, neck = JOINTS.index("head"), JOINTS.index("neck")
        told["springs"].append({"joints": [{"node": neck}, {"node": head}]})
        told["springs"].append(told["springs"][0])

    avatar = read(tmp_path, broken(body))
    assert len(avatar.levels[0].springs) == LINKS
    assert any("1 spring bones are joints of the body" in note for note in avatar.notes)
    assert any(f"{LINKS} spring bones are named twice" in note for note in avatar.notes)

    def short(told, document):
        document["nodes"][told["springs"][0]["joints"][LINKS]["node"]]["translation"] = [0, 0, 0]

    avatar = read(tmp_path, broken(short))
    assert len(avatar.levels[0].springs) == LINKS - 1
    assert any("1 spring bones have no length" in note for note in avatar.notes)


def test_a_thousand_chains_are_cut_to_what_is_simulated(tmp_path):
    def crowd(told, document):
        for _ in range(1000):
            first = len(document["nodes"])
            document["nodes"] += [{"translation": [0, 0.05, 0], "children": [first + 1]}, {"translation": [0, 0.1, 0]}]
            document["nodes"][JOINTS.index("head")].setdefault("children", []).append(first)
            told["springs"].append({"joints": [{"node": first}, {"node": first + 1}]})

    avatar = read(tmp_path, broken(crowd))
    assert len(avatar.levels[0].springs) == MOST_BONES
    assert any(f"{1000 + LINKS} spring bones: those nearest to the body swing" in note for note in avatar.notes)
    assert set(avatar.levels[0].springs.near.max(1)) <= set(range(MOST_BONES))


def test_textures_share_one_picture_and_keep_their_colours():
    rng = np.random.default_rng(0)
    pictures = [rng.integers(0, 256, (64, 32, 3)).astype(np.uint8), np.full((1, 1, 3), 7, np.uint8)]
    atlas = texture_atlas([*pictures, pictures[0]])
    height, width = atlas.pixels.shape[:2]
    for number, picture in enumerate([*pictures, pictures[0]]):
        x, y = np.round(atlas.corners[number] * [width, height]).astype(int)
        w, h = np.round(atlas.sizes[number] * [width, height]).astype(int)
        assert np.array_equal(atlas.pixels[y : y + h, x : x + w], picture)
        assert np.array_equal(atlas.pixels[y - RIM, x], picture[0, 0])
    assert np.array_equal(atlas.corners[0], atlas.corners[2])


def test_the_tail_of_the_body_hangs_on_its_pelvis(tmp_path):
    avatar = read(tmp_path, spring_vrm(1, (PONYTAIL, TAIL)))
    springs = avatar.levels[0].springs
    assert sorted({JOINTS[joint] for joint in springs.joints.tolist()}) == ["head", "pelvis"]
    assert (springs.parents < 0).sum() == 2
