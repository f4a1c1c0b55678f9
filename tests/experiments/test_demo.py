"""The demo keeps what is complete and goes on where it stopped."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from refusals import refused

from avatar.gltf.avatar_file import write_avatar
from command.errors import AssetError
from command.stages import Stage, run_stages
from experiments.beside_sheet import VIEWS, write_sheet
from experiments.demo import SCENE, film, stages, summary
from player.scene.mannequin import mannequin
from player.scene.scene_file import read_scene


def writing(path, log, name):
    def run():
        log.append(name)
        path.write_text(name)
        return 0

    return Stage(name, path, run)


def test_complete_stages_are_kept_and_one_without_its_product_stops_the_demo(tmp_path):
    log = []
    todo = [writing(tmp_path / name, log, name) for name in ("a", "b", "c")]
    (tmp_path / "a").write_text("there")
    (tmp_path / "c").write_text("stale")
    run_stages(todo)
    assert log == ["b", "c"]
    assert (tmp_path / "a").read_text() == "there" and (tmp_path / "c").read_text() == "c"
    run_stages(todo)
    assert log == ["b", "c"]
    log.clear()
    todo = [Stage("train", tmp_path / "run.json", lambda: 0), writing(tmp_path / "b", log, "b")]
    refused(AssetError, "'train' ended without", run_stages, todo)
    assert log == []


def test_the_demo_ends_with_film_sheet_and_report_and_says_times_and_what_was_missed(tmp_path):
    names = [stage.product.relative_to(tmp_path).as_posix() for stage in stages(tmp_path)]
    assert names[-4:] == ["avatar.making/head.glb", "avatar.mp4", "contact.png", "report/bench.json"]
    avatar = replace(mannequin(), provenance={"baked": {"missed": ["34.7 dB against the field"]}})
    write_avatar(tmp_path / "avatar.glb", avatar)
    text = "\n".join(summary(tmp_path, {"train": 61.2, "bake": 12.0}))
    assert "train" in text and "61 s" in text and "73 s" in text
    assert "missed: 34.7 dB" in text and "film.toml" in text
    assert text.index("avatar.mp4") < text.index("contact.png") < text.index("bench.html")
    assert f"\n  selfscan play {tmp_path / 'avatar.glb'}\n" in text and text.endswith("--minutes 15")


def test_raw_videos_of_who_calls_for_a_view_network_are_made_and_the_report_has_intervals(tmp_path, monkeypatch):
    commands = []

    def command(*words):
        commands.append([str(word) for word in words])
        return lambda: 0

    monkeypatch.setattr("experiments.demo.command", command)
    stages(tmp_path)
    synth, make, sheet, bench = commands
    assert sheet[-2:] == synth[-2:] == ["--sheen", "0.5"]
    assert float(synth[synth.index("--sheen") + 1]) > 0 and "--raw" in synth
    assert "--minutes" not in make and make[2] == synth[3] == str(tmp_path / "films")
    assert int(bench[bench.index("--rounds") + 1]) >= 20 and int(bench[bench.index("--frames") + 1]) > 1


def test_the_film_is_a_scene_that_shows_the_view_mode_of_the_avatar(tmp_path, monkeypatch):
    monkeypatch.setattr("experiments.demo.command", lambda *words: lambda: 0)
    avatar = mannequin()
    write_avatar(tmp_path / "avatar.glb", avatar)
    film(tmp_path / "avatar.glb", tmp_path / "film.toml", tmp_path / "avatar.mp4")()
    scene = read_scene(tmp_path / "film.toml")
    assert scene.effects.view == avatar.default_view == "network"
    assert "orbit" in (tmp_path / "film.toml").read_text() and "antialiasing" in SCENE


@pytest.mark.parametrize(("people", "size"), [(1, (16, 2)), (2, (16, 4)), (3, (32, 4)), (5, (32, 6))])
def test_a_sheet_has_one_column_of_two_people_at_most_and_two_of_more(tmp_path, monkeypatch, people, size):
    for kind, shade in (("true", 40), ("avatar", 200)):
        tiles = [np.full((2, 2, 3), shade, np.uint8)] * len(VIEWS)
        monkeypatch.setattr(f"experiments.beside_sheet.{kind}_tiles", lambda *_, tiles=tiles, **_more: tiles)
    write_sheet(tmp_path / "sheet.png", [("builtin", "me.glb")] * people, side=2)
    with Image.open(tmp_path / "sheet.png") as page:
        assert (page.format, page.size) == ("PNG", size)
        assert np.asarray(page)[0, :4, 0].tolist() == [40, 40, 200, 200]
