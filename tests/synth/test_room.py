"""Light in a room: shadows, what is open to the sky, the camera's curve."""

import numpy as np
import pytest
from icosphere import icosphere

from avatar.rotation import matrix_from_axis_angle
from avatar.texture import linear_from_srgb, srgb_from_linear
from geometry.mesh import TriangleMesh, concatenated
from synth.light import light_of
from synth.room import (
    ROOM,
    LightSource,
    ReceivedLight,
    Room,
    RoomLighting,
    ambient,
    openness,
    shade_in_room,
    sunlit_share,
    turn_between,
)

UP = np.array([0.0, 1, 0])


def plane(side: float, cells: int):
    """A level square about the origin, facing up."""
    at = np.linspace(-side / 2, side / 2, cells + 1)
    x, z = np.meshgrid(at, at, indexing="ij")
    vertices = np.stack([x, np.zeros_like(x), z], -1).reshape(-1, 3)
    a = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).reshape(-1)
    quads = np.stack([a, a + 1, a + cells + 2, a + cells + 1], 1)
    return vertices, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def ball(radius: float, middle):
    """A sphere's vertices, faces and normals."""
    vertices, faces = icosphere(radius, middle, subdivisions=5)
    return vertices, faces, (vertices - middle) / radius


def ball_over_plane(radius: float = 0.1):
    """A ball, its middle 30 cm over a square of 1.6 m; the plane's vertices come first."""
    ground, ball = TriangleMesh(*plane(1.6, 80)), TriangleMesh(*icosphere(radius, [0, 0.3, 0], subdivisions=5))
    return *concatenated([ground, ball]), len(ground.vertices)


@pytest.mark.parametrize("direction", [(0, 1, 0), (0.6, 0.8, 0), (-0.36, 0.8, 0.48)])
def test_a_ball_shadows_the_ellipse_that_it_should(rasteriser, direction):
    """A point of the plane is dark where its line to the light passes nearer than the radius to the middle."""
    vertices, faces, count = ball_over_plane()
    towards = np.array(direction, float)
    ground = vertices[:count]
    lit = sunlit_share(rasteriser, vertices, faces, ground, np.tile(UP, (count, 1)), towards)
    off = np.linalg.norm(np.cross(np.array([0, 0.3, 0]) - ground, towards), axis=1)
    # 4 to 5 mm a pixel, a point compared with the four round it
    assert (lit[off < 0.094] == 0).all() and (lit[off > 0.112] == 1).all()
    assert 30 < (off < 0.094).sum() < 400


def test_a_ball_is_lit_on_one_half_and_does_not_shadow_itself_there(rasteriser):
    points, faces, normals = ball(0.5, [0, 0, 0])
    towards = np.array([0.48, 0.6, 0.64])
    lit = sunlit_share(rasteriser, points, faces, points, normals, towards)
    cosine = normals @ towards
    assert (lit[cosine > 0.1] == 1).all() and (lit[cosine <= 0] == 0).all()


def test_a_wide_source_makes_the_soft_shadow_that_its_width_says(rasteriser):
    """The share seen is the share of its directions whose lines pass the ball; the middle of the umbra is dark, as the
    ball covers more of the sky than the source does."""
    vertices, faces, count = ball_over_plane()
    source = LightSource((0.0, 1.0, 0.0), width=30.0, height=30.0, irradiance=1.0, samples=64, gloss=20.0)
    room = Room((source,), ceiling=0.0, floor=0.0, exposure=1.0)
    lighting = RoomLighting(rasteriser, faces)
    seen = lighting.on(vertices, room).seen[0, 0, :count]
    ground = vertices[:count]
    passes = []
    for towards in source.directions():
        passes.append(np.linalg.norm(np.cross(np.array([0, 0.3, 0]) - ground, towards), axis=1) > 0.1)
    # a pixel of 4 mm decides late or early at edges of some of the 64 shadows
    np.testing.assert_allclose(seen, np.mean(passes, 0), atol=0.09)
    radius = np.linalg.norm(ground, axis=1)
    assert seen[radius < 0.015].max() < 0.01 and seen[radius > 0.25].min() == 1
    assert 0.3 < seen[(radius > 0.09) & (radius < 0.11)].mean() < 0.7


def test_nothing_in_the_way_gives_the_radiance_that_is_all_round(rasteriser):
    """Energy: a convex body in an even room of radiance 1 receives 1 everywhere; under a sky, a + 2/3 b n.y."""
    points, faces, normals = ball(0.5, [0, 0, 0])
    open_to = openness(rasteriser, points, faces, points, normals)
    even = Room((), ceiling=1.0, floor=1.0, exposure=1.0)
    # grazing directions are a pixel's work: a few hundredths of their small share are lost
    np.testing.assert_allclose(ambient(even, normals, open_to, UP), 1.0, atol=0.02)
    sky = Room((), ceiling=0.8, floor=0.2, exposure=1.0)
    np.testing.assert_allclose(ambient(sky, normals, open_to, UP), 0.5 + 0.2 * normals[:, 1], atol=0.02)


