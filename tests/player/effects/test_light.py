"""The light of a scene: lamps, albedo and a panorama as ambient and lamps, against the integral itself."""

from dataclasses import replace

import moderngl
import numpy as np
import pytest
from pictures import sky

from avatar.camera import Camera, orbit_camera
from avatar.light import CaptureLight, lamps_of
from avatar.rotation import fibonacci_sphere
from avatar.skeleton import skin_transforms
from avatar.skinning import blended_rotations
from player.draw.posing import posed_vertices
from player.effects.background_source import read_panorama
from player.effects.light import AvatarLight, Light
from player.effects.panorama import direction_from_pixel
from player.effects.panorama_light import LUMINANCE, NORMALS, fitted_light, irradiance
from player.film.shot import Shot, with_whole_paths
from player.scene.effects import PLAIN
from player.scene.scene import Scene, SceneAvatar

SIZE = (120, 140)
CAMERA = orbit_camera((0.1, 0, -0.2), 2.6, 0.5, 0.1, SIZE)
SIDE = lamps_of(np.array([[0.8, 0.5, 0.2], [-0.7, 0.1, -0.3]]), np.array([0.6, 0.3]))
OFF = replace(PLAIN, view="off")


def lit_avatar(avatar, gamma: float = 1.0, gloss: float = 0.1):
    """The built-in body as if it had been filmed in a light; what it was seen under varies over it."""
    level = avatar.levels[0]
    seen = np.stack([0.9 + 0.2 * level.normals[:, 1], 0.02 + 0.01 * level.normals[:, 0]], 1).astype(np.float32)
    light = CaptureLight(0.4, SIDE, gloss=gloss, gamma=gamma, frame="world")
    return replace(avatar, levels=(replace(level, light=seen),), light=light)


@pytest.fixture
def shown(render, avatar, pose):
    """The picture of the built-in body, or another, with these effects."""
    return lambda effects, who=avatar: render(who, SIZE, effects=effects).draw([pose], CAMERA)


def why_of(renderer) -> str:
    """What is said of the avatar's pass in the last frame."""
    return next(one.decision.why for one in renderer.drawn if one.item.name == "avatar: paper")


def expected(rasteriser, avatar, pose, base, light):
    """The picture by NumPy, where a pixel shows one triangle in the middle of others."""
    level = avatar.levels[0]
    axis_angle, root = pose
    transforms = skin_transforms(axis_angle, avatar.joint_positions, root, rest=avatar.canonical_pose)
    posed = posed_vertices(avatar, level, pose)
    normals = np.einsum("vij,vj->vi", blended_rotations(level.skin, transforms), level.normals)
    drawn = rasteriser.draw(posed, level.faces.astype(np.int64), CAMERA)
    hit = drawn.face >= 0
    corners, weight = level.faces[drawn.face[hit]], drawn.barycentric[hit].astype(np.float64)
    of = lambda values: (weight[:, :, None] * values[corners]).sum(1)
    unit = lambda v: v / np.linalg.norm(v, axis=-1, keepdims=True)
    # at the vertices, of three each, and between them
    n, eye, seen = normals[corners], unit(CAMERA.eye - posed[corners]), level.light.astype(np.float64)[corners]
    each = lambda k: light.shown(
        light.albedo(base[hit] / 255, seen[:, k, 0], seen[:, k, 1]),
        light.shading(n[:, k]),
        light.highlight(n[:, k], eye[:, k]),
    )
    by_vertex = sum(weight[:, k, None] * each(k) for k in range(3))
    n, seen, eye = unit(of(normals)), of(level.light.astype(np.float64)), unit(CAMERA.eye - of(posed))
    albedo = light.albedo(base[hit] / 255, seen[:, 0], seen[:, 1])
    by_pixel = light.shown(albedo, light.shading(n), light.highlight(n, eye))
    return hit, 255 * by_vertex, 255 * by_pixel


def assert_lit(rasteriser, avatar, pose, base, shown, light):
    """As NumPy has it at the vertices; on the whole as it has it in each pixel."""
    hit, by_vertex, by_pixel = expected(rasteriser, avatar, pose, base[..., :3].astype(np.float64), light)
    off = np.abs(shown[..., :3][hit] - by_vertex).max(1)
    assert np.quantile(off, 0.9) <= 0.6
    assert np.abs(shown[..., :3][hit] - by_pixel).max(1).mean() < 1.2


