"""A table of ARKit's shapes (.csv), a row a frame, as Live Link Face exports its takes: the body stands in T-pose.

    Timecode,BlendShapeCount,EyeBlinkLeft,EyeLookDownLeft, ... ,TongueOut,HeadYaw,HeadPitch,HeadRoll,LeftEyeYaw, ...

Columns go by their names: in that app's header JawRight stands before JawLeft and MouthRight before MouthLeft, other
than in its datagrams. Head angles are radians, yaw to the person's right, pitch upwards (judged), and the eyes look
where their shapes say. The frame rate is the number of rows with one and the same hour, minute and second.
"""

import re
from collections import Counter
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from avatar.face import SHAPES
from avatar.face_names import shapes_called
from avatar.gaze import gaze_of, turned_head
from avatar.motion.clip import Clip, Motion, RestSkeleton, builtin_skeleton, checked_rate
from command.errors import AssetError
from files.input_file import read_text

WHAT = "a table of ARKit's shapes (.csv)"
MAX_BYTES = 1 << 26
FEWEST = 10  # shapes in the header
ASSUMED_RATE = 60.0
HEAD = ("HeadYaw", "HeadPitch", "HeadRoll")
LARGEST = 1e3
LONGEST_HEADER = 20_000  # letters
SECOND = re.compile(r"\s*(\d{1,2}:\d{1,2}:\d{1,2})")


def read_face_csv(path: Path | str, skeleton: RestSkeleton | None = None) -> Motion:
    """Open a table of faces.

    Raises:
        AssetError: no such header, a row of another length, a value that is no finite number. File and line are named.
    """
    path, skeleton = Path(path), builtin_skeleton() if skeleton is None else skeleton
    lines = [line for line in read_text(path, WHAT, most=MAX_BYTES).splitlines() if line.strip()]
    header = [name.strip().strip('"') for name in lines[0][:LONGEST_HEADER].split(",")] if lines else []
    called = {k: shapes_called(name) or {} for k, name in enumerate(header)}
    columns = {k: next(iter(shapes)) for k, shapes in called.items() if len(shapes) == 1}
    if len(columns) < FEWEST:
        raise AssetError(f"{path}: expected {WHAT}, found {len(columns)} of their names in the first line")
    if len(set(columns.values())) < len(columns):
        raise AssetError(f"{path}: expected each shape once in the first line")
    if len(lines) < 2:
        raise AssetError(f"{path}: expected a row a frame, found none")
    heads = [header.index(name) for name in HEAD if name in header]
    wanted = [*columns, *heads]
    values = np.array([_row(f"{path}: line {k}", line, len(header), wanted) for k, line in enumerate(lines[1:], 2)])
    weights = np.zeros((len(values), len(SHAPES)))
    weights[:, list(columns.values())] = np.clip(values[:, : len(columns)], 0.0, 1.0)
    turns = values[:, len(columns) :] * [-1.0, -1.0, 1.0] if len(heads) == 3 else np.zeros((len(values), 3))
    notes = ["body: none in the file, in T-pose"]
    rate = checked_rate(f"{path}: Timecode", _rate(lines[1:], notes))
    gaze, pose = gaze_of(weights), turned_head(turns)

    root = np.tile([0.0, skeleton.pelvis_height, 0.0], (len(values), 1))
    clip = Clip(pose, root, rate, tuple(notes), skeleton.pelvis_height, weights, gaze)
    return clip.motion(path.name)


def _row(place: str, line: str, count: int, wanted: list[int]) -> Float[Array, "values"]:
    cells = line.split(",")
    if len(cells) != count:
        raise AssetError(f"{place} should have {count} values as the first line, has {len(cells)}")
    try:
        row = np.array([float(cells[k]) for k in wanted])
    except ValueError as error:
        raise AssetError(f"{place}: {str(error)[:80]}") from None
    if not (np.abs(row) < LARGEST).all():
        raise AssetError(f"{place} should be finite numbers below {LARGEST:g}, is not")
    return row


def _rate(rows: list[str], notes: list[str]) -> float:
    """Frames a second: the median number of rows a whole second."""
    seconds = Counter(found[1] for found in map(SECOND.match, rows) if found)
    # the first and the last second are cut
    whole = list(seconds.values())[1:-1]
    if not whole:
        notes.append(f"no whole second of Timecode: {ASSUMED_RATE:g} frames per second assumed")
        return ASSUMED_RATE
    return float(np.median(whole))
