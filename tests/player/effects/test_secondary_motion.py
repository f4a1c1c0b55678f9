"""Loose parts that follow the body: at any rate, after any jump, asleep at rest, and drawn where they are."""

from dataclasses import replace

import numpy as np
import pytest
from glsl_probe import probe
from loose_avatar import dance, danced, dressed, moved

from avatar.camera import orbit_camera
from avatar.skeleton import skin_transforms
from avatar.skinning import skin_points
from player.effects.contact import Contact
from player.effects.contact_capsules import capsule_distances
from player.effects.ground import Ground
from player.effects.loose_motion import CALM, SPEED_CAP, STEP, LooseMotion
from player.effects.loose_parts import PARTICLES, LooseParts, loose_parts
from player.effects.outline import Outline
from player.effects.secondary_motion import SecondaryMotion
from player.gl.blocks import LOOSE
from player.scene.effects import PLAIN

SIZE = (150, 170)
CAMERA = orbit_camera((0, 1.0, 0), 3.0, 0.6, 0.1, SIZE)
MOVING = replace(PLAIN, view="off", secondary_motion=SecondaryMotion())
STILL = replace(PLAIN, view="off")


def decision(renderer):
    return next(one.decision for one in renderer.drawn if "secondary motion" in one.item.name)


@pytest.mark.parametrize("skinning", ["lbs", "dual_quaternion"])
def test_loose_parts_are_drawn_where_the_simulation_has_them_and_skin_stays(render, dressed_avatar, skinning):
    moving = render(dressed_avatar, SIZE, effects=replace(MOVING, skinning=skinning))
    still = render(dressed_avatar, SIZE, effects=replace(STILL, skinning=skinning))
    pose = danced(moving)
    image, plain = moving.draw([pose], CAMERA), still.draw([pose], CAMERA)
    assert (image != plain).any(-1).mean() > 0.005
    assert decision(moving).runs and "particles" in decision(moving).why
    # the offsets added by hand to the canonical vertices, each turned back by its skin: the same picture
    level = dressed_avatar.levels[0]
    motion = next(item.offsets.motion() for item in moving.plan.passes if "secondary motion" in item.name)
    if skinning == "lbs":
        added = np.einsum("vk,vkc->vc", motion.parts.follows, motion.offsets[motion.parts.near])
        transforms = skin_transforms(pose[0], dressed_avatar.joint_positions, pose[1])
        blended = np.einsum("vk,vkij->vij", level.skin.weights, transforms[level.skin.joints])[:, :3, :3]
        canonical = level.positions + np.linalg.solve(blended, added[..., None])[..., 0]
        before, after = (skin_points(points, level.skin, transforms) for points in (level.positions, canonical))
        assert np.abs(after - before - added).max() < 1e-6
        by_hand = replace(dressed_avatar, levels=(replace(level, positions=canonical.astype(np.float32)),))
        expected = render(by_hand, SIZE, effects=STILL).draw([pose], CAMERA)
        assert (image != expected).any(-1).mean() < 0.002


def test_the_shader_adds_what_the_vertex_follows(context):
    rng = np.random.default_rng(3)
    block = np.zeros((), LOOSE)
    block["loose_offset"][:, :3] = rng.normal(size=(300, 3))
    near, follows = rng.integers(0, 300, (200, 4)), rng.random((200, 4)).astype(np.float32)
    values, call = {"near": near, "follows": follows}, "vec4(loosened(near, follows), 0.0)"
    out = probe(context, ["loose.glsl"], call, values, blocks={"Loose": block}, ints=("near",), stage="vertex")
    expected = np.einsum("vk,vkc->vc", follows, block["loose_offset"][near][..., :3])
    assert np.abs(out[:, :3] - expected).max() < 1e-5


def test_an_avatar_without_loose_parts_costs_nothing(context, render):
    avatar = dressed(skirt=False, hair=False)
    renderer = render(avatar, SIZE, effects=STILL)
    pose = dance(0.7)
    before, objects, programs = renderer.draw([pose], CAMERA), context.counts.objects(), renderer.plan.handles
    renderer.change(effects=MOVING)
    assert not renderer.moves and renderer.plan.handles == programs and context.counts.objects() == objects
    danced(renderer)
    assert np.array_equal(renderer.draw([pose], CAMERA), before)
    assert "avatar: secondary motion" in {item.name for item in renderer.plan.passes}
    assert decision(renderer).why == "nothing of it is loose"


def test_shadow_outline_and_darkening_move_with_it(render, dressed_avatar):
    for effect in ({"outline": Outline(width=4.0)}, {"ground": Ground("shadow")}, {"contact": Contact()}):
        images = []
        for wish in (SecondaryMotion(), None):
            renderer = render(dressed_avatar, SIZE, effects=replace(STILL, secondary_motion=wish, **effect))
            pose = danced(renderer)
            with_it = renderer.draw([pose], CAMERA).astype(int)
            renderer.change(effects=replace(STILL, secondary_motion=wish))
            danced(renderer)
            images.append(with_it - renderer.draw([pose], CAMERA))
        assert (images[0] != images[1]).any(), effect


def test_a_shadow_is_thrown_anew_while_parts_move_and_no_pose_is_refused(render, dressed_avatar):
    renderer = render(dressed_avatar, SIZE, effects=replace(MOVING, ground=Ground()))
    pose, states = danced(renderer), []
    for frame in range(240):
        renderer.move([pose], 0.7 + (frame + 1) / 60)
        if frame in (0, 1, 238, 239):
            renderer.draw([pose], CAMERA)
            states.append(next(str(one.decision.state) for one in renderer.drawn if one.item.name == "ground: mask"))
    assert states == ["runs", "runs", "runs", "kept"]
    renderer = render(dressed_avatar, SIZE, effects=MOVING)
    with pytest.raises(ValueError, match="not finite"):
        renderer.move([(np.full((52, 3), np.nan), np.zeros(3))], 0.0)
    with pytest.raises(ValueError, match="1 avatars need as many poses, found 0"):
        renderer.move([], 0.0)


