"""The base install stays light: drawing needs no torch, filming alone needs av, and import is quick."""

import json
import subprocess
import sys

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
    assert (heavy | {"websockets", "pythonosc"}).isdisjoint(found["modules"])
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
