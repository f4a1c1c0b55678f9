"""The examples that README and docs/python.md show are run, in order, on a small avatar."""

import ast
import importlib
import json
import re
from inspect import signature
from pathlib import Path

import pytest

from avatar.gltf.avatar_file import write_avatar
from player.scene.mannequin import mannequin

ROOT = Path(__file__).parents[2]
BLOCK = re.compile(r"^```python( no-run)?\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def blocks(page: str) -> list[tuple[bool, str]]:
    """Each Python example of a page: whether it is run here, and its text."""
    return [(not no_run, code) for no_run, code in BLOCK.findall((ROOT / page).read_text("utf-8"))]


@pytest.fixture
def demo(tmp_path, monkeypatch) -> Path:
    """A folder where out/demo/avatar.glb is the built-in body, as the examples expect an avatar there."""
    (tmp_path / "out" / "demo").mkdir(parents=True)
    write_avatar(tmp_path / "out" / "demo" / "avatar.glb", mannequin())
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize(("page", "least"), [("README.md", 1), ("docs/python.md", 4)])
def test_examples_run_as_they_stand(demo, page, least):
    names: dict[str, object] = {}
    run = [code for wanted, code in blocks(page) if wanted]
    assert len(run) >= least
    for code in run:
        exec(compile(code, page, "exec"), names)


def test_the_notebook_runs_and_was_saved_with_its_pictures(demo):
    cells = json.loads((ROOT / "docs" / "avatars.ipynb").read_text("utf-8"))["cells"]
    written = [cell for cell in cells if cell["cell_type"] == "code"]
    names: dict[str, object] = {}
    for cell in written:
        exec(compile("".join(cell["source"]), "avatars.ipynb", "exec"), names)
    assert len(written) >= 4
    assert sum("image/png" in output.get("data", {}) for cell in written for output in cell["outputs"]) >= 3


def test_what_an_example_imports_and_calls_is_there_even_where_it_is_not_run():
    checked = 0
    for wanted, code in blocks("docs/python.md"):
        if wanted:
            continue
        tree = ast.parse(code)
        imported = {
            alias.name: getattr(importlib.import_module(node.module or ""), alias.name)
            for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) for alias in node.names
        }  # fmt: skip
        for call in (node for node in ast.walk(tree) if isinstance(node, ast.Call)):
            if isinstance(call.func, ast.Name) and call.func.id in imported:
                named = {keyword.arg: None for keyword in call.keywords if keyword.arg}
                signature(imported[call.func.id]).bind(*call.args, **named)
                checked += 1
    assert checked >= 5


@pytest.mark.parametrize("package", ["avatar", "player"])
def test_public_names_are_those_of_the_page(package):
    module = importlib.import_module(package)
    row = re.search(rf"^\| `{package}` \| (.*) \|$", (ROOT / "docs/python.md").read_text("utf-8"), re.MULTILINE)
    assert row is not None and sorted(re.findall(r"`(\w+)`", row[1])) == sorted(module.__all__)
    assert all(getattr(module, name) is not None for name in module.__all__)
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        module.nonsense  # noqa: B018


def test_readme_is_short_and_its_links_lead_somewhere():
    text = (ROOT / "README.md").read_text("utf-8")
    assert len(text.splitlines()) <= 100
    for page in [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]:
        for target in re.findall(r"\]\(([^)#\s]+)", page.read_text("utf-8")):
            if not target.startswith(("http:", "https:", "mailto:")):
                assert (page.parent / target).exists(), f"{page.name}: {target}"
