"""FXAA and MSAA: against references, at silhouettes, on transparent and busy backgrounds."""

from dataclasses import replace

import numpy as np
import pytest
from dual_quaternions import skin_points_dual_quaternion
from PIL import Image

from avatar.camera import orbit_camera, project
from avatar.skeleton import BIG_POSE, skin_transforms
from avatar.skinning import skin_points
from player.draw.posing import Poser, posed_vertices, screen_bounds
from player.effects import antialiasing as fxaa_pass
from player.effects.background import Background
from player.effects.outline import Outline
from player.gl.tiles import TILE, Patches, covered
from player.scene.effects import Effects

SIZE = (180, 200)
CAMERA = orbit_camera((0.1, 0, -0.2), 2.6, 0.5, 0.1, SIZE)


@pytest.fixture
def picture(render, avatar, pose):
    """Draws one frame of the mannequin."""

    def draw(antialiasing, background=(0.0, 0.0, 0.0, 0.0), size=SIZE, who=avatar):
        effects = Effects("off", antialiasing=antialiasing)
        return render(who, size, effects=effects, background=background).draw([pose], CAMERA)

    return draw


def fxaa(image):
    """The five-tap form of Lottes 2009 on premultiplied RGBA in [0,1]: shaders/fxaa.frag in NumPy."""
    height, width = image.shape[:2]
    signal = image[..., :3] @ [0.299, 0.587, 0.114] + image[..., 3]
    around = np.pad(signal, 1, "edge")
    nw, ne, sw, se = around[:-2, :-2], around[:-2, 2:], around[2:, :-2], around[2:, 2:]
    low, high = np.min([signal, nw, ne, sw, se], 0), np.max([signal, nw, ne, sw, se], 0)
    along = np.stack([(sw + se) - (nw + ne), (nw + sw) - (ne + se)], -1)
    reduce = np.maximum((nw + ne + sw + se - 4 * low) / 32, 1 / 128)
    along = np.clip(along / (np.abs(along).min(-1) + reduce)[..., None], -8, 8)
    y, x = np.mgrid[:height, :width].astype(float)

    def at(share):
        px = np.clip(x + share * along[..., 0], 0, width - 1)
        py = np.clip(y + share * along[..., 1], 0, height - 1)
        x0, y0 = np.minimum(px.astype(int), width - 2), np.minimum(py.astype(int), height - 2)
        u, v = (px - x0)[..., None], (py - y0)[..., None]
        upper = image[y0, x0] * (1 - u) + image[y0, x0 + 1] * u
        return upper * (1 - v) + (image[y0 + 1, x0] * (1 - u) + image[y0 + 1, x0 + 1] * u) * v

    near = (at(-1 / 6) + at(1 / 6)) / 2
    far = near / 2 + (at(-1 / 2) + at(1 / 2)) / 4
    found = far[..., :3] @ [0.299, 0.587, 0.114] + far[..., 3]
    out = np.where(((found < low) | (found > high))[..., None], near, far)
    return np.where((high - low < np.maximum(1 / 24, (high - 1) / 8))[..., None], image, out)


def steps_in_depth(depth):
    """Where surfaces end: pixels beside nothing, and steps of more than four pixels' width. 0 is nothing."""
    u = np.pad(np.where(depth > 0, 1 / np.maximum(depth, 1e-9), 0), 1, "edge")
    around = np.stack([u[:-2, :-2], u[2:, 2:], u[:-2, 2:], u[2:, :-2]])
    here, pixel = u[1:-1, 1:-1], 1 / CAMERA.K[1, 1]
    bend = np.maximum(np.abs(around[0] + around[1] - 2 * here), np.abs(around[2] + around[3] - 2 * here))
    five = np.concatenate([around, here[None]])
    return (five > 0).any(0) & ((five == 0).any(0) | (bend > 4 * pixel * here))


def test_fxaa_is_its_reference_where_surfaces_end_and_msaa_the_mean_of_four_samples(rasteriser, picture, avatar, pose):
    plain, smooth = picture("none"), picture("fxaa")
    level = avatar.levels[0]
    depth = rasteriser.draw(posed_vertices(avatar, level, pose), level.faces.astype(int), CAMERA, cull=True)
    edges = steps_in_depth(np.where(depth.face >= 0, depth.depth, 0))
    expected = np.where(edges[..., None], np.round(255 * fxaa(plain / 255)), plain)
    away = np.abs(smooth - expected).max(-1)
    assert 800 < (smooth != plain).any(-1).sum() < 0.4 * (plain[..., 3] > 0).sum(), "outlines, not the paint"
    # texture units keep 8 bits of a place between texels; where near and far are equally good, rounding decides
    assert (away > 2).mean() < 5e-4
    flat = replace(avatar.levels[0], base_color=np.full((4, 4, 3), (200, 90, 30), np.uint8))
    who = replace(avatar, levels=(flat,))
    alpha = picture("msaa", who=who)[..., 3]
    assert set(np.unique(alpha)) <= {0, 63, 64, 127, 128, 191, 192, 255}
    large = picture("none", size=(SIZE[0] * 8, SIZE[1] * 8), who=who)[..., 3] / 255
    coverage = large.reshape(SIZE[1], 8, SIZE[0], 8).mean((1, 3))
    plain = picture("none", who=who)[..., 3] / 255
    assert np.abs(alpha / 255 - coverage).mean() < 0.45 * np.abs(plain - coverage).mean()


