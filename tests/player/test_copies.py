"""Copies of one avatar: made once, posed together, drawn at once, and the same picture as avatars apart."""

from dataclasses import replace

import numpy as np
import pytest

from avatar.camera import orbit_camera
from avatar.light import CaptureLight
from player.copies import copies_bounds, groups_of, palette, posed_copies
from player.mannequin import mannequin
from player.passes.contact import Contact
from player.passes.ground import Ground
from player.passes.light import Light
from player.passes.outline import Outline
from player.passes.view import OUT_OF_VIEW
from player.posing import Poser, dual_parts, quaternions, screen_bounds
from player.renderer import Renderer
from player.scenes.effects import PLAIN, Effects

SIZE = (160, 120)
CAMERA = orbit_camera((0.0, 0, 0), 5.0, 0.3, 0.2, SIZE)
# a uniform block of the frame's constants, std140
FRAME_BYTES = 80


def poses_of(count, seed=0):
    """Poses side by side, the last out of view."""
    rng = np.random.default_rng(seed)
    at = np.stack([np.linspace(-1.2, 1.2, count), np.zeros(count), rng.uniform(-1, 1, count)], 1)
    at[-1] = [500.0, 0, 0]
    return [(0.3 * rng.normal(size=(52, 3)), one) for one in at]


def drawn(context, avatars, poses, **options):
    renderer = Renderer(context, avatars, SIZE, **options)
    try:
        return renderer.draw(poses, CAMERA).astype(int)
    finally:
        renderer.release()


def calls_of_a_frame(context, renderer, poses):
    """Draws and bytes uploaded of the second frame."""
    renderer.draw(poses, CAMERA)
    draws, sent = context.counts.calls["draw"], context.counts.uploaded
    renderer.draw(poses, CAMERA)
    return context.counts.calls["draw"] - draws, context.counts.uploaded - sent


def test_copies_are_the_avatars_that_are_one_object(avatar):
    other = replace(avatar)
    assert groups_of([avatar, other, avatar, avatar]) == ((0, 2, 3), (1,))


def test_posed_together_is_posed_one_by_one(avatar):
    poser, poses = Poser(avatar, avatar.levels[0]), poses_of(7)
    # the eye is inside of this one
    poses.append((np.zeros((52, 3)), -CAMERA.camera_from_world[:3, :3].T @ CAMERA.camera_from_world[:3, 3]))
    together = posed_copies(poser, poses, CAMERA)
    bounds = copies_bounds(together, CAMERA)
    rows = palette(together, dual=False, directions=True).reshape(-1, 4, 52, 4)
    duals = palette(together, dual=True, directions=False).reshape(-1, 4, 52, 4)
    for k, pose in enumerate(poses):
        alone = poser.posed(*pose, CAMERA)
        np.testing.assert_allclose(together[k].view_from_canonical, alone.view_from_canonical, rtol=0, atol=1e-11)
        np.testing.assert_allclose(together[k].centers, alone.centers, rtol=0, atol=1e-11)
        expected = screen_bounds(alone, CAMERA)
        np.testing.assert_allclose(bounds[k].box, expected.box, rtol=1e-9)
        np.testing.assert_allclose(bounds[k].depth, expected.depth, rtol=1e-9, atol=1e-11)
        matrices = rows[k, :3].transpose(1, 0, 2)
        np.testing.assert_allclose(matrices, alone.view_from_canonical[:, :3], rtol=1e-6, atol=1e-6)
        turns = quaternions(alone)
        np.testing.assert_allclose(rows[k, 3], turns, rtol=0, atol=1e-6)
        np.testing.assert_allclose(duals[k, 3], turns, rtol=0, atol=1e-6)
        np.testing.assert_allclose(duals[k, 0], dual_parts(alone, turns), rtol=1e-6, atol=1e-6)
    assert np.isinf(bounds[-1].box).all()


def test_a_pose_that_is_not_finite_is_refused(avatar):
    poses = poses_of(3)
    poses[1][0][7, 1] = np.nan
    with pytest.raises(ValueError, match="not finite"):
        posed_copies(Poser(avatar, avatar.levels[0]), poses, CAMERA)


