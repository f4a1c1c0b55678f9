"""Joints that the person clicks, where there is no detector: pictures of the body's film on a page in the browser.

Twelve joints, and the nose, without which limbs seen from before and from behind are the same. The page is served on
127.0.0.1 alone, under a name that cannot be guessed. What was clicked is written as MMPose does, in Halpe's order. Of
all other frames only the ankles are written, between where they were clicked: enough to know that a person is there,
too little to be fitted. Each click is kept as it comes: who stops and begins again goes on with the next joint.
"""

import io
import json
import secrets
from collections.abc import Callable, Mapping
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array
from PIL import Image

from capture.keypoints.orders import HALPE_26
from capture.keypoints.record import SIDES, number
from capture.raw.glance import SMALL
from capture.raw.judge import FEWEST_CLEAR
from capture.raw.video_file import VideoFile, read_frames
from command.errors import AssetError
from files.input_file import Json, parse_json, read_bytes
from files.whole import whole_file, write_json

LIMBS = (("shoulder", "elbow", "wrist"), ("hip", "knee", "ankle"))
POINTS = (*(f"{side}_{name}" for limb in LIMBS for side in SIDES for name in limb), "nose")
# the first and the last may be of stepping in and out
PICTURES = 10
# grey levels, and share of the picture, by which a person who steps in changes it
CHANGE, SHARE = 25, 0.01
# share of the clicked points that differ from the film's first frame, where that one is of the empty room
OFF_ROOM = 0.7
# confidence of an ankle between clicked frames
ANKLE = 0.5
MOST_BYTES = 1 << 20
Clicked = dict[int, Float[Array, "13 3"]]


def click_joints(video: VideoFile, out: Path, say: Callable[[str], None] = print) -> None:
    """Let the person click, and write the keypoints of the film to `out`. `say` gets the page's address.

    Raises:
        AssetError: the film cannot be read.
    """
    changes = _changes(video)
    first, count = int((changes > SHARE).argmax()), len(changes)
    numbers = np.linspace(first, count - 1, 2 * PICTURES + 1)[1::2].astype(int).tolist()
    pictures = {frame.number: frame.picture for frame in read_frames(video, only=frozenset([0, *numbers]))}
    room = pictures[0].astype(np.int16)
    draft = out.with_suffix(".clicks")
    clicked = answered({k: pictures[k] for k in numbers}, say, draft)
    off = [np.abs(pictures[k][int(y), int(x)] - room[int(y), int(x)]).max() > CHANGE
           for k, rows in clicked.items() for x, y, seen in rows if seen]  # fmt: skip
    write_clicked(out, clicked, count, first if off and np.mean(off) > OFF_ROOM else 0)
    draft.unlink(missing_ok=True)


def _changes(video: VideoFile) -> Float[Array, "frames"]:
    """The share of each frame that differs from the first one, a change of the exposure allowed for."""
    out, room = [], None
    for frame in read_frames(video, SMALL, grey=True):
        grey = frame.picture.astype(np.float32)
        room = grey if room is None else room
        out.append(float((np.abs(grey - room - np.median(grey - room)) > CHANGE).mean()))
    return np.array(out)


def answered(
    pictures: Mapping[int, UInt8[Array, "height width 3"]], say: Callable[[str], None], draft: Path
) -> Clicked:
    """Serve the page until its answer comes: x, y and whether it is seen of each of POINTS, by picture.

    What was done so far is kept in the file `draft`, and the page begins with it.
    """
    place, found = f"/{secrets.token_urlsafe(16)}/", {}
    page = (files("capture.raw") / "click.html").read_text("utf-8")
    begun = _read_log(read_bytes(draft, "clicks", most=MOST_BYTES), str(draft)) if draft.exists() else []
    facts = json.dumps({"pictures": sorted(pictures), "points": POINTS, "fewest": FEWEST_CLEAR, "log": begun})
    content = {place: ("text/html; charset=utf-8", page.replace("@FACTS@", facts).encode())}
    content |= {f"{place}{k}.jpg": ("image/jpeg", _jpeg(picture)) for k, picture in pictures.items()}

    class Page(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send(200, *content[self.path]) if self.path in content else self.send(404, "text/plain", b"")

        def do_POST(self) -> None:
            length = self.headers.get("Content-Length", "")
            sent = {f"{place}points", f"{place}log"}
            if self.path not in sent or not (length.isdecimal() and int(length) <= MOST_BYTES):
                return self.send(404, "text/plain", b"")
            data = self.rfile.read(int(length))
            try:
                if self.path == f"{place}log":
                    write_json(draft, _read_log(data, "clicks"))
                    return self.send(200, "text/plain", b"")
                found.update(_read_answer(data, pictures))
            except AssetError as error:
                return self.send(400, "text/plain; charset=utf-8", str(error).encode())
            self.send(200, "text/plain", b"")
            self.server.shutdown()

        def send(self, code: int, kind: str, body: bytes) -> None:
            self.send_response(code)
            self.send_header("Content-Type", kind)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *_line: object) -> None:
            """Nothing is printed for a request."""

    with ThreadingHTTPServer(("127.0.0.1", 0), Page) as server:
        say(f"http://127.0.0.1:{server.server_port}{place}")
        server.serve_forever(0.1)
    return found


