"""A face on a sheet before the built-in head: cuts, lips, eyes, blinks, the strip, and templates that get none."""

from dataclasses import replace

import numpy as np
import pytest
from face_sheet import IRIS, SKIN, WHITE, face_sheet
from scipy.ndimage import gaussian_filter
from scipy.spatial import KDTree
from tiny_avatar import tiny_avatar

from avatar.face import SHAPES, Eye
from avatar.texture import bytes_of, sample_texture
from bake.bake import _Clock, faced
from bake.face.blink import edges_of_lids
from bake.face.cut import MEANS, chains, cut_along, divided_faces, refined
from bake.face.eye_drawing import draw_eyes
from bake.face.eyes import CAP, POLAR, cap, disc, edge_of_lids, eye_axis, iris_picture, pictured_lids, polar
from bake.face.face import COARSE, parted, with_face
from bake.face.features import PIXEL, ROUND, FrontPicture, aligned, brows_off, darkest_off, with_brow
from bake.face.lips import STEP, lip_line
from bake.face.mouth import TOOTH, coarser, mouth_behind, mouth_picture, zipped
from bake.face.own import cheek_color, with_own_face
from bake.face.strip import LEFT_EYE, MOUTH, size_in, uv_in, with_strip
from bake.face.template import FaceRefused, person_face
from capture.own_face import FITTED, OwnFace
from geometry.mesh import face_areas, half_edges

SHEET = face_sheet()
PARTED = parted(SHEET.level, SHEET.person, lip_line(SHEET.person))
FACED = with_face([SHEET.level, SHEET.level], SHEET.person)


def moved(level, **weights):
    """Positions of a level with shapes so; a blink is both sides'."""
    points = level.positions.astype(np.float64)
    for name, weight in weights.items():
        for shape in [s for s in SHAPES if s in (name, f"{name}Left", f"{name}Right")]:
            points[level.face.vertices] += weight * level.face.offsets[SHAPES.index(shape)]
    return points


def grid(side=9):
    """A flat mesh in the unit square."""
    y, x = np.mgrid[:side, :side] / (side - 1)
    n = np.arange(side * side).reshape(side, side)
    a, b, c, d = (part.ravel() for part in (n[:-1, :-1], n[:-1, 1:], n[1:, 1:], n[1:, :-1]))
    return np.c_[x.ravel(), y.ravel(), 0 * x.ravel()], np.concatenate([np.c_[a, b, c], np.c_[a, c, d]])


def test_a_cut_leaves_no_face_on_both_sides_and_all_of_the_area():
    points, faces = grid()
    value = points[:, 1] - 0.3 - 0.2 * points[:, 0]
    cut = cut_along(faces, value)
    ends = points[cut.edges]
    whole = np.concatenate([points, ends[:, 0] + cut.share[:, None] * (ends[:, 1] - ends[:, 0])])
    beyond = whole[:, 1] - 0.3 - 0.2 * whole[:, 0]
    assert (cut.side[:, None] * beyond[cut.faces] > -1e-12).all()
    assert face_areas(whole, cut.faces).sum() == pytest.approx(1, abs=1e-12)


@pytest.mark.parametrize("edges", [[[0, 1]], [[0, 1], [1, 2]], [[0, 1], [0, 2], [1, 2]]])
def test_a_face_is_divided_on_one_two_or_three_edges_and_keeps_its_facing(edges):
    points, edges = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array(edges)
    whole = np.concatenate([points, points[edges].mean(1)])
    faces = divided_faces(np.array([[0, 1, 2]]), edges, 3)
    area = np.cross(whole[faces[:, 1]] - whole[faces[:, 0]], whole[faces[:, 2]] - whole[faces[:, 0]])[:, 2]
    assert len(faces) == 1 + len(edges) and (area > 0.1).all() and area.sum() == pytest.approx(1)


def test_long_edges_are_halved_where_they_pass_though_their_middle_is_far():
    """As they fan out over a flat upper lip from the border of the chart beside it."""
    like = {*MEANS, "joints", "weights"}
    rows = {name: values[:3] for name, values in vars(SHEET.level).items() if name in like and values is not None}
    rows |= {"positions": np.float32([[0, 1, 0], [-4, 0, 0], [4, 0, 0]]), "faces": np.uint32([[0, 1, 2]])}
    level = replace(SHEET.level, **rows)
    there = lambda points: np.hypot(points[:, 0] - 3.8, points[:, 1]) < 0.5
    found = refined(level, there, 0.5)
    edges = np.unique(np.sort(half_edges(found.faces.astype(int)), axis=1), axis=0)
    ends = found.positions[edges].astype(float)
    assert np.linalg.norm(np.diff(ends, axis=1), axis=2)[there(ends.mean(1))].max() <= 0.5


