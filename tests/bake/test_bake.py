import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from tiny_avatar import tiny_avatar

from avatar.gltf.avatar_file import read_avatar
from avatar.skeleton import PARTS
from avatar.skinning import SkinWeights
from bake.bake import (
    BakeOptions,
    _Clock,
    bake_run,
    broken_parts,
    extracted,
    level_plan,
    run_surface,
    shown_surface,
    unseen_lines,
    written,
)
from bake.promises import missed_promises
from command.errors import AssetError
from geometry.closest import closest_points, triangle_index
from geometry.mesh import TriangleMesh
from geometry.repair import find_faults


@pytest.fixture(scope="module")
def baked(run, small, tmp_path_factory):
    folder = tmp_path_factory.mktemp("baked")
    lines = []
    bake_run(run, folder / "one.glb", small, lines.append)
    return folder, lines


def welded(level):
    """The level's triangles with the copies that the atlas made of a vertex merged again."""
    _, index = np.unique(level.positions, axis=0, return_inverse=True)
    return index.reshape(-1)[level.faces.astype(np.int64)]


@pytest.mark.slow
def test_same_run_bakes_to_the_same_bytes(run, small, baked):
    folder, _ = baked
    bake_run(run, folder / "two.glb", small, lambda line: None)
    assert (folder / "one.glb").read_bytes() == (folder / "two.glb").read_bytes()


def test_file_holds_what_was_promised(baked, run):
    avatar = read_avatar(baked[0] / "one.glb")
    # this field's color ignores the direction
    assert avatar.default_view == "off" and avatar.network is None
    level, coarse = avatar.levels
    assert len(coarse.faces) <= 1_000 < len(level.faces) <= 2_000
    for one, texels in ((level, 256), (coarse, 64)):
        assert not find_faults(welded(one), len(one.positions))
        assert (one.weights.astype(int).sum(1) == 255).all()
        assert one.base_color.shape == (texels, texels, 3)
    assert np.abs(np.ptp(level.positions, axis=0) - np.ptp(coarse.positions, axis=0)).max() < 0.02
    np.testing.assert_allclose(np.linalg.norm(level.view_dir, axis=1), 1, atol=1e-3)
    facts = avatar.provenance["baked"]
    assert facts["against_field"]["paper_db"] > 24
    assert facts["levels"][0]["field_to_mesh_mm"]["mean"] < 1.5
    assert avatar.provenance["preset"] == "analytic"


def test_levels_go_down_to_a_thousand_triangles_and_a_good_bake_says_nothing():
    assert level_plan(BakeOptions()) == [(30_000, 2048), (10_000, 1024), (3_000, 512), (1_000, 256)]
    assert level_plan(BakeOptions(faces=3_000, texture=128)) == [(3_000, 128), (1_000, 64)]
    assert level_plan(BakeOptions(faces=1_000, texture=256)) == [(1_000, 256)]
    assert missed_promises(facts_with(), BakeOptions(), 7_000_000) == []
    assert missed_promises(facts_with(), BakeOptions(texture=4096), 20_000_000) == []
    assert len(missed_promises(facts_with(), BakeOptions(texture=512), 20_000_000)) == 1


@pytest.fixture(scope="module")
def sheen(sheen_run, small, tmp_path_factory):
    folder = tmp_path_factory.mktemp("sheen")
    bake_run(sheen_run, folder / "sheen.glb", small, lambda line: None)
    return folder, read_avatar(folder / "sheen.glb")


@pytest.mark.slow
def test_sheen_ships_a_view_mode_that_is_nearer_to_the_cone_field(sheen):
    folder, avatar = sheen
    assert avatar.default_view in ("network", "linear")
    facts = avatar.provenance["baked"]
    scores = facts["against_field"]["cone_db"]
    assert scores[avatar.default_view] >= scores["off"] + 0.5 and set(scores) >= {"off", "vertex", "linear"}
    for group in ("novel_view", "novel_pose"):
        apart = facts["against_field"][group]["cone_db"]
        assert apart[avatar.default_view] > apart["off"] and facts["against_field"][group]["paper_db"] > 24
    assert (folder / "sheen.onnx").exists() == (avatar.network is not None)


@pytest.mark.slow
def test_a_hand_that_broke_off_is_named_and_goes_back_to_its_template(run, small, monkeypatch):
    # which would hold the hand's middle
    monkeypatch.setattr("bake.layers.solid_inside", lambda distance, subject: distance)
    hand = run.surface.vertices[run.surface.part == PARTS.index("hand_left")]
    low, high = (torch.tensor(edge, dtype=torch.float32) for edge in (hand.min(0) - 0.05, hand.max(0) + 0.05))
    whole = run.field.distance
    lost = lambda points: torch.where(((points > low) & (points < high)).all(1), 0.05, whole(points))
    asked, lines = [], []

    def with_templates(names):
        asked.append(set(names))
        return run.field

    broken = replace(run, field=replace(run.field, distance=lost), with_templates=with_templates)
    origin, clock = run_surface(run.surface), _Clock(lines.append)
    found = extracted(broken, origin, small, clock)
    assert asked == [{"hand_left"}] and list(found.given_up) == ["hand_left"]
    assert not broken_parts(found.extraction.mesh, origin.vertices, origin.part)
    assert "of hand_left is more than 3 cm" in lines[0] and "the template stays for hand_left" in lines[0]
    with pytest.raises(AssetError, match="of hand_left is more than 3 cm"):
        extracted(replace(broken, with_templates=None), origin, small, clock)
    # one that is given up before is not asked for twice
    asked.clear()
    found = extracted(broken, origin, small, clock, {"hand_left": "why"})
    assert asked == [{"hand_left"}] and found.given_up == {"hand_left": "why"}


