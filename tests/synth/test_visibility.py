"""What of a mesh can be seen from outside."""

import numpy as np
from icosphere import icosphere

from synth.visibility import visible_faces


def test_only_the_outer_of_two_spheres_is_seen(rasteriser):
    outer, faces = icosphere(0.9)
    inner, _ = icosphere(0.88)
    seen = visible_faces(rasteriser, np.concatenate([outer, inner]), np.concatenate([faces, faces + len(outer)]))
    assert seen[: len(faces)].all() and not seen[len(faces) :].any()


def test_faces_smaller_than_a_pixel_are_seen(rasteriser):
    vertices, faces = icosphere(0.004, subdivisions=4)  # 1 mm faces on a bead 1.7 m from another: 5 mm pixels
    far = vertices + [1.7, 0, 0]
    assert visible_faces(rasteriser, np.concatenate([vertices, far]), np.concatenate([faces, faces + len(far)])).all()