def test_lines_are_found_whole_and_loops_end_where_they_begin():
    line, loop = chains(np.array([[5, 3], [3, 9], [0, 1], [1, 2], [2, 0], [9, 7], [7, 8]]))
    assert line.tolist() in ([5, 3, 9, 7, 8], [8, 7, 9, 3, 5])
    assert loop[0] == loop[-1] and set(loop.tolist()) == {0, 1, 2}


def test_two_lines_are_sewn_by_every_edge_of_both_once():
    faces = zipped(np.array([0, 0.4, 0.6, 1]), np.array([0, 0.5, 1]))
    edges = {tuple(sorted(pair)) for face in faces.tolist() for pair in zip(face, face[1:] + face[:1])}
    assert {(0, 1), (1, 2), (2, 3), (4, 5), (5, 6)} <= edges and len(faces) == 5


def test_half_of_a_mouth_keeps_its_seam_and_names_its_own_vertices():
    whole, half = SHEET.person, coarser(SHEET.person)
    inside = np.unique(half.face.inside)
    assert np.isin(np.concatenate(half.face.seam), inside).all() and np.isin(inside, whole.face.inside).all()
    assert len(half.inside) == len(inside) < 0.6 * len(whole.inside)
    assert len(half.parts) == sum(half.face.part_counts) < 0.6 * len(whole.parts)
    assert half.face.part_faces.max() == len(half.parts) - 1
    # teeth and tongue stay apart
    part = np.repeat(np.arange(3), half.face.part_counts)[half.face.part_faces]
    assert (part == part[:, :1]).all() and half.face.offsets.shape[1] - 13380 == len(half.parts)


def test_lips_touch_at_rest_and_part_between_their_corners_when_the_jaw_opens():
    level, offsets = PARTED.growing
    upper, lower = level.positions[PARTED.upper], level.positions[PARTED.lower]
    np.testing.assert_array_equal(upper, lower)
    jaw = offsets[SHAPES.index("jawOpen"), :, 1]
    apart = jaw[PARTED.upper] - jaw[PARTED.lower]
    assert apart[[0, -1]].tolist() == [0, 0] and apart.max() > 0.02 and apart[5:-5].min() > 0.005
    assert np.median(np.linalg.norm(np.diff(upper, axis=0), axis=1)) > STEP


@pytest.mark.parametrize("shape", ["mouthDimpleLeft", "mouthStretchRight", "noseSneerLeft"])
def test_lips_that_a_shape_hardly_parts_stay_closed(shape):
    offsets = PARTED.growing.offsets[SHAPES.index(shape)]
    apart = offsets[PARTED.upper, 1] - offsets[PARTED.lower, 1]
    assert apart.max() < 1e-7 and np.abs(offsets[PARTED.upper]).max() > 1e-4


def test_a_mouth_closed_again_leaves_less_than_a_millimetre():
    offsets = PARTED.growing.offsets
    both = offsets[SHAPES.index("jawOpen")] + offsets[SHAPES.index("mouthClose")]
    assert np.linalg.norm(both[PARTED.upper] - both[PARTED.lower], axis=1).max() < 0.0008


@pytest.mark.parametrize("number", [0, 1])
@pytest.mark.parametrize("shape", ["jawOpen", "mouthFunnel", "mouthSmileLeft", "mouthUpperUpRight"])
def test_no_shape_opens_a_gap_between_lips_and_mouth(shape, number):
    level = FACED.levels[number]
    points = np.round(moved(level, **{shape: 1.0}) * 1e6).astype(np.int64)
    near = lip_line(SHEET.person).away(level.positions.astype(np.float64)) < 0.003
    place = np.unique(points, axis=0, return_inverse=True)[1].reshape(-1)
    # teeth and tongue come after the inside, and have edges of their own
    skin = np.flatnonzero(near & (level.view_seen > 0))
    edges = np.concatenate([level.faces[:, [i, (i + 1) % 3]] for i in range(3)]).astype(np.int64)
    own = edges[np.isin(edges, skin).all(1)]
    assert np.isin(place[own[:, 0]] * len(place) + place[own[:, 1]],
                   place[edges[:, 1]] * len(place) + place[edges[:, 0]]).all()  # fmt: skip


