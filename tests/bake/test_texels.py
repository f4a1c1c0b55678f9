import numpy as np
import pytest
from charted_ball import charted_ball
from scipy.optimize import lsq_linear
from scipy.spatial import KDTree

from avatar.texture import bytes_of
from bake.texture import seams
from bake.texture.seams import inward, seam_steps, seen_steps, solve_seams
from bake.texture.texels import JITTER, TexelMap, rasterise_charts, sample_texels, spread
from geometry.mesh import component_labels

SIZE, LEVELS = 512, 4


@pytest.fixture(scope="module")
def atlas():
    """A ball in charts with gutters of 8 texels, painted with a pattern that changes within a few texels."""
    ball = charted_ball(SIZE, 8)
    image = spread(0.5 + 0.35 * np.sin(ball.points * [100.0, 80.0, 65.0]), ball.texels)
    return ball.chart, ball.texels, image, ball.edges


@pytest.fixture(scope="module")
def dense():
    """A ball whose top is 2.5 times as dense, in charts of 256 texels a side, and its mesh."""
    ball = charted_ball(256, 4, faces=1200, step=0.005, above=0.05)
    return ball.mesh, ball.chart, ball.texels.size


def test_triangles_keep_corners_and_area_and_a_dense_part_its_share_of_texels(dense):
    mesh, found, size = dense
    assert len(found.faces) == len(mesh.faces)
    given = np.sort(np.sort(mesh.faces, axis=1).view([("", mesh.faces.dtype)] * 3).ravel())
    kept = found.source[found.faces]
    kept = np.sort(np.sort(kept.astype(mesh.faces.dtype), axis=1).copy().view([("", mesh.faces.dtype)] * 3).ravel())
    assert (given == kept).all()
    assert found.uv.min() >= 0 and found.uv.max() <= 1
    a, b, c = (found.uv[found.faces[:, i]] * size for i in range(3))
    flat = 0.5 * np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    p, q, r = (mesh.vertices[found.source[found.faces[:, i]]] for i in range(3))
    solid = 0.5 * np.linalg.norm(np.cross(q - p, r - p), axis=1)
    density = [np.sqrt(flat[found.face_part == k].sum() / solid[found.face_part == k].sum()) for k in (0, 1)]
    assert density[1] / density[0] == pytest.approx(2.5, rel=0.1)
    np.testing.assert_array_equal(bytes_of(np.arange(256) / 255 - 1e-9), np.arange(256))


def test_charts_do_not_overlap_and_keep_their_gutter(dense):
    _, found, size = dense
    # components of faces that share atlas vertices are charts; a texel centre lies in one of them only
    labels = component_labels(found.faces, len(found.uv))[found.faces[:, 0]]
    texels = rasterise_charts(found.uv, found.faces, size, skirt=1e-6)
    owner = np.full(size * size, -1)
    owner[texels.index] = labels[texels.face]
    for label in np.unique(labels):
        alone = rasterise_charts(found.uv, found.faces[labels == label], size, skirt=1e-6)
        assert (owner[alone.index] == label).all()
    image = owner.reshape(size, size)
    for axis in (0, 1):
        one, other = np.moveaxis(image, axis, 0)[:-1], np.moveaxis(image, axis, 0)[1:]
        assert not ((one != other) & (one >= 0) & (other >= 0)).any()


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


