"""Imports run one way between packages; what a package loads is what it may; the bound of the hard cases."""

import ast
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[1]
# what each package may import of the others
MAY = {
    "command": set(),
    "files": {"command"},
    "avatar": set(),
    "geometry": {"avatar"},
    "capture": {"avatar", "geometry"},
    "player": {"avatar"},
    "shaders": set(),
    "train": {"avatar", "geometry", "capture"},
    "synth": {"avatar", "geometry", "capture", "player"},
    "bake": {"avatar", "geometry", "capture", "train", "player", "shaders"},
    "bench": {"avatar", "geometry", "capture", "train", "player", "shaders", "synth", "bake"},
}


def modules(package: str) -> dict[str, Path]:
    """The modules of a package by name."""
    return {
        ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path
        for path in sorted((ROOT / package).rglob("*.py"))
    }


def imported(name: str, path: Path, known: dict[str, Path], *, lazily: bool) -> set[str]:
    """The modules of the project that a module imports, at its top or also inside its functions."""
    tree = ast.parse(path.read_text())
    found: set[str] = set()
    for node in ast.walk(tree) if lazily else tree.body:
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            below = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= (below & known.keys()) or {node.module}
    return {other for other in found if other in known and other != name}


# any package may read files and settings
BASE = {"files", "command"}
MAY = {package: may if package in BASE else may | BASE for package, may in MAY.items()}
EVERY = {name: path for package in (*MAY, "experiments") for name, path in modules(package).items()}


@pytest.mark.parametrize("package", MAY)
def test_a_package_imports_only_what_lies_below_it(package):
    wrong = [
        f"{name} imports {other}"
        for name, path in modules(package).items()
        for other in sorted(imported(name, path, EVERY, lazily=True))
        if other.split(".")[0] not in MAY[package] | {package}
    ]
    assert not wrong


# inside the player, from the lowest; the commands stand above all
ORDER = ("gl", "draw face pose", "effects", "scene", "budget", "film web live", "window")
RANK = {name: rank for rank, names in enumerate(ORDER) for name in names.split()}


def test_the_player_imports_one_way():
    """What stands at the top of a module: gl <- draw <- effects <- scene <- budget <- film, web, live <- window."""

    def rank(name: str) -> int:
        return RANK.get(name.split(".")[1], 7) if name.count(".") > 1 else 7

    wrong = [
        f"{name} imports {other}"
        for name, path in modules("player").items()
        for other in sorted(imported(name, path, EVERY, lazily=False))
        if other.startswith("player.") and rank(other) > rank(name)
    ]
    assert not wrong


def test_no_circle_leaves_its_folder():
    graph = {name: imported(name, path, EVERY, lazily=False) for name, path in EVERY.items()}
    folder = {name: path.parent for name, path in EVERY.items()}
    reached: dict[str, set[str]] = {}
    for start in graph:
        seen, todo = set(), list(graph[start])
        while todo:
            name = todo.pop()
            if name not in seen:
                seen.add(name)
                todo += graph[name]
        reached[start] = seen
    wrong = [(a, b) for a in graph for b in reached[a] if a < b and a in reached[b] and folder[a] != folder[b]]
    assert not wrong


@pytest.mark.parametrize(("function", "places"), [("av.open", ["files.input_file", "capture.raw.webcam"]),
                                                  ("Image.open", ["files.picture"]), ("np.load", [])])  # fmt: skip
def test_what_decodes_files_of_others_is_called_in_one_place_only(function, places):
    """Where they are checked first; of films, where they are read. A webcam is no file."""
    found = []
    for name, path in (EVERY | modules("selfscan")).items():
        for node in ast.walk(ast.parse(path.read_text())) if not name.startswith("experiments") else ():
            if isinstance(node, ast.Call) and ast.unparse(node.func).removeprefix("PIL.") == function:
                writes = len(node.args) > 1 and ast.unparse(node.args[1]) == "'w'"
                found += [] if writes else [name]
    assert found == places


LOAD = """
import importlib, json, sys
for name in sys.argv[1:]:
    importlib.import_module(name)
print(json.dumps(sorted({name.split(".")[0] for name in sys.modules})))
"""


@pytest.mark.parametrize("package", ["files", "command", "avatar", "geometry", "capture", "player", "synth", "train"])
def test_a_package_loads_neither_what_lies_above_it_nor_what_its_install_lacks(package):
    """Every module of it, in a fresh process; without learning no torch either."""
    names = [name for name in modules(package) if not name.endswith("__main__")]
    ran = subprocess.run([sys.executable, "-c", LOAD, *names], capture_output=True, text=True, cwd=ROOT)
    assert ran.returncode == 0, ran.stderr
    loaded = set(json.loads(ran.stdout))
    forbidden = {"experiments", *MAY} - MAY[package] - {package}
    forbidden |= {"moderngl", "glfw"} if package == "train" else {"torch"}
    if package in ("files", "command", "avatar", "player"):
        forbidden |= {"scipy", "trimesh", "skimage"}
    if package == "avatar":
        forbidden |= {"moderngl", "av"}
    assert not loaded & forbidden


READ = """
import sys
from pathlib import Path
import torch
import bake.bake
from train.preset import PRESETS
from train.run import read_run
read_run(Path(sys.argv[1]))
for name in ("demo", "fast", "preview"):
    with torch.device("meta"):
        PRESETS[name].parts[1].networks.build(3, torch.ones(3, device="cpu"), 0.01)
print(" ".join(sys.modules))
"""


@pytest.mark.slow
def test_a_run_is_read_and_baked_without_what_torch_compiles_with(tiny_run):
    """Its import takes seconds, and its LLVM crashes a process that Mesa's was loaded into first."""
    out = subprocess.run([sys.executable, "-c", READ, str(tiny_run)], capture_output=True, text=True, check=True).stdout
    loaded = set(out.split())
    assert "torch" in loaded and not loaded & {"sympy", "triton", "torch._dynamo"}


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


@pytest.mark.parametrize("measured", [np.zeros(0), np.zeros((0, 3)), [], np.nan, [0.0, np.nan], 2.0, -2.0])
def test_nothing_a_nan_and_what_is_too_large_are_within_no_bound(within, measured):
    with pytest.raises(AssertionError, match=r"nothing was measured|exceeds the bound"):
        within(measured, 1.0)


@pytest.mark.parametrize("measured", [0.0, -1.0, [[0.5, -1.0]], 1])
def test_the_largest_absolute_value_is_within_its_bound(within, measured):
    within(measured, 1.0)
