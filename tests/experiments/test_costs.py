from types import SimpleNamespace

import experiments.costs
from experiments.costs import main


def test_the_table_has_a_column_a_run_and_says_what_a_run_knows_nothing_of(tmp_path, monkeypatch, capsys):
    runs = {
        "old": {"body": 100.0, "hand_left": 30.0, "hand_right": 31.0, "all": 300.0},
        "new": {"body": 90.0, "hand_left": 30.0, "hand_right": 30.0, "light": 12.0, "all": 290.0},
    }
    monkeypatch.setattr(
        experiments.costs, "read_facts",
        lambda run: {"subject": run.name, "machine": "two cores", "seconds": runs[run.name]},
    )  # fmt: skip
    assert main([str(tmp_path / "old"), str(tmp_path / "new")]) == 0
    rows = {cells[0].strip(): [c.strip() for c in cells[1:]] for cells in _cells(capsys.readouterr().out)}
    assert rows["seconds"][:2] == ["old (two cores)", "new (two cores)"]
    assert rows["hands"][:2] == ["61", "60"]
    assert rows["the capture's light"] == ["-", "12", "`--without light`"]
    assert rows["training in all"][:2] == ["300", "290"]

    clock = SimpleNamespace(stdout="[  1.0 s, + 1.0] mesh\n[ 55.5 s, +20.0] me.glb: 7.0 MB\n", stderr="")
    asked = []
    monkeypatch.setattr(experiments.costs.subprocess, "run", lambda words, **kept: asked.append(words) or clock)
    out = tmp_path / "costs.md"
    assert main([str(tmp_path / "new"), "--bake", "-o", str(out)]) == 0
    assert "| bake, textures from the videos | 56 | `--texture-from videos` |" in out.read_text()
    assert [words[-1] for words in asked] == ["field", "videos"]


def _cells(text):
    return [line.strip("|").split("|") for line in text.splitlines() if not line.startswith("|---")]