def test_copies_of_an_avatar_swing_each_in_its_own_way(render, dressed_avatar):
    renderer = render(dressed_avatar, SIZE, effects=MOVING)
    pose = danced(renderer)
    alone = renderer.draw([pose], CAMERA)
    two = render([dressed_avatar, dressed_avatar], SIZE, effects=MOVING)
    still = (np.zeros((52, 3)), np.array([50.0, 0.95, 0]))
    for frame in range(43):
        two.move([dance(frame / 60), still], frame / 60)
    image = two.draw([pose, still], CAMERA)
    loose = [item.offsets.motion().reach for item in two.plan.passes if "secondary motion" in item.name]
    assert np.array_equal(image, alone) and loose[0] > 0.05 > loose[1]


SETTINGS = SecondaryMotion()
STANDING = (np.zeros((52, 3)), np.zeros(3))


@pytest.fixture(scope="module")
def parts():
    avatar = dressed()
    return loose_parts(avatar, avatar.levels[0])


def test_few_particles_are_followed_by_near_vertices_and_capsule_distances_are_exact(parts):
    level = dressed().levels[0]
    assert 100 < len(parts.places) <= PARTICLES
    share, loose = parts.follows.sum(1), level.loose
    assert (share[loose == 0] == 0).all() and np.allclose(share[loose > 0.25], 1)
    away = np.linalg.norm(level.positions[:, None] - parts.places[parts.near], axis=2)
    assert away[parts.follows > 0].max() < 0.2
    for particle, row in enumerate(parts.neighbours):
        for other in row[parts.pull[particle] > 0]:
            assert particle in parts.neighbours[other], "neighbours are so both ways"
    rng = np.random.default_rng(0)
    points, starts, ends = rng.normal(size=(50, 3)), rng.normal(size=(4, 3)), rng.normal(size=(4, 3))
    ends[3] = starts[3]
    along = np.linspace(0, 1, 20001)[:, None]
    expected = [
        [np.linalg.norm(point - (start + along * (end - start)), axis=1).min() for start, end in zip(starts, ends)]
        for point in points
    ]
    assert np.abs(capsule_distances(points, starts, ends) - expected).max() < 1e-4


@pytest.mark.slow
def test_a_minute_of_dancing_nothing_is_deeper_than_5_mm_in_the_body(parts):
    motion, deepest, stretched = LooseMotion(parts, SETTINGS), 0.0, []
    for frame in range(60 * 30):
        pose = dance(frame / 30)
        motion.move(pose, frame / 30)
        # positions and capsules anew, from the pose
        now = parts.drive((pose[0], np.zeros(3)))
        at = now.targets + motion.offsets
        deepest = max(deepest, float((parts.radii - capsule_distances(at, *now.capsules)).max()))
        length = np.linalg.norm(at[parts.neighbours] - at[:, None], axis=2)
        stretched.append((length / np.maximum(now.lengths.T, 1e-9))[parts.pull > 0])
    assert deepest <= 0.005
    assert np.percentile(stretched, 99) < 1.25


def test_what_a_sudden_stop_flings_is_no_faster_than_the_cap(parts):
    """A whole turn in a fifth of a second, then none: a skirt's hem had 11 m/s."""
    motion, yaw, fastest, last = LooseMotion(parts, SETTINGS), 0.0, 0.0, np.zeros(3)
    for step in range(80):
        yaw += np.radians(55.0) / 4 * (16 <= step < 40)
        axis_angle = np.zeros((52, 3))
        axis_angle[0, 1] = (yaw + np.pi) % (2 * np.pi) - np.pi
        motion.move((axis_angle, np.zeros(3)), step * STEP)
        if step > 41:
            fastest = max(fastest, np.linalg.norm(motion.offsets - last, axis=1).max() / STEP)
        last = motion.offsets.copy()
    assert 4.0 < fastest <= SPEED_CAP


def test_who_stands_as_filmed_is_drawn_as_filmed_and_asleep(parts, monkeypatch):
    motion = moved(parts, 60, 2 * CALM, lambda t: STANDING)[0]
    assert motion.asleep and not motion.shows and motion.reach < 1e-6
    monkeypatch.setattr(LooseParts, "drive", lambda *_: pytest.fail("nothing is computed at rest"))
    steps = motion.steps
    for frame in range(1000):
        motion.move(STANDING, 2 * CALM + frame / 60)
    assert motion.steps == steps


def test_slow_drift_wakes_it_and_hair_hangs_down_when_the_head_does(parts):
    """Too slow to be seen from one frame to the next: asleep is measured from the pose in which it fell asleep."""
    motion = moved(parts, 60, 2 * CALM, lambda t: STANDING)[0]
    assert motion.asleep
    woken = False
    for frame in range(300):
        axis_angle = np.zeros((52, 3))
        axis_angle[15, 0] = 1e-4 * frame
        motion.move((axis_angle, np.zeros(3)), 2 * CALM + frame / 60)
        woken |= not motion.asleep
    assert woken
    # Gravity acts by how far it has turned since pose 0.
    bent = np.zeros((52, 3))
    bent[3, 0] = 1.2
    still = moved(parts, 60, 4, lambda t: (bent, np.zeros(3)))[0]
    hair = parts.places[:, 1] > 0.3
    assert still.asleep and still.offsets[hair, 1].mean() < -0.005
