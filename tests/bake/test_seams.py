import numpy as np
import pytest
from capsules import ball_mesh
from scipy.optimize import lsq_linear
from scipy.spatial import KDTree

from avatar.texture import mipmaps
from bake import seams
from bake.atlas import unwrap
from bake.seams import chart_edges, seam_steps, solve_seams
from bake.texels import TexelMap, barycentric, bytes_from_unit, rasterise_charts, sample_texels, spread
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


def steps_by_mip(found, edges, image):
    return [seam_steps(found.uv, edges, mip) for mip in mipmaps(bytes_from_unit(image), LEVELS)]


def test_chart_edges_agree_in_every_mip_in_use(atlas):
    found, texels, image, edges = atlas
    before = steps_by_mip(found, edges, image)
    after = steps_by_mip(found, edges, solve_seams(image, texels, found.uv, edges, LEVELS))
    assert np.quantile(before[3], 0.99) > 8
    for steps in after:
        assert np.median(steps) <= 1 and np.quantile(steps, 0.99) <= 4


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
    monkeypatch.setattr(seams, "EMPHASIS", (1.0,))
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


def test_edges_that_miss_the_goal_are_closed_further_and_others_stay(atlas, monkeypatch):
    monkeypatch.setattr(seams, "AGREE", 0.2)
    found, texels, image, edges = atlas
    plain = solve_seams(image, texels, found.uv, edges, LEVELS)

    def largest(closed):
        return max(np.quantile(steps, 0.99) for steps in steps_by_mip(found, edges, closed))

    assert np.array_equal(plain, solve_seams(image, texels, found.uv, edges, LEVELS, goal=largest(plain)))
    goal = 0.9 * largest(plain)
    further = solve_seams(image, texels, found.uv, edges, LEVELS, goal=goal)
    assert largest(further) <= goal
    inside = texels.index[texels.inside]
    moved = np.abs(further - image).reshape(-1, 3)[inside]
    assert np.sqrt(np.mean(moved**2)) < seams.LARGEST_CHANGE * np.sqrt(2048 / SIZE)


def test_closing_further_stops_before_the_charts_lose_too_much(atlas):
    """Stripes that no goal can reach: the insides move no further than the first pass or LARGEST_CHANGE."""
    found, texels, image, edges = atlas
    striped = np.where((np.arange(SIZE) % 2)[None, :, None], 0.9, 0.1) + np.zeros_like(image)
    closed = solve_seams(striped, texels, found.uv, edges, LEVELS, goal=0.1)
    moved = (closed - striped).reshape(-1, 3)[texels.index[texels.inside]]
    first = solve_seams(striped, texels, found.uv, edges, LEVELS, goal=1000.0)
    most = np.sqrt(np.mean((first - striped).reshape(-1, 3)[texels.index[texels.inside]] ** 2))
    assert np.sqrt(np.mean(moved**2)) <= max(most, seams.LARGEST_CHANGE * np.sqrt(2048 / SIZE)) + 1e-9