def test_a_coarser_level_follows_the_finest_one_as_it_would_move_by_itself():
    level, alone = FACED.levels[1], parted(SHEET.level, SHEET.person, lip_line(SHEET.person), COARSE[1]).growing
    assert level.face.follow is not None and FACED.levels[0].face.follow is None
    place = KDTree(alone.level.positions).query(level.positions[level.face.vertices])
    same = place[0] < 1e-7
    off = np.linalg.norm(level.face.offsets[:, same] - alone.offsets[:, place[1][same]], axis=2)
    # lips touch: their offsets are of either
    assert same.sum() > 1000 and np.percentile(off, 99) < 0.0002


@pytest.mark.parametrize("weight", [0, 0.25, 0.5, 0.75, 1])
def test_lids_stay_outside_of_the_balls_while_they_close(weight):
    level = FACED.levels[0]
    points = moved(level, eyeBlink=weight)
    for eye in FACED.eyes:
        near = (np.linalg.norm(level.positions - eye.center, axis=1) < 0.018) & (level.view_seen > 0)
        near &= level.positions[:, 2] > eye.center[2]
        near[np.setdiff1d(np.arange(len(near)), level.faces)] = False
        assert np.linalg.norm(points[near] - eye.center, axis=1).min() - eye.radius > 0.0002


def test_a_blink_brings_the_upper_edge_to_the_lower_one():
    level, offsets = PARTED.growing
    for opened, side in zip(PARTED.opened, ("Left", "Right")):
        edge = level.positions[opened.loop] + offsets[SHAPES.index(f"eyeBlink{side}"), opened.loop]
        first, last = sorted((int(edge[:, 0].argmin()), int(edge[:, 0].argmax())))
        one, other = edge[first : last + 1], np.r_[edge[last:], edge[: first + 1]]
        x = np.linspace(edge[:, 0].min() + 0.003, edge[:, 0].max() - 0.003, 30)
        y = [np.interp(x, *half[np.argsort(half[:, 0]), :2].T) for half in (one, other)]
        # as far below it as hides the ball from below
        assert np.abs(y[0] - y[1]).max() < 0.0012


