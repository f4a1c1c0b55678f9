"""The base install stays light: drawing needs no torch, filming alone needs av, and import is quick."""

import json
import re
import subprocess
import sys
from pathlib import Path

import player

CODE = """
import json, sys, time
import numpy
start = time.perf_counter()
import avatar, player
import avatar.gltf.avatar_file, avatar.motion.clip, player.film.command, player.play_command, player.scene.renderer
import player.draw.raster, player.doctor
spent = time.perf_counter() - start
print(json.dumps({"modules": sorted({name.split(".")[0] for name in sys.modules}), "seconds": spent}))
"""


def test_avatar_and_player_import_no_training_code():
    out = subprocess.run([sys.executable, "-c", CODE], capture_output=True, text=True, check=True)
    found = json.loads(out.stdout)
    heavy = {"torch", "train", "bake", "bench", "av", "glfw", "scipy", "trimesh", "onnxruntime", "matplotlib"}
    assert heavy.isdisjoint(found["modules"])
    print(f"import avatar, player and all their parts beside numpy: {found['seconds']:.3f} s")


FILM = """
import sys
from player.film.command import render_main
assert render_main(sys.argv[1:]) == 0
print(" ".join(name for name in sys.modules if name.startswith("player.")))
"""


def test_headless_render_loads_neither_live_nor_window(tmp_path):
    scene = tmp_path / "scene.toml"
    scene.write_text('[[avatar]]\npath = "mannequin"\nmotion = "walking"\n[[avatar]]\npath = "mannequin:female"\n')
    options = ["--scene", str(scene), "--frame", "3", "--size", "32x40", "--explain", "-o", str(tmp_path / "a.png")]
    out = subprocess.run([sys.executable, "-c", FILM, *options], capture_output=True, text=True, check=True).stdout
    loaded = set(out.splitlines()[-1].split())
    assert "player.effects.avatar" in loaded
    assert not [name for name in loaded if name.split(".")[1] in ("live", "window", "gui", "pose")]


def test_parts_of_headless_films_name_neither_live_nor_window():
    """Nor do branches that were not taken above: cameras of captures, films in parts, clusters."""
    root = Path(player.__file__).parent
    files = [*root.glob("*.py"), *(root / "filming").glob("*.py"), *(root / "scenes").glob("*.py"),
             *(root / "passes").glob("*.py")]  # fmt: skip
    allowed = {"play_command.py", "doctor.py"}
    wrong = [
        f"{file.name}: {line.strip()}"
        for file in files
        if file.name not in allowed
        for line in file.read_text("utf-8").splitlines()
        if re.match(r"\s*(from|import) player\.(live|window|gui|pose)\b", line)
    ]
    assert wrong == []
