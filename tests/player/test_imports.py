"""The base install stays light: drawing needs no torch, filming alone needs av, and import is quick."""

import json
import subprocess
import sys

CODE = """
import json, sys, time
import numpy
start = time.perf_counter()
import avatar, player
import avatar.gltf.avatar_file, avatar.motion.clip, player.render_command, player.play_command, player.renderer,
player.raster, player.doctor spent = time.perf_counter() - start
print(json.dumps({"modules": sorted({name.split(".")[0] for name in sys.modules}), "seconds": spent}))
"""


def test_avatar_and_player_import_no_training_code():
    out = subprocess.run([sys.executable, "-c", CODE], capture_output=True, text=True, check=True)
    found = json.loads(out.stdout)
    heavy = {"torch", "train", "bake", "bench", "av", "glfw", "scipy", "trimesh", "onnxruntime", "matplotlib"}
    assert heavy.isdisjoint(found["modules"])
    print(f"import avatar, player and all their parts beside numpy: {found['seconds']:.3f} s")
