"""The command line as a person meets it, also where the machine fails, and the commands of `selfscan make`."""

import os
import re
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import av
import glfw
import numpy as np
import pytest
import torch
from memory_use import mounted
from mesh_distance import mesh_distance
from recorded_commands import recorded_commands
from tiny_avatar import tiny_avatar

import selfscan.__main__ as entry
from avatar.gltf.avatar_file import read_avatar, write_avatar
from avatar.gltf.write import GltfBuilder
from avatar.skeleton import PARTS
from capture.raw import filming
from capture.raw.video_file import open_video
from capture.raw.webcam import Webcam
from capture.read.command import FilmOptions
from command.errors import AssetError
from command.interrupt import Stopped, deferred_stop
from files.whole import exclusive_lock, whole_file
from player.window.picture_window import PictureWindow
from selfscan import make
from selfscan.__main__ import COMMANDS, main

ROOT = Path(__file__).parents[2]


def run(capsys, *argv: object) -> tuple[int, str]:
    """Exit code and what stood on standard error."""
    try:
        code = main([str(a) for a in argv])
    except SystemExit as stop:  # argparse
        code = int(stop.code or 0)
    return code, capsys.readouterr().err


def refused(capsys, *argv: object, names: tuple[str, ...]) -> None:
    code, err = run(capsys, *argv)
    assert code == 1, err
    lines = [line for line in err.strip().splitlines() if not line.startswith("note:")]
    assert len(lines) == 1 and "Traceback" not in err, err
    for name in names:
        assert name in lines[0], f"{name!r} not in: {lines[0]}"


def test_usage_a_missing_package_and_absent_files_are_named(capsys, monkeypatch, tmp_path):
    assert main([]) == 2
    assert "selfscan COMMAND" in capsys.readouterr().out
    import importlib.metadata

    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"selfscan {importlib.metadata.version('selfscan')}\n"
    monkeypatch.setitem(sys.modules, "pyvista", None)
    refused(capsys, "inspect", "me.glb", "-o", tmp_path / "out", names=("pyvista", "pip install -e '.[inspect]'"))
    absent = tmp_path / "absent.glb"
    refused(capsys, "render", absent, "--motion", "counting", "-o", tmp_path / "a.png", names=("absent.glb",))
    refused(capsys, "synth", absent, tmp_path / "cap", names=("absent.glb",))
    refused(capsys, "train", tmp_path / "cap", "-o", tmp_path / "run", names=("cap",))
    refused(capsys, "bake", tmp_path / "run", "-o", tmp_path / "a.glb", names=("run",))
    refused(capsys, "eval", tmp_path / "run", tmp_path / "cap", names=("run",))
    refused(capsys, "bench", absent, "-o", tmp_path / "bench", names=("absent.glb",))
    for words in ("train {0} -o {0}", "bench a.glb --run {0} -o {0}", "import totalselfscan {0} {0}"):
        refused(capsys, *words.format(absent).split(), names=("which is read and would be replaced",))
    assert list(tmp_path.iterdir()) == []


WRONG = [
    ("bake r -o a.glb --texture 1000", "texture: expected a power of two from 64 to 8192, found 1000"),
    ("dance", "dance"),
    ("rendr", "did you mean render?"),
    ("export a.glb --motion counting -o out.fbx", "expected a name that ends in .bvh, .glb, .npz, .vrm, found"),
    ("export a.glb --motion counting -o out.npz --unit cm", "--unit is for .bvh"),
    ("export a.glb -o out.vrm --author An\udcffna", "--author: expected UTF-8 text, found 'An\\udcffna'"),
    ("synth builtin cap --keypoints", "--seconds and what follows it go with --raw"),
    ("synth builtin cap --raw --frames 20", "--template are of a capture"),
    ("import", "expected video, totalselfscan or easymocap, found nothing"),
    ("import kinect a b", "expected video, totalselfscan or easymocap, found kinect"),
    ("import easymocap a b", "are required: --body, --head, --landmarks, --masks"),
]


@pytest.mark.parametrize(("line", "said"), WRONG)
def test_wrong_usage_is_one_line_and_makes_nothing(capsys, monkeypatch, tmp_path, line, said):
    monkeypatch.chdir(tmp_path)
    code, err = run(capsys, *line.split())
    assert code == 2 and said in err and err.count("\n") == 1 and not list(tmp_path.iterdir())


