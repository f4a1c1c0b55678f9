"""`selfscan inspect`: what it measures on meshes whose answers are known, and the folder it writes."""

import dataclasses
import json
import re

import numpy as np
import pytest
from PIL import Image
from tiny_avatar import tiny_avatar, tiny_level, unit

from avatar.gltf.avatar_file import write_avatar
from avatar.skeleton import JOINTS
from bench.inspect import mesh_facts
from bench.inspect.accuracy_sections import from_field
from bench.inspect.colors import ABSENT, SEQUENTIAL, Ramp, rgb
from bench.inspect.command import inspect
from bench.inspect.options import InspectCommand, inspect_main
from bench.inspect.page import Check, PagePicture, PageSection, page
from capture.read.template import part_of
from command.errors import AssetError

CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float) * 0.1
SIDES = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])


def cube(image=None, inset=0.0):
    """A cube of 10 cm; each side is a chart of its own: 24 vertices, 12 triangles, textured side by side."""
    count = 24
    corner = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * (1 - 2 * inset) + inset
    uv = np.concatenate([(corner + [k, 0]) / [6, 1] for k in range(6)])
    faces = np.concatenate([[[4 * k, 4 * k + 1, 4 * k + 2], [4 * k, 4 * k + 2, 4 * k + 3]] for k in range(6)])
    joints = np.zeros((count, 4), np.uint8)
    weights = np.tile(np.array([255, 0, 0, 0], np.uint8), (count, 1))
    normals = unit(CUBE[SIDES].reshape(-1, 3) - 0.05)
    return dataclasses.replace(
        tiny_level(),
        positions=CUBE[SIDES].reshape(-1, 3).astype(np.float32),
        normals=normals,
        uv=uv.astype(np.float32),
        faces=faces.astype(np.uint32),
        joints=joints,
        weights=weights,
        view_dir=-normals,
        view_q=np.zeros((count, 6), np.float32),
        view_seen=np.ones(count, np.float32),
        base_color=np.full((20, 120, 3), 90, np.uint8) if image is None else image,
        features=None,
    )


def test_a_cut_cube_is_closed_once_welded_and_holes_fins_and_loose_pieces_are_counted():
    assert len(np.unique(mesh_facts.weld(cube()))) == 8
    assert mesh_facts.closedness(cube()) == (0, 0, 1)
    level = cube()
    open_cube = dataclasses.replace(level, faces=level.faces[:-2])
    assert mesh_facts.closedness(open_cube) == (4, 0, 1)
    fin = np.array([[0, 1, 10]], np.uint32)  # a third triangle on the edge of corners 0 and 1
    finned = dataclasses.replace(level, faces=np.concatenate([level.faces, fin]))
    assert mesh_facts.closedness(finned).crowded_edges >= 1
    far = dataclasses.replace(level, positions=level.positions + np.float32(1), faces=level.faces + np.uint32(24))
    of_vertices = [name for name, value in vars(level).items() if np.shape(value)[:1] == level.positions.shape[:1]]
    doubled = {name: np.concatenate([getattr(level, name), getattr(far, name)]) for name in [*of_vertices, "faces"]}
    both = dataclasses.replace(level, **doubled)
    assert mesh_facts.closedness(both) == (0, 0, 2)


def test_vertices_that_move_apart_are_not_welded_and_parts_follow_the_heaviest_joint():
    level = cube()
    joints = level.joints.copy()
    joints[:4, 0] = 7
    apart = dataclasses.replace(level, joints=joints)
    assert len(np.unique(mesh_facts.weld(apart))) == 12 and mesh_facts.closedness(apart).open_edges == 8
    joints = np.zeros((24, 4), np.uint8)
    joints[:, 0], joints[:, 1] = JOINTS.index("head"), JOINTS.index("left_index2")
    weights = np.zeros((24, 4), np.uint8)
    weights[:12, :2], weights[12:, :2] = [155, 100], [100, 155]
    level = dataclasses.replace(level, joints=joints, weights=weights)
    np.testing.assert_array_equal(part_of(level.skin), [1] * 12 + [2] * 12)
    assert mesh_facts.share_of_area(level, part_of(level.skin) == 1) == pytest.approx(0.5)


def test_seam_steps_are_those_of_the_colors_painted():
    rng = np.random.default_rng(0)
    level = cube(rng.integers(0, 256, (20, 120, 3), dtype=np.uint8))
    seams = mesh_facts.seams(level)
    assert len(seams.edges) == 12  # of a cube; diagonals are no seams
    assert seams.steps[0].max(0).min() > 0  # noise differs everywhere

    plain = np.full((64, 384, 3), 50, np.uint8)
    plain[:, 64:128] = 57  # one side of the cube in another color: its four edges step by 7, the others by nothing
    seams = mesh_facts.seams(cube(plain, inset=0.2))
    for steps in seams.steps[:3]:
        np.testing.assert_array_equal(np.sort(steps.max(0)), [0] * 8 + [7] * 4)


