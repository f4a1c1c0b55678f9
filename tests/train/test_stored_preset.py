"""Presets written to run.json and read back."""

import json
from dataclasses import replace

import pytest

from command.settings import SettingsSource, record_of, settings_json
from train.command import ITEM_NAMES, PRESET_NAMES
from train.preset import ITEMS, PRESETS, Preset


def stored(name="demo"):
    return json.loads(json.dumps(settings_json(PRESETS[name])))


def read(content):
    return record_of(Preset, content, SettingsSource(whole=True), ("settings",))


@pytest.mark.parametrize("name", PRESETS)
def test_a_preset_comes_back_as_it_was(name):
    assert read(stored(name)) == PRESETS[name]
    assert read(stored(name) | {"rays": 7}) == replace(PRESETS[name], rays=7)


def test_a_setting_that_is_unknown_is_named():
    with pytest.raises(ValueError, match=r"settings\.what_is_gone: unknown key in \[settings\]; "):
        read(stored() | {"what_is_gone": 1})


def test_a_setting_that_is_absent_is_named():
    content = stored()
    del content["parts"][0]["networks"]["width"]
    with pytest.raises(ValueError, match=r"settings\.parts 1\.networks: .* needs the key width"):
        read(content)


@pytest.mark.parametrize("networks", [{"kind": "cloud"}, {}, 7, {"kind": ["hash"]}])
def test_unknown_networks_are_refused_by_name(networks):
    content = stored()
    content["parts"][2]["networks"] = networks
    with pytest.raises(ValueError, match=r"settings\.parts 3\.networks\.kind: expected one of triplane, hash, paper"):
        read(content)


def test_settings_that_are_no_object_are_refused():
    for content in ([], None):
        with pytest.raises(ValueError, match=r"settings: expected a table, \[settings\], found"):
            read(content)


def test_the_command_line_names_the_presets_and_what_they_add():
    assert [preset.name for preset in PRESETS.values()] == list(PRESETS) == list(PRESET_NAMES)
    assert list(ITEMS) == list(ITEM_NAMES)
