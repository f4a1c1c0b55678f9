"""The map from equation to file is true: file and name are there, and the file says which equation it is."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
ROW = re.compile(r"^\| (Eq\. \d+|supplement, [^|]+?) \| [^|]+ \| `([\w/]+\.py)` \| `(\w+)` \|$", re.MULTILINE)
ROWS = ROW.findall((ROOT / "docs" / "equations.md").read_text("utf-8"))


def test_all_fourteen_equations_have_a_row():
    assert {row[0] for row in ROWS} >= {f"Eq. {number}" for number in range(1, 15)}


@pytest.mark.parametrize(("equation", "file", "name"), ROWS, ids=lambda value: value.replace(" ", "_"))
def test_an_equation_is_where_the_map_says(equation, file, name):
    text = (ROOT / file).read_text("utf-8")
    names = {node.name for node in ast.walk(ast.parse(text)) if isinstance(node, ast.FunctionDef | ast.ClassDef)}
    assert name in names
    number = equation.removeprefix("Eq. ")
    said = {
        number
        for low, high in re.findall(r"Eq\. (\d+)(?:(?:-|, | and )(\d+))?", text)
        for number in range(int(low), int(high or low) + 1)
    }
    if number.isdecimal():
        assert int(number) in said
    else:
        assert "supplement" in text.lower()
