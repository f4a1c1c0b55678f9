"""The floor, the shadow on it and lines: where they lie, and how the shadow falls."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import binary_dilation, maximum_filter

from avatar.camera import orbit_camera, project
from avatar.light import CaptureLight, lamps_of
from player.draw.posing import posed_vertices
from player.effects.grid import Grid
from player.effects.ground import Ground
from player.effects.light import Light
from player.effects.shadow import STILL, MaskPass
from player.scene.effects import PLAIN, Effects
from player.scene.motions import motion_for

SIZE = (160, 180)
OFF = replace(PLAIN, view="off")
WHITE = (1.0, 1.0, 1.0, 1.0)
# from above, in front
CAMERA = orbit_camera((0, 0.6, 0), 4.0, 0.5, 0.5, SIZE)


@pytest.fixture(scope="module")
def standing(avatar):
    """Frame 20 of a walk."""
    clip = motion_for(avatar, "walking").read()
    return clip.axis_angle[20].astype(float), clip.root[20].astype(float) * [0, 1, 0]


def with_ground(**settings) -> Effects:
    return replace(OFF, ground=Ground(**settings))


def shadow_alone(renderer, pose, camera):
    """Alpha of the shadow, also where the body hides it."""
    renderer.draw([pose], camera)
    shadow = next(one.item for one in renderer.drawn if one.item.name == "ground: shadow")
    renderer._frame(renderer.last, only=shadow)
    image = np.empty((*renderer.size[::-1], 4), np.uint8)
    renderer.target.read_into(image, components=4)
    return image[..., 3] / 255


@pytest.mark.parametrize("skinning", ["lbs", "dual_quaternion"])
@pytest.mark.parametrize("direction", [(0.4, 0.85, 0.45), (-0.6, 0.5, 0.1), (0.0, 1.0, 0.0)])
def test_each_point_of_the_body_throws_its_shadow_along_the_lamps_ray(render, avatar, standing, direction, skinning):
    ground = with_ground(kind="shadow", direction=direction, softness=0.0, strength=1.0)
    camera = orbit_camera((0, 0, 0), 6.0, 0.4, 0.9, SIZE)
    alpha = shadow_alone(render(avatar, SIZE, effects=replace(ground, skinning=skinning)), standing, camera)
    points = posed_vertices(avatar, avatar.levels[0], standing)
    x, y, z = direction
    fallen = points - points[:, 1:2] * np.array([x, y, z]) / y
    column, row = project(camera, fallen)[0].astype(int).T
    inside = (column > 0) & (row > 0) & (column < SIZE[0]) & (row < SIZE[1])
    assert inside.mean() > 0.6
    # a point on an outline lies on the edge of a pixel that is half dark
    near = maximum_filter(alpha, 3)
    assert np.quantile(near[row[inside], column[inside]], 0.01) > 0.4
    covered = np.zeros(SIZE[::-1], bool)
    covered[np.clip(row, 0, SIZE[1] - 1), np.clip(column, 0, SIZE[0] - 1)] = True
    assert alpha[~binary_dilation(covered, np.ones((7, 7)))].max() < 0.05, "what nothing shades is not dark anywhere"


def test_feet_stand_on_their_shadow_all_through_a_walk(render, avatar):
    """Within 3 pixels of where a sole touches, the ground is dark, at 640 x 640; under the tip of a toe less so."""
    size, clip = (640, 640), motion_for(avatar, "walking").read()
    renderer = render(avatar, size, effects=with_ground(kind="shadow", strength=1.0))
    near = []
    for frame in range(0, 200, 10):
        pose = clip.axis_angle[frame].astype(float), clip.root[frame].astype(float)
        camera = orbit_camera(pose[1] * [1, 0, 1] + [0, 0.85, 0], 3.2, 0.02 * frame, 0.25, size)
        alpha, points = shadow_alone(renderer, pose, camera), posed_vertices(avatar, avatar.levels[0], pose)
        for column, row in project(camera, points[np.abs(points[:, 1]) < 0.004])[0].astype(int):
            near.append(alpha[row - 3 : row + 4, column - 3 : column + 4].max())
            assert near[-1] > 0.2, f"frame {frame}"
    assert len(near) > 200 and np.quantile(near, 0.05) > 0.5


@pytest.mark.parametrize(("drawn", "fewer", "thrown"), [(0, 10, 2), (0, 5, 1), (0, 0, 0), (1, 0, 1), (2, -1, 2)])
def test_a_coarser_level_of_detail_throws_the_shadow(render, avatar, standing, monkeypatch, drawn, fewer, thrown):
    """The coarsest with enough triangles, none finer than what is drawn."""
    level = avatar.levels[0]
    levels = (level, replace(level, faces=level.faces[5:]), replace(level, faces=level.faces[10:]))
    monkeypatch.setattr("player.effects.shadow.TRIANGLES", len(level.faces) - fewer)
    renderer = render(replace(avatar, levels=levels), SIZE, effects=with_ground(kind="shadow"), level=drawn)
    (mask,) = [item for item in renderer.plan.passes if isinstance(item, MaskPass)]
    assert mask.meshes[0].mesh.faces.bytes == 12 * len(levels[thrown].faces)
    image = renderer.draw([standing], CAMERA)[..., 3]
    if drawn == 0:
        fine = render(avatar, SIZE, effects=with_ground(kind="shadow")).draw([standing], CAMERA)[..., 3]
        assert (image > 0).any() and np.abs(image.astype(int) - fine).mean() < 0.05


def test_it_hardens_at_contact(render, avatar, standing):
    """The edge of a foot's shadow is narrower than that of the head's."""
    camera = orbit_camera((0, 0, 0), 6.0, 0.0, np.pi / 2 - 0.01, (400, 400))
    soft, hard = (
        shadow_alone(render(avatar, (400, 400), effects=with_ground(kind="shadow", softness=s)), standing, camera)
        for s in (6.0, 0.0)
    )
    points = posed_vertices(avatar, avatar.levels[0], standing)
    fallen = points - points[:, 1:2] * np.array([0.4, 0.85, 0.45]) / 0.85
    blur = np.abs(soft - hard)

    def about(chosen):
        column, row = project(camera, fallen[chosen])[0].astype(int).T
        return blur[row, column].mean()

    assert about(points[:, 1] < 0.03) < 0.4 * about(points[:, 1] > points[:, 1].max() - 0.2)


def test_a_shadow_that_moves_on_does_not_pop(render, avatar, standing):
    """Steps of 3 mm over more than the mask's steps: no pixel's change is much more than a sharp edge's own."""
    camera = orbit_camera((0, 0.2, 0), 5.0, 0.3, 0.7, SIZE)
    renderer = render(avatar, SIZE, effects=with_ground(kind="shadow", strength=1.0))
    frames = [shadow_alone(renderer, (standing[0], standing[1] + [0.003 * k, 0, 0.002 * k]), camera) for k in range(40)]
    change = np.abs(np.diff(frames, axis=0))
    moving = change[:, np.max(change, 0) > 0.004]
    assert np.quantile(moving, 0.99) < 0.15
    # none of the steps stands out
    each = change.mean((1, 2))
    assert each.max() < 2.0 * np.median(each)