@pytest.mark.parametrize("gamma", [1.0, 2.2])
def test_the_captures_light_is_what_numpy_says(shown, rasteriser, avatar, pose, gamma):
    filmed = lit_avatar(avatar, gamma)
    base, lit = shown(OFF, filmed), shown(replace(OFF, light=Light()), filmed)
    assert_lit(rasteriser, filmed, pose, base, lit, filmed.light)


@pytest.mark.parametrize("gamma", [1.0, 2.2])
def test_light_without_a_highlight_is_one_factor_of_each_vertex(render, rasteriser, avatar, pose, gamma):
    filmed = lit_avatar(avatar, gamma, gloss=0.0)
    matt = filmed.levels[0].light * np.float32([1, 0])
    filmed = replace(filmed, levels=(replace(filmed.levels[0], light=matt),))
    base = render(filmed, SIZE, effects=OFF).draw([pose], CAMERA)
    asked = render(filmed, SIZE, effects=replace(OFF, light=Light()))
    assert_lit(rasteriser, filmed, pose, base, asked.draw([pose], CAMERA), filmed.light)
    programs = [handle for handle in asked.plan.handles if handle.kind is moderngl.Program]
    assert any(("LIT", 1) in program.depends_on for program in programs)


def test_albedo_is_shown_without_light_and_named_lamps_light_a_file_without(shown, rasteriser, avatar, pose):
    filmed = lit_avatar(avatar)
    base, albedo = (shown(replace(OFF, light=light), filmed) for light in (None, Light(by="albedo")))
    assert_lit(rasteriser, filmed, pose, base, albedo, CaptureLight(1.0))
    # Even ones of 1 change nothing: test_light_that_changes_nothing_is_the_plan_without_it.
    lamps = Light(by="lamps", ambient=0.0, strength=1.0, direction=(0.0, 0.0, 1.0))
    base, lit = (shown(replace(OFF, light=light)) for light in (None, lamps))
    assert (lit <= base).all() and lit[..., :3].sum() < 0.95 * base[..., :3].sum()


def test_view_dependence_is_lit_too_and_explained(render, shown, avatar, pose):
    filmed = lit_avatar(avatar)
    lit = render(filmed, SIZE, effects=replace(PLAIN, view="network", light=Light()))
    dark = lit.draw([pose], CAMERA).copy()
    assert any("lit by ambient 0.40 and 2 lamps" in one.decision.why for one in lit.drawn)
    bright = shown(replace(PLAIN, view="network"), filmed)
    assert np.abs(dark.astype(int) - bright).max() > 30


# -- panoramas, and what is behind


@pytest.mark.parametrize("view", ["off", "network"])
def test_a_file_that_holds_light_draws_the_same_with_the_same_objects_where_none_is_asked_for(
    render, context, avatar, pose, view
):
    pictures, objects = [], []
    for who in (avatar, lit_avatar(avatar)):
        renderer = render(who, SIZE, effects=replace(PLAIN, view=view))
        pictures.append(renderer.draw([pose], CAMERA))
        objects.append((context.counts.objects(), renderer.plan.bytes))
        renderer.release()
    assert np.array_equal(*pictures) and objects[0] == objects[1]


@pytest.fixture(scope="session")
def behind(backgrounds):
    """A panorama that is turned, and a warm dark picture."""
    return backgrounds | {"hdr": replace(backgrounds["hdr"], turn_deg=40.0)}


def test_a_panorama_lights_avatars_as_its_lamps_would(render, shown, avatar, pose, behind):
    path = behind["hdr"].path
    own = render(avatar, SIZE, effects=replace(OFF, light=Light("panorama")), background=behind["hdr"])
    light = fitted_light(read_panorama(path), np.radians(40.0), gamma=1.0, most=4)
    (drawn,) = [item for item in own.plan.passes if item.name == "avatar: paper"]
    (lit_by,) = [one.light for one in drawn.variants[-1].added if isinstance(one, AvatarLight)]
    assert lit_by == light and 1 <= len(light.lamps) <= 4
    named = render(avatar, SIZE, effects=replace(OFF, light=Light("panorama", path)), background=behind["image"])
    lit, turned_back = own.draw([pose], CAMERA), named.draw([pose], CAMERA)
    body = shown(OFF)[..., 3] > 0
    assert np.abs(lit[body].astype(int) - turned_back[body]).max() > 20, "the background's own turn counts"
    assert "its file has no light, its colors are taken for albedo" in why_of(own)


