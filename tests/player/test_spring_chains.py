"""Spring bones of a .vrm: as the specification's equation has them, at any rate of frames, after any jump, at rest."""

from dataclasses import replace

import numpy as np
import pytest
import rigs
from loose_paths import dance, gently, moved
from spring_vrm import PONYTAIL, SETTINGS, TAIL, spring_vrm

from avatar.gltf.avatar_file import read_avatar
from avatar.skeleton import JOINTS
from player.loose_capsules import capsule_distances
from player.loose_motion import CALM, LONGEST, LooseMotion
from player.passes.secondary_motion import SecondaryMotion
from player.spring_chains import SpringParts, spring_parts

ASKED = SecondaryMotion()
STANDING = (np.zeros((52, 3)), np.zeros(3))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("vrm")


def parts_of(folder, **file) -> SpringParts:
    file.setdefault("settings", SETTINGS | {"gravityPower": 0.2})
    avatar = read_avatar(rigs.write(folder / "one.vrm", spring_vrm(**file)))
    parts = spring_parts(avatar, avatar.levels[0])
    assert parts is not None
    return parts


@pytest.fixture(scope="module")
def parts(folder):
    sphere = ("head", (0.0, 0.05, 0.0), (0.0, 0.10, 0.0), 0.1)
    return parts_of(folder, tubes=(PONYTAIL, TAIL), colliders=[sphere])


def one_bone(parts, **values):
    """The first link alone, straight down, with values of its own."""
    springs = parts.springs
    first = {name: getattr(springs, name)[:1].copy() for name in
             ("heads", "tails", "joints", "parents", "stiffness", "gravity", "drag", "centers", "radii")}  # fmt: skip
    first["tails"] = first["heads"] + [0, -0.07, 0]
    first |= {name: np.array(value, float) for name, value in values.items()}
    alone = replace(springs, **first, heeds=np.zeros((1, len(springs.collider_radii)), bool), near=0 * springs.near)
    length = np.linalg.norm(alone.tails - alone.heads, axis=1, keepdims=True)
    return replace(parts, springs=alone, places=alone.tails, lengths=length, generations=(), center=-np.ones(1, int))


def equation(stiffness, gravity, drag, length, seconds):
    """Angle of the pendulum that the specification's numbers mean, 60 times a second; gravity across the bone."""
    rate = -60 * np.log(1 - drag)
    pull, across = np.array([stiffness, gravity]) * rate / drag / length
    state, out, dt = np.zeros(2), [0.0], 1 / 6000

    def slope(s):
        return np.array([s[1], across * np.cos(s[0]) - pull * np.sin(s[0]) - rate * s[1]])

    for step in range(round(seconds / dt)):
        a = slope(state)
        b = slope(state + dt / 2 * a)
        c = slope(state + dt / 2 * b)
        state = state + dt / 6 * (a + 2 * b + 2 * c + slope(state + dt * c))
        if step % 100 == 99:
            out.append(state[0])
    return np.array(out)


def frame_by_frame(stiffness, gravity, drag, length, frames):
    """The same angle as VRMC_springBone 1.0 steps it, at 60 frames a second."""
    before = now = np.array([0.0, -length])
    out = [0.0]
    for _ in range(frames):
        tail = now + (now - before) * (1 - drag) + np.array([gravity, -stiffness]) / 60
        before, now = now, tail * length / np.linalg.norm(tail)
        out.append(np.arctan2(now[0], -now[1]))
    return np.array(out)


