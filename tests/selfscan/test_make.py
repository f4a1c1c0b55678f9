"""`selfscan make`: the commands it runs, what it keeps, and what it refuses."""

from pathlib import Path

import pytest
from recorded_commands import recorded_commands

from command.errors import AssetError
from command.interrupt import Stopped
from selfscan import make

FILMS = ("body.mp4", "head.mp4", "left.mp4", "right.mp4")


@pytest.fixture
def films(tmp_path):
    folder = tmp_path / "me"
    folder.mkdir()
    for name in FILMS:
        (folder / name).write_text(name)
    return folder


STOPPED = 130


@pytest.fixture
def ran(monkeypatch):
    """Stands for the commands: each writes its product."""
    return recorded_commands(monkeypatch, make, product)


def product(words):
    out = Path(words[words.index("-o") + 1])
    if words[1] == "bake":
        out.write_text(" ".join(words))
        return
    out.mkdir()
    (out / ("run.json" if words[1] == "train" else "capture.json")).write_text("{}")


def test_a_first_avatar_stands_where_the_better_one_will(films, ran, tmp_path, capsys):
    out = tmp_path / "me.glb"
    assert make.main([str(films), "-o", str(out), "--stature", "1.78", "--sex", "female"]) == 0
    kinds = [words[1] for words in ran]
    assert kinds == ["import", "train", "bake", "bake"]
    read, first, early, last = ran
    assert read[read.index("--stature") + 1] == "1.78" and read[read.index("--sex") + 1] == "female"
    assert "--frames" not in read
    assert first[first.index("--preset") + 1] == "preview"
    assert "--texture" in early and "--texture" not in last
    assert out.read_text() == " ".join(last)
    assert capsys.readouterr().out.count(f"{out}: ready after") == 2


def test_four_minutes_end_with_the_first_avatar_and_more_go_on_from_there(films, ran, tmp_path):
    out = tmp_path / "me.glb"
    make.main([str(films), "-o", str(out), "--minutes", "4"])
    assert [words[1] for words in ran] == ["import", "train", "bake"]
    make.main([str(films), "-o", str(out)])
    assert [words[1] for words in ran[3:]] == ["bake"]


@pytest.mark.parametrize(("minutes", "fields", "taken"), [("15", 9.7, True), ("60", 9.9, False)])
def test_fields_take_the_place_where_they_show_the_films_better(
    films, ran, tmp_path, monkeypatch, capsys, minutes, fields, taken
):
    monkeypatch.setattr(make, "off_the_films", lambda avatar: fields if "fields" in avatar.name else 10.0)
    out = tmp_path / "me.glb"
    make.main([str(films), "-o", str(out), "--minutes", minutes])
    assert [words[1] for words in ran[4:]] == ["train", "bake"] and ("--iterations" in ran[4]) == (minutes == "15")
    shown = f"fields_{minutes}" if taken else "better"
    for _ in range(2):
        assert f"{shown}.glb" in out.read_text()
        said = capsys.readouterr().out
        assert (f"the template stays: the fields show the films no better ({fields:.2f}" in said) != taken
        out.unlink()
        make.main([str(films), "-o", str(out), "--minutes", minutes])


def test_what_was_stopped_goes_on_where_it_was(films, monkeypatch, tmp_path):
    out = tmp_path / "me.glb"
    recorded_commands(monkeypatch, make, lambda words: STOPPED if words[1] == "bake" else product(words))
    with pytest.raises(Stopped):
        make.main([str(films), "-o", str(out)])
    assert not out.exists()
    ran = recorded_commands(monkeypatch, make, product)
    make.main([str(films), "-o", str(out)])
    assert [words[1] for words in ran] == ["bake", "bake"]


def test_an_avatar_that_was_moved_away_is_put_there_again(films, ran, tmp_path):
    out = tmp_path / "me.glb"
    make.main([str(films), "-o", str(out)])
    made = out.read_text()
    out.unlink()
    make.main([str(films), "-o", str(out)])
    assert out.read_text() == made and len(ran) == 4


def test_other_films_are_not_mixed_with_work_that_is_there(films, ran, tmp_path):
    out = tmp_path / "me.glb"
    make.main([str(films), "-o", str(out), "--minutes", "4"])
    (films / "body.mp4").write_text("another film")
    with pytest.raises(AssetError, match=r"me\.making: holds the work on other films or options"):
        make.main([str(films), "-o", str(out), "--minutes", "4"])


def test_films_that_are_not_there_are_refused_before_anything_is_made(tmp_path):
    with pytest.raises(AssetError, match=r"nowhere\.mp4: expected a film"):
        make.main([str(tmp_path / "nowhere.mp4"), "-o", str(tmp_path / "me.glb")])
    assert not list(tmp_path.iterdir())
