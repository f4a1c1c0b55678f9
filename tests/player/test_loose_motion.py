"""Loose parts that follow the body: at any rate of frames, after any jump, outside of the body, and asleep at rest."""

from dataclasses import replace

import numpy as np
import pytest
from loose_avatar import dressed
from loose_paths import dance, moved

from player.effects.contact_capsules import capsule_distances
from player.effects.loose_motion import CALM, LooseMotion
from player.effects.loose_parts import PARTICLES, LooseParts, loose_parts
from player.effects.secondary_motion import SecondaryMotion

SETTINGS = SecondaryMotion()
STANDING = (np.zeros((52, 3)), np.zeros(3))


@pytest.fixture(scope="module")
def parts():
    avatar = dressed()
    return loose_parts(avatar, avatar.levels[0])


def test_there_are_few_particles_and_vertices_follow_those_near_them(parts):
    level = dressed().levels[0]
    assert 100 < len(parts.places) <= PARTICLES
    share, loose = parts.follows.sum(1), level.loose
    assert (share[loose == 0] == 0).all() and np.allclose(share[loose > 0.25], 1)
    away = np.linalg.norm(level.positions[:, None] - parts.places[parts.near], axis=2)
    assert away[parts.follows > 0].max() < 0.2
    for particle, row in enumerate(parts.neighbours):
        for other in row[parts.pull[particle] > 0]:
            assert particle in parts.neighbours[other], "neighbours are so both ways"


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


def test_two_runs_have_the_same_bits(parts):
    avatar = dressed()
    one, two = (moved(found, 30, 3, dance)[1] for found in (parts, loose_parts(avatar, avatar.levels[0])))
    assert np.array_equal(one, two) and np.abs(one).max() > 0.05


def test_who_stands_as_filmed_is_drawn_as_filmed_and_asleep(parts, monkeypatch):
    motion = moved(parts, 60, 2 * CALM, lambda t: STANDING)[0]
    assert motion.asleep and not motion.shows and motion.reach < 1e-6
    monkeypatch.setattr(LooseParts, "drive", lambda *_: pytest.fail("nothing is computed at rest"))
    steps = motion.steps
    for frame in range(1000):
        motion.move(STANDING, 2 * CALM + frame / 60)
    assert motion.steps == steps


def test_slow_drift_wakes_it(parts):
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


def test_hair_hangs_down_when_the_head_does(parts):
    """Gravity acts by how far it has turned since pose 0."""
    bent = np.zeros((52, 3))
    bent[3, 0] = 1.2
    still = moved(parts, 60, 4, lambda t: (bent, np.zeros(3)))[0]
    hair = parts.places[:, 1] > 0.3
    assert still.asleep and still.offsets[hair, 1].mean() < -0.005


def test_nothing_loose_has_no_particles():
    avatar = dressed(skirt=False, hair=False)
    assert loose_parts(avatar, avatar.levels[0]) is None
    level = replace(avatar.levels[0], loose=np.zeros(len(avatar.levels[0].positions), np.float32))
    assert loose_parts(avatar, level) is None


def test_capsule_distances_are_those_to_the_segment():
    rng = np.random.default_rng(0)
    points, starts, ends = rng.normal(size=(50, 3)), rng.normal(size=(4, 3)), rng.normal(size=(4, 3))
    ends[3] = starts[3]
    along = np.linspace(0, 1, 20001)[:, None]
    expected = [
        [np.linalg.norm(point - (start + along * (end - start)), axis=1).min() for start, end in zip(starts, ends)]
        for point in points
    ]
    assert np.abs(capsule_distances(points, starts, ends) - expected).max() < 1e-4
