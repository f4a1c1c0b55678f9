"""Eyes get finer cells, more triangles and more texels: what a field's details come to in a bake."""

from dataclasses import replace

import numpy as np
from capsules import ball_mesh

from bake.atlas import unwrap
from bake.level import enlargements, magnifiers
from bake.options import BakeOptions
from geometry.decimate import Magnifier, magnified
from geometry.isosurface import Detail

EYE = Detail(np.array([-0.015, -0.01, 0.085]), np.array([0.015, 0.01, 0.105]), 0.001)


def test_a_field_s_details_are_magnified_before_head_and_hands():
    options = BakeOptions()
    joints = np.random.default_rng(0).normal(size=(52, 3))
    plain, eyed = enlargements(joints, options), enlargements(joints, options, (EYE,))
    assert len(eyed) == len(plain) + 1 and len(plain) == 3
    first = eyed[0]
    assert isinstance(first, Magnifier) and first.scale == options.eye_scale > 1
    np.testing.assert_allclose(first.centre, [0, 0, 0.095])
    assert first.radius == 0.015
    assert magnifiers((EYE,), replace(options, eye_scale=3.0))[0].scale == 3.0


def test_magnified_charts_have_finer_texels_at_the_eye_alone():
    mesh = ball_mesh(step=0.006)
    part = np.zeros(len(mesh.faces), np.int64)
    middle = mesh.vertices[mesh.faces].mean(1)
    near = np.linalg.norm(middle - 0.5 * (EYE.low + EYE.high), axis=1) < 0.015
    far = middle[:, 2] < 0

    def texels(vertices):
        """Of each part of the surface, per square metre."""
        chart = unwrap(vertices, mesh.faces, part, np.ones(1), size=256, padding=2)
        a, b, c = (256 * chart.uv[chart.faces[:, i]] for i in range(3))
        covered = 0.5 * np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
        return covered[near].sum() / near.sum(), covered[far].sum() / far.sum()

    (eye, back), (fine, behind) = (
        texels(mesh.vertices),
        texels(magnified(mesh.vertices, magnifiers((EYE,), BakeOptions()))),
    )
    assert fine / behind > 3 * eye / back
