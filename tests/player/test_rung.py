"""Rungs: what each number of the record makes of an avatar, and that what is left alone stays as it was."""

from dataclasses import replace

import numpy as np
import pytest

from avatar.camera import orbit_camera
from player.budget.rung import Rung, rung_of, strongest_joints, with_strongest_joints
from player.scene.effects import PLAIN

SIZE = (160, 160)
CAMERA = orbit_camera(np.zeros(3), 2.4, 0.3, 0.1, SIZE)


@pytest.fixture(scope="module")
def pose():
    bent = np.random.default_rng(3).normal(0, 0.25, (52, 3))
    return bent, np.zeros(3)


def test_the_strongest_joints_are_kept_and_sum_to_one():
    joints = np.array([[4, 7, 9, 2], [1, 0, 0, 0]], np.uint8)
    weights = np.array([[30, 100, 25, 100], [255, 0, 0, 0]], np.uint8)
    named, kept = strongest_joints(joints, weights, 3)
    assert named.tolist() == [[7, 2, 4, 0], [1, 0, 0, 0]]
    assert kept.sum(1).tolist() == [255, 255] and kept[0].tolist() == [112, 110, 33, 0]
    assert strongest_joints(joints, weights, 1)[1].tolist() == [[255, 0, 0, 0], [255, 0, 0, 0]]


def test_an_avatar_that_follows_no_more_is_left_as_it_is(avatar):
    assert with_strongest_joints(avatar, 4) is avatar
    weaker = with_strongest_joints(avatar, 2)
    assert [level.influences for level in weaker.levels] == [2]
    assert with_strongest_joints(weaker, 2) is weaker
    assert Rung("all", "off").prepared([avatar, avatar])[1] is avatar
    first, second = Rung("fewer", "off", joints=1, halvings=1).prepared([avatar, avatar])
    assert first is second and first is not avatar


@pytest.mark.parametrize("skinning", ["lbs", "dual_quaternion"])
@pytest.mark.parametrize("joints", [1, 2])
def test_shaders_that_read_fewer_joints_draw_what_those_that_read_four_do(render, pose, joints, skinning, avatar):
    weaker = with_strongest_joints(avatar, joints)
    far = (pose[0], np.array([0.0, 0.0, 50.0]))
    pictures = []
    for avatars in ([weaker], [weaker, avatar]):
        # beside one that follows four, programs read four; behind the eye it is not seen
        drawn = render(avatars, SIZE, effects=replace(PLAIN, view="network", skinning=skinning))
        pictures.append(drawn.draw([pose, far][: len(avatars)], CAMERA))
    # compilers round sums of two and of four in their own ways
    fewer, four = (picture.astype(np.float32) for picture in pictures)
    assert np.abs(fewer - four).mean() < 0.02
    whole = render(avatar, SIZE, view="network")
    assert np.abs(whole.draw([pose], CAMERA) - fewer).mean() > 0.1


def test_each_number_of_a_rung_costs_picture_and_some_cost_memory(context, pose, avatar):
    best = rung_of(avatar, "off")

    def drawn(rung):
        renderer = rung.renderer(context, [avatar], SIZE)
        picture = renderer.draw([pose], CAMERA).astype(np.float32)
        renderer.release()
        return picture, renderer.plan.bytes, renderer.size

    picture, size, pixels = drawn(best)
    assert pixels == SIZE
    two, one = (np.abs(drawn(replace(best, joints=joints))[0] - picture).mean() for joints in (2, 1))
    assert 0 < two < one
    smaller = drawn(replace(best, halvings=2))
    # three quarters, then fifteen sixteenths of its texels are gone
    texels = 4 * np.prod(avatar.levels[0].base_color.shape[:2])
    assert size - smaller[1] > 0.9 * texels and not np.array_equal(smaller[0], picture)
    assert drawn(replace(best, share=0.25))[2] == (40, 40)
