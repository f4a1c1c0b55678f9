"""The table of keys in words: over the picture, in `selfscan play --help`, and in the documentation:
`python -m player.window.help` writes its tables in docs/play.md and docs/posing.md.

A test holds the files against this module, so they cannot fall behind what keys do.
"""

import re
from collections.abc import Sequence
from itertools import zip_longest
from pathlib import Path

from files.whole import write_text
from player.window.actions import GROUPS, MOUSE, MOUSE_ON_VIDEO, POSING, VIDEO, KeyGroup

DOCS = Path(__file__).parents[2] / "docs"
# files with a table, and the groups that it shows
TABLES = {"play.md": tuple(group for group in GROUPS if group is not POSING), "posing.md": (POSING,)}
# columns of a terminal
WIDTH = 112
START, END = "<!-- keys: written by python -m player.window.help -->\n", "<!-- end of keys -->\n"


def rows(group: KeyGroup) -> list[tuple[str, str]]:
    """Keys and what they do."""
    return [(", ".join(action.shown_keys), action.means) for action in group.actions]


def mouse_rows(groups: Sequence[KeyGroup]) -> list[tuple[str, str]]:
    """Gestures and what they do."""
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


def table(groups: tuple[KeyGroup, ...]) -> str:
    """Groups as a Markdown table."""
    lines = ["| key | |", "|---|---|"]
    for group in groups:
        if len(groups) > 1:
            lines.append(f"| **{group.title}** | |")
        for action in group.actions:
            keys = ", ".join(f"`{key}`" for key in action.shown_keys)
            lines.append(f"| {keys} | {action.means} |")
    return "\n".join(lines) + "\n"


def with_table(text: str, groups: tuple[KeyGroup, ...]) -> str:
    """A page with its table as it should be."""
    pattern = re.escape(START) + ".*?" + re.escape(END)
    assert re.search(pattern, text, re.DOTALL), "the page has no place for the keys"
    return re.sub(pattern, lambda _: START + "\n" + table(groups) + "\n" + END, text, flags=re.DOTALL)


def main() -> None:
    for name, groups in TABLES.items():
        path = DOCS / name
        text = with_table(path.read_text("utf-8"), groups)
        write_text(path, text)


if __name__ == "__main__":
    main()
