"""A face carried to the same face, larger: every point lands on itself, unless a template was registered beside it."""

from functools import cache

import numpy as np
import pytest
from painted_capture import free_subject

from avatar.face import SHAPES
from avatar.face_template import BODY
from bake.face.template import person_face
from experiments.face_correspondence import REGIONS, Scan, markdown, pair_scores, summary

NAMES = tuple(name for names, *_ in REGIONS.values() for name in names)
LIKE = ("mouthPucker", "eyeBlinkRight", "eyeBlinkLeft", *["browOuterUpRight", "browInnerUp"] * 2)


@cache
def scan(name: str, scale: float, beside: float) -> Scan:
    """The built-in man's face at a scale, its template so far to one side, metres."""
    person = person_face(free_subject("male"))
    points = scale * person.vertices
    uv = np.c_[np.arange(BODY) / BODY, np.zeros(BODY)] * 100
    offsets = person.face.offsets[[SHAPES.index(one) for one in LIKE], :BODY]
    there = person._replace(vertices=points + [beside, 0, 0])
    return Scan(name, points, person.skin, uv, NAMES, offsets, there, there)


@pytest.mark.parametrize("beside, least, most", [(0.0, 0.0, 0.01), (0.003, 1.5, 3.01)])
def test_points_land_as_far_off_as_a_template_lies_beside_the_person(beside, least, most):
    found = summary([pair_scores(scan("a", 1.0, 0.0), scan("b", 1.05, beside))])
    for region in REGIONS:
        assert found[region]["points"] > 15 and least <= found[region]["median_mm"] <= most
    # the same shapes on both: what differs comes from the template
    assert found["shapes"]["people_differ"] == 0 and (found["shapes"]["error_of_motion"] > 0.05) == (beside > 0)
    assert f"| mouth | of a test | {found['mouth']['points']} |" in markdown({"of a test": found})
