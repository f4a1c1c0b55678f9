import numpy as np
import pytest
from capsules import ball_mesh
from scipy.optimize import lsq_linear
from scipy.spatial import KDTree

from bake.atlas import unwrap
from bake.texture import seams
from bake.texture.seams import chart_edges, inward, seam_steps, seen_steps, solve_seams
from bake.texture.texels import TexelMap, barycentric, rasterise_charts, sample_texels, spread
from geometry.decimate import decimate

SIZE, LEVELS = 512, 4


@pytest.fixture(scope="module")
def atlas():
    """A ball in charts with gutters of 8 texels, painted with a pattern that changes within a few texels."""
    mesh = decimate(ball_mesh(step=0.006), 800)
    found = unwrap(mesh.vertices, mesh.faces, np.zeros(len(mesh.faces), int), np.ones(1), size=SIZE, padding=8)
    texels = rasterise_charts(found.uv, found.faces, SIZE)
    corners = mesh.vertices[found.source]

    def color_at(rows, jitter):
        some = texels.rows(rows)
        weight = barycentric(found.uv, found.faces, some, jitter)
        points = (weight[:, :, None] * corners[found.faces[some.face]]).sum(1)
        return 0.5 + 0.35 * np.sin(points * [100.0, 80.0, 65.0])

    image = spread(sample_texels(color_at, texels), texels)
    return found, texels, image, chart_edges(found.uv, found.faces, found.source)


def test_texels_away_from_chart_edges_stay_and_those_beside_move_little(atlas):
    found, texels, image, edges = atlas
    moved = np.abs(solve_seams(image, texels, found.uv, edges, LEVELS) - image).max(-1).reshape(-1)[texels.index]
    ends = np.concatenate([found.uv[side] for side in edges]).mean(1) * SIZE
    centre = np.stack([texels.index % SIZE, texels.index // SIZE], 1) + 0.5
    far = KDTree(ends).query(centre)[0] > 40  # farther than mip 3 reads from any edge, edges being 30 texels long
    assert far.sum() > 1000 and (moved[far] == 0).all()
    assert np.sqrt(np.mean(moved[texels.inside] ** 2)) < 0.02


def test_image_that_already_agrees_is_not_touched(atlas):
    found, texels, image, edges = atlas
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
        row, column, value, count = seams.edge_reads(uv, edges, size >> mip)
        read = np.zeros((count, (size >> mip) ** 2))
        np.add.at(read, (row, column), value)
        rows.append(np.sqrt(seams.AGREE * 1024 / size * seams.GROW**mip) * read @ mean)
        wanted.append(np.zeros(count))
        if mip == 0:  # all texels are read in the finest mip
            touched = np.zeros(read.shape, bool)
            touched[row, column] = True
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
