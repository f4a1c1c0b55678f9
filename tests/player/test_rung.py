"""The numbers of a rung, and avatars with twist joints beside others."""

from dataclasses import replace

import numpy as np
import pytest
from limb_sections import posed, turned

from avatar.camera import orbit_camera, project
from avatar.skeleton import BIG_POSE
from bake.bend import with_room
from bake.twist import with_twist
from player.budget.rung import Rung, rung_of, strongest_joints, with_strongest_joints
from player.draw.posing import Poser, screen_bounds
from player.effects.contact import Contact
from player.effects.ground import Ground
from player.effects.outline import Outline
from player.gl.tiles import Patches
from player.scene.effects import PLAIN
from player.scene.mannequin import mannequin
from player.scene.renderer import Renderer
from player.web.packing import packed_avatar

SMALL = (160, 160)
NEAR = orbit_camera(np.zeros(3), 2.4, 0.3, 0.1, SMALL)


@pytest.fixture(scope="module")
def pose():
    bent = np.random.default_rng(3).normal(0, 0.25, (52, 3))
    return bent, np.zeros(3)


def test_the_strongest_joints_are_kept_and_who_follows_no_more_is_left_alone(avatar):
    assert with_strongest_joints(avatar, 4) is avatar
    weaker = with_strongest_joints(avatar, 2)
    assert [level.influences for level in weaker.levels] == [2]
    assert with_strongest_joints(weaker, 2) is weaker
    assert Rung("all", "off").prepared([avatar, avatar])[1] is avatar
    first, second = Rung("fewer", "off", joints=1, halvings=1).prepared([avatar, avatar])
    assert first is second and first is not avatar
    joints = np.array([[4, 7, 9, 2], [1, 0, 0, 0]], np.uint8)
    weights = np.array([[30, 100, 25, 100], [255, 0, 0, 0]], np.uint8)
    named, kept = strongest_joints(joints, weights, 3)
    assert named.tolist() == [[7, 2, 4, 0], [1, 0, 0, 0]]
    assert kept.sum(1).tolist() == [255, 255] and kept[0].tolist() == [112, 110, 33, 0]
    assert strongest_joints(joints, weights, 1)[1].tolist() == [[255, 0, 0, 0], [255, 0, 0, 0]]


@pytest.mark.parametrize("skinning", ["lbs", "dual_quaternion"])
@pytest.mark.parametrize("joints", [1, 2])
def test_shaders_that_read_fewer_joints_draw_what_those_that_read_four_do(render, pose, joints, skinning, avatar):
    weaker = with_strongest_joints(avatar, joints)
    far = (pose[0], np.array([0.0, 0.0, 50.0]))
    pictures = []
    for avatars in ([weaker], [weaker, avatar]):
        # beside one that follows four, programs read four; behind the eye it is not seen
        drawn = render(avatars, SMALL, effects=replace(PLAIN, view="network", skinning=skinning))
        pictures.append(drawn.draw([pose, far][: len(avatars)], NEAR))
    # compilers round sums of two and of four in their own ways
    fewer, four = (picture.astype(np.float32) for picture in pictures)
    assert np.abs(fewer - four).mean() < 0.02
    whole = render(avatar, SMALL, view="network")
    assert np.abs(whole.draw([pose], NEAR) - fewer).mean() > 0.1


def test_each_number_of_a_rung_costs_picture_and_some_cost_memory(context, pose, avatar):
    best = rung_of(avatar, "off")

    def drawn(rung):
        renderer = rung.renderer(context, [avatar], SMALL)
        picture = renderer.draw([pose], NEAR).astype(np.float32)
        renderer.release()
        return picture, renderer.plan.bytes, renderer.size

    picture, size, pixels = drawn(best)
    assert pixels == SMALL
    two, one = (np.abs(drawn(replace(best, joints=joints))[0] - picture).mean() for joints in (2, 1))
    assert 0 < two < one
    smaller = drawn(replace(best, halvings=2))
    # three quarters, then fifteen sixteenths of its texels are gone
    texels = 4 * np.prod(avatar.levels[0].base_color.shape[:2])
    assert size - smaller[1] > 0.9 * texels and not np.array_equal(smaller[0], picture)
    assert drawn(replace(best, share=0.25))[2] == (40, 40)


ORIGIN = np.zeros(3)
BARE = replace(PLAIN, view="off")
SHOULDER = orbit_camera((0.35, 0.3, 0.0), 1.2, 0.3, 0.2, (200, 200))


