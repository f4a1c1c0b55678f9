"""Skin beside hair and stretched edges, on a plate of skin whose first columns are hair."""

import numpy as np
import pytest

from avatar.skeleton import JOINTS, PARTS
from avatar.skinning import SkinWeights
from bench.score.beside_hair import edges_at_hair, skin_beside_hair, skin_to_surface, stretched_edges
from bench.score.true_mesh import TrueMesh

HEAD = JOINTS.index("head")


def plate(hair_columns: int) -> TrueMesh:
    """An upright plate of 1 cm squares, 15 columns along x, 5 rows; it follows the head bone."""
    x, y = np.meshgrid(np.arange(16), np.arange(6), indexing="ij")
    vertices = np.stack([x.ravel() * 0.01, y.ravel() * 0.01, np.zeros(x.size)], 1)
    a = (np.arange(15)[:, None] * 6 + np.arange(5)).ravel()
    faces = np.concatenate([np.stack([a, a + 6, a + 7], 1), np.stack([a, a + 7, a + 1], 1)])
    skin = SkinWeights(np.full((96, 4), HEAD), np.tile(np.array([1, 0, 0, 0], np.float32), (96, 1)))
    hair = x.ravel() <= hair_columns if hair_columns else np.zeros(96, bool)
    return TrueMesh(vertices, faces, skin, np.zeros((52, 3)), np.full(96, PARTS.index("head")), hair,
                    np.ones(len(faces), bool))  # fmt: skip


def test_skin_beside_hair_ends_four_centimetres_from_it():
    truth = plate(5)
    columns = truth.vertices[truth.faces].mean(1)[:, 0]
    beside = columns[skin_beside_hair(truth)]
    assert beside.min() > 0.05  # none of it is hair
    # the last hair face's middle lies at 4.67 cm
    assert 0.083 < beside.max() < 0.0868


def test_without_hair_nothing_is_beside_it():
    truth = plate(0)
    assert not skin_beside_hair(truth).any()
    assert len(edges_at_hair(truth, truth.vertices, truth.faces)) == 0


def test_hair_that_nobody_sees_has_nothing_beside_it():
    truth = plate(5)
    truth.visible[truth.hair[truth.faces].any(1)] = False
    assert not skin_beside_hair(truth).any()


def test_skin_of_the_trunk_is_not_beside_hair_though_its_edges_are():
    truth = plate(5)
    truth.part[:] = PARTS.index("body")
    truth.skin.joints[:] = JOINTS.index("spine3")
    assert not skin_beside_hair(truth).any()
    assert len(edges_at_hair(truth, truth.vertices, truth.faces)) > 0


def test_skin_beside_hair_is_as_far_as_the_surface_lies_off_it():
    truth = plate(5)
    # in the canonical pose: the plate follows the head, which the big pose leaves alone
    canonical = truth.canonical()
    assert skin_to_surface(truth, canonical, truth.faces) == pytest.approx(0, abs=1e-9)
    assert skin_to_surface(truth, canonical + [0, 0, 0.007], truth.faces) == pytest.approx(0.007, abs=1e-6)
    assert skin_to_surface(plate(0), canonical, truth.faces) is None


def test_edges_are_counted_once_however_many_poses_stretch_them():
    truth = plate(5)
    rest = truth.vertices
    edges = edges_at_hair(truth, rest, truth.faces)
    assert len(np.unique(edges, axis=0)) == len(edges)
    opened = rest + [0.03, 0, 0] * (rest[:, :1] > 0.045)
    # the squares between the fourth and fifth centimetre: 6 edges across and 5 diagonals
    assert stretched_edges(edges, rest, [rest, opened, opened]) == 11
    # between skin and skin it is no matter of hair
    assert stretched_edges(edges, rest, [rest + [0.03, 0, 0] * (rest[:, :1] > 0.085)]) == 0
    assert stretched_edges(edges, rest, [rest, rest * 1.9]) == 0
    # a plate of tenths of a millimetre: three times as long is not to be seen
    assert stretched_edges(edges, rest * 0.01, [rest * 0.03]) == 0