def test_texels_away_from_chart_edges_stay_those_beside_move_little_and_none_where_sides_agree(atlas):
    found, texels, image, edges = atlas
    moved = np.abs(solve_seams(image, texels, found.uv, edges, LEVELS) - image).max(-1).reshape(-1)[texels.index]
    ends = np.concatenate([found.uv[side] for side in edges]).mean(1) * SIZE
    centre = np.stack([texels.index % SIZE, texels.index // SIZE], 1) + 0.5
    far = KDTree(ends).query(centre)[0] > 40  # farther than mip 3 reads from any edge, edges being 30 texels long
    assert far.sum() > 1000 and (moved[far] == 0).all()
    assert np.sqrt(np.mean(moved[texels.inside] ** 2)) < 0.02
    flat = np.full_like(image, 0.25)
    np.testing.assert_allclose(solve_seams(flat, texels, found.uv, edges, LEVELS), flat, atol=1e-5)


def test_solution_is_the_least_squares_one_within_the_bounds(monkeypatch):
    """Two charts of two texels each against SciPy's bounded least squares of the same problem."""
    size = 4
    monkeypatch.setattr(seams, "AGREE", 8 * size / 1024)
    monkeypatch.setattr(seams, "KEEP_GUTTER", 0.02)
    monkeypatch.setattr(seams, "DESCENT", 500)
    uv = np.array([[0.25, 0.25], [0.25, 0.75], [0.75, 0.25], [0.75, 0.75]])
    edges = seams.ChartEdges(np.array([[0, 1]]), np.array([[2, 3]]))
    texels = TexelMap(np.array([4, 5, 9]), np.zeros(3, int), np.array([True, False, True]), size)
    image = np.random.default_rng(0).uniform(0.3, 0.7, (size, size, 1))
    given = image.reshape(-1)
    keep = np.full(16, seams.KEEP_GUTTER)
    keep[[4, 9]], keep[5] = seams.KEEP_INSIDE, seams.KEEP_SKIRT
    rows, wanted = [np.diag(np.sqrt(keep))], [np.sqrt(keep) * given]
    low, high = given.copy(), given.copy()
    halve = np.kron(np.kron(np.eye(2), [[0.5, 0.5]]), np.kron(np.eye(2), [[0.5, 0.5]]))
    for mip, mean in enumerate((np.eye(16), halve)):
        reads = seams.edge_reads(uv, edges, size >> mip)
        rows.append(np.sqrt(seams.AGREE * 1024 / size * seams.GROW**mip) * reads.toarray() @ mean)
        wanted.append(np.zeros(reads.shape[0]))
        if mip == 0:  # all texels are read in the finest mip
            touched = np.zeros(reads.shape, bool)
            np.put_along_axis(touched, reads.indices.reshape(-1, 8), True, 1)
            for texel in np.flatnonzero(touched.any(0)):
                seen = given[touched[touched[:, texel]].any(0)]
                low[texel], high[texel] = seen.min(), seen.max()
    assert (low < high).all()
    expected = lsq_linear(np.concatenate(rows), np.concatenate(wanted), (low, high), tol=1e-12).x
    found = solve_seams(image, texels, uv, edges, 2).reshape(-1)
    assert ((found < low + 1e-9) | (found > high - 1e-9)).any()
    np.testing.assert_allclose(found, expected, atol=2e-4)


def test_what_is_seen_of_a_step_is_what_exceeds_the_step_of_the_picture_there(atlas):
    """A plain picture shows each step whole; one that steps there as well shows nothing of it."""
    found, _, _, edges = atlas
    plain = np.full((SIZE, SIZE, 3), 100, np.uint8)
    column, row = np.floor(found.uv[edges.left[0]].mean(0) * SIZE).astype(int)
    lighter = plain.copy()
    lighter[row - 4 : row + 5, column - 4 : column + 5] = 140
    steps = seam_steps(found.uv, edges, lighter)
    whole, own = (seen_steps(found.uv, found.faces, edges, lighter, picture) for picture in (plain, lighter))
    np.testing.assert_array_equal(whole, steps)
    middle = 2 * len(edges.left)
    assert whole[middle] == 40 and own[middle] == 0 and (own <= steps).all()


def test_inward_leads_from_both_sides_of_an_edge_into_its_charts(atlas):
    found, texels, _, edges = atlas
    shows = np.zeros(SIZE * SIZE, bool)
    shows[texels.index[texels.inside]] = True
    for side in edges:
        middle, into = found.uv[side].mean(1), inward(found.uv, found.faces, side)
        np.testing.assert_allclose(np.linalg.norm(into, axis=1), 1)
        for away, share in ((1.5, 1.0), (-1.5, 0.0)):
            column, row = np.floor(middle * SIZE + away * into).astype(int).T
            assert abs(shows[row * SIZE + column].mean() - share) < 0.03