def test_who_asks_for_a_person_that_is_no_avatar_yet_learns_how_to_make_one(capsys, tmp_path):
    name = "builtin:female"
    for command, out in (("render", "a.png"), ("web", "a.html"), ("export", "a.bvh"), ("bench", "bench")):
        motion = () if command == "bench" else ("--motion", "counting")
        refused(capsys, command, name, *motion, "-o", tmp_path / out, names=(name, f"synth {name} CAPTURE"))


def test_a_gltf_without_a_humanoid_is_refused(capsys, tmp_path):
    builder = GltfBuilder()
    builder.add_accessor(np.eye(3, dtype=np.float32), bounds=True)
    mesh = {"primitives": [{"attributes": {"POSITION": 0}}]}
    box = tmp_path / "box.glb"
    box.write_bytes(builder.to_bytes({"asset": {"version": "2.0"}, "meshes": [mesh], "nodes": [{"mesh": 0}],
                                      "scenes": [{"nodes": [0]}]}))  # fmt: skip
    refused(capsys, "synth", box, tmp_path / "cap", names=("box.glb",))
    refused(capsys, "render", box, "--motion", "counting", "-o", tmp_path / "a.png", names=("box.glb",))
    assert sorted(p.name for p in tmp_path.iterdir()) == ["box.glb"]


HEAVY = ("torch", "scipy", "skimage", "matplotlib", "onnxruntime", "av", "trimesh")
KINDS = [("import", kind) for kind in ("video", "totalselfscan", "easymocap")]