def test_cone_half_angles_are_those_of_the_clamp_and_a_ramp_meets_its_ends():
    level = cube()
    d = np.tile([0.0, 0.0, -1.0], (24, 1)).astype(np.float32)
    q = np.zeros((24, 6), np.float32)
    q[:, 0] = 1 / np.sin(np.radians(20)) ** 2 - 1  # along x: |t'| <= sin 20 degrees
    q[:, 3] = 1 / np.sin(np.radians(45)) ** 2 - 1  # along y
    level = dataclasses.replace(level, view_dir=d, view_q=q)
    np.testing.assert_allclose(np.sort(mesh_facts.cone_degrees(level), axis=1), np.tile([20, 45], (24, 1)), atol=1e-4)
    half = dataclasses.replace(level, view_seen=np.full(24, 0.5, np.float32))
    expected = np.degrees(np.arcsin(0.5 * np.sin(np.radians([20, 45]))))
    np.testing.assert_allclose(np.sort(mesh_facts.cone_degrees(half), axis=1)[0], expected, atol=1e-4)
    colors = Ramp(0.0, 10.0).colors(np.array([-1.0, 0.0, 5.0, 10.0, 99.0, np.nan]))
    first, *_, last = SEQUENTIAL
    np.testing.assert_array_equal(colors[[0, 1, 3, 4, 5]], rgb([first, first, last, last, ABSENT]))
    between = rgb(SEQUENTIAL[2:4]).mean(0)
    assert np.abs(colors[2] - between).max() <= 0.5
    one = PagePicture("one", b"\x89PNG", 'says "hi"')
    text = page("<b>Eve</b>", ["from a & b"], [Check("size", "1 MB", "12 MB", True), Check("hole", "2", "0", False)],
                [PageSection("look", [one], None, [("x",), ("<i>",)], "a < b")])  # fmt: skip
    assert "&lt;b&gt;Eve&lt;/b&gt;" in text and "<b>Eve" not in text and "a &lt; b" in text and "&lt;i&gt;" in text
    assert 'src="data:image/png;base64,iVBORw==' in text and "says &quot;hi&quot;" in text
    assert re.findall(r'(?:src|href)="(?!data:|#)', text) == [] and "<script" not in text and "url(" not in text
    assert ">good<" in text and ">look<" in text


def test_distance_to_a_field_is_the_farthest_of_corners_and_centre():
    level = cube()

    def plane(points):  # distance above y = 4 cm
        return points[:, 1] - 0.04

    found = from_field(level, plane)
    corners = level.positions.astype(float)[level.faces][..., 1]
    y = np.concatenate([corners, corners.mean(1, keepdims=True)], axis=1) - 0.04
    expected = 1e3 * y[np.arange(12), np.abs(y).argmax(1)]
    np.testing.assert_allclose(found, expected, atol=1e-4)
    assert found.max() == pytest.approx(60, abs=1e-3) and found.min() == pytest.approx(-40, abs=1e-3)


@pytest.fixture
def person(tmp_path):
    """A cube for a head and a face-less tiny avatar for the rest: two levels with a view network."""
    avatar = tiny_avatar()
    write_avatar(tmp_path / "eve.glb", avatar)
    return tmp_path / "eve.glb"


def test_the_folder_holds_a_page_with_every_picture_and_the_numbers(person, tmp_path, monkeypatch, capfd):
    pytest.importorskip("pyvista")
    monkeypatch.setenv("DISPLAY", ":77")  # no such display: VTK must not be sent to look for it
    out = tmp_path / "out"
    arguments = [str(person), "-o", str(out), "--size", "64"]
    assert inspect_main(arguments) == 0
    said = capfd.readouterr()
    assert "X server" not in said.err and f"{out}/inspect.html:" in said.out
    text = (out / "inspect.html").read_text()
    pictures = sorted(p.stem for p in out.iterdir() if p.suffix == ".png")
    assert text.count("<img ") == len(pictures)
    names = "look_off look_network look_change face cones seen triangles parts weights seams_mip0"
    assert set(names.split()) <= set(pictures)
    for name in pictures:
        with Image.open(out / f"{name}.png") as image:
            assert np.asarray(image.convert("RGB")).std() > 1  # something is drawn
    with Image.open(out / "parts.png") as image:
        assert image.size == (64 * 3, 64)
    facts = json.loads((out / "inspect.json").read_text())
    assert facts["levels"][0]["faces"] == 6 and facts["bytes"] == person.stat().st_size
    assert {check["what"] for check in facts["checks"] if check["good"] is False} >= {
        "open edges, and edges of more than two triangles, level by level"
    }
    # a second time replaces it; a folder of someone else's is not touched
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "file").write_text("mine")
    with pytest.raises(AssetError, match="expected an empty or absent folder"):
        inspect(InspectCommand(person, tmp_path / "other", size=64))
    assert (tmp_path / "other" / "file").read_text() == "mine"


def test_bad_input_is_told_and_leaves_nothing(person, tmp_path):
    with pytest.raises(AssetError, match="nowhere"):
        inspect_main([str(person), "-o", str(tmp_path / "out"), "--run", str(tmp_path / "nowhere")])
    assert not (tmp_path / "out").exists()
