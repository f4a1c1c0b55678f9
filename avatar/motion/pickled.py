"""Pose sequences in pickles (.pkl): SMPL+H and MoSh files, and fits saved with SMPL's parameter names.

Their names are those of avatar/motion/smpl_fields.py. The pickle is never run (files/unpickle.py). It is read whole: a
sequence longer than memory belongs in an .npz.
"""

from pathlib import Path

import numpy as np
from numpy import ndarray as Array

from avatar.body import Body
from avatar.motion.clip import Motion
from avatar.motion.smpl_fields import BODY, WHOLE, HeldRows, PoseFields, read_pose_fields
from command.errors import AssetError
from files.unpickle import Value, read_pickle

# the most numbers in a field of lists: 300 MB as Python holds them
MAX_NUMBERS = 10_000_000


def read_pickled_motion(path: Path | str, *, body: Body | None = None) -> Motion:
    """Open a pickled pose sequence; `body` is the model it was made for.

    Raises:
        AssetError: damaged, or naming anything but data; else as `read_pose_fields`.
    """
    path = Path(path)
    content = read_pickle(path, "a pose sequence")
    fields = {k: v for k, v in content.items() if isinstance(k, str)} if type(content) is dict else {}
    if not fields.keys() & {*WHOLE, *BODY}:
        found = sorted(str(key)[:40] for key in content)[:12] if fields else f"a {type(content).__name__}"
        raise AssetError(f"{path}: no poses; expected one of {', '.join(WHOLE + BODY)}; found {found}")

    def member(name: str) -> HeldRows:
        return HeldRows(_array(path, fields, name))

    there = frozenset(name for name, value in fields.items() if value is not None)
    return read_pose_fields(PoseFields(path, there, member, None), body, [])


def _array(path: Path, fields: dict[str, Value], name: str) -> Array:
    """A field as an array of numbers or text; lists of equally long lists count."""
    value = fields[name]
    try:
        if not isinstance(value, (str, bytes, Array)) and _numbers_within(value, {}) > MAX_NUMBERS:
            raise AssetError(f"{path}: {name} should be an array, is lists of more than {MAX_NUMBERS} numbers")
        return np.asarray(value)
    except (ValueError, OverflowError):
        raise AssetError(f"{path}: {name} should be numbers, is no array or has lists of unequal lengths") from None


def _numbers_within(value: Value, counted: dict[int, int]) -> int:
    """How many numbers lists of lists (or arrays) hold; one that is there twice counts twice, but is walked once."""
    if isinstance(value, Array) and value.dtype.kind in "biuf":
        return value.size
    if isinstance(value, (int, float, np.number)):
        return 1
    if not isinstance(value, (list, tuple)):
        raise ValueError(f"a {type(value).__name__}")
    if id(value) not in counted:
        counted[id(value)] = sum(_numbers_within(item, counted) for item in value)
    return counted[id(value)]
