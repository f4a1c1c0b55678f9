"""The lights that a run folder holds."""

from pathlib import Path

import pytest

from avatar.light import CaptureLight, Lamp
from avatar.skeleton import PARTS
from command.errors import AssetError
from train.run import lights_of

RUN = Path("run")
LIGHT = CaptureLight(0.5, (Lamp((0.0, 0.6, 0.8), 0.7),))


def test_a_run_gives_its_lights_back_by_video_and_older_runs_have_none():
    assert lights_of(RUN, {}) == {}
    assert lights_of(RUN, {"light": None}) == {}
    assert lights_of(RUN, {"light": {part: LIGHT.json() for part in PARTS}}) == dict.fromkeys(PARTS, LIGHT)


@pytest.mark.parametrize(
    ("light", "message"),
    [
        ({"body": LIGHT.json()}, r"run.json: light should hold body, head, hand_left, hand_right or be null, is \['bo"),
        ("fixed", "run.json: light should hold .* is 'fixed'"),
        ({part: {**LIGHT.json(), "gamma": 9} for part in PARTS}, "run.json: light: gamma: expected at most 4, found 9"),
    ],
)
def test_lights_that_are_none_are_refused(light, message):
    with pytest.raises(AssetError, match=message):
        lights_of(RUN, {"light": light})