def test_a_panorama_that_is_nowhere_or_black_is_refused(render, avatar, behind):
    with pytest.raises(ValueError, match="light by panorama: expected its path, or a background of kind hdr"):
        render(avatar, SIZE, effects=replace(OFF, light=Light("panorama")), background=behind["image"])
    with pytest.raises(ValueError, match="the panorama is black"):
        fitted_light(np.zeros((32, 64, 3)), 0.0, gamma=1.0, most=4)


def test_light_that_changes_nothing_is_the_plan_without_it(render, context, avatar, pose):
    """Even light of 1 on an avatar whose file tells none, and the capture's where there is none."""
    for light in (Light("lamps", ambient=1.0, strength=0.0), Light("capture"), Light("albedo")):
        asked, plain = (render(avatar, SIZE, effects=replace(OFF, light=one)) for one in (light, None))
        assert set(asked.plan.handles) == set(plain.plan.handles)
        assert np.array_equal(asked.draw([pose], CAMERA), plain.draw([pose], CAMERA))
    assert "not lit anew: its file has no light" in why_of(asked)


def test_a_panorama_is_a_file_of_the_film_and_even_light_its_own_irradiance(behind, within):
    scene = Scene((SceneAvatar("mannequin"),), effects=replace(OFF, light=Light("panorama", behind["hdr"].path)))
    shot = Shot(scene, 0, 1, SIZE, 30.0, None)
    assert behind["hdr"].path in shot.files()
    assert with_whole_paths(scene).effects.light.path == behind["hdr"].path
    even = np.full((64, 128, 3), 0.7)
    within(np.abs(irradiance(even, 0.3, fibonacci_sphere(50)) - 0.7).max(), 2e-3)
    light = fitted_light(even, 0.0, gamma=2.2, most=4)
    assert light.lamps == () and abs(light.ambient - 1) < 1e-12 and off_by(light, even, 0.0) < 2e-3


def off_by(light, panorama, turn, normals=fibonacci_sphere(NORMALS)):  # noqa: B008  never written to
    """How far a light is from the panorama's own, of mean 1, root mean square."""
    true = irradiance(panorama, turn, normals) @ LUMINANCE
    true = (true / true.mean()) ** (light.gamma / 2.2)
    return float(np.sqrt(np.mean((light.shading(normals) - true / true.mean()) ** 2)))


def test_a_sun_is_one_lamp_towards_where_the_background_shows_it(within):
    """Also turned: the pixel that the background draws for a direction is the one that lights from there."""
    for turn in (0.0, 1.1):
        panorama = np.full((128, 256, 3), 0.2)
        panorama[30:33, 170:173] = 4000.0
        light = fitted_light(panorama, turn, gamma=2.2, most=4)
        brightest = light.directions[light.strengths.argmax()]
        # as shaders/panorama.frag looks a direction up, after direction_from_pixel has turned it
        camera_turn = direction_from_pixel(Camera(np.eye(3), np.eye(4), (1, 1)), turn)
        looked_up = camera_turn @ brightest
        u = 0.5 + np.arctan2(looked_up[0], -looked_up[2]) / (2 * np.pi)
        v = 0.5 - np.arcsin(looked_up[1]) / np.pi
        assert abs(u - 171.5 / 256) < 0.03 and abs(v - 31.5 / 128) < 0.05
        assert light.strengths.max() > 5 * light.ambient
        within(off_by(light, panorama, turn), 0.12)


@pytest.mark.parametrize("gamma", [1.0, 2.2])
def test_an_evening_sky_is_met_to_some_percent_and_no_lamp_is_negative(within, gamma):
    panorama, normals = sky(256), fibonacci_sphere(400)
    light = fitted_light(panorama, 0.4, gamma=gamma, most=4)
    assert 1 <= len(light.lamps) <= 4 and light.ambient >= 0 and (light.strengths >= 0).all()
    shading = light.shading(normals)
    assert (shading >= 0).all() and abs(shading.mean() - 1) < 0.02
    # at other normals than those it was fitted at
    off = off_by(light, panorama, 0.4, normals)
    within(off, 0.12)
    assert abs(off - off_by(light, panorama, 0.4)) < 0.02