@pytest.mark.parametrize(("stiffness", "drag"), [(0.3, 0.2), (0.5, 0.3), (1.0, 0.4), (2.0, 0.7)])
def test_a_bone_swings_as_the_specifications_numbers_say(parts, stiffness, drag):
    alone = one_bone(parts, stiffness=[stiffness], gravity=[[0.5 * stiffness, 0, 0]], drag=[drag])
    motion, angles = LooseMotion(alone, ASKED), []
    for frame in range(91):
        # a moment late: what is drawn is the substep before
        motion.move(STANDING, frame / 60 + (frame > 0) / 120)
        away = motion.offsets[0] + [0, -0.07, 0]
        angles.append(np.arctan2(away[0], -away[1]))
    expected = equation(stiffness, 0.5 * stiffness, drag, 0.07, 1.5)
    assert np.abs(angles - expected).max() <= 0.12 * expected.max()
    assert angles[-1] == pytest.approx(np.arctan(0.5), rel=0.02)
    # the specification's own steps are coarse: the same rest, and about the same overshoot
    steps = frame_by_frame(stiffness, 0.5 * stiffness, drag, 0.07, 90)
    assert angles[-1] == pytest.approx(steps[-1], rel=0.05)
    assert np.max(angles) == pytest.approx(np.max(steps), rel=0.2)


def test_a_chain_at_rest_hangs_between_its_rest_and_gravity(parts):
    motion = moved(parts, 60, 3, lambda t: STANDING)[0]
    now, springs = parts.drive(STANDING), parts.springs
    count = len(springs)
    at = now.targets[:count] + motion.offsets
    assert motion.asleep and motion.reach > 0.01
    for bone, parent in enumerate(springs.parents):
        head = now.targets[count + bone] if parent < 0 else at[parent]
        direction = (at[bone] - head) / parts.lengths[bone]
        rest = (springs.tails - springs.heads)[bone] / parts.lengths[bone]
        if parent >= 0:
            above = at[parent] - (now.targets[count + parent] if springs.parents[parent] < 0
                                  else at[springs.parents[parent]])  # fmt: skip
            rest = above / np.linalg.norm(above)
        force = springs.stiffness[bone] * rest + springs.gravity[bone]
        assert direction @ force / np.linalg.norm(force) > 0.999


def test_paths_do_not_depend_on_how_often_frames_are_drawn(parts):
    often = moved(parts, 240, 4, dance)[1]
    for rate in (30, 60):
        assert np.abs(moved(parts, rate, 4, dance)[1] - often).max() <= 0.02 * np.abs(often).max()
    odd = LooseMotion(parts, ASKED)
    for frame in range(4 * 50 + 1):
        odd.move(dance(frame / 50), frame / 50)
    assert np.abs(odd.offsets - often[-1]).max() <= 0.04 * np.abs(often).max()


def strung(parts, motion, pose):
    """Length of each bone as drawn, parts of its own."""
    now, count = parts.drive((pose[0], np.zeros(3))), len(parts.springs)
    heads = now.targets[count:].copy()
    held = parts.springs.parents >= 0
    heads[held] += motion.offsets[parts.springs.parents[held]]
    return np.linalg.norm(now.targets[:count] + motion.offsets - heads, axis=1) / parts.lengths[:, 0]