def test_under_a_ball_less_of_the_sky_is_seen(rasteriser):
    """A ball at distance h over a level surface hides (r / h)^2 of its light from an even sky."""
    vertices, faces, count = ball_over_plane(0.2)
    ground, up = vertices[:count], np.tile(UP, (count, 1))
    lit = ambient(Room((), 1.0, 1.0, 1.0), up, openness(rasteriser, vertices, faces, ground, up), UP)
    radius = np.linalg.norm(ground, axis=1)
    # 24 directions of the whole sphere, 12 above
    assert abs(lit[radius < 0.015].mean() - (1 - (0.2 / 0.3) ** 2)) < 0.12
    assert lit[radius > 0.75].min() > 0.9


def test_a_turned_body_is_lit_as_if_it_were_drawn_anew(rasteriser):
    """What is kept of a body is good for any heading; another pose is found out."""
    vertices, faces, _ = ball_over_plane()
    lighting = RoomLighting(rasteriser, faces)
    lighting.on(vertices, ROOM)
    kept = lighting.body
    turn = matrix_from_axis_angle(np.array([0.2, 1.1, -0.3]))
    turned = vertices @ turn.T + [0.3, -1.0, 2.0]
    np.testing.assert_allclose(turn_between(vertices, turned), turn, atol=1e-12)
    again = lighting.on(turned, ROOM)
    assert lighting.body is kept
    fresh = RoomLighting(rasteriser, faces).on(turned, ROOM)
    # but for a few vertices that one of them takes for buried
    assert (again.seen != fresh.seen).mean() < 0.001
    # directions over the sphere stand otherwise to the turned plane: a few hundredths of an ambient of .2
    np.testing.assert_allclose(again.irradiance, fresh.irradiance, atol=0.06)
    moved = turned.copy()
    moved[-1] += 0.01
    assert turn_between(vertices, moved) is None
    lighting.on(moved, ROOM)
    assert lighting.body is not kept


def test_light_stands_still_while_the_body_turns(rasteriser):
    points, faces, normals = ball(0.5, [0, 0, 0])
    lit = RoomLighting(rasteriser, faces).on(points, ROOM)
    window = np.array(ROOM.sources[0].direction) / np.linalg.norm(ROOM.sources[0].direction)
    brightest = normals[lit.irradiance[0].argmax()]
    turn = matrix_from_axis_angle(np.array([0.0, 2.0, 0.0]))
    turned = RoomLighting(rasteriser, faces).on(points @ turn.T, ROOM)
    assert np.linalg.norm(brightest - turn @ normals[turned.irradiance[0].argmax()]) < 0.25
    assert brightest @ window > 0.5


def test_the_curve_is_the_standard_one_and_its_own_inverse():
    np.testing.assert_allclose(
        linear_from_srgb(np.array([0, 0.04045, 0.5, 1])), [0, 0.0031308, 0.2140411, 1], atol=1e-6
    )
    shown = np.linspace(0, 1, 256)
    np.testing.assert_allclose(srgb_from_linear(linear_from_srgb(shown)), shown, atol=1e-6)


def test_light_multiplies_linear_values_and_is_clipped():
    base = np.array([[200.0, 100.0, 30.0], [200.0, 100.0, 30.0]])
    away = np.tile([0, -1.0, 0], (2, 1))
    room = Room((), ceiling=0.0, floor=0.0, exposure=2.0)
    shown = shade_in_room(base, away, -away, ReceivedLight(np.array([0.5, 4.0]), np.zeros((0, 2))), room)
    np.testing.assert_allclose(shown[0], base[0], atol=1e-9)
    expected = 255 * srgb_from_linear(np.minimum(8 * linear_from_srgb(base[1] / 255), 1))
    np.testing.assert_allclose(shown[1], expected)
    assert round(shown[1, 0]) == 255 > shown[1, 2]


def test_a_highlight_goes_where_the_source_is_not_seen():
    source = LightSource((0.0, 1.0, 0.0), width=10.0, height=10.0, irradiance=1.0, samples=4, gloss=60.0)
    room = Room((source,), ceiling=0.0, floor=0.0, exposure=1.0)
    up = np.tile(UP, (2, 1))
    shown = shade_in_room(np.zeros((2, 3)), up, up, ReceivedLight(np.zeros(2), np.array([[1.0, 0.0]])), room)
    np.testing.assert_allclose(shown[0], 255 * srgb_from_linear(np.full(3, 0.04 * 68 / 8)))
    assert (shown[1] == 0).all()


def test_a_triangle_that_dips_into_the_body_is_not_darkened_by_its_hidden_corner(rasteriser):
    """A strip that runs into a closed ball: its last visible vertices keep their light to the rim."""
    strip, strip_faces = plane(2.0, 20)
    strip = strip * [1, 1, 0.2] + [1.0, 0.1, 0]
    vertices, faces = concatenated([TriangleMesh(*icosphere(0.3, subdivisions=5)), TriangleMesh(strip, strip_faces)])
    lighting = RoomLighting(rasteriser, faces)
    room = Room((), ceiling=1.0, floor=1.0, exposure=1.0)
    lit = lighting.on(vertices, room).irradiance[0, -len(strip) :]
    inside = np.linalg.norm(strip, axis=1)
    first = (inside < 0.27) & (np.abs(strip[:, 0] - 0.2) < 0.01)
    assert lit[first].min() > 0.15  # of .5 beside a wall; buried, they would have 0
    assert lit[np.abs(strip[:, 0]) < 0.01].max() == 0


def test_the_room_is_the_same_for_every_video_and_seed():
    assert all(light_of("room", video, seed) is ROOM for video in ("body", "head", "hand_left") for seed in (0, 7))
