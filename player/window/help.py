"""The table of keys in words: over the picture, in `selfscan play --help`, and, by experiments/key_docs.py, in the
documentation."""

from collections.abc import Sequence
from itertools import zip_longest

from player.window.actions import GROUPS, MOUSE, MOUSE_ON_VIDEO, VIDEO, KeyGroup

# columns of a terminal
WIDTH = 112


def rows(group: KeyGroup) -> list[tuple[str, str]]:
    return [(", ".join(action.shown_keys), action.means) for action in group.actions]


def mouse_rows(groups: Sequence[KeyGroup]) -> list[tuple[str, str]]:
    return [*MOUSE, *(MOUSE_ON_VIDEO if VIDEO in groups else ())]


def command_line_help() -> str:
    """Keys and mouse for `selfscan play --help`, at most WIDTH columns wide."""
    lines = ["keys"]
    for group in GROUPS:
        lines += [f"  {group.title.lower()}", *_two_columns(rows(group))]
    return "\n".join([*lines, "mouse", *_two_columns(mouse_rows(GROUPS))])


def _two_columns(cells: list[tuple[str, str]]) -> list[str]:
    """Lines with two cells each where they fit, else with one."""
    wide = max(len(left) for left, _ in cells) + 2
    texts = [f"{left:<{wide}s}{right}" for left, right in cells]
    half = -(-len(texts) // 2)
    wide = max(map(len, texts[:half])) + 3
    lines = [f"    {a:<{wide}s}{b}".rstrip() for a, b in zip_longest(texts[:half], texts[half:], fillvalue="")]
    return lines if max(map(len, lines)) <= WIDTH else [f"    {text}" for text in texts]
