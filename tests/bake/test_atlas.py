import numpy as np
from capsules import ball_mesh

from bake import atlas
from geometry.decimate import decimate

SIZE = 256


def test_squeezed_triangles_get_charts_of_their_own_and_the_order_stays(monkeypatch):
    mesh = decimate(ball_mesh(step=0.005), 1200)
    part = (mesh.vertices[mesh.faces].mean(1)[:, 1] > 0.05).astype(int)
    calls, packed = [], atlas._pack_groups
    monkeypatch.setattr(atlas, "squeezed", lambda *_: np.array([3, 4] if len(calls) == 1 else [], int))
    monkeypatch.setattr(atlas, "_pack_groups", lambda *given: (calls.append(given[2].copy()), packed(*given))[1])
    found = atlas.pack(mesh.vertices, mesh.faces, part, np.array([1.0, 2.5]), SIZE, 4)
    order = np.argsort(part, kind="stable")
    assert len(calls) == 2 and set(np.flatnonzero(calls[1] & 1)) == set(order[[3, 4]])
    assert (found.face_part == part[order]).all()
    assert (np.sort(found.source[found.faces]) == np.sort(mesh.faces[order])).all()


def test_a_triangle_that_is_squeezed_one_way_is_found_whatever_its_part_s_density():
    square = np.array([[[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]]]).repeat(8, axis=0)
    texels = np.array([[[0, 0], [10, 0], [0, 10.0]]]).repeat(8, axis=0)
    density = np.array([1.0, 1, 1, 1, 2, 2, 2, 2])
    texels[4:] *= 2
    texels[2, 2, 1] = texels[6, 1, 0] = 2.0
    assert atlas.squeezed(square, texels, density).tolist() == [2, 6]
