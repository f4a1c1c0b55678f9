"""Files and folders are written whole or not at all, and nothing of anyone else's goes."""

import fcntl
import os
import signal
import stat
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from memory_use import mounted
from refusals import refused

import files.whole
from command.errors import AssetError
from files.whole import check_file, check_folder, whole_file, whole_folder, write_text

ROOT = Path(__file__).parents[2]
needs_root = pytest.mark.skipif(os.geteuid() != 0, reason="only root may make devices and mounts")


def write_frames(folder: Path, names: str, text: str) -> None:
    with whole_folder(folder) as made:
        for name in names:
            (made / name).write_text(text)


def everything(folder: Path) -> list[str]:
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*"))


def test_what_is_interrupted_leaves_the_old_file_no_folder_and_no_litter(tmp_path):
    with pytest.raises(RuntimeError), whole_folder(tmp_path / "run") as folder:
        (folder / "x").write_text("x")
        raise RuntimeError
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "a.bin").write_bytes(b"old")
    with pytest.raises(KeyboardInterrupt), whole_file(tmp_path / "a.bin") as file:
        file.write(b"new, half")
        raise KeyboardInterrupt
    assert [p.name for p in tmp_path.iterdir()] == ["a.bin"]
    assert (tmp_path / "a.bin").read_bytes() == b"old"


def test_a_folder_of_ours_is_replaced_and_someone_elses_is_not(tmp_path):
    write_frames(tmp_path / "run", "xy", "one")
    write_frames(tmp_path / "run", "x", "two")
    assert everything(tmp_path) == ["run", "run/.selfscan", "run/x"]
    assert (tmp_path / "run" / "x").read_text() == "two"
    (tmp_path / "theirs").mkdir()
    (tmp_path / "theirs" / "thesis.txt").write_text("years of work")
    with pytest.raises(AssetError, match="expected an empty or absent folder"), whole_folder(tmp_path / "theirs"):
        pass
    assert (tmp_path / "theirs" / "thesis.txt").read_text() == "years of work"


@pytest.mark.parametrize("change", ["a file", "a folder", "a link", "an edit"])
def test_what_a_person_put_into_a_folder_of_ours_stays(tmp_path, change):
    frames = tmp_path / "frames"
    write_frames(frames, "ab", "first")
    if change == "a file":
        (frames / "notes.txt").write_text("mine")
    elif change == "a folder":
        (frames / "mine").mkdir()
    elif change == "a link":
        (frames / "link").symlink_to("a")
    else:
        (frames / "a").write_text("edited by hand")
    before = everything(tmp_path)
    refused(AssetError, r"is not known to be selfscan's|a in it was changed", write_frames, frames, "a", "second")
    assert everything(tmp_path) == before and (frames / "b").read_text() == "first"


def test_a_file_that_comes_into_the_folder_meanwhile_stays_and_so_does_the_work(tmp_path):
    frames = tmp_path / "frames"
    write_frames(frames, "a", "first")
    with pytest.raises(AssetError, match=r"the new folder is .*frames\.new"), whole_folder(frames) as made:
        (made / "a").write_text("second")
        (frames / "thesis.txt").write_text("years of work")
    assert everything(tmp_path) == [
        "frames", "frames.new", "frames.new/.selfscan", "frames.new/a",
        "frames/.selfscan", "frames/a", "frames/thesis.txt",
    ]  # fmt: skip
    assert (frames / "a").read_text() == "first" and (tmp_path / "frames.new/a").read_text() == "second"


def test_the_old_folder_is_whole_until_the_new_one_is_in_place(tmp_path, monkeypatch):
    frames, rename, seen = tmp_path / "frames", os.rename, []
    write_frames(frames, "abc", "first")

    def fails_at_the_second(source, target):
        seen.append(source)
        if len(seen) == 2:
            raise OSError(5, "Input/output error")
        rename(source, target)

    # where two names cannot change places in one step
    monkeypatch.setattr(files.whole, "_exchanged", lambda one, other: False)
    monkeypatch.setattr(files.whole.os, "rename", fails_at_the_second)
    refused(AssetError, "cannot be written: Input/output error", write_frames, frames, "a", "second")
    assert everything(tmp_path) == ["frames", "frames/.selfscan", "frames/a", "frames/b", "frames/c"]
    assert (frames / "a").read_text() == "first"


def test_a_name_of_a_file_that_is_no_text_can_be_written_into_a_page(tmp_path):
    write_text(tmp_path / "page.html", "of caf\udce9.glb")
    assert (tmp_path / "page.html").read_text("utf-8") == "of caf\\udce9.glb"


def test_a_folder_that_is_read_or_holds_what_is_read_is_not_replaced(tmp_path):
    write_frames(tmp_path / "run", "a", "a night of work")
    for read in (tmp_path / "run", tmp_path / "run" / "a"):
        refused(AssetError, "is read and would be replaced", check_folder, tmp_path / "run", None, read)
    check_folder(tmp_path / "run", tmp_path, tmp_path / "other")


