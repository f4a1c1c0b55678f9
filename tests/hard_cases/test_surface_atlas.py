"""HARD_CASES, Surface and atlas: fields without surfaces, thin sheets, torn meshes, slow unwraps, thin charts."""

import time

import numpy as np
import pytest
from capsules import ball_mesh, sphere
from charted_ball import charted_ball

from avatar.body import builtin_body
from avatar.texture import bytes_of, mipmaps, sample_texture
from bake.atlas import squeezed, unwrap
from bake.skin import transferred_weights
from bake.texture.seams import seam_steps, solve_seams
from bake.texture.texels import rasterise_charts, spread
from command.errors import AssetError
from geometry.closest import match_surface
from geometry.decimate import balanced, decimate
from geometry.isosurface import GridSteps, Hints, extract
from geometry.mesh import TriangleMesh, compact
from geometry.repair import find_faults, repair

BOX = np.array([[-0.12, -0.12, -0.12], [0.12, 0.12, 0.12]])


def found(distance, normal=None, box=BOX, step=0.01):
    return extract(distance, normal or sphere(0.1)[1], Hints(box, np.zeros(len(box), bool)), GridSteps(step, step))


FIELDS = {
    "positive everywhere": lambda p: np.full(len(p), 0.05),
    "negative everywhere": lambda p: np.full(len(p), -0.05),
    "should be positive 3 cm outside": sphere(0.2)[0],
    "should be finite": lambda p: np.where(p[:, 0] > 0.05, np.nan, sphere(0.1)[0](p)),
}


@pytest.mark.parametrize("reason", FIELDS)
def test_a_field_that_bounds_nothing_in_its_box_is_refused(reason):
    with pytest.raises(AssetError, match=reason):
        found(FIELDS[reason])


def test_islands_and_inner_sheets_are_dropped(within):
    ball, speck, hole = sphere(0.1)[0], sphere(0.012, (0.13, 0.0, 0.0))[0], sphere(0.03)[0]
    result = found(lambda p: np.minimum(np.maximum(ball(p), -hole(p)), speck(p)))
    assert result.islands == 2
    within(find_faults(result.mesh.faces, len(result.mesh.vertices)), 0, "faults")
    within(np.linalg.norm(result.mesh.vertices, axis=1) - 0.1, 1e-4, "m")


@pytest.mark.parametrize("thickness", [0.02, 0.012, 0.006, 0.002])
def test_sheet_thinner_than_a_voxel_is_closed_or_gone(thickness, within):
    """Thinner than a voxel a sheet may have holes, but the mesh is closed or the loss is an error."""

    def slab(p):
        q = np.abs(p - 0.0013) - np.array([0.09, 0.09, 0.5 * thickness])
        return np.linalg.norm(np.maximum(q, 0), axis=1) + np.minimum(q.max(1), 0)

    def normal(p):
        step = 1e-5 * np.eye(3)
        g = np.stack([slab(p + s) - slab(p - s) for s in step], 1)
        return g / np.maximum(np.linalg.norm(g, axis=1, keepdims=True), 1e-12)

    try:
        result = found(slab, normal)
    except AssetError as error:
        assert thickness < 0.01 and "everywhere" in str(error)
        return
    within(find_faults(result.mesh.faces, len(result.mesh.vertices)), 0, "faults")
    assert np.isfinite(result.mesh.vertices).all()


def test_sheet_of_air_that_ends_in_a_jump_is_filled_and_a_gap_is_not(within):
    """A slit into a ball that the field leaves open and that is solid deep inside; beside it a gap of the same
    width that ends as surfaces do, at a distance of zero."""
    ball = sphere(0.1)[0]

    def gap(p, centre, inner):
        q = np.abs(p - [centre, 0.06, 0.0]) - [0.008, 0.05, 0.2]
        return np.where(p[:, 1] > inner, np.linalg.norm(np.maximum(q, 0), axis=1) + np.minimum(q.max(1), 0), 1.0)

    def field(p):
        slit, notch = gap(p, -0.03, -1.0), gap(p, 0.03, -1.0)
        value = np.maximum(ball(p), -np.minimum(slit, notch))
        # made solid: the slit's lower end jumps from air to 4 cm inside
        return np.where((p[:, 0] < 0) & (p[:, 1] < 0.05) & (np.linalg.norm(p, axis=1) < 0.07), -0.04, value)

    result = found(field, step=0.004)
    assert result.slits > 0
    within(find_faults(result.mesh.faces, len(result.mesh.vertices)), 0, "faults")
    inside = np.linalg.norm(result.mesh.vertices, axis=1) < 0.075
    within((inside & (result.mesh.vertices[:, 0] < 0)).sum(), 0, "vertices left in the slit")
    assert (inside & (result.mesh.vertices[:, 0] > 0)).sum() > 100