@pytest.mark.parametrize("skinning", ["lbs", "dual_quaternion"])
@pytest.mark.parametrize("size", [SIZE, (181, 67)])
@pytest.mark.parametrize("outline", [None, Outline(width=17.0)])
def test_fxaa_on_tiles_is_fxaa_on_the_whole_picture(render, avatar, pose, monkeypatch, skinning, size, outline):
    renderer = render(avatar, size, effects=Effects("off", skinning, "fxaa", outline=outline))
    tiles = renderer.draw([pose], CAMERA)
    monkeypatch.setattr(fxaa_pass, "covered", lambda boxes, size, margin: np.full_like(covered(boxes, size, 0), True))
    assert np.array_equal(tiles, renderer.draw([pose], CAMERA))
    assert ((tiles[..., 3] > 0) & (tiles[..., 3] < 255)).sum() > 100


@pytest.mark.parametrize("antialiasing", ["fxaa", "msaa"])
@pytest.mark.parametrize("level", [0, 255])
def test_edges_get_between_values_and_stay_premultiplied(picture, avatar, antialiasing, level):
    plain = replace(avatar.levels[0], base_color=np.full((4, 4, 3), level, np.uint8))
    image = picture(antialiasing, who=replace(avatar, levels=(plain,))).astype(int)
    alpha = image[..., 3]
    assert ((alpha > 0) & (alpha < 255)).sum() > 300
    assert set(np.unique(picture("none")[..., 3])) == {0, 255}
    assert np.abs(image[..., :3] - alpha[..., None] * (level > 0)).max() <= 1, "white is its alpha: no fringe"


@pytest.mark.parametrize("antialiasing", ["fxaa", "msaa"])
def test_a_busy_background_is_not_touched_where_nobody_is(picture, tmp_path, antialiasing):
    noise = np.random.default_rng(1).integers(0, 256, (SIZE[1], SIZE[0], 3), np.uint8)
    Image.fromarray(noise).save(tmp_path / "noise.png")
    background = Background("image", path=str(tmp_path / "noise.png"))
    image, alone = picture(antialiasing, background), picture(antialiasing)
    nobody = alone[..., 3] == 0
    assert np.array_equal(image[nobody][:, :3], noise[nobody]) and (image[..., 3] == 255).all()
    # premultiplied colours over the background, as any compositor would lay them
    laid = alone[..., :3] + noise * (1 - alone[..., 3:] / 255)
    assert np.abs(image[..., :3] - laid).max() <= 2


@pytest.mark.parametrize("dual", [False, True])
def test_patches_and_bounds_hold_every_vertex_in_any_pose(avatar, dual):
    level = avatar.levels[0]
    patches = Patches(level)
    rng = np.random.default_rng(2)
    skin = level.skin
    posed = skin_points_dual_quaternion if dual else skin_points
    for reach in (0.0, 0.4, 1.5):
        axis_angle, root = rng.normal(size=(52, 3)) * reach, rng.normal(size=3) * 0.2
        bones = Poser(avatar, level).posed(axis_angle, root, CAMERA)
        tiles = covered(patches.boxes(bones.view_from_canonical, CAMERA, dual=dual), SIZE, 0)
        transforms = skin_transforms(axis_angle, avatar.joint_positions, root, rest=BIG_POSE)
        points = posed(level.positions.astype(float), skin, transforms)
        pixels, depth = project(CAMERA, points)
        inside = ((pixels >= 0) & (pixels < SIZE)).all(1) & (depth > 0)
        cells = (pixels[inside] / TILE).astype(int)
        assert tiles[cells[:, 1], cells[:, 0]].all()
        if reach == 0.0 and not dual:
            assert tiles.mean() < 0.75, "far from the whole picture"
        bounds = screen_bounds(bones, CAMERA)
        assert bounds.depth[0] <= depth.min() and depth.max() <= bounds.depth[1]
        assert (pixels >= bounds.box[:2]).all() and (pixels <= bounds.box[2:]).all()
    nowhere = np.array([[-np.inf, -np.inf, np.inf, np.inf], [50.0, -90.0, 60.0, -80.0]])
    assert covered(nowhere[:1], (40, 40), 2).all() and not covered(nowhere[1:], (40, 40), 2).any()
