"""What happens when the machine fails and not the input: full disks, closed streams, signals, and our own mistakes."""

import os
import re
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest
import torch
from small_disk import mounted
from tiny_avatar import tiny_avatar

import selfscan.__main__ as command
from avatar.gltf.avatar_file import write_avatar
from command.errors import AssetError
from command.interrupt import Stopped, deferred_stop
from files.whole import whole_file
from selfscan.__main__ import main

ROOT = Path(__file__).parents[2]
SELFSCAN = f"{sys.executable} -m selfscan"


def shell(line: str, **environment: str) -> subprocess.CompletedProcess:
    return subprocess.run(
        ["bash", "-c", line], cwd=ROOT, capture_output=True, text=True, env={**os.environ, **environment}
    )


@pytest.fixture(scope="module")
def film(tmp_path_factory):
    """A command that films five seconds of a small avatar, but for -o."""
    path = tmp_path_factory.mktemp("avatar") / "tiny.glb"
    write_avatar(path, tiny_avatar())
    return f"{SELFSCAN} render {path} --motion walking --frames 0:40 --size 48x48"


def test_a_name_that_is_no_text_is_printed_all_the_same(film, tmp_path):
    done = shell(f"{film} --frames 0:1 -o {tmp_path}/$'\\xff.mp4'", PYTHONIOENCODING="utf-8:strict")
    assert done.returncode == 0, done.stderr
    assert "\\udcff.mp4: 1 frame" in done.stdout


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
@pytest.mark.parametrize("asked", ["--help", "render --help", "--version"])
def test_output_that_cannot_be_printed_is_one_line(asked):
    done = shell(f"{SELFSCAN} {asked} > /dev/full")
    assert done.returncode == 1
    assert done.stderr == "selfscan: what was printed is lost: No space left on device\n"


def test_a_reader_that_goes_is_no_error():
    done = shell(f"set -o pipefail; {SELFSCAN} --help | true")
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.slow
@pytest.mark.parametrize("streams", [">&-", "2>&-", "<&- >&- 2>&-", "> >(true)", "2> >(true)", "2> /dev/full"])
def test_a_film_is_written_whatever_becomes_of_what_is_printed(film, tmp_path, streams):
    out = tmp_path / "film.mp4"
    done = shell(f"{film} -o {out} {streams}")
    assert done.returncode == 0 and "Traceback" not in done.stderr
    expected = tmp_path / "expected.mp4"
    assert shell(f"{film} -o {expected}").returncode == 0
    assert out.read_bytes() == expected.read_bytes()


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may mount a small disk")
def test_a_full_disk_is_one_line_for_every_command_that_writes(film, tmp_path, capsys):
    disk, avatar = tmp_path / "disk", film.split()[4]
    with mounted(disk, "64k"):
        with suppress(OSError), open(disk / "filler", "wb", buffering=0) as file:
            while file.write(bytes(1 << 12)):
                pass
        motion = [avatar, "--motion", "counting", "--frames", "0:9"]
        for arguments in (
            ["export", *motion, "-o", f"{disk}/a.glb"], ["export", *motion, "-o", f"{disk}/a.npz"],
            ["export", *motion, "-o", f"{disk}/a.bvh"], ["render", *motion, "-o", f"{disk}/a.mp4"],
            ["render", *motion, "-o", f"{disk}/frames"],
            ["render", *motion, "-o", f"{disk}/a.gif"],
        ):  # fmt: skip
            assert main(arguments) == 1
            said = [line for line in capsys.readouterr().err.splitlines() if not line.startswith("frames")]
            assert len(said) == 1 and f"selfscan {arguments[0]}: {arguments[-1]}" in said[0], said
            assert "cannot be written" in said[0] and "No space left" in said[0]
            assert [path.name for path in disk.iterdir()] == ["filler"]
        with (
            pytest.raises(AssetError, match=r"a\.ckpt: cannot be written: No space left"),
            whole_file(disk / "a.ckpt") as file,
        ):
            torch.save({"weights": torch.zeros(1 << 20)}, file)


def test_the_disk_and_the_memory_are_one_line(monkeypatch, capsys):
    for error, line in (
        (OSError(28, "No space left on device"), "selfscan render: No space left on device\n"),
        (PermissionError(13, "Permission denied", "a.glb"), "selfscan render: a.glb: Permission denied\n"),
        (MemoryError("Unable to allocate 9 GiB"), "selfscan render: not enough memory Unable to allocate 9 GiB\n"),
    ):
        monkeypatch.setattr(command, "_dispatch", lambda _name, _rest, error=error: (_ for _ in ()).throw(error))
        assert main(["render"]) == 1
        assert capsys.readouterr().err == line


def test_an_error_of_ours_asks_for_a_report_and_says_where_it_is(monkeypatch, capsys, tmp_path):
    def breaks(_name, _rest):
        raise IndexError("index 5 is out of bounds\nand more")

    monkeypatch.setattr(command, "_dispatch", breaks)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    assert main(["render", "a.glb"]) == 1
    found = re.fullmatch(
        r"selfscan render: an error that should not happen, IndexError: index 5 is out of bounds; please report it "
        r"with (\S+\.txt)\n",
        capsys.readouterr().err,
    )
    assert found
    report = Path(found[1]).read_text()
    assert "breaks" in report and "['render', 'a.glb']" in report and "Python 3" in report
    assert main(["--debug", "render"]) == 1
    assert "Traceback" in capsys.readouterr().err and len(list(tmp_path.iterdir())) == 1
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "none"))
    assert main(["render"]) == 1
    assert "please report it with what `selfscan --debug ...` shows" in capsys.readouterr().err


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_ends_a_command_with_its_code(monkeypatch, capsys, number, code):
    before = signal.getsignal(number)
    monkeypatch.setattr(command, "_dispatch", lambda _name, _rest: signal.raise_signal(number))
    assert main(["render"]) == code
    assert "selfscan render: stopped" in capsys.readouterr().err and signal.getsignal(number) == before
    assert issubclass(Stopped, KeyboardInterrupt)


def test_a_signal_that_was_dropped_is_taken_up_later(monkeypatch, capsys):
    """ctypes drops an exception that is raised while OpenGL calls back."""

    def dropped(_name, _rest):
        with suppress(Stopped):
            signal.raise_signal(signal.SIGTERM)
        with deferred_stop() as stop:
            stop.check()

    def broken(_name, _rest):
        with suppress(Stopped):
            signal.raise_signal(signal.SIGTERM)
        raise RuntimeError("half a shader")

    for dispatch in (dropped, broken):
        monkeypatch.setattr(command, "_dispatch", dispatch)
        assert main(["render"]) == 143
        assert capsys.readouterr().err == "\nselfscan render: stopped\n"
    with deferred_stop() as stop:
        assert not stop.asked


@pytest.mark.slow
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_film_that_is_stopped_leaves_the_old_one_and_nothing_else(film, tmp_path, number, code):
    out = tmp_path / "film.mp4"
    out.write_bytes(b"the old film")
    arguments = [*film.replace("0:40", "0:100").replace("48x48", "1600x1600").split(), "-o", str(out)]
    process = subprocess.Popen(arguments, cwd=ROOT, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 100
    while not list(tmp_path.glob(".selfscan-*.tmp")) and time.monotonic() < deadline:
        time.sleep(0.02)
    process.send_signal(number)
    _, said = process.communicate(timeout=100)
    assert process.returncode == code and "stopped" in said and "Traceback" not in said
    assert [path.name for path in tmp_path.iterdir()] == ["film.mp4"] and out.read_bytes() == b"the old film"