def test_the_mask_is_kept_while_nothing_moves_whatever_the_camera_does(context, render, avatar, standing):
    renderer = render(avatar, SIZE, effects=with_ground(kind="shadow"))
    nearer = orbit_camera((0, 0.6, 0), 3.5, 0.7, 0.4, SIZE)
    moved = standing[0], standing[1] + [0, 0, 0.1]

    def draws(pose, camera):
        before = context.counts.calls["draw"]
        renderer.draw([pose], camera)
        return context.counts.calls["draw"] - before

    cases = [(standing, CAMERA), (standing, CAMERA), (standing, nearer), (moved, nearer), (moved, nearer)]
    assert [draws(*case) for case in cases] == [4, 2, 2, 4, 2]
    states = {one.item.name: one.decision for one in renderer.drawn}
    assert states["ground: mask"] == STILL
    kept = renderer.draw([standing], CAMERA)
    fresh = render(avatar, SIZE, effects=with_ground(kind="shadow"))
    assert np.array_equal(kept, fresh.draw([standing], CAMERA))


@pytest.mark.parametrize("kind", ["plane", "checker", "shadow"])
@pytest.mark.parametrize("antialiasing", ["fxaa", "msaa"])
def test_antialiasing_leaves_the_ground_as_it_is_and_a_window_shows_the_same(
    context, render, avatar, standing, kind, antialiasing
):
    plain = with_ground(kind=kind)
    sharp = render(avatar, SIZE, effects=plain, background=WHITE).draw([standing], CAMERA).astype(int)
    smooth = render(avatar, SIZE, effects=replace(plain, antialiasing=antialiasing), background=WHITE)
    image = smooth.draw([standing], CAMERA)
    body = render(avatar, SIZE, effects=OFF).draw([standing], CAMERA)[..., 3] > 0
    near = binary_dilation(body, np.ones((5, 5)))
    assert np.abs(image - sharp)[~near].max() <= 1
    window = render(avatar, None, effects=replace(plain, antialiasing=antialiasing), background=WHITE)
    color, depth = context.gl.renderbuffer(SIZE), context.gl.depth_renderbuffer(SIZE)
    framebuffer = context.gl.framebuffer([color], depth)
    window.draw_into(framebuffer, [standing], CAMERA)
    raw = np.frombuffer(framebuffer.read(components=4, alignment=1), np.uint8).reshape(*SIZE[::-1], 4)[::-1]
    for thing in (framebuffer, color, depth):
        thing.release()
    off = np.abs(raw.astype(int) - image).max(-1)
    # a ray through the edge of a texel may fall to either side
    assert np.quantile(off, 0.999) <= 1 and off.max() <= 8


