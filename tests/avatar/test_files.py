"""Files and folders are written whole or not at all."""

import pytest

from avatar.errors import AssetError
from avatar.files import whole_file, whole_folder


def test_an_interrupted_file_leaves_the_old_one_and_no_litter(tmp_path):
    (tmp_path / "a.bin").write_bytes(b"old")
    with pytest.raises(KeyboardInterrupt), whole_file(tmp_path / "a.bin") as file:
        file.write(b"new, half")
        raise KeyboardInterrupt
    assert [p.name for p in tmp_path.iterdir()] == ["a.bin"]
    assert (tmp_path / "a.bin").read_bytes() == b"old"


def test_an_interrupted_folder_leaves_nothing(tmp_path):
    with pytest.raises(RuntimeError), whole_folder(tmp_path / "run") as folder:
        (folder / "x").write_text("x")
        raise RuntimeError
    assert list(tmp_path.iterdir()) == []


def test_a_folder_of_ours_is_replaced_and_someone_elses_is_not(tmp_path):
    for text in ("one", "two"):
        with whole_folder(tmp_path / "run") as folder:
            (folder / "x").write_text(text)
    assert (tmp_path / "run" / "x").read_text() == "two"
    (tmp_path / "theirs").mkdir()
    (tmp_path / "theirs" / "thesis.txt").write_text("years of work")
    with pytest.raises(AssetError, match="empty or absent folder"), whole_folder(tmp_path / "theirs"):
        pass
    assert (tmp_path / "theirs" / "thesis.txt").read_text() == "years of work"
