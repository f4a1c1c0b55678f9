"""What no video saw: filled round limbs and by material; hair and what it hangs over."""

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from avatar.skeleton import JOINTS
from bake.texture.fill import BLEND, NEAR, TexelSurface, filled_colors
from bake.texture.hair_colors import hair_on_body, strange_on_hair
from bake.texture.pixel_reads import Place, pieces_of_faces
from bake.texture.video_texture import limb_axes, limbs_of
from geometry.mesh import TriangleMesh


def sheet(width):
    """Points 2.5 mm apart of a sheet 10 cm high."""
    x, y = np.meshgrid(np.linspace(0, width, round(400 * width) + 1), np.linspace(0, 0.1, 41))
    return np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], 1)


def flat_surface(points, axis=np.nan):
    """Sheets as meshes, one piece each, whose vertices are the texels as well, facing +z, of a limb along `axis`."""
    shape = (41, round(400 * np.ptp(points[:, 0])) + 1)
    index = np.arange(len(points)).reshape(-1, *shape)
    a, b, c, d = index[:, :-1, :-1], index[:, :-1, 1:], index[:, 1:, 1:], index[:, 1:, :-1]
    faces = np.concatenate([np.stack(f, -1).reshape(-1, 3) for f in ((a, b, c), (a, c, d))])
    count = len(points)
    return TexelSurface(
        TriangleMesh(points, faces), np.stack([np.arange(count)] * 3, 1), np.tile([1.0, 0, 0], (count, 1)), points,
        np.tile([0, 0, 1.0], (count, 1)), np.full(count, 6e-6), np.repeat(np.arange(len(index)), index[0].size),
        np.zeros((count, 2), int), np.zeros(count), np.full((1, 3), axis),
    )  # fmt: skip


def test_unseen_skin_becomes_skin_and_cloth_stays_cloth():
    """An unseen strip across an arm of skin and a sleeve: what the field dreamt there goes."""
    points = sheet(0.2)
    surface = flat_surface(points)
    skin, cloth = np.array([0.8, 0.6, 0.5]), np.array([0.1, 0.15, 0.4])
    truth = np.where(points[:, [0]] < 0.1, skin, cloth)
    seen = np.abs(points[:, 1] - 0.05) > 0.02
    dreamt = np.where(seen[:, None], truth, cloth + 0.1)
    found = filled_colors(surface, dreamt, seen)
    # beside the hem either may stay, or both mixed
    away = np.abs(points[~seen, 0] - 0.1) > 0.012 + 2 * BLEND
    np.testing.assert_allclose(found[away], truth[~seen][away], atol=NEAR + 1e-3)
    assert np.abs(dreamt[~seen] - truth[~seen]).max() > 0.4
    np.testing.assert_array_equal(filled_colors(surface, dreamt, np.zeros(len(seen), bool)), dreamt)


def test_unseen_cloth_of_two_colors_is_one_of_them_and_nothing_between_but_at_borders():
    """White stripes on black that the field saw as grey: each texel becomes white or black."""
    points = sheet(0.2)
    surface = flat_surface(points)
    white = np.floor(points[:, 0] / 0.02).astype(int) % 2 == 0
    truth = np.where(white[:, None], 0.9, 0.1) * np.ones(3)
    seen = np.abs(points[:, 1] - 0.05) > 0.02
    blurred = np.where(seen[:, None], truth, 0.5 + 0.05 * np.sign(truth - 0.5))
    found = filled_colors(surface, blurred, seen)
    off = np.minimum(np.abs(found - 0.9), np.abs(found - 0.1)).max(1)
    inside = np.abs(points[~seen, 0] % 0.02 - 0.01) < 0.01 - 2 * BLEND
    assert off[inside].max() < 0.1 and inside.mean() > 0.3
    assert (np.abs(found - truth[~seen]).max(1) < 2 * NEAR)[inside].mean() > 0.85


