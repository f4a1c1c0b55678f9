"""Which rung a window shows under a load that comes and goes: simulated frames, no clock."""

from dataclasses import replace

import numpy as np
import pytest

from player.budget.controller import PATIENCE, SETTLING, SLOW, WATCHED, BudgetController
from player.budget.ladder import PricedRung, at_quality, frontier, parse_budget, scene_rungs, within
from player.budget.rung import Rung

LADDER = [
    PricedRung(Rung(name, "off", k), ms, 1.1 * ms, error)
    for k, (name, ms, error) in enumerate(
        [("network", 12.0, 0.0), ("linear", 9.0, 1.0), ("bad", 9.5, 3.0), ("vertex", 6.0, 2.0), ("paper", 4.0, 4.0),
         ("coarse", 2.0, 9.0)]
    )
]  # fmt: skip


def named(name):
    return next(one for one in LADDER if one.rung.name == name)


def played(controller, loads, seed=0):
    """Changes as (frame, rung) while each frame is as slow as its load makes it, a little up and down."""
    rng, changes = np.random.default_rng(seed), []
    for number, load in enumerate(loads):
        changed = controller.frame(controller.current.ms_median * load * rng.normal(1, 0.03))
        if changed is not None:
            changes.append((number, changed.rung.name))
    return changes


def test_a_budget_buys_the_most_exact_rung_that_holds_it_in_p95():
    assert [one.rung.name for one in frontier(LADDER)] == ["coarse", "paper", "vertex", "linear", "network"]
    assert [within(LADDER, budget).rung.name for budget in (2.3, 4.5, 8.0, 9.8, 9.95, 100.0)] == [
        "coarse", "paper", "vertex", "vertex", "linear", "network",
    ]  # fmt: skip
    assert within(LADDER, 2.0) is None and within(LADDER, 8.0, load=1.5).rung.name == "paper"


def test_quality_walks_the_frontier():
    names = [at_quality(LADDER, quality).rung.name for quality in np.linspace(0, 1, 11)]
    assert names[0] == "coarse" and names[-1] == "network"
    order = [one.rung.name for one in frontier(LADDER)]
    places = [order.index(name) for name in names]
    assert places == sorted(places) and set(places) == {0, 1, 2, 3, 4}


def test_it_goes_down_after_twelve_slow_frames_and_not_after_eleven():
    controller = BudgetController(LADDER, 8.0, named("vertex"))
    quiet, busy = [1.0] * (SETTLING + 20), [2.0]
    assert played(controller, quiet + busy * (SLOW - 1) + [1.0] * WATCHED) == []
    controller = BudgetController(LADDER, 8.0, named("vertex"))
    assert played(controller, quiet + busy * SLOW) == [(SETTLING + 20 + SLOW - 1, "coarse")]


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("load", [1.5, 1.9, 3.0])
def test_a_load_that_comes_and_goes_costs_at_most_two_changes_each_way(seed, load):
    controller = BudgetController(LADDER, 8.0, named("vertex"))
    loads = [1.0] * 300 + [load] * 600 + [1.0] * 1200
    changes = played(controller, loads, seed)
    down = [change for change in changes if 300 <= change[0] < 900]
    up = [change for change in changes if change[0] >= 900]
    assert 1 <= len(down) <= 2 and 1 <= len(up) <= 2 and len(changes) == len(down) + len(up)
    assert down[0][0] < 300 + 2 * SLOW and controller.current.rung.name == "vertex"
    # not at the first quick frames
    assert up[0][0] >= 900 + WATCHED // 2


def test_a_rung_that_cannot_be_held_is_tried_ever_more_rarely():
    """A driver slower than its measurement: the better rung always fails."""

    class Lying(BudgetController):
        @property
        def load(self):
            return 1.0

    controller, tries, rng = Lying(LADDER, 8.0, named("paper")), [], np.random.default_rng(0)
    for number in range(6000):
        real = 9.0 if controller.current.rung.name == "vertex" else controller.current.ms_median
        changed = controller.frame(real * rng.normal(1, 0.02))
        if changed is not None and changed.rung.name == "vertex":
            tries.append(number)
    gaps = np.diff(tries)
    assert len(tries) >= 4 and all(b > 1.5 * a for a, b in zip(gaps[:3], gaps[1:4]))
    assert max(gaps) <= WATCHED * PATIENCE + 100


def test_it_leaves_room_before_it_goes_up():
    """9.9 ms of p95 fit 10, but not with a twentieth of it left."""
    quiet = [1.0] * 1000
    assert played(BudgetController(LADDER, 10.0, named("vertex")), quiet) == []
    changes = played(BudgetController(LADDER, 10.6, named("vertex")), quiet)
    assert [name for _, name in changes] == ["linear"] and changes[0][0] >= WATCHED
    assert BudgetController(LADDER, 10.0, named("vertex")).costlier.rung.name == "linear"
    assert BudgetController(LADDER, 80.0, named("network")).costlier is None


@pytest.mark.parametrize(("text", "ms"), [("8ms", 8.0), ("0.5", 0.5), ("120fps", 1000 / 120), (" 4 MS ", 4.0)])
def test_budgets_are_milliseconds_or_frames_a_second(text, ms):
    assert parse_budget(text) == pytest.approx(ms)


@pytest.mark.parametrize("text", ["", "fast", "0ms", "-1ms", "nan", "0fps", "1e9ms"])
def test_what_is_no_budget_is_refused(text):
    with pytest.raises(Exception, match="expected milliseconds or frames a second"):
        parse_budget(text)


def test_rungs_of_a_scene_are_what_all_its_avatars_hold(avatar):
    names = [rung.name for rung in scene_rungs([avatar])]
    assert names[:4] == ["network per pixel, 27k", "linear, 27k", "per vertex, 27k", "paper mode, 27k"]
    cheaper = ["texture 256", "texture 128", "texture 64", "2 joints", "1 joint"]
    assert names[4:] == [f"{view}, 27k, {one}" for view in ("network per pixel", "paper mode") for one in cheaper]
    assert {rung.view for rung in scene_rungs([avatar], view="linear")} == {"linear"}
    assert {rung.level for rung in scene_rungs([avatar], view="off", level=0)} == {0}
    plain = replace(avatar, network=None, linear=None, default_view="off")
    assert {rung.view for rung in scene_rungs([avatar, plain])} == {"off"}
