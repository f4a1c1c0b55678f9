"""Node and its packages for tests of other people's programs.

SELFSCAN_GLTF_VALIDATOR names the folder that `npm install --prefix FOLDER gltf-validator three @pixiv/three-vrm`
filled; else the repository's root is looked into.
"""

import json
import os
import shutil
import subprocess
from pathlib import Path

import pytest

TESTS = Path(__file__).parent


def package_folder(package: str) -> Path:
    """The folder whose node_modules holds the package; the test is skipped where it or Node is missing."""
    for place in (os.environ.get("SELFSCAN_GLTF_VALIDATOR"), TESTS.parent):
        if place and (Path(place) / "node_modules" / package).is_dir() and shutil.which("node"):
            return Path(place)
    pytest.skip(f"no Node with {package}: `npm install {package}`, its folder in SELFSCAN_GLTF_VALIDATOR")


def run_node(script: str, *arguments: object) -> dict:
    """What a script of tests/ prints, as JSON."""
    command = ["node", str(TESTS / script), *(str(a) for a in arguments)]
    run = subprocess.run(command, capture_output=True, text=True)
    assert run.returncode == 0, run.stderr[-4000:]
    return json.loads(run.stdout)