def test_the_border_of_two_materials_is_no_saw_and_goes_over_into_what_was_seen():
    """A slanted hairline: votes of cells of several texels would make steps of it."""
    points = sheet(0.2)
    surface = flat_surface(points)
    points = 0.25 * points
    surface = surface._replace(points=points, mesh=TriangleMesh(points, surface.mesh.faces))
    skin, hair = np.array([0.8, 0.6, 0.5]), np.array([0.1, 0.1, 0.12])
    truth = np.where(points[:, [1]] < 0.005 + 0.3 * points[:, [0]], skin, hair)
    seen = np.abs(points[:, 0] - 0.025) > 0.008
    filled = truth.copy()
    filled[~seen] = filled_colors(surface, np.where(seen[:, None], truth, 0.45), seen)
    columns = slice(29, 52)
    height = (filled.reshape(41, 81, 3)[:, columns, 0] > 0.45).sum(0)
    assert np.ptp(height) > 8 and np.abs(np.diff(height)).max() <= 2


def test_print_runs_round_trunk_and_limbs_and_a_collar_has_no_direction(painted):
    axes = dict(zip(JOINTS, limb_axes(painted.joint_positions[: len(JOINTS)]), strict=True))
    for name in ("spine2", "left_shoulder", "right_knee"):
        assert np.linalg.norm(axes[name]) == pytest.approx(1)
    assert not axes["neck"].any() and not axes["left_collar"].any() and np.isnan(axes["head"]).all()


def test_stripes_go_on_round_a_limb_whatever_the_field_dreamt():
    """A sleeve with stripes of 1.5 cm round it, brighter in front than behind, whose outside no video saw."""
    points = np.concatenate([sheet(0.2)] * 2)
    inner = np.arange(len(points)) >= len(points) // 2
    angle = 2 * np.pi * points[:, 1] / np.ptp(points[:, 1])
    outward = np.stack([np.zeros(len(points)), np.cos(angle), np.sin(angle)], 1)
    surface = flat_surface(points, [1.0, 0.0, 0.0])._replace(
        points=np.where(inner, 0.038, 0.04)[:, None] * outward + points * [1, 0, 0], piece=np.zeros(len(points), int),
        normals=np.where(inner[:, None], -outward, outward),
    )  # fmt: skip
    bright = np.where(np.floor(points[:, 0] / 0.015).astype(int) % 2 == 0, 0.9, 0.3)
    truth = np.where(inner, 0.1, bright * (1 - 0.2 * (np.sin(angle) < 0)))[:, None] * np.ones(3)
    seen = np.cos(angle) < 0.3
    guess = np.where(seen[:, None], truth, 0.5)
    found = filled_colors(surface, guess, seen)
    # from front to back in equal steps; the lining is none of the outside
    part = np.where(angle < np.pi, angle, angle - 2 * np.pi)[~seen] / np.arccos(0.3)
    wanted = np.where(inner[~seen], 0.1, bright[~seen] * (1 - 0.1 * (1 - part)))[:, None]
    amid = np.abs((points[~seen, 0] / 0.015) % 1 - 0.5) < 0.2
    np.testing.assert_allclose(found[amid], np.tile(wanted[amid], 3), atol=0.08)
    by_material = filled_colors(surface._replace(axes=np.full((1, 3), np.nan)), guess, seen)
    assert (np.abs(by_material - wanted)[amid].max(1) > 0.3).any()


def tube(axes, middle):
    """A limb of radius 4 cm and 20 cm long, whose `middle` moves across: angles round it, and its surface."""
    points = sheet(0.2)
    angle = 2 * np.pi * points[:, 1] / 0.1
    outward = np.stack([np.zeros(len(points)), np.cos(angle), np.sin(angle)], 1)
    across = np.stack([points[:, 0], middle(points[:, 0]), np.zeros(len(points))], 1)
    return (angle + np.pi) % (2 * np.pi) - np.pi, flat_surface(points)._replace(
        points=across + 0.04 * outward, normals=outward, axes=axes
    )


