"""Life without input: a function of (seed, time), with the statistics of people's blinks and saccades."""

import numpy as np
import pytest

from avatar.face import SHAPES
from avatar.gaze import UP, YAW
from player.face.life import CLOSED, CLOSING, OPENING, blink, lid, life, sway, wander

BLINKS = [SHAPES.index("eyeBlinkLeft"), SHAPES.index("eyeBlinkRight")]


def test_a_moment_is_the_same_whatever_was_asked_before_and_other_seeds_are_others():
    moments = [0.0, 3.1, 599.99, 600.01, 7200.5, -4.0]
    first = [(life(3, t), sway(3, t)) for t in moments]
    again = [(life(3, t), sway(3, t)) for t in reversed(moments)][::-1]
    for (face, turns), (other, same) in zip(first, again, strict=True):
        assert face.weights.tobytes() == other.weights.tobytes() and face.gaze.tobytes() == other.gaze.tobytes()
        assert turns.tobytes() == same.tobytes()
    assert not np.array_equal([wander(3, t) for t in moments], [wander(4, t) for t in moments])


@pytest.mark.parametrize("seed", range(4))
def test_ten_minutes_of_blinks_are_ten_to_seventeen_a_minute_and_log_normal(seed):
    closed = np.array([blink(seed, t) for t in np.arange(0, 600, 0.02)])
    shut = np.flatnonzero((closed[1:] == 1) & (closed[:-1] < 1)) * 0.02
    assert 10 <= len(shut) / 10 <= 17
    steps = np.log(np.diff(shut))
    assert 0.4 < steps.std() < 0.8 and np.abs(np.mean((steps - steps.mean()) ** 3)) / steps.std() ** 3 < 0.8
    # closed for less than a tenth of the time
    assert (closed > 0.5).mean() < 0.06


def test_a_lid_closes_fully_and_faster_than_it_opens():
    at = np.linspace(0, CLOSING + CLOSED + OPENING, 331)
    way = np.array([lid(t) for t in at])
    assert way[0] == 0 and way[-1] < 1e-3 and (way[(at >= CLOSING) & (at <= CLOSING + CLOSED)] == 1).all()
    falls = np.flatnonzero(np.diff(way) < 0)
    half = (at[falls[way[falls] > 0.5]][-1] - CLOSING - CLOSED) / OPENING
    assert 0.25 < half < 0.45  # the rest is the tail


def test_saccades_are_as_fast_as_the_law_says_and_most_gaze_is_near_what_is_looked_at():
    t = np.arange(0, 150, 0.002)
    way = np.degrees([wander(1, moment) for moment in t])
    speed = np.linalg.norm(np.diff(way, axis=0), axis=1) / 0.002
    moving = np.flatnonzero(np.diff(np.r_[0, speed > 1e-6, 0].astype(int))).reshape(-1, 2)
    size = np.array([np.linalg.norm(way[b] - way[a]) for a, b in moving])
    peak = np.array([speed[a:b].max() for a, b in moving])
    law = 473 * (1 - np.exp(-size / 7.8))
    assert (size > 2).sum() > 40 and np.abs(peak / law - 1)[size > 2].max() < 0.15
    assert np.mean(np.linalg.norm(way, axis=1) < 3) > 0.75 and np.abs(way).max() <= 22


def test_lids_follow_the_gaze_and_eyes_stop_at_their_reach():
    up = life(0, 0.0, np.full((2, 2), [9.0, 9.0]))
    assert (np.abs(up.gaze[:, 0]) <= YAW).all() and up.weights[SHAPES.index("eyeLookUpLeft")] > 0.8
    assert (up.gaze[:, 1] <= UP).all() and up.weights[SHAPES.index("eyeLookDownLeft")] == 0
    shut = next(t for t in np.arange(0, 60, 0.01) if blink(0, t) == 1)
    assert life(0, shut, np.full((2, 2), -0.4)).weights[BLINKS].tolist() == [1, 1]


def test_a_body_sways_by_one_to_two_degrees_and_its_legs_stand():
    turns = np.degrees([sway(2, t) for t in np.arange(0, 120, 0.1)])
    assert 0.8 < np.abs(turns).max() < 2.2 and (turns[:, [0, 1, 2, 4, 5, 7, 8]] == 0).all()
    assert np.abs(np.diff(turns, axis=0)).max() < 0.25
