"""What every peer's script does: reads the body, draws when told, answers with times. Runs in the peer's own venv.

    python draw_NAME.py BODY.npz default|lightest

default: the library as it comes, but without shadows and floors: its own antialiasing, and normals computed by it
from the vertices of each frame. lightest: normals given beforehand, antialiasing off where it can be.

Lines of JSON on standard input and output: {"draw": 5} answers {"wall_ms": [5 numbers], "cpu_ms": [...]};
{"picture": "x.npy"} writes the last picture; {"quit": 1} ends. The first line out says what draws.
"""

import json
import os
import sys
import time

import numpy as np


class Body:
    """The animated grey body: posed vertices and normals of each frame, one camera (OpenCV convention)."""

    def __init__(self, path):
        with np.load(path) as data:
            self.vertices = data["vertices"]  # (frames, v, 3) float32, world metres
            self.normals = data["normals"]  # (frames, v, 3) float32, unit
            self.faces = data["faces"]  # (f, 3) int32
            self.K = data["K"]
            self.camera_from_world = data["camera_from_world"]
            self.width, self.height = (int(n) for n in data["size"])
        self.eye = -self.camera_from_world[:3, :3].T @ self.camera_from_world[:3, 3]
        self.forward = self.camera_from_world[2, :3]
        self.fov_y = 2 * np.arctan(0.5 * self.height / self.K[1, 1])
        self.world_from_view = np.linalg.inv(np.diag([1.0, -1, -1, 1]) @ self.camera_from_world)


def serve(make):
    """make(body, lightest) -> (draw(number) -> picture (h, w, 3 or 4), facts: dict)."""
    answers = os.fdopen(os.dup(1), "w")
    # what libraries print is not an answer
    os.dup2(2, 1)

    def answer(content):
        answers.write(json.dumps(content) + "\n")
        answers.flush()

    body = Body(sys.argv[1])
    start = time.perf_counter()
    draw, facts = make(body, sys.argv[2] == "lightest")
    picture, number = np.asarray(draw(0)), 0
    answer({**facts, "first_frame_s": time.perf_counter() - start, "size": list(picture.shape[1::-1])})
    for line in sys.stdin:
        request = json.loads(line)
        if "draw" in request:
            wall, cpu = [], []
            for _ in range(request["draw"]):
                number = (number + 1) % len(body.vertices)
                t, c = time.perf_counter(), time.process_time()
                picture = np.asarray(draw(number))
                cpu.append(1e3 * (time.process_time() - c))
                wall.append(1e3 * (time.perf_counter() - t))
            answer({"wall_ms": wall, "cpu_ms": cpu})
        elif "picture" in request:
            np.save(request["picture"], picture[..., :3])
            answer({"written": request["picture"]})
        else:
            break
    answers.flush()
    # some libraries crash on their way out
    os._exit(0)


GREY = (0.6, 0.6, 0.6)