def test_a_head_that_was_given_up_is_whole_again_where_it_had_learned_to_be_thinner(run, small):
    head = run.surface.part == PARTS.index("head")
    thin = np.where(head[:, None], run.surface.vertices - 0.04 * run.surface.normals, run.surface.vertices)
    source = replace(run, surface=replace(run.surface, vertices=thin), with_templates=lambda names: run.field)
    found = extracted(source, run_surface(source.surface), small, _Clock(lambda line: None), {"head": "why"})
    mesh = found.extraction.mesh
    away = closest_points(run.surface.vertices[head], triangle_index(mesh.vertices, mesh.faces)).distance
    assert away.max() < 1e-3


def test_a_part_that_was_given_up_is_measured_where_the_extracted_surface_has_it(run):
    origin = run_surface(run.surface)
    hand = origin.part == PARTS.index("hand_left")
    template = TriangleMesh(origin.vertices + [0.01, 0, 0], origin.faces)
    shown, normals = shown_surface(origin, run.surface.normals, template, {"hand_left": "why"})
    assert hand.any() and np.abs(shown.vertices[hand] - origin.vertices[hand]).max() > 1e-3
    index = triangle_index(template.vertices, template.faces)
    assert closest_points(shown.vertices[hand], index).distance.max() < 1e-9
    np.testing.assert_array_equal(shown.vertices[~hand], origin.vertices[~hand])
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-6)
    assert shown_surface(origin, run.surface.normals, template, {})[0].vertices.tolist() == origin.vertices.tolist()


def facts_with(paper_db=41.0, steps=(1.0, 2.0), view_db=40.0):
    mips = [{"p99": 9.0, "seen_p99": step} for step in steps]
    level = {"seam_step": {"mips": mips}, "texel_mm_by_part": {"body": 2.0}}
    against = {"paper_db": paper_db, "per_view_db": {"t body": view_db, "t head": None}}
    return {"against_field": against, "levels": [level], "texture_from": "field"}


def test_a_neck_that_the_heads_video_shows_is_not_said_to_be_unseen(run):
    """A surface that is all neck, and that no frame shows."""
    count = len(run.surface.vertices)
    skin = SkinWeights(np.tile([12, 0, 0, 0], (count, 1)), np.tile(np.float32([1, 0, 0, 0]), (count, 1)))
    neck = replace(run, surface=replace(run.surface, skin=skin, view_count=np.zeros_like(run.surface.view_count)))
    surface = run_surface(neck.surface)
    without, shown = (" ".join(unseen_lines(neck, surface, collar=collar)) for collar in (False, True))
    assert "the neck" in without and shown == ""


def test_the_network_of_an_earlier_avatar_does_not_stay_beside_one_without(tmp_path):
    out, options = tmp_path / "a.glb", BakeOptions()
    for avatar in (tiny_avatar(), tiny_avatar(network=None, default_view="linear")):
        written(avatar, out, facts_with(), options, _Clock(lambda line: None))
        assert out.with_suffix(".onnx").exists() == (avatar.network is not None)


def test_each_promise_missed_is_one_line_with_what_to_do():
    lines = missed_promises(facts_with(34.71, (3.0, 9.87), 29.3), BakeOptions(), 20_000_000)
    assert len(lines) == 3
    assert "34.7 dB against the field, promised are 40" in lines[0]
    assert "t body, 29.3 dB" in lines[0] and "--faces 60000" in lines[0]
    assert "level 0" in lines[1] and "mip 1 9.9" in lines[1] and "mip 0" not in lines[1]
    assert "less than 425 px tall" in lines[1] and "selfscan inspect" in lines[1]
    assert "20.0 MB, promised are at most 12" in lines[2] and "--texture" in lines[2]


def test_no_more_triangles_are_advised_than_can_be_baked():
    (line,) = missed_promises(facts_with(34.7), BakeOptions(faces=120_000), 7_000_000)
    assert "--faces 150000" in line
    (line,) = missed_promises(facts_with(34.7), BakeOptions(faces=150_000), 7_000_000)
    assert "--faces" not in line and "selfscan inspect" in line
    with pytest.raises(ValueError, match="faces: expected at most 150000"):
        BakeOptions(faces=240_000)


def test_textures_from_the_videos_promise_to_be_nearer_to_them_than_the_field_is():
    """Far from the field is what they are for."""
    facts = facts_with(34.71) | {"texture_from": "videos", "videos": {"head": {"rms_before": 9.0, "rms_after": 4.0}}}
    assert missed_promises(facts, BakeOptions(), 7_000_000) == []
    facts["videos"]["head"]["rms_after"] = 9.5
    (line,) = missed_promises(facts, BakeOptions(), 7_000_000)
    assert line.startswith("head: its video differs by 9.5") and "--texture-from field" in line


@pytest.mark.slow
def test_what_was_missed_is_said_last_and_stands_in_the_file(run, small, tmp_path):
    lines = []
    avatar = bake_run(run, tmp_path / "a.glb", small, lines.append)
    missed = avatar.provenance["baked"]["missed"]
    assert missed and lines[-len(missed) :] == [f"missed: {line}" for line in missed]
    assert json.dumps(missed[0])[1:-1].encode() in (tmp_path / "a.glb").read_bytes()
