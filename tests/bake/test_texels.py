import numpy as np
import pytest
from capsules import ball_mesh

from avatar.texture import bytes_of
from bake import atlas
from bake.atlas import unwrap
from bake.texture.texels import JITTER, barycentric, rasterise_charts, sample_texels, spread
from geometry.decimate import decimate

SIZE = 256


@pytest.fixture(scope="module")
def chart():
    mesh = decimate(ball_mesh(step=0.005), 1200)
    part = (mesh.vertices[mesh.faces].mean(1)[:, 1] > 0.05).astype(int)
    found = unwrap(mesh.vertices, mesh.faces, part, np.array([1.0, 2.5]), size=SIZE, padding=4)
    return mesh, part, found


def texture(mesh, found, color):
    texels = rasterise_charts(found.uv, found.faces, SIZE)
    corners = mesh.vertices[found.source]

    def color_at(rows, jitter):
        some = texels.rows(rows)
        weight = barycentric(found.uv, found.faces, some, jitter)
        return color((weight[:, :, None] * corners[found.faces[some.face]]).sum(1))

    return texels, spread(sample_texels(color_at, texels), texels)


def test_every_triangle_keeps_its_corners_and_area(chart):
    mesh, part, found = chart
    assert len(found.faces) == len(mesh.faces)
    given = np.sort(np.sort(mesh.faces, axis=1).view([("", mesh.faces.dtype)] * 3).ravel())
    kept = found.source[found.faces]
    kept = np.sort(np.sort(kept.astype(mesh.faces.dtype), axis=1).copy().view([("", mesh.faces.dtype)] * 3).ravel())
    assert (given == kept).all()
    assert found.uv.min() >= 0 and found.uv.max() <= 1


def test_dense_part_gets_its_share_of_texels(chart):
    mesh, part, found = chart
    a, b, c = (found.uv[found.faces[:, i]] * SIZE for i in range(3))
    flat = 0.5 * np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    p, q, r = (mesh.vertices[found.source[found.faces[:, i]]] for i in range(3))
    solid = 0.5 * np.linalg.norm(np.cross(q - p, r - p), axis=1)
    density = [np.sqrt(flat[found.face_part == k].sum() / solid[found.face_part == k].sum()) for k in (0, 1)]
    assert density[1] / density[0] == pytest.approx(2.5, rel=0.1)


def test_charts_do_not_overlap_and_keep_their_gutter(chart):
    _, _, found = chart
    # components of faces that share atlas vertices are charts; a texel centre lies in one of them only
    from geometry.mesh import component_labels

    labels = component_labels(found.faces, len(found.uv))[found.faces[:, 0]]
    texels = rasterise_charts(found.uv, found.faces, SIZE, skirt=1e-6)
    owner = np.full(SIZE * SIZE, -1)
    owner[texels.index] = labels[texels.face]
    for label in np.unique(labels):
        alone = rasterise_charts(found.uv, found.faces[labels == label], SIZE, skirt=1e-6)
        assert (owner[alone.index] == label).all()
    image = owner.reshape(SIZE, SIZE)
    for axis in (0, 1):
        one, other = np.moveaxis(image, axis, 0)[:-1], np.moveaxis(image, axis, 0)[1:]
        assert not ((one != other) & (one >= 0) & (other >= 0)).any()


def test_gutters_hold_the_color_of_the_nearest_chart(chart):
    mesh, _, found = chart
    texels, image = texture(mesh, found, lambda p: np.full((len(p), 3), 0.25))
    assert len(texels.index) < SIZE * SIZE
    np.testing.assert_allclose(image, 0.25, atol=1e-12)


def test_texel_is_the_mean_of_its_samples_where_color_changes():
    uv = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    texels = rasterise_charts(uv, faces, 32)

    def checker(rows, jitter):
        x = (texels.index[rows] % 32 + 0.5 + jitter[0]) / 32
        return np.repeat((x > 0.5 + 0.25 / 32)[:, None].astype(float), 3, axis=1)

    image = spread(sample_texels(checker, texels), texels)
    beyond = np.mean(JITTER[:, 0] > -0.25)  # the step lies a quarter into column 16
    np.testing.assert_allclose(image[:, 16, 0], beyond)
    assert (image[:, 15, 0] == 0).all() and (image[:, 17, 0] == 1).all()
    # of two samples the centre and the first beside it; of one the centre alone
    for samples in (1, 2):
        fewer = spread(sample_texels(checker, texels, samples=samples), texels)
        np.testing.assert_allclose(fewer[:, 16, 0], np.mean(JITTER[:samples, 0] > -0.25))


def test_bytes_are_rounded_not_truncated():
    np.testing.assert_array_equal(bytes_of(np.arange(256) / 255 - 1e-9), np.arange(256))


def test_squeezed_triangles_get_charts_of_their_own_and_the_order_stays(chart, monkeypatch):
    mesh, part, _ = chart
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