def test_a_transparent_picture_keeps_the_shadow_as_alpha(render, avatar, standing):
    over = render(avatar, SIZE, effects=with_ground(kind="shadow"), background=WHITE).draw([standing], CAMERA)
    alone = render(avatar, SIZE, effects=with_ground(kind="shadow")).draw([standing], CAMERA)
    body = render(avatar, SIZE, effects=OFF).draw([standing], CAMERA)[..., 3] > 0
    ground = ~body & (alone[..., 3] > 0)
    assert ground.sum() > 200 and (alone[ground][:, :3] == 0).all()
    assert np.abs(255 - alone[..., 3][ground].astype(int) - over[..., 0][ground]).max() <= 1


def test_the_lamps_that_light_avatars_throw_the_shadow(render, avatar, standing):
    lamp = (-0.7, 0.6, -0.2)
    lit = render(avatar, SIZE, effects=replace(with_ground(kind="shadow"), light=Light("lamps", direction=lamp)))
    told = render(avatar, SIZE, effects=with_ground(kind="shadow", direction=lamp))
    assert np.array_equal(shadow_alone(lit, standing, CAMERA), shadow_alone(told, standing, CAMERA))
    filmed = replace(
        avatar,
        levels=(replace(avatar.levels[0], light=np.ones((len(avatar.levels[0].positions), 2), np.float32)),),
        light=CaptureLight(0.5, lamps_of(np.array([lamp]), np.array([0.5])), frame="world"),
    )
    own = render(filmed, SIZE, effects=replace(with_ground(kind="shadow"), light=Light()))
    assert np.array_equal(shadow_alone(own, standing, CAMERA), shadow_alone(told, standing, CAMERA))


TOP = orbit_camera((0, 0, 0), 8.0, 0.0, np.pi / 2 - 1e-4, SIZE)
RED = (1.0, 0.0, 0.0, 1.0)
# nobody in the way of the lines
ABOVE = np.array([0.0, 50.0, 0.0])


def test_lines_lie_at_whole_metres(render, avatar, pose):
    image = render(avatar, SIZE, effects=replace(OFF, grid=Grid(color=RED))).draw([(pose[0], ABOVE)], TOP)
    alpha = image[..., 3].astype(float)
    assert (image[..., 1:3] == 0).all() and (image[..., 0] == image[..., 3]).all(), "premultiplied red"
    metre = TOP.K[0, 0] / 8.0
    for k in (-1, 0, 1):
        column, row = round(SIZE[0] / 2 + k * metre), round(SIZE[1] / 2 + k * metre)
        assert alpha[30, column - 1 : column + 1].max() > 100 and alpha[row - 1 : row + 1, 30].max() > 100
    between = alpha[10:150, round(SIZE[0] / 2 + 0.1 * metre)]
    assert np.median(between) < 5
