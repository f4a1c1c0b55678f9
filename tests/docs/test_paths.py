"""What documents, docstrings and help name is there: files, folders, modules and commands."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from experiments.mutants import PLANTED
from selfscan.__main__ import COMMANDS, PACKAGES

ROOT = Path(__file__).parents[2]
FOLDERS = (*PACKAGES, "docs", "experiments", "tests")
PATH = re.compile(rf"(?<![\w/.-])((?:{'|'.join(FOLDERS)})/[\w/.-]*\w\.(?:py|md|glsl|vert|frag|toml|json|ipynb|mjs))\b")
MODULE = re.compile(rf"-m ((?:{'|'.join(FOLDERS)})(?:\.\w+)*)")
COMMAND = re.compile(r"(?:^ {4}|`|&& |\"!)selfscan ([a-z]+)\b", re.MULTILINE)


def sources() -> list[Path]:
    """Documents by hand, and every source; measured results keep the commands of their day."""
    kinds = (".md", ".ipynb", ".py", ".glsl", ".vert", ".frag", ".toml")
    inside = [path for folder in FOLDERS for path in (ROOT / folder).rglob("*") if path.suffix in kinds]
    written = [path for path in inside if not path.is_relative_to(ROOT / "docs" / "results")]
    return [*sorted(written), ROOT / "README.md", ROOT / "THIRD_PARTY.md", ROOT / "Makefile"]


def found(pattern: re.Pattern[str]) -> Iterator[tuple[str, str]]:
    """Place and name of each match."""
    for path in sources():
        text = path.read_text("utf-8")
        for match in pattern.finditer(text):
            yield f"{path.relative_to(ROOT)}:{text.count(chr(10), 0, match.start()) + 1}", match[1]


def test_every_file_that_is_named_is_there():
    named = list(found(PATH))
    assert len(named) > 60
    assert [(place, name) for place, name in named if not (ROOT / name).exists()] == []


def test_every_module_that_is_run_is_there():
    named = list(found(MODULE))
    assert len(named) > 20
    missing = []
    for place, name in named:
        path = ROOT / name.replace(".", "/")
        if not (path.with_suffix(".py").exists() or (path / "__main__.py").exists()):
            missing.append((place, name))
    assert missing == []


def test_every_command_that_is_named_is_there():
    named = list(found(COMMAND))
    assert len(COMMANDS) == 15 and len(named) > 60
    assert [(place, name) for place, name in named if name not in COMMANDS] == []


@pytest.mark.parametrize("page", sorted((ROOT / "docs").glob("*.md")), ids=lambda path: path.name)
def test_no_page_installs_from_an_index_that_does_not_have_it(page):
    assert not re.search(r"pip install '?selfscan", page.read_text("utf-8"))


def test_the_ten_questions_are_answered_by_files_that_are_there():
    text = (ROOT / "docs" / "decisions.md").read_text("utf-8")
    rows = re.findall(r"^  \| [^|]+\? \| (.+) \|$", text, re.MULTILINE)
    named = [name for row in rows for name in re.findall(r"`([\w/.]+)`", row)]
    assert len(rows) == 10 and all((ROOT / name).exists() for name in named)


def test_planted_errors_can_still_be_planted_and_name_tests_that_are_there():
    for planted in PLANTED:
        text = (ROOT / planted.file).read_text("utf-8")
        assert text.count(planted.old) == 1 and planted.new != planted.old, planted
        assert all((ROOT / test).exists() for test in planted.tests.split()), planted