def test_marks_that_name_files_elsewhere_and_folders_above_reach_nothing(tmp_path, monkeypatch):
    place = tmp_path / "none" / "deeper"
    for check, write in ((check_file, whole_file), (check_folder, whole_folder)):
        refused(AssetError, r"there is no folder .*none/deeper; make it first", check, place / "z")
        with pytest.raises(AssetError, match="there is no folder"), write(place / "z"):
            pass
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "thesis.txt").write_text("years of work")
    (tmp_path / "frames").mkdir()
    (tmp_path / "frames/.selfscan").write_text('{"content": {"../thesis.txt": [13, 0]}}')
    write_frames(tmp_path / "frames", "a", "new")
    assert (tmp_path / "thesis.txt").read_text() == "years of work"
    write_frames(tmp_path / "own", "a", "first")
    monkeypatch.chdir(tmp_path / "own")
    for name in (".", "..", str(tmp_path / "own"), "../own", ""):
        with pytest.raises(AssetError, match="current folder"), whole_folder(name):
            pass
    assert (tmp_path / "own/a").read_text() == "first"


def test_what_is_no_file_is_not_replaced_by_one(tmp_path):
    os.mkfifo(tmp_path / "fifo")
    (tmp_path / "folder").mkdir()
    (tmp_path / "to_fifo").symlink_to("fifo")
    for name, message in (("fifo", "is a device, a pipe"), ("to_fifo", "is a device, a pipe"), ("folder", "a folder")):
        with pytest.raises(AssetError, match=message), whole_file(tmp_path / name):
            pass
    with pytest.raises(AssetError, match="is a device"), whole_file("/dev/null"):
        pass
    assert stat.S_ISCHR(os.stat("/dev/null").st_mode) and stat.S_ISFIFO(os.lstat(tmp_path / "fifo").st_mode)
    assert (tmp_path / "to_fifo").is_symlink() and (tmp_path / "folder").is_dir()


def test_a_link_stays_and_what_it_points_at_is_written_and_a_protected_file_refused(tmp_path):
    (tmp_path / "store").mkdir()
    (tmp_path / "store/one.json").write_text("old")
    os.chmod(tmp_path / "store/one.json", 0o640)
    (tmp_path / "latest.json").symlink_to("store/one.json")
    with whole_file(tmp_path / "latest.json", "w") as file:
        file.write("new")
    assert (tmp_path / "latest.json").is_symlink() and (tmp_path / "store/one.json").read_text() == "new"
    assert stat.S_IMODE(os.stat(tmp_path / "store/one.json").st_mode) == 0o640
    (tmp_path / "a").write_text("kept")
    os.chmod(tmp_path / "a", 0o444)
    with pytest.raises(AssetError, match="write-protected"), whole_file(tmp_path / "a"):
        pass
    assert (tmp_path / "a").read_text() == "kept"


def test_long_names_are_written_and_leftovers_locked_are_in_work(tmp_path):
    with whole_file(tmp_path / ("n" * 250)) as file:
        file.write(b"x")
    for name in ("n" * 256, "a\0b"):
        with pytest.raises(AssetError, match="cannot be written"), whole_file(tmp_path / name):
            pass
    other = tmp_path / ".selfscan-12345678.tmp"
    with open(other, "w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        with whole_file(tmp_path / "a"):
            pass
        assert other.exists()
    with whole_file(tmp_path / "a"):
        pass
    assert not other.exists()


KILLED = """
import os, signal, sys
from files.whole import whole_file, whole_folder
with whole_folder(sys.argv[1] + "/run") as folder, whole_file(sys.argv[1] + "/a.mp4") as film:
    (folder / "x").write_text("half")
    film.write(b"half")
    film.flush()
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_what_a_killed_process_left_is_removed_by_the_next_and_work_in_hand_is_not(tmp_path):
    done = subprocess.run([sys.executable, "-c", KILLED, str(tmp_path)], cwd=ROOT)
    assert done.returncode == -signal.SIGKILL
    assert len(everything(tmp_path)) == 3
    (tmp_path / ".selfscan-mine.tmp").write_text("not a name of ours")
    (tmp_path / ".selfscan-abcdefgh.tmp").symlink_to(ROOT)
    with whole_file(tmp_path / "b.mp4") as first, whole_file(tmp_path / "c.mp4") as second:
        first.write(b"1")
        second.write(b"2")
    assert everything(tmp_path) == [".selfscan-abcdefgh.tmp", ".selfscan-mine.tmp", "b.mp4", "c.mp4"]


@needs_root
def test_a_full_disk_is_one_line_and_leaves_the_old(tmp_path):
    full = tmp_path / "full"
    with mounted(full, "256k"):
        with whole_file(full / "a.npz") as file:
            file.write(b"old")
        write_frames(full / "run", "x", "old")
        for _ in range(2):
            with pytest.raises(AssetError, match=r"a\.npz: cannot be written: No"), whole_file(full / "a.npz") as file:
                np.savez(file, a=np.zeros(1 << 20))
            with (
                pytest.raises(AssetError, match=r"full/run.*: cannot be written: No space"),
                whole_folder(full / "run") as folder,
                whole_file(folder / "y") as file,
            ):
                file.write(bytes(1 << 20))
        assert everything(full) == ["a.npz", "run", "run/.selfscan", "run/x"]
        assert (full / "a.npz").read_bytes() == b"old" and (full / "run/x").read_text() == "old"


@needs_root
def test_a_mount_point_is_refused_before_anything_is_removed(tmp_path):
    with mounted(tmp_path / "disk", "256k"):
        with pytest.raises(AssetError, match="mount point"), whole_folder(tmp_path / "disk"):
            pass
        write_frames(tmp_path / "disk/frames", "a", "first")
        assert (tmp_path / "disk/frames/a").read_text() == "first"
