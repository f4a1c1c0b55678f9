"""The tables of keys in docs/play.md and docs/posing.md, from the table of actions: `python -m experiments.key_docs`.

A test holds the files against this module, so they cannot fall behind what keys do.
"""

import re
from pathlib import Path

from files.whole import write_text
from player.window.actions import GROUPS, POSING, KeyGroup

DOCS = Path(__file__).parents[1] / "docs"
# files with a table, and the groups that it shows
TABLES = {"play.md": tuple(group for group in GROUPS if group is not POSING), "posing.md": (POSING,)}
START, END = "<!-- keys: written by python -m experiments.key_docs -->\n", "<!-- end of keys -->\n"


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
