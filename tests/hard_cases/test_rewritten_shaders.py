"""Shaders rewritten in ways that change nothing show the same picture (experiments/shader_rewrites.py draws all)."""

import pytest

from experiments.glsl_rewrites import REWRITES, Plan
from experiments.glsl_statements import Statement
from experiments.shader_rewrites import DRAWINGS, difference

NAMES = tuple(REWRITES)
# pairs where programs are few, all ten one after the other where they are many
TRIED = [("capture's light", NAMES[k::5]) for k in range(5)] + [("picture", NAMES[k::5]) for k in range(5)]
TRIED += [(name, NAMES) for name in ("view network", "rasteriser", "panels")]


@pytest.fixture(scope="module")
def plain(context):
    return {name: DRAWINGS[name](context) for name in dict(TRIED)}


@pytest.mark.rows
@pytest.mark.parametrize(("name", "rewrites"), TRIED, ids=[f"{n}-{'+'.join(r)[:30]}" for n, r in TRIED])
def test_a_rewritten_shader_draws_the_same_picture(context, plain, within, name, rewrites):
    plan = Plan(rewrites, seed=4)
    apart = difference(context, name, plan, plain[name])
    assert plan.sites
    within(apart, 1, "/255, two rewrites" if len(rewrites) == 2 else "/255, all ten rewrites")


def test_a_rewrite_that_is_none_is_noticed(context, plain, monkeypatch):
    def brighter(at):
        for one in at.assigned():
            one.body[one.place] = Statement(f"{one.before}({one.value}) * 1.1;")

    monkeypatch.setitem(REWRITES, "times one", brighter)
    assert difference(context, "picture", Plan(("times one",)), plain["picture"]).max() > 1
