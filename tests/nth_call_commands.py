"""What is tried by nth_call.py: commands that write, at tiny sizes, and parts of `selfscan play` without its window."""

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np

from command.errors import AssetError
from files.whole import whole_file, whole_folder

BODY = ["player.film.command", "player.film.render", "av"]


def rendered(out: str, old: str, new: str, *more: str) -> dict:
    """`selfscan render`: other frames of one motion."""
    shared = ["render", "builtin", "--motion", "counting", "--size", "32x32", "-o", "{}/" + out, *more]
    return {"modules": BODY, "old": [*shared, *old.split()], "new": [*shared, *new.split()], "out": out}


def exported(out: str) -> dict:
    """`selfscan export`: two motions."""
    both = [["export", "builtin", "--motion", motion, "-o", "{}/" + out] for motion in ("counting", "walking")]
    return {"modules": ["player.export_command"], "old": both[0], "new": both[1], "out": out}


def called(name: str, out: str, modules: list[str]) -> dict:
    """A function below, told which of the two it is to write."""
    return {"modules": modules, "old": ["old"], "new": ["new"], "out": out, "call": f"nth_call_commands:{name}"}


def keep_file(folder: Path, arguments: list[str]) -> int:
    return said(lambda: _write(folder / "a.bin", arguments[0]))


def _write(path: Path, text: str) -> None:
    with whole_file(path) as file:
        file.write(text.encode() * 9000)


def keep_folder(folder: Path, arguments: list[str]) -> int:
    def write() -> None:
        with whole_folder(folder / "frames") as made:
            (made / "inner").mkdir()
            for name in "ab"[: len(arguments[0]) - 1]:
                (made / "inner" / name).write_text(arguments[0])

    return said(write)


def keep_pose(folder: Path, arguments: list[str]) -> int:
    """A pose of one's own, in place of another."""
    from player.pose.history import KeptPose
    from player.pose.library import Library

    pose = KeptPose(np.full((52, 3), 0.1 * len(arguments[0])) + (arguments[0] == "new"), np.zeros(3))
    return said(lambda: Library(folder / "poses").write("mine", pose))


def record_take(folder: Path, arguments: list[str]) -> int:
    """Some frames of a live source, recorded to the end."""
    from player.draw.drawing import Pose
    from player.live.take import Take

    def record() -> None:
        take = Take(folder / "take.npz")
        for number in range(6):
            pose = Pose(np.full((52, 3), 0.01 * number + (arguments[0] == "new")), np.zeros(3))
            take.add(number / 30, pose)
        print("\n".join(take.finish()))
        if take.stopped:
            raise AssetError(f"{take.path}: stopped: {take.stopped}")

    return said(record)


def shorter_take(path: Path) -> bool:
    """Whether it is the beginning of one: a disk that is full stops a take, and what was recorded is kept."""
    from avatar.motion.read import read_motion

    motion = read_motion(path)
    poses = motion.read(0, motion.frames).axis_angle[:, 0, 0]
    return motion.frames < 6 and bool(np.abs(np.diff(poses) - 0.01).max(initial=0) < 1e-6)


def whole_avatar(path: Path) -> bool:
    """Whether it is an avatar file, all of it: what it says of its making may have changed."""
    from avatar.baked_avatar import check_avatar
    from avatar.gltf.avatar_file import read_avatar

    check_avatar(read_avatar(path))
    return True


def whole_capture(path: Path) -> bool:
    """Whether all of a capture is there."""
    from capture.folder import read_capture

    return bool(read_capture(path).videos)


def whole_run(path: Path) -> bool:
    """Whether all of a run is there."""
    from train.run import read_run

    return len(read_run(path).surface.vertices) > 0


def keep_checkpoint(folder: Path, arguments: list[str]) -> int:
    """A checkpoint of a training, over an earlier one."""
    import torch

    from train.trainer import Position, save_checkpoint

    def write() -> None:
        torch.manual_seed(arguments[0] == "new")
        field = torch.nn.Linear(3, 2)
        adam = torch.optim.Adam(field.parameters())
        save_checkpoint(folder / "body.ckpt", field, adam, torch.Generator(), Position())

    return said(write)


def train_tiny(folder: Path, arguments: list[str]) -> int:
    """`selfscan train --resume` by the preset of tiny.py, in this process."""
    from tiny import TINY, tiny_training

    from selfscan.__main__ import main

    capture, seed = arguments
    codes = []
    with suppress(AssertionError):
        tiny_training(Path(capture), folder / "run", "--seed", seed, "--resume", preset=TINY,
                      command=lambda words: codes.append(main(["train", *words])) or codes[0])  # fmt: skip
    return codes[0]


def said(act: Callable[[], object]) -> int:
    """The exit code of an act, as `selfscan` has it; this process does nothing else."""
    import selfscan.__main__ as command

    def dispatch(name: str, rest: list[str]) -> int:
        act()
        return 0

    command._dispatch = dispatch
    return command._run(["play"])


COMMANDS = {
    "a file": called("keep_file", "a.bin", []),
    "a folder": called("keep_folder", "frames", []),
    "pose library": called("keep_pose", "poses/mine.npz", ["player.pose.library"]),
}
SLOW = {
    "play's take": called("record_take", "take.npz", ["player.live.take"]) | {"also": "shorter_take"},
    "a checkpoint": called("keep_checkpoint", "body.ckpt", ["torch._dynamo", "train.trainer"]),
    "export to AMASS": exported("out.npz"),
    "export to BVH": exported("out.bvh"),
    "render to a picture": rendered("out.png", "--frame 0", "--frame 9"),
    "render to frames": rendered("out", "--frames 0:3", "--frames 9:11"),
    "render to a film": rendered("out.mp4", "--frames 0:3", "--frames 9:11"),
    "render --resume": rendered("out.mp4", "--frames 0:3", "--frames 9:11", "--resume"),
    "web": {
        "modules": ["player.web_command"], "old": ["web", "mannequin", "-o", "{}/out.html"],
        "new": ["web", "mannequin:female", "-o", "{}/out.html"], "out": "out.html",
    },
}  # fmt: skip
# {authors}: two people in the authors' folders, and a body model
IMPORT = {
    "modules": ["capture.read.totalselfscan"], "most": 12, "also": "whole_capture", "out": "out",
    "old": ["import", "totalselfscan", "{authors}/male-old", "{}/out", "--body", "{authors}/model.npz"],
    "new": ["import", "totalselfscan", "{authors}/male-new", "{}/out", "--body", "{authors}/model.npz"],
}  # fmt: skip
# half a minute each, tried by night (experiments/nth_calls.py), where {capture} and {run} are made
LONG = {
    "synth": {
        "modules": ["synth.command"], "most": 3, "also": "whole_capture", "out": "out",
        "old": ["synth", "builtin", "{}/out", "--size", "32", "--frames", "4", "--no-truth"],
        "new": ["synth", "builtin", "{}/out", "--size", "32", "--frames", "5", "--no-truth"],
    },
    "train --resume": {
        "modules": ["train.command", "tiny"], "most": 3, "also": "whole_run", "out": "run",
        "old": ["{capture}", "1"], "new": ["{capture}", "2"], "call": "nth_call_commands:train_tiny",
    },
    "bake": {
        "modules": ["bake.command"], "most": 6, "also": "whole_avatar", "out": "out.glb",
        "old": ["bake", "{run}", "-o", "{}/out.glb", "--faces", "1500", "--texture", "128"],
        "new": ["bake", "{run}", "-o", "{}/out.glb", "--faces", "1200", "--texture", "128"],
    },
}  # fmt: skip
