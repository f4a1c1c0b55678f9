"""Errors planted by chance: which live, which change nothing, and when that is too many."""

import pytest

import experiments.sampled_mutants as sampled
from experiments.mutants import ROOT, outcome
from experiments.sampled_mutants import CORE, EQUAL, Mutant, main


def test_those_that_live_are_listed_and_too_many_of_them_are_an_error(monkeypatch, tmp_path, capsys):
    (same_file, before, after), why = next(iter(EQUAL.items()))
    planted = [Mutant(same_file, 1, before, after, "same"), Mutant(same_file, 2, "a - b", "a + b", "lives"),
               Mutant(same_file, 3, "a | b", "a & b", "dies")]  # fmt: skip
    monkeypatch.setattr(sampled, "CORE", {same_file: "some tests"})
    monkeypatch.setattr(sampled, "copied", lambda place: place)
    monkeypatch.setattr(sampled, "drawn", lambda *_: iter(planted))
    monkeypatch.setattr(sampled, "outcome", lambda tree, file, code, tests: "killed" if code == "dies" else "LIVES")
    out = tmp_path / "page.md"
    assert main(["-o", str(out)]) == 1 and main(["--most", "0.34"]) == 0
    assert "1 of 3 live" in capsys.readouterr().out
    lines = out.read_text().splitlines()
    assert f"| {same_file} | 3 | 1 | 1 | 1 | some tests |" in lines
    assert f"| {same_file}:1 | `{before}` | `{after}` | {why} |" in lines
    assert f"| {same_file}:2 | `a - b` | `a + b` | a hole |" in lines


@pytest.mark.parametrize("file", CORE)
def test_files_and_their_tests_are_there(file):
    assert all((ROOT / path).exists() for path in (file, *CORE[file].split()))


def test_a_planted_error_is_found_and_taken_out_again(tmp_path):
    (tmp_path / "sum.py").write_text("def add(a, b):\n    return a + b\n")
    (tmp_path / "test_sum.py").write_text("from sum import add\n\n\ndef test_add():\n    assert add(1, 2) == 3\n")
    (tmp_path / "pyproject.toml").write_text("[tool.pytest.ini_options]\nmarkers = ['slow']\n")
    kept = (tmp_path / "sum.py").read_text()
    assert outcome(tmp_path, "sum.py", kept.replace("+", "-"), "test_sum.py").startswith("killed")
    assert outcome(tmp_path, "sum.py", kept, "test_sum.py") == "LIVES"
    assert (tmp_path / "sum.py").read_text() == kept