def test_the_unseen_side_of_a_bent_limb_goes_over_from_its_front_to_its_back():
    angle, surface = tube(np.array([[1.0, 0, 0]]), lambda x: 0.06 * np.sin(np.pi * x / 0.2))
    # at its ends the next limb is asked as well
    amid = np.abs(surface.points[:, 0] - 0.1) < 0.08
    seen = np.cos(angle) < 0.3
    bright = np.where(angle > 0, 0.8, 0.4)
    found = filled_colors(surface, np.where(seen, bright, 0.0)[:, None] * np.ones(3), seen)
    wanted = 0.6 + 0.2 * angle[~seen] / np.arccos(0.3)
    np.testing.assert_allclose(found[amid[~seen], 0], wanted[amid[~seen]], atol=0.05)


def test_what_is_unseen_at_a_joint_is_of_both_limbs():
    angle, surface = tube(np.tile([1.0, 0, 0], (2, 1)), np.zeros_like)
    x = surface.points[:, 0]
    second = (x > 0.1).astype(int)
    surface = surface._replace(
        limbs=np.stack([second, 1 - second], 1), over=np.clip(0.5 - np.abs(x - 0.1) / 0.06, 0, None)
    )
    seen = np.cos(angle) < 0.3
    found = filled_colors(surface, np.where(second, 0.2, 0.8)[:, None] * np.ones(3), seen)[:, 0]
    np.testing.assert_allclose(found, np.interp(x[~seen], [0.07, 0.13], [0.8, 0.2]), atol=0.02)


def test_a_limb_goes_over_into_the_next_as_their_joints_share_it():
    share = np.zeros((4, 52))
    elbow, shoulder, wrist, head = (
        JOINTS.index(name) for name in ("left_elbow", "left_shoulder", "left_wrist", "head")
    )
    share[0, [shoulder, elbow]], share[1, [shoulder, elbow]], share[2, [elbow, wrist]] = (0.8, 0.2), (0, 1), (0.4, 0.6)
    share[3, [head, shoulder]] = 0.96, 0.04
    axes = np.full((52, 3), np.nan)
    axes[[shoulder, elbow]] = [1, 0, 0]
    corners = np.array([[0, 0, 0], [0, 1, 1], [2, 2, 2], [3, 3, 3]])
    limbs, over = limbs_of(share, axes, Place(corners, np.tile([0.5, 0.25, 0.25], (4, 1))))
    assert limbs[:3].tolist() == [[shoulder, elbow], [elbow, shoulder], [wrist, elbow]] and limbs[3, 0] == head
    np.testing.assert_allclose(over[:3], [0.2, 0.4, 0.4])


def test_a_leg_under_a_hem_is_filled_from_the_leg_and_not_from_the_skirt_round_it():
    points = np.concatenate([sheet(0.2)] * 2)
    skirt, angle = np.arange(len(points)) >= len(points) // 2, 2 * np.pi * points[:, 1] / 0.1
    outward = np.stack([np.zeros(len(points)), np.cos(angle), np.sin(angle)], 1)
    # the skirt ends at .1; what no video saw of the leg begins 2 cm below its hem
    along = points[:, :1] + np.where(skirt, 0.1, 0)[:, None]
    places = np.where(skirt, 0.09, 0.04)[:, None] * outward + along * [1, 0, 0]
    surface = flat_surface(points, [1.0, 0.0, 0.0])._replace(
        points=places, normals=outward, piece=np.zeros(len(points), int)
    )
    seen = skirt | (places[:, 0] < 0.08)
    color = np.where(skirt[:, None], [0.2, 0.7, 0.6], [0.3, 0.4, 0.7])
    found = filled_colors(surface, np.where(seen[:, None], color, 0.5), seen)
    near = places[~seen, 0] < 0.099
    np.testing.assert_allclose(found[near], color[~seen][near], atol=0.02)


def test_pieces_are_found_across_chart_edges_and_skin_under_hair_is_filled_from_skin():
    """Two squares whose triangles share no corner in the atlas, one above the other."""
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32)
    found = pieces_of_faces(np.concatenate([square, square + [0, 0, 1]]), np.arange(12).reshape(4, 3))
    assert found[0] == found[1] != found[2] == found[3]
    # An unseen strip of skin under a sheet of hair, whose texels are the nearest seen ones.
    points = np.concatenate([sheet(0.1), sheet(0.1) + [0, 0, 0.003]])
    surface = flat_surface(points)
    piece = surface.piece
    skin, hair = np.array([0.8, 0.6, 0.5]), np.array([0.15, 0.1, 0.05])
    seen = (piece == 1) | (np.abs(points[:, 1] - 0.05) > 0.03)
    dreamt = np.where((piece == 1)[:, None] | ~seen[:, None], hair, skin)
    found = filled_colors(surface, dreamt, seen)
    np.testing.assert_allclose(found, np.tile(skin, (len(found), 1)), atol=NEAR + 1e-3)