CASES = {
    "teleport": lambda t, pose: (pose[0], pose[1] + (t >= 1) * np.array([100.0, 0, 50])),
    "turn of 180 degrees in a frame": lambda t, pose: (pose[0] + (t >= 1) * np.eye(52)[0][:, None] * [0, np.pi, 0],
                                                       pose[1]),
    "ten kilometres away": lambda t, pose: (pose[0], pose[1] + [1e4, 0, 1e4]),
    "head thrown back in a frame": lambda t, pose: (pose[0] - (t >= 1) * np.eye(52)[15][:, None] * [1.0, 0, 0],
                                                    pose[1]),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("drag", [0.0, 0.4, 1.0])
def test_whatever_the_body_does_it_comes_to_rest_within_three_seconds(folder, name, drag):
    parts = parts_of(folder, settings=SETTINGS | {"dragForce": drag, "gravityPower": 0.1})
    stop, motion = gently(1.5), LooseMotion(parts, ASKED)
    for frame in range(int(4.5 * 60) + 1):
        t = frame / 60
        pose = CASES[name](t, gently(t) if t < 1.5 else stop)
        motion.move(pose, t)
        assert np.abs(strung(parts, motion, pose) - 1).max() < 1e-6
    assert motion.asleep


@pytest.mark.parametrize("dt", [0.0, 1e-6, LONGEST, 10.0, -3.0])
def test_frames_of_any_length_are_endured(parts, dt):
    motion, t = LooseMotion(parts, ASKED), 0.0
    for frame in range(70):
        t += 1 / 60 if frame < 60 else dt
        motion.move(dance(frame / 60), t)
        assert np.isfinite(motion.offsets).all()
    if dt in (10.0, -3.0):
        # begun anew, as skinned
        assert motion.reach < 0.03
    last = dance(69 / 60)
    for _ in range(180):
        t += 1 / 60
        motion.move(last, t)
    assert motion.asleep


def test_ten_kilometres_away_it_moves_as_at_home(parts):
    here = moved(parts, 60, 2, dance)[1]
    far = moved(parts, 60, 2, lambda t: (dance(t)[0], dance(t)[1] + [1e4, 0, -1e4]))[1]
    assert np.abs(here).max() > 0.05 and np.abs(here - far).max() < 1e-6


def test_two_runs_have_the_same_bits(parts):
    one, two = (moved(parts, 30, 2, dance)[1] for _ in range(2))
    assert np.array_equal(one, two) and np.abs(one).max() > 0.05


def test_without_gravity_who_stands_is_drawn_as_skinned_and_asleep(folder, monkeypatch):
    parts = parts_of(folder, settings=SETTINGS)
    motion = moved(parts, 60, 2 * CALM, lambda t: STANDING)[0]
    assert motion.asleep and not motion.shows and motion.reach < 1e-9
    monkeypatch.setattr(SpringParts, "drive", lambda *_: pytest.fail("nothing is computed at rest"))
    for frame in range(1000):
        motion.move(STANDING, 2 * CALM + frame / 60)


def test_motion_of_the_centre_is_none(folder):
    """A body that is carried and turned as a whole: with its pelvis as centre nothing swings, with none all does."""

    def carried(t):
        pose = np.zeros((52, 3))
        pose[0, 1] = 2.0 * np.sin(3 * t)
        return pose, np.array([2.0 * np.sin(2 * t), 0.2 * np.cos(3 * t), t * t])

    reach = {}
    for center in (None, "pelvis"):
        parts = parts_of(folder, settings=SETTINGS, center=center)
        reach[center] = np.abs(moved(parts, 60, 2, carried)[1]).max()
    assert reach[None] > 0.05 and reach["pelvis"] < 0.02 * reach[None]


@pytest.mark.parametrize("version", [0, 1])
def test_tails_keep_out_of_the_files_colliders(folder, version):
    sphere = ("head", (0.0, 0.05, -0.03), (0.0, 0.12, -0.03), 0.12)
    reached = {}
    for colliders in ([sphere], []):
        # drawn into the head
        settings = SETTINGS | {"gravityPower": 1.0, "gravityDir": [0, 0, 1], "stiffness": 0.5}
        parts = parts_of(folder, version=version, settings=settings, colliders=colliders)
        motion, deepest = LooseMotion(parts, ASKED), 0.0
        for frame in range(90):
            motion.move(gently(frame / 30), frame / 30)
            now = parts.drive((gently(frame / 30)[0], np.zeros(3)))
            at = now.targets[: len(motion.offsets)] + motion.offsets
            middle = now.targets[len(motion.offsets)] if not colliders else now.capsules[0, 0]
            away = np.linalg.norm(at - middle, axis=1)
            if colliders:
                deepest = max(deepest, float((0.14 - capsule_distances(at, *now.capsules)).max()))
            reached[bool(colliders)] = away.min()
        if colliders:
            assert deepest <= 0.01
    assert reached[True] >= 0.13


def test_a_vertex_goes_as_far_as_what_it_lies_between(parts):
    """At rest a tube bends with its bones: vertices at a joint go with it."""
    motion = moved(parts, 60, 1, dance)[0]
    springs = parts.springs
    added = np.einsum("vk,vkc->vc", parts.follows, motion.offsets[parts.near])
    moves = np.abs(parts.follows).sum(1) > 0
    assert 0 < moves.sum() < len(moves) and not added[~moves].any()
    assert np.allclose(parts.follows[moves].sum(1).max(), 1)
    assert JOINTS[springs.joints[-1]] == "head" and np.abs(added[moves]).max() > 0.05