def _jpeg(picture: UInt8[Array, "height width 3"]) -> bytes:
    file = io.BytesIO()
    Image.fromarray(picture).save(file, "JPEG", quality=92)
    return file.getvalue()


def _read_log(data: bytes, place: str) -> list[Json]:
    """What was done on the page, in order: [x, y], "hidden" or "pass"; AssetError where it is something else."""
    log = parse_json(data, place, "what was clicked")
    if not isinstance(log, list) or len(log) > PICTURES * (len(POINTS) + 1):
        raise AssetError(f"{place}: expected a list of at most {PICTURES * (len(POINTS) + 1)} clicks")
    for entry in log:
        if entry in ("hidden", "pass"):
            continue
        if not isinstance(entry, list) or len(entry) != 2:
            raise AssetError(f"{place}: expected [x, y], hidden or pass, found {str(entry)[:40]!r}")
        for value in entry:
            number(place, value)
    return log


def _read_answer(data: bytes, pictures: Mapping[int, Array]) -> Clicked:
    """What the page sends: by picture [x, y] or null of each of POINTS; AssetError where it is not, or of too few."""
    place, out = "clicked joints", {}
    answer = parse_json(data, place, "places by picture")
    names = {str(k): k for k in pictures}
    if not isinstance(answer, dict) or not set(answer) <= set(names) or len(answer) < FEWEST_CLEAR:
        raise AssetError(f"{place}: expected {FEWEST_CLEAR} or more of the pictures {', '.join(names)}")
    for name, points in answer.items():
        if not isinstance(points, list) or len(points) != len(POINTS):
            raise AssetError(f"{place}: picture {name}: expected {len(POINTS)} places")
        rows = out[names[name]] = np.zeros((len(POINTS), 3))
        for k, point in enumerate(points):
            if point is None:
                continue
            if not isinstance(point, list) or len(point) != 2:
                raise AssetError(f"{place}: picture {name}: {POINTS[k]} should be [x, y] or null, is {str(point)[:40]}")
            height, width = pictures[names[name]].shape[:2]
            most = np.nextafter([width, height], 0)
            rows[k] = *np.clip([number(f"{place}: picture {name}", v) for v in point], 0, most), 1
    return out


def write_clicked(out: Path, clicked: Clicked, count: int, first: int) -> None:
    """Keypoints of `count` frames, in which a person is from the frame `first` on."""
    rows, numbers = np.zeros((count, len(HALPE_26), 3)), np.array(sorted(clicked))
    rows[numbers[:, None], [HALPE_26.index(name) for name in POINTS]] = [clicked[k] for k in numbers]
    others = np.setdiff1d(np.arange(first, count), numbers)
    for ankle in (HALPE_26.index(f"{side}_ankle") for side in SIDES):
        known = numbers[rows[numbers, ankle, 2] > 0]
        if len(known):
            for axis in range(2):
                rows[others, ankle, axis] = np.interp(others, known, rows[known, ankle, axis])
            rows[others, ankle, 2] = ANKLE
    # MMPose counts pixels from the middle of the first one
    rows[..., :2] -= 0.5
    people = [
        [{"keypoints": row[:, :2].round(2).tolist(), "keypoint_scores": row[:, 2].tolist()}] if row[:, 2].any() else []
        for row in rows
    ]
    infos = [{"frame_id": k, "instances": found} for k, found in enumerate(people)]
    with whole_file(out, "w") as file:
        json.dump({"instance_info": infos}, file)
