"""BVH motion capture files: hierarchy and frames, in the file's own units and axes.

Frames are read in blocks, so that a file may be longer than memory. Angles are degrees in the file, radians
here. A joint's rotation is the product of its rotation channels in the order written; position channels take
the place of the joint's OFFSET (as Blender and most exporters mean it).
"""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import BinaryIO

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from avatar.motion.clip import Motion, RestSkeleton, checked_rate
from avatar.motion.retarget import retarget
from avatar.motion.rig import AnimatedRig, PlacedJoints, runs
from avatar.motion.smplh_rig import is_smplh, leg_length, read_exactly
from avatar.rotation import matrix_from_axis_angle
from command.errors import AssetError
from files.input_file import open_input

# a place in the file is remembered every so many frames
INDEX_STEP = 64
MOST_JOINTS = 10_000
LONGEST_LINE = 1 << 20  # bytes
# the largest number, so that what is computed from it is finite
LARGEST = 1e9
# frames are read in blocks: a file may be longer than memory
MAX_BYTES = 1 << 40
UNITS = {1.0: "metre", 0.01: "centimetre", 0.001: "millimetre"}
# metres of thigh and shin, a child's to a giant's
LEGS = (0.3, 1.4)


@dataclass(frozen=True, kw_only=True)
class Bvh(AnimatedRig):
    """One BVH file, opened: rest skeleton, channels, and where the frames lie."""

    # from the parent, file units
    offsets: Float[Array, "joints 3"]
    # per joint, such as ("Xposition", ..., "Zrotation", ...)
    channels: tuple[tuple[str, ...], ...]
    # byte and line of frames 0, 64, 128, ...
    places: tuple[tuple[int, int], ...] = field(repr=False)

    @property
    def width(self) -> int:
        return sum(len(c) for c in self.channels)

    def values(self, start: int, stop: int) -> Float[Array, "frames channels"]:
        """Channel values of frames start .. stop - 1, as in the file."""
        if not 0 <= start <= stop <= self.frames:
            raise ValueError(f"frames {start}:{stop} are not inside {self.path}, which has {self.frames}")
        if start == stop:
            return np.zeros((0, self.width))
        rows, row = np.zeros((stop - start, self.width)), []
        # the remembered place is at or before the first frame
        byte, line = self.places[start // INDEX_STEP]
        frame = start - start % INDEX_STEP
        with open_input(self.path, "a BVH file", most=MAX_BYTES) as file:
            file.seek(byte)
            while frame < stop:
                text = file.readline(LONGEST_LINE)
                if not text:
                    raise AssetError(f"{self.path}: line {line}: the file has become shorter while it was read")
                row += text.split()
                if len(row) >= self.width:
                    if frame >= start:
                        rows[frame - start] = self._numbers(row, line, frame)
                    frame, row = frame + 1, []
                line += 1
        return rows

    def _numbers(self, words: list[bytes], line: int, frame: int) -> Array:
        place = f"{self.path}: line {line}: frame {frame}"
        try:
            row = np.array([float(word) for word in words])
        except ValueError as error:
            raise AssetError(f"{place}: {error}") from None
        if len(row) != self.width:
            raise AssetError(f"{place} should have {self.width} numbers, has {len(row)}")
        good = np.abs(row) < LARGEST
        if not good.all():
            ends = np.cumsum([len(c) for c in self.channels])
            joint = self.names[int(np.searchsorted(ends, np.argmin(good), side="right"))]
            raise AssetError(f"{place}, joint {joint} is not finite, or beyond {LARGEST:g}")
        return row

    def transforms(self, frames: Int[Array, "frames"]) -> PlacedJoints:
        """Forward kinematics: rotation world_from_joint and position of every joint, in the file's world."""
        columns = iter(np.concatenate([self.values(*run) for run in runs(frames)]).T)
        rotations = np.tile(np.eye(3), (len(frames), len(self.names), 1, 1))
        positions = np.tile(self.offsets, (len(frames), 1, 1))
        for joint, (parent, channels) in enumerate(zip(self.parents, self.channels, strict=True)):
            R, t = rotations[:, joint], positions[:, joint]
            for name in channels:
                axis, values = "XYZ".index(name[0]), next(columns)
                if name.endswith("position"):
                    t[:, axis] = values
                else:
                    R[:] = R @ matrix_from_axis_angle(np.eye(3)[axis] * np.radians(values[:, None]))
            if parent >= 0:
                t[:] = positions[:, parent] + (rotations[:, parent] @ t[..., None])[..., 0]
                R[:] = rotations[:, parent] @ R
        return rotations, positions

    @property
    def rest_positions(self) -> Float[Array, "joints 3"]:
        """Joint positions with every rotation zero and every joint at its OFFSET."""
        positions = np.array(self.offsets)
        for joint, parent in enumerate(self.parents):
            if parent >= 0:
                positions[joint] += positions[parent]
        return positions


def open_bvh(path: Path | str) -> Bvh:
    """Read the hierarchy of a BVH file and find its frames (one pass, numbers are checked when read).

    Raises:
        AssetError: not a BVH file, a broken hierarchy, fewer or more numbers than the header promises, a
            frame time that is not positive. The message names file and line.
    """
    path = Path(path)
    try:
        with open_input(path, "a BVH file", most=MAX_BYTES) as file:
            reader = _Lines(path, file)
            tree = _hierarchy(reader)
            frames, rate = _motion_header(reader)
            return replace(tree, frames=frames, rate=rate, places=_index(reader, frames, tree.width))
    except OSError as error:
        raise AssetError(f"{path}: cannot be read: {error.strerror}") from None


class _Lines:
    """Non-empty lines of a file as words, with their numbers for messages."""

    def __init__(self, path: Path, file: BinaryIO):
        self.path, self.file, self.number, self.byte = path, file, 0, 0

    def next(self) -> list[str]:
        """The words of the next line that is not empty; AssetError at the end of the file."""
        while True:
            line = self.file.readline(LONGEST_LINE)
            self.number, self.byte = self.number + 1, self.byte + len(line)
            if not line:
                raise self.error("the file ends too early")
            if len(line) == LONGEST_LINE:
                raise self.error(f"a line is longer than {LONGEST_LINE} bytes; expected a BVH file")
            words = line.decode("utf-8", "replace").removeprefix("\ufeff").split()
            if words:
                return words

    def before_brace(self, words: list[str]) -> str:
        """The name of what a line opens; its brace ends that line, or is the next one."""
        if words[-1] == "{":
            return " ".join(words[1:-1])
        if self.next() != ["{"]:
            raise self.error(f"expected the brace of {' '.join(words)[:60]}")
        return " ".join(words[1:])

    def error(self, text: str) -> AssetError:
        return AssetError(f"{self.path}: line {self.number}: {text}")

    def floats(self, words: list[str], count: int, what: str) -> list[float]:
        try:
            values = [float(word) for word in words]
        except ValueError as error:
            raise self.error(f"{what}: {error}") from None
        if len(values) != count or not (np.abs(values) < LARGEST).all():
            raise self.error(f"{what} should be {count} finite numbers below {LARGEST:g}, found {' '.join(words)[:60]}")
        return values


def _hierarchy(reader: _Lines) -> Bvh:
    """Everything up to the brace that closes the root's: a file whose frames are not known yet."""
    words = reader.next()
    if words[0].upper() != "HIERARCHY":
        raise reader.error(f"expected HIERARCHY, found {words[0][:30]!r}; is this a BVH file?")
    names, parents, ends = list[str](), list[int](), list[tuple[int, tuple[float, float, float]]]()
    offsets, channels = list[list[float] | None](), list[tuple[str, ...]]()
    # numbers of the joints whose braces are open; -1: an End Site's
    inside: list[int] = []
    while inside or not names:
        words = reader.next()
        key, joint = words[0].upper(), inside[-1] if inside else None
        if key in ("ROOT", "JOINT", "END"):
            if (key == "ROOT") != (not names) or joint == -1:
                raise reader.error(f"{key} cannot stand here; one ROOT, then JOINTs and End Sites inside braces")
            name = reader.before_brace(words)
            if key == "END":
                inside.append(-1)
                continue
            if not name or len(names) == MOST_JOINTS:
                raise reader.error(f"more than {MOST_JOINTS} joints" if name else f"{key} needs a name")
            inside.append(len(names))
            names.append(name)
            parents.append(-1 if joint is None else joint)
            offsets.append(None)
            channels.append(())
        elif key not in ("OFFSET", "CHANNELS", "}") or joint is None:
            found = "MOTION before the hierarchy is closed" if key == "MOTION" else f"found {words[0][:30]!r}"
            raise reader.error(f"expected ROOT, JOINT, End Site, OFFSET, CHANNELS or a closing brace, {found}")
        elif key == "OFFSET":
            x, y, z = reader.floats(words[1:], 3, "OFFSET")
            if joint < 0:
                ends.append((inside[-2], (x, y, z)))
            else:
                offsets[joint] = [x, y, z]
        elif key == "CHANNELS":
            if joint < 0:
                raise reader.error("CHANNELS of an End Site, which has none")
            channels[joint] = _channel_names(reader, words)
        else:
            if joint >= 0 and offsets[joint] is None:
                raise reader.error(f"joint {names[joint]} has no OFFSET")
            inside.pop()
    places = np.array(offsets, np.float64)
    return Bvh(
        path=reader.path, names=tuple(names), parents=tuple(parents), ends=tuple(ends), frames=0, rate=1.0,
        offsets=places, channels=tuple(channels), places=(),
    )  # fmt: skip


def _channel_names(reader: _Lines, words: list[str]) -> tuple[str, ...]:
    """What CHANNELS lists, behind their number."""
    listed = [word.capitalize() for word in words[2:]]
    if not words[1:] or words[1] != str(len(listed)):
        raise reader.error(f"CHANNELS promises {' '.join(words[1:2])} names, {len(listed)} follow")
    known = {axis + kind for axis in "XYZ" for kind in ("position", "rotation")}
    if set(listed) - known or len(set(listed)) != len(listed):
        raise reader.error(f"CHANNELS should be different ones of X/Y/Zposition and X/Y/Zrotation, are {listed}")
    return tuple(listed)


def _motion_header(reader: _Lines) -> tuple[int, float]:
    words = reader.next()
    if words[0].upper() != "MOTION":
        raise reader.error(f"expected MOTION, found {words[0][:30]!r}")
    words = reader.next()
    if words[0].upper().rstrip(":") != "FRAMES" or not words[-1].isdecimal() or len(words[-1]) > 12:
        raise reader.error(f"expected 'Frames: N', found {' '.join(words)[:40]!r}")
    frames = int(words[-1])
    if frames < 1:
        raise reader.error("0 frames, expected at least 1")
    words = reader.next()
    if [w.upper().rstrip(":") for w in words[:2]] != ["FRAME", "TIME"]:
        raise reader.error(f"expected 'Frame Time: seconds', found {' '.join(words)[:40]!r}")
    (seconds,) = reader.floats(words[2:], 1, "Frame Time")
    if not seconds > 0:
        raise reader.error(f"Frame Time should be positive seconds, is {seconds}")
    place = f"{reader.path}: line {reader.number}: the rate that Frame Time {seconds:g} gives"
    return frames, checked_rate(place, 1 / max(seconds, 1e-9))


def _index(reader: _Lines, frames: int, width: int) -> tuple[tuple[int, int], ...]:
    """Where every 64th frame begins; checks that there are as many numbers as promised."""
    if not width:
        raise reader.error("no joint has channels")
    places, found, words, byte = [], 0, 0, reader.byte
    while line := reader.file.readline(LONGEST_LINE):
        reader.number += 1
        if words == 0 and len(places) * INDEX_STEP == found:
            places.append((byte, reader.number))
        byte += len(line)
        words += len(line.split())  # a frame may be wrapped over several lines
        if words > width:
            raise reader.error(f"frame {found} should have {width} numbers, has {words}")
        if words == width:
            found, words = found + 1, 0
            if found > frames:
                raise reader.error(f"more than the {frames} frames that the header promises")
    if found != frames or words:
        raise reader.error(f"the header promises {frames} frames of {width} numbers, the file ends in frame {found}")
    return tuple(places)


def read_bvh(path: Path | str, skeleton: RestSkeleton | None = None) -> Motion:
    """Open a BVH file as a motion of our skeleton: exactly where its rig is ours, else by avatar/motion/retarget.py."""
    bvh = open_bvh(path)
    if not is_smplh(bvh):
        return retarget(bvh, skeleton)
    leg = leg_length(bvh.rest_positions, {name: k for k, name in enumerate(bvh.names)})
    unit = next((unit for unit in UNITS if LEGS[0] < leg * unit < LEGS[1]), None)
    if unit is None:
        return retarget(bvh, skeleton)
    # where the skeleton rests on the ground, as avatar/motion/bvh_write.py has it
    height = float(bvh.offsets[0, 1])
    notes = [f"unit: {UNITS[unit]}, by the length of the legs, {leg:.4g}"]
    return read_exactly(bvh, notes, unit, unit * height if leg < height < 1.5 * leg else None)