def torn(kind):
    ball = ball_mesh()
    faces = ball.faces.copy()
    if kind == "hole":
        return TriangleMesh(ball.vertices, faces[~(ball.vertices[faces].mean(1)[:, 1] > 0.08)])
    if kind == "doubled":
        return TriangleMesh(ball.vertices, np.concatenate([faces, faces[:7], faces[20:24, ::-1]]))
    if kind == "fin":
        fin = np.array([[faces[0, 0], faces[0, 1], faces[50, 2]]])
        return TriangleMesh(ball.vertices, np.concatenate([faces, fin]))
    if kind == "degenerate":
        return TriangleMesh(ball.vertices, np.concatenate([faces, [[3, 3, 9], [5, 5, 5]]]))
    if kind == "pinched":
        return TriangleMesh(ball.vertices, np.where(faces == faces[0, 0], faces[200, 0], faces))
    raise ValueError(kind)


@pytest.mark.parametrize("kind", ["hole", "doubled", "fin", "degenerate", "pinched"])
def test_broken_meshes_are_refused_by_decimation_and_closed_by_mending(kind, within):
    mesh = torn(kind)
    assert find_faults(mesh.faces, len(mesh.vertices))
    with pytest.raises(ValueError, match="closed and manifold"):
        decimate(mesh, 100)
    closed = repair(mesh)
    within(find_faults(closed.faces, len(closed.vertices)), 0, "faults")
    assert len(decimate(closed, 800).faces) <= 810


def test_nothing_left_to_mend_is_an_error():
    with pytest.raises(AssetError, match="no triangle left"):
        repair(TriangleMesh(np.zeros((3, 3)), np.array([[0, 0, 1], [1, 2, 2]])))


@pytest.mark.parametrize("target", [3000, 800, 100, 20])
def test_decimation_never_opens_a_hole(target, within):
    mesh = decimate(ball_mesh(step=0.006), target)
    within(find_faults(mesh.faces, len(mesh.vertices)), 0, "faults")


def test_vertices_never_referenced_are_dropped(within):
    ball = ball_mesh()
    loose = TriangleMesh(np.concatenate([[[9.0, 9, 9]], ball.vertices, [[np.nan] * 3]]), ball.faces + 1)
    kept, index = compact(loose.vertices, loose.faces)
    assert len(kept.vertices) == len(ball.vertices) and index[0] == 1
    within(np.linalg.norm(decimate(loose, 800).vertices, axis=1) - 0.1, 0.01, "m")


def test_balancing_turns_no_triangle_over(within):
    distance, normal = sphere(0.1)
    mesh = decimate(ball_mesh(step=0.005), 500)
    rough = TriangleMesh(mesh.vertices * (1 + 0.02 * np.sin(40 * mesh.vertices[:, :1])), mesh.faces)
    smooth = balanced(rough, distance, normal, rounds=4)
    facing = [np.cross(m.vertices[m.faces[:, 1]] - m.vertices[m.faces[:, 0]],
                       m.vertices[m.faces[:, 2]] - m.vertices[m.faces[:, 0]]) for m in (rough, smooth)]  # fmt: skip
    within(((facing[0] * facing[1]).sum(1) < 0).sum(), 0, "turned")


def test_unwrapping_is_stopped_when_it_takes_too_long():
    mesh = ball_mesh(step=0.004)
    began = time.monotonic()
    with pytest.raises(AssetError, match=r"should end within 0\.05 s"):
        unwrap(mesh.vertices, mesh.faces, np.zeros(len(mesh.faces), int), np.ones(1), size=256, padding=2, seconds=0.05)
    assert time.monotonic() - began < 600


