"""Presets written to run.json and read back."""

import json
from dataclasses import replace

import pytest

from train.preset import DEMO, PRESETS
from train.stored_preset import preset_from_json, preset_json


def stored(name="demo"):
    return json.loads(json.dumps(preset_json(PRESETS[name])))


@pytest.mark.parametrize("name", PRESETS)
def test_a_preset_comes_back_as_it_was_although_no_such_preset_is_left(name, monkeypatch):
    expected, content = replace(PRESETS[name], single=True), stored(name) | {"single": True}
    monkeypatch.delitem(PRESETS, name)
    assert preset_from_json(content, name) == (expected, ())


@pytest.mark.parametrize("name", PRESETS)
def test_networks_of_earlier_runs_are_known_by_their_settings(name):
    content = stored(name)
    for part in content["parts"]:
        del part["networks"]["kind"]
    assert preset_from_json(content, name) == (PRESETS[name], ())


def test_settings_that_came_later_take_their_default_and_are_named():
    content = stored()
    del content["pose_rate"], content["parts"][1]["background"], content["parts"][0]["networks"]["width"]
    content["what_is_gone"] = 1
    preset, assumed = preset_from_json(content, "gone")
    assert preset == DEMO
    assert sorted(assumed) == ["settings.parts[0].networks.width", "settings.parts[1].background", "settings.pose_rate"]


def test_a_setting_without_default_is_todays_or_refused():
    content = stored()
    del content["parts"][0]["cell"]
    assert preset_from_json(content, "demo") == (DEMO, ("settings.parts[0].cell",))
    with pytest.raises(ValueError, match=r"settings\.parts\[0\]\.cell is absent"):
        preset_from_json(content, "gone")


def test_a_run_without_settings_is_of_todays_preset():
    assert preset_from_json(None, "demo") == (DEMO, ("settings",))
    with pytest.raises(ValueError, match=r"preset should be one of .*, is 'gone'"):
        preset_from_json(None, "gone")
    with pytest.raises(ValueError, match=r"preset should be one of .*, is \[\]"):
        preset_from_json(None, [])


@pytest.mark.parametrize("change, message", [
    ({"rays": "many"}, r"settings\.rays should be int, is 'many'"),
    ({"rays": True}, r"settings\.rays should be int, is True"),
    ({"rays": 1.5}, r"settings\.rays should be int"),
    ({"clip": float("nan")}, r"settings\.clip should be float, is nan"),
    ({"density": "fog"}, r"settings\.density should be \('neus', 'volsdf'\), is 'fog'"),
    ({"parts": {}}, r"settings\.parts should be a list, is dict"),
    ({"parts": []}, r"settings\.parts should hold 4, holds 0"),
    ({"adam": [0.9, 0.99]}, r"settings\.adam should hold 3, holds 2"),
    ({"union": 3}, r"settings\.union should be an object, is int"),
])  # fmt: skip
def test_a_setting_of_another_kind_is_refused_by_name(change, message):
    with pytest.raises(ValueError, match=message):
        preset_from_json(stored() | change, "demo")


@pytest.mark.parametrize("networks", [{"kind": "cloud"}, {}, 7, {"kind": ["hash"]}])
def test_unknown_networks_are_refused_by_name(networks):
    content = stored()
    content["parts"][2]["networks"] = networks
    with pytest.raises(ValueError, match=r"settings\.parts\[2\]\.networks"):
        preset_from_json(content, "demo")


def test_settings_that_are_no_object_are_refused():
    with pytest.raises(ValueError, match="settings should be an object, is list"):
        preset_from_json([], "demo")
