"""A bake that misses what it promises says so, with what to do."""

import json

from bake.bake import BakeOptions, bake_run
from bake.promises import missed_promises


def facts_with(paper_db=41.0, steps=(1.0, 2.0), view_db=40.0):
    mips = [{"p99": 9.0, "seen_p99": step} for step in steps]
    level = {"seam_step": {"mips": mips}, "texel_mm_by_part": {"body": 2.0}}
    against = {"paper_db": paper_db, "per_view_db": {"t body": view_db, "t head": None}}
    return {"against_field": against, "levels": [level], "texture_from": "field"}


def test_a_bake_that_keeps_its_promises_says_nothing():
    assert missed_promises(facts_with(), BakeOptions(), 7_000_000) == []


def test_each_promise_missed_is_one_line_with_what_to_do():
    lines = missed_promises(facts_with(34.71, (3.0, 9.87), 29.3), BakeOptions(), 20_000_000)
    assert len(lines) == 3
    assert "34.7 dB against the field, promised are 40" in lines[0]
    assert "t body, 29.3 dB" in lines[0] and "--faces 60000" in lines[0]
    assert "level 0" in lines[1] and "mip 1 9.9" in lines[1] and "mip 0" not in lines[1]
    assert "less than 425 px tall" in lines[1] and "selfscan inspect" in lines[1]
    assert "20.0 MB, promised are at most 12" in lines[2] and "--texture" in lines[2]


def test_textures_from_the_videos_promise_to_be_nearer_to_them_than_the_field_is():
    """Far from the field is what they are for."""
    facts = facts_with(34.71) | {"texture_from": "videos", "videos": {"head": {"rms_before": 9.0, "rms_after": 4.0}}}
    assert missed_promises(facts, BakeOptions(), 7_000_000) == []
    facts["videos"]["head"]["rms_after"] = 9.5
    (line,) = missed_promises(facts, BakeOptions(), 7_000_000)
    assert line.startswith("head: its video differs by 9.5") and "--texture-from field" in line


def test_more_texels_may_take_more_room():
    assert missed_promises(facts_with(), BakeOptions(texture=4096), 20_000_000) == []
    assert len(missed_promises(facts_with(), BakeOptions(texture=512), 20_000_000)) == 1


def test_what_was_missed_is_said_last_and_stands_in_the_file(run, small, tmp_path):
    lines = []
    avatar = bake_run(run, tmp_path / "a.glb", small, lines.append)
    missed = avatar.provenance["baked"]["missed"]
    assert missed and lines[-len(missed) :] == [f"missed: {line}" for line in missed]
    assert json.dumps(missed[0])[1:-1].encode() in (tmp_path / "a.glb").read_bytes()