def test_unwrapping_survives_degenerate_and_crowded_triangles():
    ball = ball_mesh()
    vertices = np.concatenate([ball.vertices, ball.vertices[:1] + [[0, 1e-9, 0]]])
    extra = np.array([[0, 1, len(ball.vertices)], [0, 5, 900], [7, 7, 8]])
    faces = np.concatenate([ball.faces, extra])
    result = unwrap(vertices, faces, np.zeros(len(faces), int), np.ones(1), size=128, padding=2)
    assert len(result.faces) == len(faces) and np.isfinite(result.uv).all()
    # no triangle may be left in the corner where the unwrapper parks what it cannot chart
    assert not (result.uv[result.faces] == 0).all((1, 2)).any()


def test_too_many_triangles_are_refused_before_they_are_tried():
    with pytest.raises(ValueError, match="at most 200000"):
        unwrap(np.zeros((3, 3)), np.zeros((200_001, 3), int), np.zeros(200_001, int), np.ones(1), size=64, padding=2)


@pytest.mark.parametrize("mip", [0, 1, 2])
def test_no_mip_bleeds_across_charts(within, mip):
    """Two charts with a gutter of 8 texels: each mip in use keeps their colors apart inside the charts."""
    uv = np.array([[0.05, 0.05], [0.45, 0.05], [0.45, 0.95], [0.05, 0.95]])
    uv = np.concatenate([uv, uv + [0.4 + 8 / 128, 0]])
    faces = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])
    texels = rasterise_charts(uv, faces, 128)
    image = spread((texels.face >= 2).astype(float)[:, None], texels)[..., 0]
    level = image.reshape(128 >> mip, 1 << mip, 128 >> mip, 1 << mip).mean((1, 3))
    centre = (np.arange(128 >> mip) + 0.5) / (128 >> mip)
    left, right = centre <= 0.45, (centre >= 0.85 + 8 / 128 - 0.4) & (centre <= 0.85 + 8 / 128)
    rows = (centre > 0.1) & (centre < 0.9)
    within(level[np.ix_(rows, left)], 0.0)
    within(level[np.ix_(rows, right)] - 1, 0.0)


@pytest.mark.parametrize("thickness", [2.0, 0.9, 0.5, 0.1])
def test_chart_thinner_than_a_texel_shows_its_own_color(thickness, within):
    """A strip (texels wide: `thickness`) beside a large chart of another color:
    read along its middle it is its own.
    """
    size = 64
    strip = np.array([[0.1, 0.2], [0.9, 0.2], [0.9, 0.2 + thickness / size], [0.1, 0.2 + thickness / size]])
    block = np.array([[0.1, 0.3], [0.9, 0.3], [0.9, 0.9], [0.1, 0.9]])
    uv, faces = np.concatenate([strip, block]), np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])
    texels = rasterise_charts(uv, faces, size)
    image = spread((texels.face < 2).astype(float)[:, None], texels)
    x = np.linspace(0.12, 0.88, 50)
    middle = np.c_[x, np.full(50, 0.2 + 0.5 * thickness / size)]
    within(sample_texture(image, middle) - 1, 1e-9)


@pytest.mark.parametrize("level, size, padding", [(0, 512, 8), (1, 512, 4)])
def test_both_sides_of_chart_edges_agree_at_every_mip_used(level, size, padding, within):
    """Median step 1, 99 of 100 within 4 of 255, in all mips that the player makes."""
    ball = charted_ball(size, padding, above=0.03)
    image = spread(0.5 + 0.3 * np.sin(ball.points * [70.0, 50.0, 60.0]), ball.texels)
    levels = padding.bit_length()
    closed = bytes_of(solve_seams(image, ball.texels, ball.chart.uv, ball.edges, levels))
    for mip in mipmaps(closed, levels):
        steps = seam_steps(ball.chart.uv, ball.edges, mip)
        within(np.median(steps), 1.0, "of 255, median")
        within(np.quantile(steps, 0.99), 4.0, "of 255, p99")


@pytest.fixture(scope="module")
def unwrapped_ball():
    """A ball in charts of an atlas of 512 texels with gutters of 8."""
    return charted_ball(512, 8)