@pytest.mark.parametrize("words", [*((name,) for name in COMMANDS), *KINDS], ids=" ".join)
def test_help_teaches_and_help_and_wrong_usage_import_nothing_heavy(words):
    """In a fresh process: arguments are read before what the work needs is loaded."""
    code = (
        "import sys; from selfscan.__main__ import main\n"
        "for more, expected in (['--help'], 0), (['--no-such-option'], 2):\n"
        "    try: code = main(sys.argv[1:] + more)\n"
        "    except SystemExit as stop: code = stop.code\n"
        "    assert code == expected, (more, code)\n"
        f"sys.exit(repr({set(HEAVY)} & set(sys.modules)) if {set(HEAVY)} & set(sys.modules) else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code, *words], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0 and "Traceback" not in done.stderr, done.stderr
    # the folder above an output is never made, and an example runs where it is typed
    assert len(done.stdout) > 200 and "out/" not in done.stdout


def test_drawing_gives_freed_memory_back_and_other_commands_leave_the_allocator_alone(monkeypatch, capsys):
    asked = []
    monkeypatch.setattr("player.gl.memory.give_back_freed_memory", lambda: asked.append(True))
    for command, expected in (("doctor", 0), ("render", 1), ("play", 2)):
        assert run(capsys, command, "--help")[0] == 0
        assert len(asked) == expected


def test_threads_of_training_sleep_while_they_wait():
    """libgomp reads it when torch is loaded; it prints what it read."""
    environment = {key: value for key, value in os.environ.items() if key != "OMP_WAIT_POLICY"}
    done = subprocess.run(
        [sys.executable, "-m", "selfscan", "train", "--help"], cwd=ROOT, capture_output=True, text=True,
        env={**environment, "OMP_DISPLAY_ENV": "TRUE"},
    )  # fmt: skip
    if "OMP_WAIT_POLICY" not in done.stderr:
        pytest.skip("this torch has another OpenMP, which does not print its settings")
    assert "OMP_WAIT_POLICY = 'PASSIVE'" in done.stderr


FILMS = ("body.mp4", "head.mp4", "left.mp4", "right.mp4")


@pytest.fixture
def films(tmp_path, monkeypatch):
    """Four files that are no films; as if large ones."""
    monkeypatch.setattr(make, "megapixels", lambda films: 0.9)
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


def test_larger_films_are_said_to_take_longer(filmed_four, tmp_path, monkeypatch):
    wanted = make.MakeCommand(tmp_path / "me.glb", FilmOptions(), (filmed_four,))
    width, height = open_video(filmed_four / "body.mp4").size
    assert make.megapixels(wanted.films) == pytest.approx(width * height / 1e6)
    told = []
    for large in (0.6, 2.1):
        monkeypatch.setattr(make, "megapixels", lambda films, large=large: large)
        told.append([stage.minutes for stage in make.make_stages(wanted)])
    assert (np.array(told[1]) >= told[0]).all() and sum(told[1]) > 2 * sum(told[0])


def test_a_first_avatar_stands_where_the_better_one_will(films, ran, tmp_path, capsys):
    out = tmp_path / "my avatar.glb"
    assert make.main([str(films), "-o", str(out), "--stature", "1.78", "--sex", "female"]) == 0
    kinds = [words[1] for words in ran]
    assert kinds == ["import", "train", "bake", "train", "bake"]
    read, first, early, head, last = ran
    assert read[read.index("--stature") + 1] == "1.78" and read[read.index("--sex") + 1] == "female"
    assert "--frames" not in read
    assert first[first.index("--preset") + 1] == "preview" and head[head.index("--preset") + 1] == "head"
    assert "--like" not in first and head[head.index("--like") + 1] == first[first.index("-o") + 1]
    assert "--texture" in early and "--texture" not in last
    assert out.read_text() == " ".join(last)
    said = capsys.readouterr().out
    assert said.count(f"{out}: ready after") == said.count(f": selfscan play '{out}' --follow\n") == 2


def test_films_that_are_not_there_are_refused_before_anything_is_made(tmp_path):
    with pytest.raises(AssetError, match=r"nowhere\.mp4: expected a film"):
        make.main([str(tmp_path / "nowhere.mp4"), "-o", str(tmp_path / "me.glb")])
    with pytest.raises(AssetError, match=r"expected body\.mp4, .* found no film"):
        make.main([str(tmp_path), "-o", str(tmp_path / "me.glb")])
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("option", ["keypoints", "masks", "models"])
def test_a_folder_that_is_named_and_absent_is_refused_before_anything_is_made(films, tmp_path, capsys, option):
    absent = tmp_path / "nope"
    for words in (("make", films), ("import", "video", films)):
        said = f"--{option} {absent}: expected a folder, found none"
        refused(capsys, *words, "-o", tmp_path / "me.glb", f"--{option}", absent, names=(said,))
    assert list(tmp_path.iterdir()) == [films]


@pytest.mark.parametrize(
    ("words", "out"),
    [
        (("make", "me"), "me.glb"),
        (("import", "video", "me"), "capture"),
        (("bake", "me"), "me.glb"),
        (("render", "builtin", "--motion", "counting", "--frames", "0:2", "--size", "64x64", "--resume"), "me.mp4"),
    ],
)
def test_what_another_process_is_making_is_left_alone(films, tmp_path, monkeypatch, capsys, words, out):
    monkeypatch.chdir(tmp_path)
    said = f"{out}: process {os.getpid()} is making it; wait for it, or choose another -o"
    with exclusive_lock(Path(out)):
        refused(capsys, *words, "-o", out, names=(said,))
    assert list(tmp_path.iterdir()) == [films]


def test_four_minutes_end_with_the_first_avatar_and_more_go_on_from_there(films, ran, tmp_path):
    out = tmp_path / "me.glb"
    make.main([str(films), "-o", str(out), "--minutes", "4"])
    assert [words[1] for words in ran] == ["import", "train", "bake"]
    make.main([str(films), "-o", str(out)])
    assert [words[1] for words in ran[3:]] == ["train", "bake"]


def test_small_films_show_no_more_texels_than_the_first_avatar_has(films, ran, tmp_path, monkeypatch):
    monkeypatch.setattr(make, "megapixels", lambda films: 0.3)
    out = tmp_path / "me.glb"
    make.main([str(films), "-o", str(out)])
    assert [words[1] for words in ran] == ["import", "train", "bake", "train", "bake"]
    assert ran[-1][-2:] == ran[2][-2:] == ["--texture", str(make.FIRST)] and out.read_text() == " ".join(ran[-1])


@pytest.mark.parametrize(("minutes", "trained"), [("15", ["fields_15"]), ("60", ["head", "fields_60"])])
def test_more_minutes_train_all_fields_and_the_last_avatar_stands(films, ran, tmp_path, minutes, trained):
    out = tmp_path / "me.glb"
    for _ in range(2):
        make.main([str(films), "-o", str(out), "--minutes", minutes])
        assert out.read_text() == " ".join(ran[-1]) and f"{trained[-1]}.glb" in ran[-1][ran[-1].index("-o") + 1]
        out.unlink()
    assert [words[1] for words in ran] == ["import", "train", "bake", *["train", "bake"] * len(trained)]
    assert [Path(words[words.index("-o") + 1]).stem for words in ran[3:]] == [t for one in trained for t in (one, one)]
    assert ("--iterations" in ran[-2]) == (minutes == "15")


def test_what_was_stopped_goes_on_where_it_was(films, monkeypatch, tmp_path):
    out = tmp_path / "me.glb"
    recorded_commands(monkeypatch, make, lambda words: STOPPED if words[1] == "bake" else product(words))
    with pytest.raises(Stopped):
        make.main([str(films), "-o", str(out)])
    assert not out.exists()
    ran = recorded_commands(monkeypatch, make, product)
    make.main([str(films), "-o", str(out)])
    assert [words[1] for words in ran] == ["bake", "train", "bake"]


def test_an_avatar_that_was_moved_away_is_put_there_again_and_other_films_are_not_mixed_in(films, ran, tmp_path):
    out = tmp_path / "me.glb"
    make.main([str(films), "-o", str(out)])
    made = out.read_text()
    out.unlink()
    make.main([str(films), "-o", str(out)])
    assert out.read_text() == made and len(ran) == 5
    # a kill came after the better one was baked, before it took the first one's place
    out.write_bytes((tmp_path / "me.making" / "first.glb").read_bytes())
    make.main([str(films), "-o", str(out)])
    assert out.read_text() == made and len(ran) == 5
    make.main([str(films), "-o", str(out), "--minutes", "4"])
    (films / "body.mp4").write_text("another film")
    with pytest.raises(AssetError, match=r"me\.making: holds the work on other films: remove it"):
        make.main([str(films), "-o", str(out), "--minutes", "4"])
    (films / "body.mp4").write_text("body.mp4")
    (films / "keypoints").mkdir()
    (films / "keypoints" / "found.json").write_text("by another detector")
    with pytest.raises(AssetError, match=r"me\.making: holds the work on other keypoints: remove it"):
        make.main([str(films), "-o", str(out), "--minutes", "4"])
    (films / "keypoints" / "found.json").unlink()
    (films / "notes.txt").write_text("nothing filmed")
    with pytest.raises(AssetError, match=r"me\.making: holds the work on other options \(none\): remove it"):
        make.main([str(films), "-o", str(out), "--minutes", "4", "--stature", "1.8"])


@pytest.mark.parametrize("folder", [True, False])
def test_what_is_no_work_of_its_own_is_left_alone(films, tmp_path, folder):
    place = tmp_path / "me.making"
    (place.mkdir() or (place / "mine").touch()) if folder else place.touch()
    with pytest.raises(AssetError, match=r"me\.making: is in the way, and not the work of `selfscan make`; remove or"):
        make.main([str(films), "-o", str(tmp_path / "me.glb")])
    assert (place / "mine").exists() or place.is_file()


def test_options_may_change_until_something_was_made(films, monkeypatch, tmp_path):
    monkeypatch.setattr(make, "command", lambda *words: lambda: 1)
    for options in ([], ["--stature", "1.8"]):
        with pytest.raises(AssetError, match="'read the films and fit the person' ended without writing it"):
            make.main([str(films), "-o", str(tmp_path / "me.glb"), *options])


@pytest.mark.slow
def test_a_webcam_films_first_and_what_was_read_is_not_filmed_again(ran, tmp_path, monkeypatch, osmesa):
    class Window(PictureWindow):
        def __init__(self, size):
            super().__init__(size, null=True)

        def show(self, picture):
            self.on_key(glfw.KEY_SPACE, glfw.PRESS)
            pressed = super().show(picture)
            seen.append(self.screen.read((0, 0, *self.screen.size)))
            return pressed

    out, seen = tmp_path / "me.glb", []
    short = (filming.Step(0.1, "in"),)
    monkeypatch.setattr(filming, "COUNTDOWN", short[0])
    monkeypatch.setattr(filming, "STEPS", dict.fromkeys(PARTS, short))
    monkeypatch.setattr("player.window.picture_window.PictureWindow", Window)
    picture = "color=lime:size=160x90:rate=30,noise=alls=9:allf=t"
    monkeypatch.setattr("capture.raw.webcam.open_camera", lambda _name: Webcam(av.open(picture, format="lavfi")))
    assert make.main(["--camera", "-o", str(out)]) == 0
    assert sorted(path.name for path in (tmp_path / "me.films").iterdir()) == list(FILMS)
    assert ran[0][3] == str(tmp_path / "me.films") and out.exists()
    # the room is green, words are white on dark
    words = seen[0][640:700, 300:980, :3]
    assert seen[0][500, 640, 1] > 200 and words.max() > 200 and np.median(words) < 60

    def none(_name: str) -> Webcam:
        raise AssetError("no camera found; there are none")

    monkeypatch.setattr("capture.raw.webcam.open_camera", none)
    assert make.main(["--camera", "-o", str(out)]) == 0
    with pytest.raises(AssetError, match=r"no camera found; there are none; or film with a phone, put body\.mp4, head"):
        make.main(["--camera", "-o", str(tmp_path / "you.glb")])
    (tmp_path / "her.making").mkdir()
    with pytest.raises(AssetError, match=r"her\.making: holds the work on other films than .*her\.films: remove"):
        make.main(["--camera", "-o", str(tmp_path / "her.glb")])


# what `make --minutes 4` leaves, in order
PRODUCTS = (Path("capture", "capture.json"), Path("first", "run.json"), Path("first.glb"))


def start_tiny(*words: object) -> subprocess.Popen:
    """A command of tiny_commands.py in a process group of its own."""
    places = os.pathsep.join([str(ROOT), str(ROOT / "tests")])
    return subprocess.Popen(
        [sys.executable, "-m", "tiny_commands", *map(str, words)], stdout=subprocess.DEVNULL, start_new_session=True,
        env={**os.environ, "PYTHONPATH": places, "OMP_NUM_THREADS": "1"},
    )  # fmt: skip


def start_make(films: Path, out: Path) -> subprocess.Popen:
    return start_tiny("make", films, "-o", out, "--minutes", "4", "--stature", "1.753", "--frames", "8")


@pytest.mark.slow
def test_killed_at_random_moments_make_goes_on_and_ends_with_the_same_avatar(tmp_path):
    """Moments of the whole work: what is kept counts as done. SELFSCAN_KILLS says how many; twenty were tried."""
    films, whole, out = (tmp_path / name for name in ("me", "whole.glb", "killed.glb"))
    raw = ("--raw", "--keypoints", "--size", "160", "--seconds", "2")
    assert start_tiny("synth", "builtin", films, *raw).wait() == 0
    began = time.time()
    assert start_make(films, whole).wait() == 0
    ends = {name: (whole.with_suffix(".making") / name).stat().st_mtime - began for name in PRODUCTS}
    moments = np.random.default_rng(7).uniform(0, max(ends.values()), int(os.environ.get("SELFSCAN_KILLS", "1")))
    for moment in np.sort(moments):
        done = max([end for name, end in ends.items() if (out.with_suffix(".making") / name).exists()], default=0.0)
        process = start_make(films, out)
        with suppress(subprocess.TimeoutExpired):
            process.wait(max(moment - done, 0.0))
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        assert process.wait() in (0, -signal.SIGKILL)
    assert start_make(films, out).wait() == 0
    assert not [path for path in tmp_path.rglob("*") if path.suffix in (".tmp", ".partial")]
    one, other = (read_avatar(path).levels[0] for path in (whole, out))
    # centimetres
    assert mesh_distance((one.positions, one.faces), (other.positions, other.faces)).chamfer < 0.05


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


def test_names_that_are_no_text_and_readers_that_go_are_no_error(film, tmp_path):
    done = shell(f"{film} --frames 0:1 -o {tmp_path}/$'\\xff.mp4'", PYTHONIOENCODING="utf-8:strict")
    assert done.returncode == 0, done.stderr
    assert "\\udcff.mp4: 1 frame" in done.stdout
    done = shell(f"set -o pipefail; {SELFSCAN} --help | true")
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
@pytest.mark.parametrize("asked", ["--help", "render --help", "--version"])
def test_output_that_cannot_be_printed_is_one_line(asked):
    done = shell(f"{SELFSCAN} {asked} > /dev/full")
    assert done.returncode == 1
    assert done.stderr == "selfscan: what was printed is lost: No space left on device\n"


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
        (FileNotFoundError(2, "No such file or directory"), "selfscan render: the folder that this terminal is in was "
         "deleted; change to one that is there\n"),
        (MemoryError("Unable to allocate 9 GiB"), "selfscan render: not enough memory Unable to allocate 9 GiB\n"),
    ):
        monkeypatch.setattr(entry, "_dispatch", lambda _name, _rest, error=error: (_ for _ in ()).throw(error))
        assert main(["render"]) == 1
        assert capsys.readouterr().err == line
    # on a terminal it takes the place of a bar
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    assert main(["render"]) == 1 and capsys.readouterr().err == "\r\x1b[K" + line


def test_an_error_of_ours_asks_for_a_report_and_says_where_it_is(monkeypatch, capsys, tmp_path):
    def breaks(_name, _rest):
        raise IndexError("index 5 is out of bounds\nand more")

    monkeypatch.setattr(entry, "_dispatch", breaks)
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
    monkeypatch.setattr(entry, "_dispatch", lambda _name, _rest: signal.raise_signal(number))
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
        monkeypatch.setattr(entry, "_dispatch", dispatch)
        assert main(["render"]) == 143
        assert capsys.readouterr().err == "\nselfscan render: stopped\n"
    with deferred_stop() as stop:
        assert not stop.asked