def test_the_atlas_stays_and_its_places_with_it_and_nothing_new_changes_with_the_view():
    before, after = SHEET.level, FACED.levels[0]
    size = len(before.base_color)
    np.testing.assert_array_equal(after.base_color[:size], before.base_color)
    assert after.features is not None and not after.features[size // 2 :].any()
    assert after.base_color.shape == (size * 17 // 16, size, 3)
    new = after.uv[:, 1] > 16 / 17
    assert new.sum() > 500 and not after.view_seen[new].any()
    read = lambda level, uv: sample_texture(level.base_color / 255.0, uv.astype(np.float64))
    with_rows = with_strip(before, {})
    np.testing.assert_allclose(read(with_rows, with_rows.uv), read(before, before.uv), atol=1e-3)


def test_a_picture_lies_in_the_strip_where_its_coordinates_say():
    width, height = size_in(LEFT_EYE, 512)
    picture = np.zeros((height, width, 3))
    picture[5, 7] = 1
    level = with_strip(SHEET.level, {LEFT_EYE: picture, MOUTH: np.full((*size_in(MOUTH, 512)[::-1], 3), 0.5)})
    uv = uv_in(LEFT_EYE, np.array([[7.5 / width, 5.5 / height]]), 512)
    assert sample_texture(level.base_color / 255.0, uv)[0].tolist() == [1, 1, 1]


def test_an_eye_looks_where_its_iris_is_and_shows_it_all_round():
    for opened, center in zip(PARTED.opened, SHEET.person.eyes.centres):
        axis = eye_axis(opened, center)
        assert np.degrees(np.arccos(axis[2])) < 2.5
        picture = iris_picture(opened, Eye(center, axis, 0.012))
        rows = lambda degrees: picture[int(np.radians(degrees) / CAP * 128)]
        assert np.abs(rows(15) - IRIS).max() < 0.15
        assert np.abs(rows(38) - WHITE).max() < 0.15
        # hidden behind the lids it is of one color, in their shade
        assert np.ptp(rows(95), axis=0).max() < 0.02 and 0.3 < rows(95).mean() < 0.6


def test_a_disc_shows_each_direction_where_the_cap_reads_it_and_its_mipmaps_keep_the_iris():
    axis = np.array([0.1, -0.05, 1.0]) / np.linalg.norm([0.1, -0.05, 1.0])
    width, height = POLAR
    row, column = np.mgrid[:height, :width] + 0.5
    directions = polar(axis, np.stack([column.ravel() / width, row.ravel() / height], 1))
    picture = disc((0.5 + 0.5 * directions).reshape(height, width, 3), (120, 120))
    shown = cap(axis)
    read = sample_texture(picture, shown.uv)
    inside = directions_off(shown.directions, axis) < 90
    np.testing.assert_allclose(read[inside], 0.5 + 0.5 * shown.directions[inside], atol=0.02)
    iris = np.where(directions_off(directions, axis) < 29, 0.1, 0.8).reshape(height, width, 1).repeat(3, 2)
    mip = disc(iris, (120, 120)).reshape(15, 8, 15, 8, 3).mean((1, 3))
    assert mip[7, 7].max() < 0.11 and mip[6:9, 6:9].max() < 0.2


def directions_off(directions, axis):
    """Degrees off an axis."""
    return np.degrees(np.arccos(np.clip(directions @ axis, -1, 1)))


@pytest.mark.slow
def test_an_eye_that_is_blurred_gets_back_what_the_blur_took_and_a_sharp_one_stays():
    def pictures(blur):
        """Both eyes' pictures of a blurred sheet from the pupil to the white, without a drawing and with it."""
        image = gaussian_filter(SHEET.level.base_color.astype(np.float64), (blur, blur, 0))
        level = replace(SHEET.level, base_color=bytes_of(image / 255))
        opened, centers = parted(level, SHEET.person, lip_line(SHEET.person)).opened, SHEET.person.eyes.centres
        loops = [one.level.positions[one.loop].astype(np.float64) for one in opened]
        drawings = draw_eyes(level, loops, centers)
        assert drawings is not None
        eyes = [Eye(center, drawing.axis(0.012), 0.012) for center, drawing in zip(centers, drawings)]
        assert all(np.degrees(np.arccos(eye.axis[2])) < 4 for eye in eyes)
        return [np.stack([iris_picture(*each, drawing)[:46] for *each, drawing in zip(opened, eyes, drawn)])
                for drawn in ([None, None], drawings)]  # fmt: skip

    true, sharp = pictures(0.01)
    blurred, drawn = pictures(3.5)
    off = lambda some: np.abs(some - true).mean()
    assert off(sharp) < 0.01 and off(blurred) > 0.04 and off(drawn) < 0.7 * off(blurred)


def test_a_drawing_adds_nothing_to_what_shines_brighter_than_its_white():
    image = gaussian_filter(SHEET.level.base_color / 255.0, (3.5, 3.5, 0))
    lids = [edge_of_lids(SHEET.person, center) for center in SHEET.person.eyes.centres]
    lamp = 0.15 * (image.mean(2, keepdims=True) > 0.72) * (np.arange(512) % 8 == 0)[:, None]
    drawings = draw_eyes(replace(SHEET.level, base_color=bytes_of(image + lamp)), lids, SHEET.person.eyes.centres)
    assert drawings is not None
    for drawing in drawings:
        bright = np.nan_to_num(drawing.picture.colors) > 0.95
        assert bright.any() and drawing.added[bright].max() <= 0


@pytest.mark.slow
def test_a_face_has_the_eyes_that_were_drawn_in_its_strip(monkeypatch):
    image = gaussian_filter(SHEET.level.base_color.astype(np.float64), (3.5, 3.5, 0))
    blurred = replace(SHEET.level, base_color=bytes_of(image / 255))
    contrast = []
    for draw in (draw_eyes, lambda *_: None):
        monkeypatch.setattr("bake.face.face.draw_eyes", draw)
        picture = with_face([blurred], SHEET.person).levels[0].base_color / 255.0
        corners = uv_in(LEFT_EYE, np.array([[0.3, 0.3], [0.7, 0.7]]), 512) * [512, len(picture)]
        (left, top), (right, bottom) = np.sort(corners, axis=0).astype(int)
        contrast.append(picture[top:bottom, left:right].std())
    assert contrast[0] > contrast[1] + 0.02


def test_lids_are_cut_where_the_picture_has_them_and_close_there():
    """Painted as the template has them and two millimetres above."""
    ends, line = [], lip_line(SHEET.person)
    lids = [edge_of_lids(SHEET.person, center) for center in SHEET.person.eyes.centres]
    for up in (0.0, 0.002):
        level = SHEET.level if up == 0 else face_sheet(lids=up).level
        level = replace(level, base_color=bytes_of(gaussian_filter(level.base_color / 255.0, (2, 2, 0))))
        drawings = draw_eyes(level, lids, SHEET.person.eyes.centres)
        assert drawings is not None
        openings = [drawing.opening for drawing in drawings]
        parts = parted(level, SHEET.person, line, openings=openings)
        points = parts.growing.level.positions
        ends.append([[points[one.loop, 1].max(), points[one.loop, 1].min()] for one in parts.opened])
        closed = parts.growing.offsets[SHAPES.index("eyeBlinkLeft")] + points
        edge = closed[parts.opened[0].loop] - SHEET.person.eyes.centres[0]
        upper = edges_of_lids(points[parts.opened[0].loop])
        low = edge[~upper][np.argsort(edge[~upper, 0])]
        over = (edge[upper, 1] - np.interp(edge[upper, 0], low[:, 0], low[:, 1]))[
            (edge[upper, 0] > low[0, 0] + 0.005) & (edge[upper, 0] < low[-1, 0] - 0.005)
        ]
        assert len(over) > 10 and over.max() < (-0.001 if up else -0.00025)
        assert np.linalg.norm(edge, axis=1).min() > SHEET.person.eyes.radii[0]
    # without lashes an iris that reaches up to the lid is told from it less exactly
    higher = np.subtract(*ends[::-1])
    assert (higher > 0.0004).all() and (np.abs(higher[:, 1] - 0.002) < 0.0008).all()


@pytest.mark.parametrize("up, tall, counts", [(0.0, 1.0, False), (0.0015, 1.0, True), (0.0015, 1.4, False)])
def test_lids_of_a_picture_count_where_the_template_s_are_off_them_and_no_lower_lid_was_lost(up, tall, counts):
    lids = [edge_of_lids(SHEET.person, center) for center in SHEET.person.eyes.centres]
    drawings = draw_eyes(SHEET.level, lids, SHEET.person.eyes.centres)
    assert drawings is not None
    edges = [one.level.positions[one.loop, :2].astype(np.float64) for one in PARTED.opened]
    edges = [edge.mean(0) + [0, up] + [1, tall] * (edge - edge.mean(0)) for edge in edges]
    found = pictured_lids(SHEET.level, SHEET.person, [d._replace(opening=e) for d, e in zip(drawings, edges)])
    assert [opening is not None for opening in found] == [counts] * 2


def test_lips_that_registration_left_beside_the_picture_s_are_found():
    off = SHEET.person._replace(vertices=SHEET.person.vertices + [0, -0.005, 0])
    found, right = lip_line(aligned(off, SHEET.level)), lip_line(SHEET.person)
    assert np.abs(np.interp(right.x[20:-20], found.x, found.y) - right.y[20:-20]).max() < 0.001


def strip(*bands, base=0.7):
    """A picture of 6 cm from y = 0 up, with bands (y, half width, brightness), and a line at y = 3 cm."""
    height = 0.06 - PIXEL * np.arange(120)
    light = np.full(120, base)
    for y, half, brightness in bands:
        light[np.abs(height - y) < half] = brightness
    x = np.linspace(-0.02, 0.02, 5)
    colors = np.tile(light[:, None, None], (1, 160, 3))
    picture = FrontPicture(colors, np.zeros((120, 160, 3)), np.array([-0.04, 0.06 - 119 * PIXEL]))
    return picture, np.c_[x, np.full(5, 0.03), 0 * x]


def test_lips_meet_in_a_thin_dark_line_not_where_a_lip_is_dark():
    picture, line = strip((0.038, 0.007, 0.4), (0.031, 0.0006, 0.35))
    off, _ = darkest_off(picture, line[:, 0], line[:, 1], 0.018, (PIXEL, ROUND))
    assert np.abs(off - 0.001).max() < 0.0006


@pytest.mark.parametrize("bands, wanted", [
    ([(0.034, 0.002, 0.4)], 0.004), ([], 0), ([(0.021, 0.003, 0.3)], 0),
    ([(0.034, 0.002, 0.4), (0.018, 0.003, 0.1)], 0.004),
])  # fmt: skip
def test_brows_are_the_dark_band_over_both_eyes_and_no_lid(bands, wanted):
    picture, brow = strip(*bands)
    assert abs(brows_off(picture, [brow, brow], np.array([[0, 0.012, 0], [0, 0.012, 0]])) - wanted) < 0.0007


def test_skin_at_a_brow_moves_with_it_and_lids_do_not():
    _, brow = strip()
    at = np.array([[0, 0.03, 0.01], [0.0, 0.018, 0.01], [0, 0.061, 0.01], [0.035, 0.03, 0.01], [0, 0.03, -0.01]])
    assert with_brow(at, brow, np.array([0, 0.012, 0])).tolist() == [1, 0, 0, 0, 0]


def test_a_painted_eye_gets_a_ball_behind_it():
    points = SHEET.level.positions.copy()
    for center in SHEET.person.eyes.centres:
        points[np.linalg.norm(points[:, :2] - center[:2], axis=1) < 0.02, 2] += 0.004
    found = with_face([replace(SHEET.level, positions=points)], SHEET.person)
    for eye, center in zip(found.eyes, SHEET.person.eyes.centres):
        np.testing.assert_allclose(eye.center - center, [0, 0, 0.004], atol=0.0015)


def test_an_atlas_too_small_for_the_pictures_gets_no_face():
    with pytest.raises(FaceRefused, match="no room"):
        with_face([replace(SHEET.level, base_color=SHEET.level.base_color[::4, ::4])], SHEET.person)


@pytest.mark.slow
def test_a_face_goes_as_far_as_its_film_says_and_its_mouth_has_the_films_colors():
    gains = np.linspace(0.6, 1.3, 10)
    skin = cheek_color(SHEET.person, SHEET.level)
    np.testing.assert_allclose(skin, 255 * np.array(SKIN), atol=1.5)
    own = OwnFace(gains, np.zeros(10), teeth=0.9 * np.array([1.0, 1.0, 0.8]) * TOOTH / skin, red=None)
    faces = [FACED.levels[0].face, with_face([SHEET.level], SHEET.person, own).levels[0].face]
    expected = dict(zip(FITTED[:8], gains)) | {"mouthClose": gains[0], "mouthPucker": 1.0}
    for name, gain in expected.items():
        before, after = (np.linalg.norm(face.offsets[SHAPES.index(name)], axis=1).max() for face in faces)
        assert after / before == pytest.approx(gain, abs=0.03), name
    people = (SHEET.person, with_own_face(SHEET.person, own, SHEET.level))
    # lids end on lids all the same
    again = parted(SHEET.level, people[1], lip_line(people[1]))
    for side, eye in zip(("Left", "Right"), PARTED.opened):
        low = [each.growing.offsets[SHAPES.index(f"eyeBlink{side}"), eye.loop, 1].min() for each in (PARTED, again)]
        assert low[1] == pytest.approx(low[0], rel=0.05)
    at = PARTED.growing.level.positions[PARTED.upper].astype(np.float64)
    moves = tuple(PARTED.growing.offsets[:, edge] for edge in (PARTED.upper, PARTED.lower))
    plain, tinted = (mouth_picture(p, mouth_behind(p, at, moves), size_in(MOUTH, 512)).reshape(-1, 3) for p in people)
    white, red = (plain[:, 2] > 0.85 * plain[:, 0]) & (plain[:, 0] > 0.3), plain[:, 0] > 1.6 * plain[:, 2]
    np.testing.assert_allclose(np.median(tinted[white] / plain[white], 0), [0.9, 0.9, 0.72], atol=0.02)
    np.testing.assert_allclose(np.median(tinted[red] / plain[red], 0), 1, atol=1e-9)


def test_another_template_gets_no_face_and_the_bake_says_once_why_it_stays_still():
    avatar, lines = tiny_avatar(), []
    other = replace(SHEET.subject, faces=SHEET.subject.faces[:, [1, 2, 0]])
    assert faced(avatar, other, None, _Clock(lines.append)) is avatar
    assert lines == ["face: stays still, its template is not of the built-in body"]


def test_lips_are_mended_where_few_vertices_are_torn_and_refused_where_most_are():
    body, rng = SHEET.subject.vertices, np.random.default_rng(0)
    seam = np.concatenate(SHEET.person.face.seam)
    torn = body.copy()
    torn[rng.choice(seam, 8)] += [0, 0.01, 0]
    mended = person_face(replace(SHEET.subject, vertices=torn))
    assert np.abs(mended.vertices[seam] - body[seam]).max() < 0.003
    near = np.linalg.norm(body - body[seam].mean(0), axis=1) < 0.045
    torn[near, 1] += 0.015 * np.sign(np.sin(body[near, 0] * 2 * np.pi / 0.024))
    with pytest.raises(FaceRefused, match="lips are torn"):
        person_face(replace(SHEET.subject, vertices=torn))
