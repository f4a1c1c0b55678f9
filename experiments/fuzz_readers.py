"""What is fuzzed (experiments/fuzz.py): each reader of the tests' table, of run and capture folders, of senders.

The table is that of tests/hard_cases/test_hostile_bytes.py, FORMATS: a kind of file has one honest example there, and
what reads it. A run and a capture are folders: one file of them is spoilt, the others are honest. Where it is imported,
the folders of tests that it names are on the path (experiments/fuzz.py).
"""

import os
import shutil
from collections.abc import Callable
from functools import cache
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from tempfile import mkdtemp

import numpy as np
import torch._dynamo
from painted_capture import free_subject, write_capture
from test_face_senders import ifacialmocap, livelinkface, openseeface, vmc
from test_hostile_bytes import FORMATS, Format, written
from tiny import TINY

import avatar.motion
import capture.folder
import capture.keypoints
from avatar.body import builtin_body
from avatar.skeleton import JOINTS
from files.picture import read_picture
from player.draw.drawing import Pose
from player.live.command import encoder
from player.live.inbox import DECODERS, Inbox
from player.pose.library import KeptPose, Library, read_pose
from train.run import build_field, read_facts, read_part, write_json, write_part
from train.template_grid import TemplateGrid
from train.trainer import Position, load_checkpoint, save_checkpoint

# readers are imported when they are needed, which is too late for those who count their edges
for package in (avatar.motion, capture.keypoints):
    for module in iter_modules(package.__path__):
        import_module(f"{package.__name__}.{module.name}")

# one of each: others differ by a few bytes
LEFT_OUT = {"pickle 1", "pickle 3", "pickle 4", "deflated npz", "arrays"}
SUBJECT = free_subject("male")


def _field():
    torch.manual_seed(0)
    return build_field(SUBJECT, 0, TINY.parts[0], TemplateGrid(torch.zeros(2, 2, 2), torch.zeros(3), 0.1), 3)


def _training() -> tuple:
    made = _field()
    return made, torch.optim.Adam(made.parameters()), torch.Generator().manual_seed(3), Position()


@cache
def _capture_folder() -> Path:
    folder = Path(mkdtemp(prefix="fuzz-capture-")) / "capture"
    write_capture(folder)
    capture.folder.read_subject = lambda *_, **__: SUBJECT
    return folder


def _capture(place: str, part: str = "body") -> tuple[Callable[[Path], bytes], Callable[[Path], object]]:
    """A capture of which one file is spoilt: an honest one, and how the folder with another in its place is read."""

    def read(path: Path) -> None:
        shutil.copyfile(path, _capture_folder() / place)
        capture.folder.read_capture(_capture_folder(), parts=(part,))

    return lambda _: (_capture_folder() / place).read_bytes(), read


def _sent(kind: str) -> Format:
    """A datagram or message of a protocol; what was shown stays finite, nothing is raised."""

    def read(path: Path) -> None:
        inbox, data = Inbox(kind), path.read_bytes()
        inbox.feed(data.decode("utf-8", "replace") if kind == "ws" else data, 0.1)
        shown = inbox.sample()
        assert shown is None or np.isfinite(shown[1].axis_angle).all()
        assert shown is None or shown[1].face is None or np.isfinite(shown[1].face.weights).all()

    made = {"ifacialmocap": ifacialmocap, "livelinkface": livelinkface, "openseeface": openseeface}
    pose = Pose(np.full((len(JOINTS), 3), 0.1), np.zeros(3))
    whole = made.get(kind) or (lambda: encoder("vmc" if kind == "vmc" else "udp", builtin_body("male"))(1, 0.5, pose))
    return Format("packet", lambda _: whole(), read, text=kind in ("udp", "ws", "ifacialmocap"))


def _kept_pose(folder: Path) -> bytes:
    return Library(folder).write("mine", KeptPose(np.full((52, 3), 0.1), np.zeros(3))).read_bytes()


MORE = {
    "run.json": Format("run.json", written(lambda p: write_json(p, {"seconds": 12.5, "rows": [1, 2.5]})),
                       lambda p: read_facts(p.parent), text=True),
    "trained part": Format("body.pt", written(lambda p: write_part(p, _field())),
                           lambda p: read_part(p, SUBJECT, 0, TINY.parts[0])),
    "checkpoint": Format("body.ckpt", written(lambda p: save_checkpoint(p, *_training())),
                         lambda p: load_checkpoint(p, *_training())),
    "capture.json": Format("capture.json", *_capture("capture.json"), text=True),
    "cameras of a capture": Format("cameras.npz", *_capture("body/cameras.npz")),
    "poses of a capture": Format("poses.npz", *_capture("body/poses.npz")),
    "head of a capture": Format("landmarks.json", *_capture("head/landmarks.json", "head"), text=True),
    # a size that differs from the first is said of the later
    "mask": Format("000003.png", *_capture("body/masks/000003.png")),
    "kept pose": Format("mine.npz", _kept_pose, read_pose),
    "grey picture": Format("a.png", FORMATS["PNG"].whole, lambda p: read_picture(p, "L")),
    **{f"sent by {kind}": _sent(kind) for kind in DECODERS},
    "blend of VMC": _sent("vmc")._replace(whole=lambda _: vmc()),
}  # fmt: skip
READERS: dict[str, Format] = {name: kind for name, kind in FORMATS.items() if name not in LEFT_OUT} | MORE


def names_like(words: list[str]) -> list[str]:
    """Readers whose name holds a word; all without any."""
    found = [name for name in READERS if not words or any(word.lower() in name.lower() for word in words)]
    if not found:
        raise SystemExit(f"no reader {' '.join(words)!r}; there are {', '.join(READERS)}")
    return found


def honest(name: str) -> bytes:
    """A whole file of a reader."""
    folder = Path(mkdtemp(prefix="fuzz-honest-"))
    try:
        return READERS[name].whole(folder)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def scratch() -> Path:
    """A folder in memory, where the system has one."""
    return Path(mkdtemp(prefix="fuzz-", dir="/dev/shm" if os.access("/dev/shm", os.W_OK) else None))
