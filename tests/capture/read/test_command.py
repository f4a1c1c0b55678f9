"""`selfscan import` as it is typed: both kinds."""

from foreign_layouts import assert_same_capture

from selfscan.__main__ import main


def test_the_authors_folder_is_imported_by_the_command(authors, source, model, tmp_path, capsys):
    assert main(["import", "totalselfscan", str(authors), str(tmp_path / "out"), "--body", str(model)]) == 0
    assert_same_capture(tmp_path / "out", source)
    printed = capsys.readouterr().out
    assert "skin weights: of model" in printed and "selfscan check" in printed and "3 of 3 frames" in printed


def test_own_videos_are_imported_by_the_command(own, source, model, tmp_path, capsys):
    words = ["import", "easymocap", str(own.root), str(tmp_path / "out"), "--body", str(model), "--head", str(own.head),
             "--landmarks", str(own.landmarks), "--masks", str(own.masks), "--frames", "2"]  # fmt: skip
    assert main(words) == 0
    assert "body: 2 of 3 frames, 000500 to 000502" in capsys.readouterr().out
    assert not (tmp_path / "out/body/images/000002.png").exists()
