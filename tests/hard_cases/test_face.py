"""Hard cases: thousands of sums of shapes, and looks as far aside as eyes turn, on the person who travels with the
program. The reference is the distance of each posed vertex from the ball, not what keeps it there."""

import numpy as np
import pytest

from avatar.face import SHAPES, FaceFrame
from avatar.gltf.avatar_file import read_avatar
from player.draw.face import FaceBlend, FaceMotion, within_limits

SUMS = 5000


@pytest.fixture(scope="module")
def man():
    return read_avatar("builtin", levels=2)


def frames(seed: int):
    """Faces of a few shapes, of many and of all 52; weights beyond 0 and 1, gaze beyond its reach."""
    rng = np.random.default_rng(seed)
    yield FaceFrame(np.ones(len(SHAPES)), np.zeros((2, 2)))
    for _ in range(SUMS - 1):
        active = rng.random(len(SHAPES)) < rng.choice([0.05, 0.3, 1.0])
        yield FaceFrame(np.where(active, rng.uniform(-0.5, 1.5, len(SHAPES)), 0.0), rng.uniform(-2, 2, (2, 2)))


@pytest.mark.parametrize("number", [0, 1])
def test_no_sum_of_shapes_puts_a_lid_into_its_ball(man, number, within):
    level, blend = man.levels[number], FaceBlend(man.levels[number], man.eyes)
    rest = level.positions[level.face.vertices].astype(np.float64)
    slot = np.full(len(level.positions), -1)
    slot[level.face.vertices] = np.arange(len(rest))
    faces = slot[level.faces.astype(int)]
    faces = faces[(faces >= 0).all(1)]
    deepest = 0.0
    lids = []
    for eye in man.eyes:
        off = np.linalg.norm(rest - eye.center, axis=1) - eye.radius
        # the rim that joins lids and ball lies in it; the rest of a lid does not
        lids.append((eye, faces[((off[faces] > 0) & (off[faces] < eye.radius)).all(1)]))
    for frame in frames(number):
        at = rest + blend.offsets(within_limits(frame))[blend.moving, :3]
        assert np.isfinite(at).all()
        for eye, own in lids:
            points = np.concatenate([at[own].reshape(-1, 3), at[own].mean(1)])
            deepest = max(deepest, eye.radius - np.linalg.norm(points - eye.center, axis=1).min())
    within(1e3 * deepest, 0.2, f"mm under the ball, level {number}")


def test_a_ball_turns_about_its_center_and_stays_a_ball(man, within):
    level, blend, off = man.levels[0], FaceBlend(man.levels[0], man.eyes), 0.0
    for frame in list(frames(2))[:200]:
        offsets = blend.offsets(within_limits(frame))
        for (slots, _, radius), eye, (first, count) in zip(blend.balls, man.eyes, level.face.balls.astype(int)):
            at = level.positions[first : first + count] + offsets[slots, :3] - eye.center
            off = max(off, float(np.abs(np.linalg.norm(at, axis=1) - radius).max()))
    within(1e6 * off, 1.0, "micrometres off the sphere")


def test_after_numbers_that_are_none_the_last_good_face_stays(man):
    motion = FaceMotion(man.levels[0], man.eyes)
    good = motion.wanted(FaceFrame(np.linspace(0, 1, len(SHAPES)), np.full((2, 2), 0.1)))
    for spoilt in (np.nan, np.inf, -np.inf):
        weights, gaze = np.zeros(len(SHAPES)), np.zeros((2, 2))
        weights[3] = spoilt
        assert motion.wanted(FaceFrame(weights, gaze)) is good
        gaze[1, 1] = spoilt
        assert motion.wanted(FaceFrame(np.zeros(len(SHAPES)), gaze)) is good
