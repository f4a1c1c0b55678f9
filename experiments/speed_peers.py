"""Other players draw the same body, in turns with ours: each in an environment and a process of its own."""

import json
import os
import select
import subprocess
import sys
import venv
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from avatar.baked_avatar import Avatar
from avatar.camera import Camera
from command.errors import AssetError
from experiments.alternating import Turn
from experiments.bare_draw import posed_vertices
from player.draw.drawing import BarePose

SCRIPTS = Path(__file__).parent / "peers"
PACKAGES = {
    # 6.4 GB: it brings torch with CUDA
    "aitviewer": ["aitviewer==1.14.2"],
    "pyrender": ["pyrender==0.1.45"],
    "pyvista": ["pyvista==0.49.1"],
    "open3d": ["open3d==0.19.0"],
}
NEEDS_X = ("aitviewer",)
PATIENCE = 120  # seconds for an answer
# of 255; a brighter pixel is one the body covers
THRESHOLD = 8
# by which a peer's coverage may differ from ours
ALIKE = 0.15


@dataclass
class Peer:
    """A running peer. `turn` has it draw some frames, as experiments.alternating.here has ours."""

    name: str
    process: subprocess.Popen[str]
    facts: dict[str, Any] = field(default_factory=dict)

    def ask(self, request: dict[str, Any]) -> dict[str, Any]:
        assert self.process.stdin is not None and self.process.stdout is not None
        # it has died: the read below says so
        with suppress(BrokenPipeError):
            self.process.stdin.write(json.dumps(request) + "\n")
            self.process.stdin.flush()
        return self.answer()

    def answer(self) -> dict[str, Any]:
        assert self.process.stdout is not None
        waiting, _, _ = select.select([self.process.stdout], [], [], PATIENCE)
        if not waiting:
            raise AssetError(f"{self.name}: no answer for {PATIENCE} s")
        line = self.process.stdout.readline()
        if not line:
            raise AssetError(f"{self.name}: ended with {self.process.wait()} instead of drawing")
        return json.loads(line)

    def turn(self, number: int, frames: int) -> Turn:
        answer = self.ask({"draw": frames + 1})
        return Turn(np.array(answer["wall_ms"][1:]), np.array(answer["cpu_ms"][1:]))


def environment(folder: Path, name: str) -> Path:
    """The peer's Python, installed when it is not there yet (pip's usual index)."""
    python = folder / name / "bin" / "python"
    ready = folder / name / "ready"
    if not ready.exists():
        print(f"installing {' '.join(PACKAGES[name])} into {folder / name}", flush=True)
        venv.create(folder / name, with_pip=True, clear=True)
        done = subprocess.run(
            [python, "-m", "pip", "install", "--quiet", *PACKAGES[name]], capture_output=True, text=True
        )
        if done.returncode:
            raise AssetError(f"{name}: pip install failed: {done.stderr.strip()[-300:]}")
        ready.touch()
    return python


def write_body(path: Path, avatar: Avatar, poses: Sequence[BarePose], camera: Camera) -> None:
    """What the peers draw: the finest mesh skinned beforehand in every pose, and the camera."""
    vertices, normals = zip(*(posed_vertices(avatar, pose) for pose in poses), strict=True)
    np.savez(
        path,
        vertices=np.array(vertices, np.float32),
        normals=np.array(normals, np.float32),
        faces=avatar.levels[0].faces.astype(np.int32),
        K=camera.K,
        camera_from_world=camera.camera_from_world,
        size=np.array(camera.size),
    )


@contextmanager
def x_server() -> Iterator[str]:
    """A display of our own (Xvfb) for those that cannot draw without one."""
    read, write = os.pipe()
    try:
        process = subprocess.Popen(
            ["Xvfb", "-displayfd", str(write), "-screen", "0", "1280x1024x24", "-nolisten", "tcp"],
            pass_fds=[write], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
    except FileNotFoundError:
        os.close(read)
        raise AssetError("needs an X server and Xvfb is not installed: apt-get install xvfb") from None
    finally:
        os.close(write)
    with os.fdopen(read) as told:
        number = told.readline().strip()
    try:
        if not number:
            raise AssetError("Xvfb found no free display")
        yield f":{number}"
    finally:
        process.terminate()
        process.wait()


@contextmanager
def running(folder: Path, body: Path, name: str, style: str) -> Iterator[Peer]:
    """A peer that drew its first frame. It ends with the block.

    Raises:
        AssetError: it cannot be installed, does not start or dies; with the last line it said.
    """
    python = environment(folder, name)
    surroundings = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "DISPLAY")}
    surroundings |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    said = body.parent / f"{name}-{style}.log"
    with ExitStack() as stack:
        if name in NEEDS_X:
            surroundings["DISPLAY"] = stack.enter_context(x_server())
        with open(said, "w") as log:
            process = subprocess.Popen(
                [python, SCRIPTS / f"draw_{name}.py", body, style],
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log, text=True, env=surroundings,
            )  # fmt: skip
        stack.callback(_end, process)
        peer = Peer(name, process)
        try:
            peer.facts = peer.answer()
            yield peer
        except AssetError as error:
            lines = said.read_text(errors="replace").strip().splitlines()
            raise AssetError(f"{error}; its last words: {lines[-1] if lines else 'none'}") from None


def _end(process: subprocess.Popen[str]) -> None:
    assert process.stdin is not None and process.stdout is not None
    with suppress(BrokenPipeError):
        # it ends when nothing more is asked
        process.stdin.close()
    try:
        process.wait(10)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    process.stdout.close()


def covered(peer: Peer, path: Path) -> float:
    """Share of the peer's picture that shows the body. Black is background."""
    peer.ask({"picture": str(path)})
    return float((np.load(path).max(-1) > THRESHOLD).mean())


def default_folder() -> Path:
    """Where the environments are kept between runs."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "selfscan" / f"peers-{sys.version_info.major}.{sys.version_info.minor}"
