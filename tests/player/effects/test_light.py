"""Avatars lit anew: read back and held against avatar/light.py, and nothing where it is not asked for."""

from dataclasses import replace

import moderngl
import numpy as np
import pytest

from avatar.camera import orbit_camera
from avatar.gltf.avatar_file import read_avatar, write_avatar
from avatar.light import CaptureLight, lamps_of
from avatar.skeleton import skin_transforms
from avatar.skinning import blended_rotations
from player.draw.posing import posed_vertices
from player.effects.background_source import read_panorama
from player.effects.light import Light
from player.effects.panorama_light import fitted_light
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
@pytest.mark.parametrize("skinning", ["lbs", "dual_quaternion"])
def test_the_captures_light_is_what_numpy_says_and_stays(shown, rasteriser, avatar, pose, gamma, skinning):
    filmed = lit_avatar(avatar, gamma)
    effects = replace(OFF, skinning=skinning)
    base, lit = shown(effects, filmed), shown(replace(effects, light=Light()), filmed)
    if skinning == "dual_quaternion":
        # its surface lies elsewhere; that it is lit is enough
        assert np.abs(lit[..., :3].astype(int) - base[..., :3]).max() > 30
        return
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


def test_without_light_albedo_is_shown(shown, rasteriser, avatar, pose):
    filmed = lit_avatar(avatar)
    base, albedo = (shown(replace(OFF, light=light), filmed) for light in (None, Light(by="albedo")))
    assert_lit(rasteriser, filmed, pose, base, albedo, CaptureLight(1.0))


def test_lamps_that_a_scene_names_light_an_avatar_whose_file_tells_no_light(shown):
    """Even ones of 1 change nothing: test_light_that_changes_nothing_is_the_plan_without_it."""
    lamps = Light(by="lamps", ambient=0.0, strength=1.0, direction=(0.0, 0.0, 1.0))
    base, lit = (shown(replace(OFF, light=light)) for light in (None, lamps))
    assert (lit <= base).all() and lit[..., :3].sum() < 0.95 * base[..., :3].sum()


@pytest.mark.parametrize("view", ["off", "vertex", "network"])
def test_not_asked_for_it_is_the_same_frame_program_and_objects(render, context, avatar, pose, view):
    plain = render(avatar, SIZE, effects=replace(PLAIN, view=view))
    before = plain.draw([pose], CAMERA).copy(), context.counts.objects(), plain.plan.bytes
    plain.release()
    filmed = render(lit_avatar(avatar), SIZE, effects=replace(PLAIN, view=view))
    after = filmed.draw([pose], CAMERA), context.counts.objects(), filmed.plan.bytes
    assert np.array_equal(before[0], after[0])
    assert before[1:] == after[1:]
    programs = [handle for handle in filmed.plan.handles if handle.kind is moderngl.Program]
    assert programs
    assert all(("LIT", 0) in program.depends_on for program in programs)


def test_view_dependence_is_lit_too_and_explained(render, shown, avatar, pose):
    filmed = lit_avatar(avatar)
    lit = render(filmed, SIZE, effects=replace(PLAIN, view="network", light=Light()))
    dark = lit.draw([pose], CAMERA).copy()
    assert any("lit by ambient 0.40 and 2 lamps" in one.decision.why for one in lit.drawn)
    bright = shown(replace(PLAIN, view="network"), filmed)
    assert np.abs(dark.astype(int) - bright).max() > 30


def test_the_file_gives_the_light_back(tmp_path, avatar):
    filmed = lit_avatar(avatar, 2.2)
    write_avatar(tmp_path / "lit.glb", filmed)
    found = read_avatar(tmp_path / "lit.glb")
    assert found.light == filmed.light
    np.testing.assert_array_equal(found.levels[0].light, filmed.levels[0].light)
    with pytest.raises(ValueError, match="light should be in the avatar and all of its levels"):
        write_avatar(tmp_path / "half.glb", replace(filmed, light=None))


# -- panoramas, and what is behind


@pytest.fixture(scope="session")
def behind(backgrounds):
    """A panorama that is turned, and a warm dark picture."""
    return backgrounds | {"hdr": replace(backgrounds["hdr"], turn_deg=40.0)}


def test_a_panorama_lights_avatars_as_its_lamps_would(render, shown, avatar, pose, behind):
    path = behind["hdr"].path
    own = render(avatar, SIZE, effects=replace(OFF, light=Light("panorama")), background=behind["hdr"])
    light = fitted_light(read_panorama(path), np.radians(40.0), gamma=1.0, most=4)
    (drawn,) = [item for item in own.plan.passes if item.name == "avatar: paper"]
    assert drawn.shading.variants[-1].light.light == light and 1 <= len(light.lamps) <= 4
    named = render(avatar, SIZE, effects=replace(OFF, light=Light("panorama", path)), background=behind["image"])
    lit, turned_back = own.draw([pose], CAMERA), named.draw([pose], CAMERA)
    body = shown(OFF)[..., 3] > 0
    assert np.abs(lit[body].astype(int) - turned_back[body]).max() > 20, "the background's own turn counts"
    assert "its file has no light, its colors are taken for albedo" in why_of(own)


def test_a_panorama_that_is_nowhere_is_said(render, avatar, behind):
    with pytest.raises(ValueError, match="light by panorama: expected its path, or a background of kind hdr"):
        render(avatar, SIZE, effects=replace(OFF, light=Light("panorama")), background=behind["image"])


def test_light_that_changes_nothing_is_the_plan_without_it(render, context, avatar, pose):
    """Even light of 1 on an avatar whose file tells none, and the capture's where there is none."""
    for light in (Light("lamps", ambient=1.0, strength=0.0), Light("capture"), Light("albedo")):
        asked, plain = (render(avatar, SIZE, effects=replace(OFF, light=one)) for one in (light, None))
        assert set(asked.plan.handles) == set(plain.plan.handles)
        assert np.array_equal(asked.draw([pose], CAMERA), plain.draw([pose], CAMERA))
    assert "not lit anew: its file has no light" in why_of(asked)


def test_a_panorama_is_one_of_the_files_of_a_film(behind):
    scene = Scene((SceneAvatar("mannequin"),), effects=replace(OFF, light=Light("panorama", behind["hdr"].path)))
    shot = Shot(scene, 0, 1, SIZE, 30.0, None)
    assert behind["hdr"].path in shot.files()
    assert with_whole_paths(scene).effects.light.path == behind["hdr"].path
