"""Pickled data of arrays: body models (.pkl) and pose sequences, read without running anything in them.

A pickle is a program for a stack machine. avatar/pickle_machine.py is that machine with nothing behind it: it
knows plain values, lists, tuples, dicts and sets, and a name that the program asks for is looked up in a short
table (avatar/pickle_objects.py), never imported. NumPy arrays, dtypes and scalars are rebuilt from their bytes;
SciPy's CSC and CSR matrices and chumpy's Ch and Select, which old body models hold, become plain arrays
(avatar/pickle_records.py). Any other name is refused.

Text of Python 2 is read as latin1. Files, steps and array bytes are bounded (MAX_BYTES, MAX_STEPS), so a file
that builds more than it holds is refused before the memory is spent.
"""

from pathlib import Path
from typing import Any

from avatar.errors import AssetError
from avatar.pickle_machine import Machine
from avatar.pickle_values import Refused

# of a file, and of all arrays made from it
MAX_BYTES = 1 << 29
# a step makes at most one object, of a few hundred bytes
MAX_STEPS = 1_000_000


def read_pickle(path: Path | str, what: str) -> Any:
    """What the pickle at `path` holds: dicts, lists, tuples, sets, text, bytes, numbers and NumPy arrays.

    `what` names the expected content in messages, for example "an SMPL+H model".

    Raises:
        AssetError: absent, too large, damaged, or it names something that is not admitted; nothing was run.
    """
    path = Path(path)
    try:
        if not path.is_file():
            raise AssetError(f"{path}: no such file; expected {what} (.pkl)")
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise AssetError(f"{path}: expected {what} of at most {MAX_BYTES} bytes, found {size}")
        data = path.read_bytes()
    except OSError as error:
        raise AssetError(f"{path}: cannot be read: {error.strerror}") from None
    return unpickled(data, path, f"{what} (.pkl)")


def unpickled(data: bytes, path: Path, what: str) -> Any:
    """What the pickle `data`, a part of the file at `path`, holds; AssetError as in `read_pickle`."""
    try:
        return Machine(data, most_steps=MAX_STEPS, most_bytes=MAX_BYTES).run()
    except Refused as error:
        raise AssetError(f"{path}: expected {what}, found: {error}") from None