@pytest.fixture(scope="module")
def twisted():
    return with_twist(mannequin())


def picture(context, avatars, poses, effects=BARE, camera=SHOULDER):
    renderer = Renderer(context, avatars, camera.size, effects=effects)
    image = renderer.draw(poses, camera)
    renderer.release()
    return image.astype(int)


def stiff(avatar, points):
    """A statue of an avatar: its posed surface, which no pose bends."""
    level = avatar.levels[0]
    ones = np.tile(np.uint8([255, 0, 0, 0]), (len(level.positions), 1))
    statue = replace(
        level, positions=points.astype(np.float32), joints=np.zeros_like(level.joints), weights=ones, twist=None
    )
    return replace(avatar, levels=(statue,))


@pytest.mark.parametrize("degrees", [90.0, 179.0])
def test_a_twisted_arm_is_drawn_as_the_reference_bends_it(context, twisted, degrees):
    pose, _ = turned(twisted, "left", degrees)
    pose[16, 2], pose[18, 1] = -0.3, -0.4
    drawn = picture(context, [twisted], [(pose, ORIGIN)])
    statue = picture(context, [stiff(twisted, posed(twisted, pose, "twist"))], [(np.zeros((52, 3)), ORIGIN)])
    assert (np.abs(drawn - statue).max(-1) > 2).mean() < 1e-3
    plain = picture(context, [stiff(twisted, posed(twisted, pose, "lbs"))], [(np.zeros((52, 3)), ORIGIN)])
    # and the measure tells linear blending without them
    assert (np.abs(drawn - plain).max(-1) > 2).mean() > 1e-2


@pytest.mark.parametrize("copy", [False, True])
def test_avatars_with_and_without_twist_joints_stand_in_one_scene(context, twisted, copy):
    """Programs count the bones of the one that has most; the other, or a copy, is drawn as alone."""
    second = twisted if copy else mannequin("female")
    pose, _ = turned(twisted, "left", 150.0)
    here, away = (pose, ORIGIN), (pose if copy else np.array(BIG_POSE), np.array([0.0, 0.0, -0.8]))
    together = picture(context, [twisted, second], [here, away])
    alone, other = picture(context, [twisted], [here]), picture(context, [second], [away])
    front, behind = alone[..., 3] > 0, (alone[..., 3] == 0) & (other[..., 3] > 0)
    np.testing.assert_array_equal(together[front], alone[front])
    np.testing.assert_array_equal(together[behind], other[behind])


@pytest.mark.parametrize("skinning", ["lbs", "dual_quaternion"])
def test_effects_take_twist_joints_as_they_take_others(context, twisted, skinning):
    """In the pose of the mesh an avatar with them looks as without, whatever the scene calls for."""
    effects = replace(
        BARE, skinning=skinning, antialiasing="fxaa", ground=Ground(height=-0.9), contact=Contact(height=-0.9),
        outline=Outline(), view="network",
    )  # fmt: skip
    pose, camera = (np.array(BIG_POSE), ORIGIN), orbit_camera((0, -0.1, 0), 3.0, 0.3, 0.2, (160, 160))
    with_them = picture(context, [twisted], [pose], effects, camera)
    without = picture(context, [mannequin()], [pose], effects, camera)
    assert (np.abs(with_them - without).max(-1) > 2).mean() < 2e-3


@pytest.mark.parametrize("dual", [False, True])
def test_the_balls_that_hold_the_surface_hold_a_twisted_arm(twisted, dual):
    pose, _ = turned(twisted, "left", 179.0)
    bones = Poser(twisted, twisted.levels[0]).posed(pose, ORIGIN, SHOULDER)
    boxes = Patches(twisted.levels[0]).boxes(bones.view_from_canonical, SHOULDER, dual=dual)
    pixels, _ = project(SHOULDER, posed(twisted, pose, "twist"))
    inside = ((pixels[:, None] >= boxes[None, :, :2] - 1e-6) & (pixels[:, None] <= boxes[None, :, 2:] + 1e-6)).all(-1)
    assert inside.any(1).all()
    box = screen_bounds(bones, SHOULDER).box
    assert (pixels >= box[:2]).all() and (pixels <= box[2:]).all()


def test_a_page_holds_the_skin_of_the_52_joints(twisted):
    plain = mannequin()
    plain = replace(plain, levels=tuple(map(with_room, plain.levels)))
    assert packed_avatar(twisted).blobs == packed_avatar(plain).blobs
