"""The base install stays light: drawing needs no torch, filming alone needs av, and import is quick."""

import subprocess
import sys

FILM = """
import sys
from player.film.command import render_main
assert render_main(sys.argv[1:]) == 0
print(" ".join(sys.modules))
"""


def test_headless_render_loads_neither_live_nor_window(tmp_path):
    scene = tmp_path / "scene.toml"
    scene.write_text('[[avatar]]\npath = "mannequin"\nmotion = "walking"\n[[avatar]]\npath = "mannequin:female"\n')
    options = ["--scene", str(scene), "--frame", "3", "--size", "32x40", "--explain", "-o", str(tmp_path / "a.png")]
    out = subprocess.run([sys.executable, "-c", FILM, *options], capture_output=True, text=True, check=True).stdout
    loaded = set(out.splitlines()[-1].split())
    assert "player.effects.avatar" in loaded
    # the legs of feet that are held
    loaded -= {"player.pose", "player.pose.ik"}
    assert not [name for name in loaded if name.startswith(("player.live", "player.window", "player.pose"))]
    heavy = {"torch", "av", "glfw", "scipy", "trimesh", "onnxruntime", "matplotlib", "websockets", "pythonosc"}
    assert not loaded & heavy
