"""The command line as a person meets it: bad input is one line and exit code 1, wrong usage 2, never a traceback."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from avatar.gltf.write import GltfBuilder
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


def test_no_command_prints_usage_and_returns_2(capsys):
    assert main([]) == 2
    assert "selfscan COMMAND" in capsys.readouterr().out


WRONG = [
    ("bake r -o a.glb --texture 1000", "texture: expected a power of two from 64 to 8192, found 1000"),
    ("dance", "dance"),
    ("rendr", "did you mean render?"),
    ("export a.glb --motion counting -o out.fbx", "expected a name that ends in .bvh, .glb, .npz, found"),
    ("export a.glb --motion counting -o out.npz --unit cm", "--unit is for .bvh"),
    ("import", "expected video, totalselfscan or easymocap, found nothing"),
    ("import kinect a b", "expected video, totalselfscan or easymocap, found kinect"),
    ("import easymocap a b", "are required: --body, --head, --landmarks, --masks"),
    ("inspect a.glb -o out --joint left_ellbow", "no joint is named 'left_ellbow'"),
]


@pytest.mark.parametrize(("line", "said"), WRONG)
def test_wrong_usage_is_one_line_and_makes_nothing(capsys, monkeypatch, tmp_path, line, said):
    monkeypatch.chdir(tmp_path)
    code, err = run(capsys, *line.split())
    assert code == 2 and said in err and err.count("\n") == 1 and not list(tmp_path.iterdir())


def test_a_missing_package_is_named_with_the_command_that_installs_it(capsys, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "pyvista", None)
    refused(capsys, "inspect", "me.glb", "-o", tmp_path / "out", names=("pyvista", "pip install -e '.[inspect]'"))


def test_absent_files_are_named(capsys, tmp_path):
    absent = tmp_path / "absent.glb"
    refused(capsys, "render", absent, "--motion", "counting", "-o", tmp_path / "a.png", names=("absent.glb",))
    refused(capsys, "synth", absent, tmp_path / "cap", names=("absent.glb",))
    refused(capsys, "train", tmp_path / "cap", "-o", tmp_path / "run", names=("cap",))
    refused(capsys, "bake", tmp_path / "run", "-o", tmp_path / "a.glb", names=("run",))
    refused(capsys, "eval", tmp_path / "run", tmp_path / "cap", names=("run",))
    refused(capsys, "bench", absent, "-o", tmp_path / "bench", names=("absent.glb",))
    assert list(tmp_path.iterdir()) == []


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
    assert len(done.stdout) > 200


def test_the_version_is_said(capsys):
    import importlib.metadata

    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"selfscan {importlib.metadata.version('selfscan')}\n"


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
