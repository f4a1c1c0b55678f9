"""Contact darkening against NumPy, and the line round avatars: where they are, and nothing where they cannot show."""

from dataclasses import replace

import numpy as np
import pytest
from glsl_probe import probe
from scipy.ndimage import binary_dilation

from avatar.camera import orbit_camera, view_from_world
from player.draw.posing import Poser, grounded
from player.effects.contact import AWAY, GROWN, Contact
from player.effects.contact_capsules import BONES, OWNERS, capsules_of, openness
from player.effects.light import Light
from player.effects.outline import Outline
from player.gl.blocks import CAPSULES
from player.scene.effects import PLAIN, Effects

SIZE = (160, 180)
OFF = replace(PLAIN, view="off")
WHITE = (1.0, 1.0, 1.0, 1.0)
DARK = replace(OFF, contact=Contact(1.0))
CAMERA = orbit_camera((0, 0.7, 0), 3.4, 0.5, 0.35, SIZE)


@pytest.fixture(scope="module")
def gray(avatar):
    """The built-in body without paint."""
    level = avatar.levels[0]
    return replace(avatar, levels=(replace(level, base_color=np.full_like(level.base_color, 200)),))


@pytest.fixture(scope="module")
def crouching(avatar):
    angles = np.zeros((52, 3))
    angles[[1, 2], 0], angles[[4, 5], 0], angles[3, 0] = -1.9, 2.2, 0.5
    angles[16, 2], angles[17, 2] = -1.2, 1.2
    return angles, grounded(avatar, angles, np.zeros(3))


def test_capsules_lie_inside_the_body(avatar):
    level = avatar.levels[0]
    capsules = capsules_of(avatar, level)
    assert len(BONES) == 15 and (capsules.radii > 0.01).all() and capsules.radii.max() < 0.2
    heaviest = np.take_along_axis(level.joints, level.weights.argmax(1)[:, None], 1)[:, 0]
    assert (capsules.spared >> OWNERS[heaviest] & 1 == 1).all()
    # thighs apart, arms out: little is hidden at rest, and the inside of a thigh sees the other
    assert np.median(capsules.rest) > 0.97 and 0.3 < capsules.rest.min() < 0.99


