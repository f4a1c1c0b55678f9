"""Avatars with twist joints in the player: drawn as the reference bends them, beside others, with every effect."""

from dataclasses import replace

import numpy as np
import pytest
from limb_sections import posed, turned

from avatar.camera import orbit_camera, project
from avatar.skeleton import BIG_POSE
from bake.bend import with_room
from bake.twist import with_twist
from player.draw.posing import Poser, screen_bounds
from player.effects.contact import Contact
from player.effects.ground import Ground
from player.effects.outline import Outline
from player.gl.tiles import Patches
from player.scene.effects import PLAIN
from player.scene.mannequin import mannequin
from player.scene.renderer import Renderer
from player.web.packing import packed_avatar

ORIGIN = np.zeros(3)
BARE = replace(PLAIN, view="off")
CAMERA = orbit_camera((0.35, 0.3, 0.0), 1.2, 0.3, 0.2, (200, 200))


@pytest.fixture(scope="module")
def avatar():
    return with_twist(mannequin())


def picture(context, avatars, poses, effects=BARE, camera=CAMERA):
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
def test_a_twisted_arm_is_drawn_as_the_reference_bends_it(context, avatar, degrees):
    pose, _ = turned(avatar, "left", degrees)
    pose[16, 2], pose[18, 1] = -0.3, -0.4
    drawn = picture(context, [avatar], [(pose, ORIGIN)])
    statue = picture(context, [stiff(avatar, posed(avatar, pose, "twist"))], [(np.zeros((52, 3)), ORIGIN)])
    assert (np.abs(drawn - statue).max(-1) > 2).mean() < 1e-3
    plain = picture(context, [stiff(avatar, posed(avatar, pose, "lbs"))], [(np.zeros((52, 3)), ORIGIN)])
    # and the measure tells linear blending without them
    assert (np.abs(drawn - plain).max(-1) > 2).mean() > 1e-2


@pytest.mark.parametrize("copy", [False, True])
def test_avatars_with_and_without_twist_joints_stand_in_one_scene(context, avatar, copy):
    """Programs count the bones of the one that has most; the other, or a copy, is drawn as alone."""
    second = avatar if copy else mannequin("female")
    pose, _ = turned(avatar, "left", 150.0)
    here, away = (pose, ORIGIN), (pose if copy else np.array(BIG_POSE), np.array([0.0, 0.0, -0.8]))
    together = picture(context, [avatar, second], [here, away])
    alone, other = picture(context, [avatar], [here]), picture(context, [second], [away])
    front, behind = alone[..., 3] > 0, (alone[..., 3] == 0) & (other[..., 3] > 0)
    np.testing.assert_array_equal(together[front], alone[front])
    np.testing.assert_array_equal(together[behind], other[behind])


@pytest.mark.parametrize("skinning", ["lbs", "dual_quaternion"])
def test_effects_take_twist_joints_as_they_take_others(context, avatar, skinning):
    """In the pose of the mesh an avatar with them looks as without, whatever the scene calls for."""
    effects = replace(
        BARE, skinning=skinning, antialiasing="fxaa", ground=Ground(height=-0.9), contact=Contact(height=-0.9),
        outline=Outline(), view="network",
    )  # fmt: skip
    pose, camera = (np.array(BIG_POSE), ORIGIN), orbit_camera((0, -0.1, 0), 3.0, 0.3, 0.2, (160, 160))
    with_them = picture(context, [avatar], [pose], effects, camera)
    without = picture(context, [mannequin()], [pose], effects, camera)
    assert (np.abs(with_them - without).max(-1) > 2).mean() < 2e-3


@pytest.mark.parametrize("dual", [False, True])
def test_the_balls_that_hold_the_surface_hold_a_twisted_arm(avatar, dual):
    pose, _ = turned(avatar, "left", 179.0)
    bones = Poser(avatar, avatar.levels[0]).posed(pose, ORIGIN, CAMERA)
    boxes = Patches(avatar.levels[0]).boxes(bones.view_from_canonical, CAMERA, dual=dual)
    pixels, _ = project(CAMERA, posed(avatar, pose, "twist"))
    inside = ((pixels[:, None] >= boxes[None, :, :2] - 1e-6) & (pixels[:, None] <= boxes[None, :, 2:] + 1e-6)).all(-1)
    assert inside.any(1).all()
    box = screen_bounds(bones, CAMERA).box
    assert (pixels >= box[:2]).all() and (pixels <= box[2:]).all()


def test_a_page_holds_the_skin_of_the_52_joints(avatar):
    plain = mannequin()
    plain = replace(plain, levels=tuple(map(with_room, plain.levels)))
    assert packed_avatar(avatar).blobs == packed_avatar(plain).blobs
