"""One table of keys: what keys do, the help, the tooltips and the documentation all come from it."""

import pytest

from command.command_line import parser_of
from experiments.key_docs import DOCS, TABLES, with_table
from player.play_command import PLAY, PlayCommand
from player.window import actions
from player.window.actions import GROUPS, Action, command_line_help
from player.window.keyboard import KEYS

ACTIONS = [action for group in GROUPS for action in group.actions]


def test_every_action_has_a_group_and_a_named_key_and_no_key_two_meanings():
    assert {id(value) for value in vars(actions).values() if isinstance(value, Action)} == {id(a) for a in ACTIONS}
    assert len(ACTIONS) == len({id(action) for action in ACTIONS}) > 25
    for action in ACTIONS:
        assert action.keys and action.means
        for key in action.keys:
            assert set(key.split("+")) <= KEYS.keys(), key
    for group in GROUPS:
        keys = [key for action in group.actions if action.when is actions._always for key in action.keys]
        assert len(keys) == len(set(keys)), group.title


@pytest.mark.parametrize("name", TABLES)
def test_the_documentation_has_the_table_of_keys_as_it_is(name):
    """Else: python -m experiments.key_docs"""
    page = (DOCS / name).read_text("utf-8")
    assert page == with_table(page, TABLES[name])
    for group in TABLES[name]:
        for action in group.actions:
            assert f"| {action.means} |" in page


def test_the_command_line_names_every_key():
    text = parser_of(PlayCommand, PLAY, everything=True).format_help()
    assert command_line_help() in text
    for group in GROUPS:
        for keys, means in group.rows:
            assert f"{keys} " in text and means in text
    assert {"p", "m", "n", "Ctrl+Z"} <= {keys for group in GROUPS for keys, _ in group.rows}
    assert max(map(len, command_line_help().splitlines())) <= 112
