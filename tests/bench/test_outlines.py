"""Outlines of a person from eight sides."""

import numpy as np
import pytest
from icosphere import icosphere

from avatar.skeleton import PARTS
from avatar.skinning import SkinWeights
from bench.field.posed_field import PosableSurface
from bench.score.outlines import FOV, outline_scores
from bench.score.posed_geometry import geometry_case, posed_pair
from bench.score.true_mesh import TrueMesh

RADIUS = 0.2  # metres


def scores(rasteriser, radius: float, shift: float = 0.0, T=None):
    """A head of RADIUS, and ours: another ball, moved to a side."""
    (true, faces), (ours, own) = icosphere(RADIUS, subdivisions=4), icosphere(radius, (shift, 0, 0), 4)
    skin = SkinWeights(np.zeros((len(true), 4), np.int64), np.eye(1, 4, dtype=np.float32).repeat(len(true), 0))
    part, all_faces = np.full(len(true), PARTS.index("head")), np.ones(len(faces), bool)
    truth = TrueMesh(true, faces, skin, np.zeros((52, 3)), part, np.zeros(len(true), bool), all_faces)
    surface = PosableSurface(ours, own, skin, np.zeros((52, 3)), np.zeros((52, 3)))
    case = geometry_case(truth, surface, all_faces)
    return outline_scores(rasteriser, case, posed_pair(case, true, ours), T)


def test_a_ball_within_a_ball_covers_the_square_of_its_share_from_every_side(rasteriser):
    found = scores(rasteriser, 0.8 * RADIUS)
    assert found.keys() == {"total", "head"}
    # as a camera near the ball sees them
    away = 1.1 * RADIUS / np.tan(FOV / 2)
    share = 0.64 * (away**2 - RADIUS**2) / (away**2 - (0.8 * RADIUS) ** 2)
    for score in found.values():
        assert score.mean == pytest.approx(share, abs=0.01) and score.worst == pytest.approx(share, abs=0.02)


def test_what_is_moved_to_a_side_shows_from_the_front_and_not_from_that_side(rasteriser):
    found = scores(rasteriser, RADIUS, shift=RADIUS)["total"]
    # two circles whose middles lie a radius apart share .391 of either
    assert found.worst == pytest.approx(0.391 / (2 - 0.391), abs=0.04) and found.worst + 0.1 < found.mean < 0.9
    back = np.eye(4)
    back[0, 3] = -RADIUS
    assert scores(rasteriser, RADIUS, shift=RADIUS, T=back)["total"].worst > 0.99
