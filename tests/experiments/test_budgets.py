"""Whether budgets hold is judged by what is drawn afterwards."""

import numpy as np
import pytest

from avatar.camera import orbit_camera
from experiments import budgets
from player.budget.ladder import PricedRung
from player.budget.measure import BudgetScene
from player.budget.rung import Rung
from player.effects.background import Background
from player.scene.effects import PLAIN

LADDER = [Rung(name, "off", level) for level, name in enumerate(("fine", "middle", "coarse"))]
SCENE = BudgetScene([], [([], orbit_camera(np.zeros(3), 2.0, 0.0, 0.0, (8, 8)))], (8, 8), PLAIN, Background(), False)


def priced(times):
    return [PricedRung(rung, ms, ms, float(k)) for k, (rung, ms) in enumerate(zip(LADDER, times, strict=True))]


@pytest.mark.parametrize(
    ("table", "now", "expected"),
    [
        ((9.0, 5.0, 2.0), (9.0, 5.5, 2.0), ("middle", True, 0)),
        ((9.0, 5.0, 2.0), (9.0, 6.5, 2.0), ("middle", False, 0)),
        # steps that would have held
        ((9.0, 7.0, 2.0), (5.0, 4.0, 2.0), ("coarse", True, 2)),
    ],
)
def test_a_budget_holds_or_fails_by_what_is_drawn_and_is_wasted_by_finer_steps_that_hold(
    monkeypatch, context, table, now, expected
):
    drawn = dict(zip(LADDER, now, strict=True))

    def rung_times(context, scene, rungs, rounds):
        return np.array([[drawn[one] for one in rungs]] * rounds)

    monkeypatch.setattr(budgets, "rung_times", rung_times)
    row = budgets.tried(context, SCENE, priced(table), 6.0, 10)
    assert (row["rung"], row["holds"], row["steps_wasted"]) == expected