def test_the_shader_says_what_numpy_says(context, avatar, crouching, within):
    rng = np.random.default_rng(3)
    capsules, bones = capsules_of(avatar, avatar.levels[0]), Poser(avatar, avatar.levels[0]).posed(*crouching, CAMERA)
    starts, ends = capsules.posed(bones)
    points = rng.normal(size=(800, 3)) * 0.4 + starts.mean(0)
    normals = rng.normal(size=(800, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    # on an axis, and at a capsule's very end
    points[0], points[1] = starts[4], 0.5 * (starts[5] + ends[5])
    spared = rng.integers(0, 1 << 15, 800).astype(np.uint32)
    block = np.zeros((), CAPSULES)
    block["capsule_start"][:15, :3], block["capsule_start"][:15, 3] = starts, capsules.radii
    block["capsule_along"][:15, :3] = ends - starts
    block["capsule_along"][:15, 3] = 1 / ((ends - starts) ** 2).sum(1)
    values = {"p": points, "n": normals, "spared": spared[:, None].astype(np.int64)}
    call = "vec4(open_sky(p, n, spared.x, 1.0, 0, 16))"
    out = probe(context, ["contact.glsl"], call, values, blocks={"Capsules": block}, ints=("spared",))[:, 0]
    expected = openness(points, normals, starts, ends, capsules.radii, spared)
    within(np.abs(out - expected).max(), 2e-5)
    assert expected.min() < 0.6


def test_limbs_that_come_near_darken_and_in_the_air_nothing_is_on_the_ground(render, gray, crouching, avatar):
    level_pose = (gray.canonical_pose.astype(float), np.array([0.0, 1.0, 0.0]))
    for pose, darkest in ((crouching, 0.85), (level_pose, 0.98)):
        plain, dark = (render(gray, SIZE, effects=effects).draw([pose], CAMERA) for effects in (OFF, DARK))
        body = plain[..., 3] > 0
        # drawn over nothing: the ground's own darkening is beside the body
        share = dark[body][:, :3].astype(float) / 200
        assert share.min() < darkest if darkest < 0.9 else share.min() > darkest
        assert share.max() <= 1.003, "nothing gets brighter"
    renderer = render(avatar, SIZE, effects=DARK)
    renderer.draw([(crouching[0], crouching[1] + [0, 6.0, 0])], orbit_camera((0, 6, 0), 3, 0, 0.2, SIZE))
    assert {one.item.name: one.decision for one in renderer.drawn}["contact: avatar on the ground"] == AWAY


def test_the_ground_is_dark_under_feet_and_nowhere_far(render, gray, crouching):
    image = render(gray, SIZE, effects=DARK, background=WHITE).draw([crouching], CAMERA)
    body = render(gray, SIZE, effects=OFF).draw([crouching], CAMERA)[..., 3] > 0
    ground = np.where(body, 255, image[..., 0])
    assert ground.min() < 150
    # the rectangle has no edge: what changes from pixel to pixel at its border is less than two steps
    assert (ground[0] == 255).all() and (ground[:, 0] >= 253).all() and (ground[:, -1] >= 253).all()
    expected = _on_the_ground(gray, crouching)
    row, column = np.nonzero(~body & (ground < 255))
    chosen = np.random.default_rng(0).choice(len(row), 200)
    truth = expected(column[chosen] + 0.5, row[chosen] + 0.5)
    off = np.abs(ground[row[chosen], column[chosen]] - 255 * truth)
    # found in texels of the ground some centimetres wide: most wrong where what hides the sky stops growing
    assert off.mean() <= 0.75 and off.max() <= 10


def _on_the_ground(avatar, pose):
    """Openness where a pixel's ray meets the ground, by NumPy."""
    capsules, bones = capsules_of(avatar, avatar.levels[0]), Poser(avatar, avatar.levels[0]).posed(*pose, CAMERA)
    starts, ends = capsules.posed(bones)
    view = view_from_world(CAMERA)

    def at(x, y):
        rays = np.stack([x, y, np.ones_like(x)], -1) @ np.linalg.inv(CAMERA.K).T @ CAMERA.camera_from_world[:3, :3]
        hit = CAMERA.eye - rays * (CAMERA.eye[1] / rays[:, 1])[:, None]
        points = hit @ view[:3, :3].T + view[:3, 3]
        up = np.tile(view[:3, 1], (len(points), 1))
        spared = np.zeros(len(points), np.uint32)
        return openness(points, up, starts, ends, GROWN * capsules.radii, spared)

    return at


@pytest.mark.parametrize("skinning", ["lbs", "dual_quaternion"])
@pytest.mark.parametrize("view", ["off", "vertex", "network"])
@pytest.mark.parametrize("light", [None, Light("lamps")])
def test_every_way_to_draw_an_avatar_is_darkened(render, gray, crouching, skinning, view, light):
    wish = replace(OFF, skinning=skinning, view=view, light=light)
    plain, dark = (
        render(gray, SIZE, effects=replace(wish, contact=one)).draw([crouching], CAMERA) for one in (None, Contact(1.0))
    )
    body = plain[..., 3] == 255
    ratio = dark[body][:, :3].astype(float).sum(1) / np.maximum(plain[body][:, :3].astype(float).sum(1), 1)
    assert np.quantile(ratio, 0.02) < 0.95 and ratio.max() < 1.01


NEARER = orbit_camera((0.1, 0, -0.2), 2.6, 0.5, 0.1, SIZE)
RED = (1.0, 0.0, 0.0, 1.0)


def grown(mask, pixels):
    """Pixels at most so far from the mask."""
    y, x = np.mgrid[-pixels : pixels + 1, -pixels : pixels + 1]
    return binary_dilation(mask, x * x + y * y <= pixels * pixels)


@pytest.mark.parametrize("skinning", ["lbs", "dual_quaternion"])
@pytest.mark.parametrize("distance", [2.6, 9.0])
def test_the_line_is_as_wide_as_it_says_near_and_far(render, avatar, pose, skinning, distance):
    camera = orbit_camera((0.1, 0, -0.2), distance, 0.5, 0.1, SIZE)
    plain = render(avatar, SIZE, effects=replace(PLAIN, skinning=skinning)).draw([pose], camera)
    effects = replace(PLAIN, skinning=skinning, outline=Outline(RED, 4.0))
    lined = render(avatar, SIZE, effects=effects).draw([pose], camera)
    body, line = plain[..., 3] > 0, (lined == (255, 0, 0, 255)).all(-1)
    added = (lined[..., 3] > 0) & ~body
    assert (added <= line).all() and not (added & ~grown(body, 5)).any()
    near, far = grown(body, 3) & ~body, grown(body, 4) & ~body
    assert added[near].mean() > 0.97 and 0.6 < added[far].mean() <= 1
    inside = body & (lined != plain).any(-1)
    assert (inside <= line).all() and (inside.sum() < 0.2 * body.sum() or distance > 3), "limbs before the body"


def test_msaa_resolves_all_of_a_wide_line(render, avatar, pose):
    """One sample a pixel and four cover the same, but for the line's edge."""
    one, four = (
        render(avatar, SIZE, effects=Effects("off", antialiasing=kind, outline=Outline(RED, 17.0))).draw([pose], NEARER)
        for kind in ("none", "msaa")
    )
    assert not ((one[..., 3] > 0) & (four[..., 3] == 0)).sum() > 60
