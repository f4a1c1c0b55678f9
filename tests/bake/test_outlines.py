"""A part goes back to its template where what it learned meets its film's outlines less well."""

from dataclasses import replace

import numpy as np
import pytest

from avatar.skeleton import PARTS
from bake.bake import bake_run
from bake.outlines import off_outline, worse_parts
from bake.run_capture import run_videos
from geometry.mesh import vertex_normals
from train.run import read_run
from train.surface import Surface


@pytest.fixture(scope="module")
def source(tiny_run):
    """A run whose surface is its template, and its videos."""
    run = read_run(tiny_run)
    subject, normals = run.subject, vertex_normals(run.subject.vertices, run.subject.faces)
    unseen = np.zeros((len(normals), 6))
    surface = Surface(
        subject.vertices, subject.faces, normals, subject.part, subject.skin, unseen[:, 0], unseen[:, :3], unseen,
        np.zeros_like(subject.part),
    )  # fmt: skip
    return replace(run.bake_source, surface=surface), run_videos(run.path, run.provenance, None)


def test_a_part_that_is_its_template_stays(source):
    worse, facts = worse_parts(*source)
    assert worse == {} and set(facts) == set(PARTS)
    assert all(0 < off["template"] == off["learned"] < 0.5 for off in facts.values())


def test_a_hand_that_grew_goes_and_one_that_learned_nothing_is_not_asked(source):
    run, videos = source
    subject = run.subject
    hand = subject.part == PARTS.index("hand_left")
    grown = subject.vertices + np.where(hand, 0.02, 0)[:, None] * vertex_normals(subject.vertices, subject.faces)
    swollen = replace(run, surface=replace(run.surface, vertices=grown))
    worse, facts = worse_parts(swollen, videos)
    assert list(worse) == ["hand_left"] and facts["hand_left"]["learned"] > 2 * facts["hand_left"]["template"]
    assert "of the film's area off" in worse["hand_left"]
    still = {part: fact | {"steps": 0} for part, fact in run.provenance["parts"].items()}
    assert worse_parts(replace(swollen, provenance=run.provenance | {"parts": still}), videos) == ({}, {})


class Begun(Exception):
    """A bake that began with these parts of its template."""


@pytest.mark.parametrize("estimated", [True, False])
def test_parts_go_back_where_the_person_was_fitted_and_none_of_who_was_given(
    run, small, videos, tmp_path, monkeypatch, estimated
):
    def begun(run, origin, options, clock, worse):
        raise Begun(sorted(worse))

    monkeypatch.setattr("bake.bake.extracted", begun)
    monkeypatch.setattr("bake.bake.worse_parts", lambda run, videos: ({"hand_left": "why"}, {}))
    lines = []
    with pytest.raises(Begun) as found:
        bake_run(run, tmp_path / "one.glb", small, lines.append, replace(videos, estimated=estimated))
    assert found.value.args == ((["hand_left"] if estimated else []),)
    assert ("hand_left: why: the template stays" in " ".join(lines)) == estimated


def test_outlines_are_compared_about_the_part_where_the_mask_is_known():
    mask = np.zeros((100, 100), bool)
    mask[20:60, 20:60] = True
    true, body = np.where(mask, 1, -1), np.full((100, 100), -1)
    body[70:90, 20:60] = 0
    wide = np.where(np.roll(mask, 1, 1) | mask, 1, body)
    off = off_outline([np.where(mask, 1, body), wide], mask, None, 1)
    assert off.tolist() == [0, 40, 1600], "a body that the mask lacks is far from the part"
    unsure = np.zeros_like(mask)
    unsure[:40] = True
    assert off_outline([true, wide], mask, unsure, 1).tolist() == [0, 20, 800]
    assert off_outline([body, body], mask, None, 1).tolist() == [0, 0, 0], "nothing shows the part"