@pytest.mark.parametrize("pattern", ["stripes", "checkerboard", "one texel in 64"])
@pytest.mark.parametrize("where", ["atlas", "surface"])
def test_closing_chart_edges_never_leaves_the_colors_of_the_two_sides(pattern, where, within, unwrapped_ball):
    """The hardest contrast, of one texel, in two pairs of colors on two halves of a ball: in every mip each channel of
    every texel stays within what its half shows."""
    size, levels = 512, 4
    chart, texels, edges, corners, points, _ = unwrapped_ball
    height = corners.mean(1)[texels.face, 1]
    upper = height > 0
    cells = np.stack([texels.index % size, texels.index // size], 1)
    if where == "surface":
        # a texel is about .8 mm there
        cells = np.floor(points[:, :2] / 0.0008).astype(int)
    on = {
        "stripes": cells[:, 0] % 2,
        "checkerboard": cells.sum(1) % 2,
        "one texel in 64": ((cells % 8) == 0).all(1).astype(int),
    }[pattern]
    pairs = np.array([[[0.2, 0.7, 0.3], [0.25, 0.4, 0.8]], [[0.8, 0.3, 0.3], [0.6, 0.35, 0.5]]])
    image = spread(pairs[upper.astype(int), on], texels)
    closed = solve_seams(image, texels, chart.uv, edges, levels)
    within(np.maximum(image.min((0, 1)) - closed, closed - image.max((0, 1))).max(), 1e-7, "beyond both")
    # away from the border of the halves only one pair of colors is there to be taken
    for half, pair in enumerate(pairs):
        own = texels.index[(upper == half) & (np.abs(height) > 0.04)]
        shown = closed.reshape(-1, 3)[own]
        within(np.maximum(pair.min(0) - shown, shown - pair.max(0)).max(), 0.5 / 255, "beyond its half")
    low, high = 255 * image.min((0, 1)), 255 * image.max((0, 1))
    for mip in mipmaps(bytes_of(closed), levels):
        within(np.maximum(low - mip, mip - high).max(), 1.0, "of 255, in a mip")


@pytest.mark.parametrize("gap", [0.004, 0.001, 0.0002])
def test_thin_parts_back_to_back_do_not_swap_sides(gap, within):
    """Two flat fingers facing each other across a gap: a query outside the closer one still takes its own side."""
    grid = np.stack(np.meshgrid(np.linspace(0, 0.03, 16), np.linspace(0, 0.03, 16)), -1).reshape(-1, 2)
    index = np.arange(256).reshape(16, 16)
    quads = np.stack([index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]], -1).reshape(-1, 4)
    up = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    vertices = np.concatenate([np.c_[grid, np.zeros(256)], np.c_[grid, np.full(256, gap)]])
    faces = np.concatenate([up, up[:, ::-1] + 256])  # the lower side looks up, the upper side looks down
    inner = grid[(grid > 0.004).all(1) & (grid < 0.026).all(1)]
    # queries that belong to the lower side but lie nearer to the upper one
    points = np.c_[inner, np.full(len(inner), 0.8 * gap)]
    match = match_surface(points, np.tile([0.0, 0, 1], (len(inner), 1)), vertices, faces)
    assert match.agrees.all()
    within((match.face >= len(up)).sum(), 0, "swapped")


def test_no_triangle_of_a_body_gets_a_third_of_the_texels_that_others_do_in_a_direction(within):
    """Large charts of a body squeezed some of their triangles, and patches of cloth were smeared."""
    body = builtin_body("male")
    vertices = body.vertices.astype(np.float64)
    found = unwrap(vertices, body.faces, np.zeros(len(body.faces), int), np.ones(1), size=1024, padding=4)
    corners = vertices[found.source][found.faces]
    within(len(squeezed(corners, 1024 * found.uv[found.faces], np.ones(len(corners)))), 0, "triangles")


def test_ear_in_front_of_the_head_keeps_its_own_weights(within):
    """A thin shell (an ear, 2 mm) over a surface that follows another joint, both facing out: no weight crosses."""
    head = ball_mesh(0.1, step=0.012)
    ear = TriangleMesh(head.vertices * 1.02, head.faces)
    ear, _ = compact(ear.vertices, ear.faces[ear.vertices[ear.faces].mean(1)[:, 0] > 0.06])
    vertices = np.concatenate([head.vertices, ear.vertices])
    faces = np.concatenate([head.faces, ear.faces + len(head.vertices)])
    source = np.zeros((len(vertices), 52))
    source[: len(head.vertices), 15], source[len(head.vertices) :, 12] = 1, 1
    moved = vertices * np.r_[np.full(len(head.vertices), 1.002), np.full(len(ear.vertices), 0.998)][:, None]
    normals = vertices / np.linalg.norm(vertices, axis=1, keepdims=True)
    match = match_surface(moved, normals, vertices, faces)
    weights, _ = transferred_weights(match, faces, faces, source)
    within(weights - source, 1e-9)