@pytest.mark.parametrize("view", ["off", "vertex", "network"])
@pytest.mark.parametrize("skinning", ["lbs", "dual_quaternion"])
def test_copies_are_the_picture_of_avatars_apart(context, avatar, view, skinning):
    effects, poses = Effects(view, skinning, "none"), poses_of(5)
    copies = drawn(context, [avatar] * 5, poses, effects=effects)
    apart = drawn(context, [replace(avatar) for _ in range(5)], poses, effects=effects)
    assert (copies[..., 3] > 0).sum() > 1000
    # bones differ by roundings of doubles: a pixel of an outline may fall the other way
    assert (np.abs(copies - apart).max(-1) > 1).sum() <= 2


@pytest.mark.parametrize("effect", ["light", "outline", "shadow", "contact", "fxaa"])
def test_effects_show_on_copies_as_on_avatars_apart(context, avatar, effect):
    lamp = Light(by="lamps")
    more = {"light": {"light": lamp}, "outline": {"outline": Outline()}, "shadow": {"ground": Ground(height=-1.0)},
            "contact": {"contact": Contact(height=-1.0)}, "fxaa": {"antialiasing": "fxaa"}}  # fmt: skip
    who = replace(avatar, light=CaptureLight(1.0, frame="world")) if effect == "light" else avatar
    effects, poses = replace(PLAIN, **more[effect]), poses_of(3)
    copies = drawn(context, [who] * 3, poses, effects=effects)
    apart = drawn(context, [replace(who) for _ in range(3)], poses, effects=effects)
    assert (np.abs(copies - drawn(context, [who] * 3, poses, effects=PLAIN)).max(-1) > 1).any(), "it shows"
    assert (np.abs(copies - apart).max(-1) > 1).sum() <= 2


def test_a_hundred_copies_are_the_objects_of_two_and_one_draw(context, avatar):
    made, calls = [], []
    for count in (2, 100):
        renderer = Renderer(context, [avatar] * count, SIZE, view="off")
        made.append((context.counts.objects(), context.counts.live_bytes))
        assert context.counts.objects() == renderer.plan.objects()
        assert context.counts.live_bytes == renderer.plan.bytes
        created = context.counts.calls["create"]
        calls.append(calls_of_a_frame(context, renderer, poses_of(count)))
        assert context.counts.calls["create"] == created
        renderer.release()
    row = 52 * 3 * 16
    assert made[0][0] == made[1][0]
    assert made[1][1] - made[0][1] == 98 * row
    # the last copy is out of view
    assert calls == [(1, FRAME_BYTES + row), (1, FRAME_BYTES + 99 * row)]


def test_those_too_small_for_view_dependence_are_drawn_apart_from_the_others(context, avatar):
    renderer = Renderer(context, [avatar] * 4, SIZE, view="vertex")
    away = CAMERA.camera_from_world[2, :3]
    poses = [(pose, root + (40 * away if k % 2 else 0)) for k, (pose, root) in enumerate(poses_of(5)[:4])]
    assert calls_of_a_frame(context, renderer, poses) == (2, FRAME_BYTES + 4 * 52 * 4 * 16)
    assert renderer.views == ["vertex"] * 4 and renderer.has_view
    image = renderer.draw(poses, CAMERA).astype(int)
    renderer.release()
    apart = drawn(context, [replace(avatar) for _ in range(4)], poses, view="vertex")
    assert (np.abs(image - apart).max(-1) > 1).sum() <= 2


def test_one_avatar_and_others_apart_know_nothing_of_copies(context, avatar):
    """Blocks of bones and a draw of each avatar's own, no uniform: the frame as it was."""
    other = mannequin()
    for avatars in ([avatar], [avatar, other]):
        renderer = Renderer(context, avatars, SIZE, view="off")
        assert not any("bones" in handle.name for handle in renderer.plan.handles if handle.bytes > 52 * 48)
        uniforms = context.counts.calls["uniform"]
        poses = poses_of(len(avatars) + 1)[:-1]
        poses[0] = (poses[0][0], np.zeros(3))
        draws, sent = calls_of_a_frame(context, renderer, poses)
        assert draws == len(avatars)
        assert sent == FRAME_BYTES + len(avatars) * 52 * 48
        assert context.counts.calls["uniform"] == uniforms
        renderer.release()


def test_copies_out_of_view_cost_nothing(context, avatar):
    renderer = Renderer(context, [avatar] * 3, SIZE, view="off")
    away = [(pose, root + [500.0, 0, 0]) for pose, root in poses_of(3)]
    assert calls_of_a_frame(context, renderer, away) == (0, 0)
    assert OUT_OF_VIEW in [outcome.decision for outcome in renderer.drawn]
    renderer.release()
