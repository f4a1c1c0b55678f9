"""Torn, lost and misdirected writes and rotten bits in what is read back: detected, or the content is the same."""

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import torch
from painted_capture import free_subject
from tiny import TINY
from tiny_avatar import same, tiny_avatar

from avatar.gltf.avatar_file import read_avatar, write_avatar
from avatar.motion.amass import write_amass
from avatar.motion.clip import Clip
from avatar.motion.read import read_motion
from capture.folder import read_subject, write_subject
from command.errors import AssetError
from player.draw.drawing import Pose
from player.live.take import Take
from train.run import SURFACE, build_field, read_facts, read_part, read_surface, write_json, write_part
from train.template_grid import TemplateGrid
from train.trainer import Position, load_checkpoint, save_checkpoint

BLOCK, TRIES = 512, 60
SUBJECT = free_subject("male")


def torn_write(data: bytearray, rng: np.random.Generator) -> None:
    """The end of a block, or of all from there on, is zeros: the power went."""
    start = int(rng.integers(len(data)))
    stop = min(start + BLOCK, len(data)) if rng.random() < 0.5 else len(data)
    data[start:stop] = bytes(stop - start)


def lost_write(data: bytearray, rng: np.random.Generator) -> None:
    """A block is what lay there before."""
    start = int(rng.integers(0, max(len(data) // BLOCK, 1))) * BLOCK
    data[start : start + BLOCK] = rng.bytes(min(BLOCK, len(data) - start))


def misdirected_write(data: bytearray, rng: np.random.Generator) -> None:
    """A block came to another's place."""
    a, b = (int(n) * BLOCK for n in rng.integers(0, max(len(data) // BLOCK, 1), 2))
    data[a : a + BLOCK] = data[b : b + BLOCK][: len(data[a : a + BLOCK])]


def bit_rot(data: bytearray, rng: np.random.Generator) -> None:
    """A bit is another."""
    data[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))


def field(frames: int = 3):
    torch.manual_seed(0)
    return build_field(SUBJECT, 0, TINY.parts[0], TemplateGrid(torch.zeros(2, 2, 2), torch.zeros(3), 0.1), frames)


def write_checkpoint(path: Path) -> None:
    save_checkpoint(path, *_training())


def read_checkpoint(path: Path) -> object:
    made, optimiser, generator, position = _training()
    load_checkpoint(path, made, optimiser, generator, position)
    return {**made.state_dict(), "generator": generator.get_state()} | vars(position)


def _training():
    made = field()
    optimiser = torch.optim.Adam(made.parameters())
    return made, optimiser, torch.Generator().manual_seed(3), Position()


def write_mesh(path: Path) -> None:
    rows = {name: np.full((4, *columns), 0.25).astype(kind) for name, (kind, columns) in SURFACE.items()}
    np.savez(path, **rows)


def write_motion(path: Path) -> None:
    rng = np.random.default_rng(2)
    write_amass(path, Clip(rng.normal(size=(30, 52, 3)), rng.normal(size=(30, 3)), 30.0))


def frames_of(path: Path) -> object:
    motion = read_motion(path)
    clip = motion.read(0, motion.frames)
    return [clip.axis_angle, clip.root, clip.rate]


class Kept(NamedTuple):
    """A kind of file that is read back: its name, how it is written and read."""

    name: str
    write: Callable[[Path], object]
    read: Callable[[Path], object]


KEPT = {
    "checkpoint": Kept("body.ckpt", write_checkpoint, read_checkpoint),
    "trained part": Kept("body.pt", lambda path: write_part(path, field()),
                         lambda path: dict(read_part(path, SUBJECT, 0, TINY.parts[0]).state_dict())),
    "surface of a run": Kept("surface.npz", write_mesh, lambda path: vars(read_surface(path))),
    "facts of a run": Kept("run.json", lambda path: write_json(path, {"seconds": 12.5, "rows": np.eye(40).tolist()}),
                           lambda path: read_facts(path.parent)),
    "subject": Kept("subject.npz", lambda path: write_subject(path, SUBJECT), lambda path: vars(read_subject(path))),
    "take": Kept("take.npz", write_motion, frames_of),
}  # fmt: skip


def content(value: object) -> list:
    """All numbers and names of what was read, to compare by."""
    if isinstance(value, torch.Tensor):
        return content(value.numpy())
    if isinstance(value, np.ndarray):
        return [value.dtype.str, value.shape, value.tobytes()]
    if isinstance(value, (dict, list, tuple)):
        pairs = value.items() if isinstance(value, dict) else enumerate(value)
        return [[key, content(inner)] for key, inner in pairs]
    return [repr(value)]


@pytest.mark.rows
@pytest.mark.parametrize("fault", [torn_write, lost_write, misdirected_write, bit_rot])
@pytest.mark.parametrize("kind", KEPT)
def test_what_a_disk_spoilt_is_never_believed(tmp_path, within, kind, fault):
    kept, rng, path = KEPT[kind], np.random.default_rng(5), tmp_path / KEPT[kind].name
    kept.write(path)
    whole, expected = path.read_bytes(), content(kept.read(path))
    detected = believed = 0
    for _ in range(TRIES):
        data = bytearray(whole)
        fault(data, rng)
        path.write_bytes(data)
        try:
            other = content(kept.read(path)) != expected
            # a damaged name of the checksum is a run of before there was one
            believed += other and not (kind == "facts of a run" and b'"check"' not in data)
        except AssetError:
            detected += 1
    assert detected
    within(believed, 0, f"believed of {TRIES} of a {kind}")


@pytest.mark.parametrize("fault", [torn_write, lost_write, misdirected_write, bit_rot])
def test_damaged_frames_of_a_take_that_was_cut_off_are_left_out(tmp_path, fault):
    rng, poses = np.random.default_rng(1), np.random.default_rng(2).normal(0, 0.3, (12, 52, 3)).astype(np.float32)
    for number in range(20):
        folder = tmp_path / str(number)
        folder.mkdir()
        take = Take(folder / "take.npz")
        for k, pose in enumerate(poses):
            take.add(k / 30, Pose(pose.astype(float), np.zeros(3)))
        take.close()
        data = bytearray(take.recording.read_bytes())
        fault(data, rng)
        take.recording.write_bytes(data)
        try:
            again = Take(folder / "take.npz")
        except AssetError as error:
            assert "expected what is left of a take" in str(error)
            continue
        again.close()
        if any("12 damaged frames" in note for note in again.notes):
            continue
        motion = read_motion(folder / "take-recovered.npz")
        read = motion.read(0, motion.frames).axis_angle.astype(np.float32)
        exact = [any(np.abs(row - pose).max() < 1e-5 for pose in poses) for row in read]
        # what was left out is filled between its neighbours
        damaged = next((int(note.split(": ")[1].split()[0]) for note in again.notes if "damaged" in note), 0)
        assert len(exact) - sum(exact) <= damaged


def test_an_avatar_notices_what_its_format_can(tmp_path, within):
    """A GLB has no checksum: its pictures and its structure are checked, its numbers only for what they may be."""
    path, rng = tmp_path / "a.glb", np.random.default_rng(5)
    write_avatar(path, tiny_avatar())
    whole, expected, believed = path.read_bytes(), read_avatar(path), 0
    for _ in range(100):
        data = bytearray(whole)
        bit_rot(data, rng)
        path.write_bytes(data)
        with suppress(AssetError):
            believed += not same(read_avatar(path), expected)
    within(believed / 100, 0.15, "of rotten bits are believed in an avatar file")
