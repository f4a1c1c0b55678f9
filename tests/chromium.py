"""three.js in headless Chromium: draws an avatar file in given poses, as anyone's web page would.

Chromium is SELFSCAN_CHROMIUM, else one of the usual names on the path; it draws with its own software rasteriser.
The page and three.js are served on 127.0.0.1; the page posts its pixels back.
"""

import contextlib
import json
import os
import queue
import shutil
import signal
import subprocess
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest

from avatar.camera import Camera, clip_from_view, view_from_world
from avatar.face import eye_turn
from avatar.gltf.face import EYE_JOINTS
from avatar.gltf.humanoid import vrm_names
from avatar.rotation import quaternion_from_axis_angle, quaternion_from_matrix
from avatar.skeleton import JOINTS
from player.draw.drawing import GivenPose

NAMES = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
KINDS = {".html": "text/html", ".js": "text/javascript", ".json": "application/json"}
PAGE = Path(__file__).parent / "interchange" / "three_frame.html"


def chromium() -> str:
    """The program; the test is skipped where there is none."""
    named = os.environ.get("SELFSCAN_CHROMIUM")
    found = next(filter(None, map(shutil.which, [named] if named else NAMES)), None)
    if found is None:
        pytest.skip("no Chromium: `apt install chromium-headless-shell`, or its path in SELFSCAN_CHROMIUM")
    return found


@contextmanager
def running(profile: Path, *words: str) -> Iterator[tuple[subprocess.Popen, Path]]:
    """A browser of its own at what `words` name, and its log; `profile` is an empty folder for its files."""
    command = [chromium(), "--headless", "--no-sandbox", "--disable-dev-shm-usage", "--mute-audio", "--no-first-run",
               "--use-angle=swiftshader", "--use-gl=angle", "--enable-unsafe-swiftshader", "--disable-extensions",
               "--remote-debugging-port=0", f"--user-data-dir={profile}", *words]  # fmt: skip
    path = profile / "stderr.txt"
    with open(path, "w") as log:
        # a session of its own: on Debian the program is a script, and ending that alone leaves the browser
        browser = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=log, start_new_session=True)
        try:
            yield browser, path
        finally:
            with contextlib.suppress(ProcessLookupError):  # it ended by itself
                os.killpg(browser.pid, signal.SIGKILL)
            browser.wait()


class _Handler(BaseHTTPRequestHandler):
    """Serves a few files, and puts what is posted into a queue."""

    def __init__(self, files: dict[str, Path | bytes], posted: queue.Queue, *arguments):
        self.files, self.posted = files, posted
        super().__init__(*arguments)

    def do_GET(self):
        path = self.path.split("?")[0]
        prefix = next((p for p in sorted(self.files, key=len)[::-1] if path.startswith(p)), None)
        content = self.files.get(prefix, b"") if prefix else None
        if isinstance(content, Path):
            place = (content / path[len(prefix or "") :].lstrip("/")).resolve() if content.is_dir() else content
            content = place.read_bytes() if place.is_file() and place.is_relative_to(content.resolve()) else None
        self.send_response(404 if content is None else 200)
        self.send_header("Content-Type", KINDS.get(Path(path).suffix, "application/octet-stream"))
        self.send_header("Content-Length", str(len(content or b"")))
        self.end_headers()
        self.wfile.write(content or b"")

    def do_POST(self):
        self.posted.put((self.path, self.rfile.read(int(self.headers["Content-Length"]))))
        self.send_response(204)
        self.end_headers()

    def log_message(self, format, *arguments):
        pass


def _faced(pose: GivenPose) -> bool:
    return len(pose) > 2 and pose[2] is not None


def _eyes(pose: GivenPose) -> dict[str, list[float]]:
    """Rotations of the eyes' joints."""
    turns = [quaternion_from_matrix(eye_turn(*gaze)).tolist() for gaze in pose[2].gaze] if _faced(pose) else []
    return dict(zip(EYE_JOINTS, turns))


def three_frames(
    avatar: Path,
    poses: Sequence[GivenPose],
    camera: Camera,
    modules: Path,
    profile: Path,
    background: str = "#000000",
    vrm: Sequence[dict] | None = None,
) -> list[np.ndarray]:
    """Frames (H, W, 3) of the avatar file by three.js, row 0 on top; faces as in poses that have one.

    vrm: the file is one, and three-vrm moves it: `expressions` and `look` (yaw, pitch, degrees) of each pose.
    `modules` is a folder with node_modules/three, `profile` an empty folder for the browser's own files.
    """
    width, height = camera.size
    names = JOINTS if vrm is None else [vrm_names(1)[joint] for joint in JOINTS]
    setup = {
        "vrm": vrm,
        "size": [width, height],
        "view_from_world": view_from_world(camera).tolist(),
        "clip_from_view": clip_from_view(camera, 0.05, 50.0).tolist(),
        "background": background,
        "rotations": [
            dict(zip(names, quaternion_from_axis_angle(pose[0]).tolist(), strict=True)) | _eyes(pose) for pose in poses
        ],
        "weights": [pose[2].weights.tolist() if _faced(pose) else None for pose in poses],
        "places": [pose[1].tolist() for pose in poses],
    }
    files: dict[str, Path | bytes] = {
        "/page.html": PAGE,
        "/setup.json": json.dumps(setup).encode(),
        "/avatar.glb": avatar,
        "/three-vrm.js": modules / "node_modules" / "@pixiv" / "three-vrm" / "lib" / "three-vrm.module.js",
        "/three/": modules / "node_modules" / "three",
    }
    posted: queue.Queue = queue.Queue()
    frames: dict[int, np.ndarray] = {}
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(_Handler, files, posted)) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        try:
            with running(profile, f"http://127.0.0.1:{server.server_address[1]}/page.html") as (browser, log):
                while len(frames) < len(poses):
                    try:
                        path, body = posted.get(timeout=1)
                    except queue.Empty:
                        assert browser.poll() is None, f"Chromium ended: {log.read_text()[-2000:]}"
                        continue
                    assert path != "/failed", body.decode()
                    pixels = np.frombuffer(body, np.uint8).reshape(height, width, 4)
                    frames[int(path.rsplit("/", 1)[1])] = pixels[::-1, :, :3].copy()
        finally:
            server.shutdown()
    return [frames[k] for k in range(len(poses))]