def test_a_lock_that_shows_the_shirt_is_unseen_and_dark_hair_with_a_shine_is_not():
    surface = flat_surface(np.concatenate([sheet(0.1), sheet(0.1)]))
    color = np.tile([0.1, 0.2, 0.9], (len(surface.points), 1))
    hair = np.flatnonzero(surface.piece == 1)
    color[hair] = [0.2, 0.14, 0.1]
    color[hair[:40]] = [0.6, 0.42, 0.3]
    shirt = hair[-40:]
    color[shirt] = [0.5, 0.55, 0.7]
    away = cdist(surface.points[hair], surface.points[shirt]).min(1)
    # a mix of both beside the shirt, and the same color far from it
    mixed, brown = hair[(away > 0) & (away < 0.004)], hair[away > 0.03]
    color[mixed] = color[brown[40:80]] = [0.25, 0.22, 0.2]
    found = strange_on_hair(surface, color, np.ones(len(color), bool), None)
    assert len(mixed) and set(np.flatnonzero(found)) == {*shirt, *mixed}
    chin = float(np.median(surface.points[shirt, 1]))
    hanging = strange_on_hair(surface, color, np.ones(len(color), bool), chin)
    assert hanging.tolist() == (found & (surface.points[:, 1] < chin)).tolist() != found.tolist()


def test_a_shoulder_that_shows_hair_is_unseen_and_its_own_shadow_or_black_cloth_is_not():
    """A sheet of hair over the first 5 cm of a red shirt 20 cm wide."""
    points = np.concatenate([sheet(0.2), sheet(0.2) * [0.25, 1, 1] + [0, 0, 0.01]])
    surface = flat_surface(points)
    x, hair = points[:, 0], surface.piece == 1
    color = np.where(hair[:, None], [0.14, 0.13, 0.15], [0.5, 0.06, 0.05])
    shown, shadow = ~hair & (x > 0.06) & (x < 0.07), ~hair & (x > 0.08) & (x < 0.09)
    color[shown], color[shadow] = [0.15, 0.13, 0.15], [0.2, 0.03, 0.02]
    color[~hair & (x > 0.09) & (x < 0.1)] = [0.6, 0.58, 0.61]  # a grey collar
    color[np.flatnonzero(hair)[::9]] *= 1.2
    every = np.ones(len(color), bool)
    assert hair_on_body(surface, color, every, None).tolist() == shown.tolist()
    assert hair_on_body(surface, color, every, 0.05).tolist() == (shown & (points[:, 1] < 0.05)).tolist()
    black = np.where(hair[:, None] | shown[:, None], color, [0.2, 0.19, 0.21])
    assert not hair_on_body(surface, black, every, None).any()


def test_the_rim_of_hair_that_ends_on_skin_shows_what_is_painted_round_it():
    """Its last 1 cm, unseen, dips from 1 cm over the skin to it; on the skin a fringe is painted."""
    points = np.concatenate([sheet(0.1), sheet(0.1)])
    hair = np.arange(len(points)) >= len(points) // 2
    points[:, 2] = np.where(hair, np.clip(points[:, 0] - 0.001, 0, 0.01), 0)
    surface = flat_surface(points)
    skin, fringe = np.array([0.8, 0.6, 0.5]), np.array([0.1, 0.09, 0.08])
    color = np.where(hair[:, None] | (points[:, :1] < 0.05), fringe, skin)
    seen = ~hair | (points[:, 0] > 0.008)
    color[~seen] = skin
    found = filled_colors(surface, color, seen)
    on_skin = points[~seen, 2] < 0.002
    np.testing.assert_allclose(found[on_skin], np.tile(fringe, (on_skin.sum(), 1)), atol=1e-6)
