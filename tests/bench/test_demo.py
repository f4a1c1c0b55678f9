"""The demo keeps what is complete and goes on where it stopped."""

import pytest

from avatar.errors import AssetError
from bench.demo import Stage, command, run_stages, stages


def writing(path, log, name):
    def run():
        log.append(name)
        path.write_text(name)
        return 0

    return Stage(name, path, run)


def test_complete_stages_are_kept_and_all_after_a_fresh_one_run_again(tmp_path):
    log = []
    todo = [writing(tmp_path / name, log, name) for name in ("a", "b", "c")]
    (tmp_path / "a").write_text("there")
    (tmp_path / "c").write_text("stale")
    run_stages(todo)
    assert log == ["b", "c"]
    assert (tmp_path / "a").read_text() == "there" and (tmp_path / "c").read_text() == "c"
    run_stages(todo)
    assert log == ["b", "c"]


def test_a_stage_without_its_product_stops_the_demo(tmp_path):
    log = []
    todo = [Stage("train", tmp_path / "run.json", lambda: 0), writing(tmp_path / "b", log, "b")]
    with pytest.raises(AssetError, match="'train' ended without"):
        run_stages(todo)
    assert log == []


def test_the_demo_ends_with_film_contact_sheet_and_report(tmp_path):
    names = [stage.product.relative_to(tmp_path).as_posix() for stage in stages(tmp_path)]
    assert names[-4:] == ["avatar.glb", "avatar.mp4", "contact.png", "report/bench.json"]


def test_a_command_that_fails_in_its_own_process_stops_the_demo(tmp_path, capfd):
    todo = [
        Stage(
            "bake",
            tmp_path / "a.glb",
            command("selfscan", "bake", tmp_path / "none", "-o", tmp_path / "a.glb"),
        )
    ]
    with pytest.raises(AssetError, match="'bake' ended without"):
        run_stages(todo)
    assert "none" in capfd.readouterr().err
