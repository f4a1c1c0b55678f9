"""What of a mesh can be seen from outside."""

import numpy as np
import trimesh

from synth.visibility import visible_faces


def _sphere(radius, subdivisions=3):
    mesh = trimesh.creation.icosphere(subdivisions, radius)
    return np.asarray(mesh.vertices), np.asarray(mesh.faces)


def test_only_the_outer_of_two_spheres_is_seen(rasteriser):
    outer, faces = _sphere(0.9)
    inner, _ = _sphere(0.88)
    seen = visible_faces(rasteriser, np.concatenate([outer, inner]), np.concatenate([faces, faces + len(outer)]))
    assert seen[: len(faces)].all() and not seen[len(faces) :].any()


def test_faces_smaller_than_a_pixel_are_seen(rasteriser):
    vertices, faces = _sphere(0.004, 4)  # 1 mm faces on a bead 1.7 m from another: 5 mm pixels
    far = vertices + [1.7, 0, 0]
    assert visible_faces(rasteriser, np.concatenate([vertices, far]), np.concatenate([faces, faces + len(far)])).all()
