"""Reading the arrays of an .npz file that someone else may have written."""

import zipfile
import zlib
from collections.abc import Collection
from pathlib import Path

import numpy as np

from avatar.errors import AssetError

UNREADABLE = (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile, zlib.error, AttributeError,
              NotImplementedError, RuntimeError, MemoryError, OverflowError)  # fmt: skip


def read_npz(path: Path | str, what: str, required: Collection[str] = ()) -> dict[str, np.ndarray]:
    """All arrays of the file by name; pickled objects are never loaded.

    `what` names the expected content in messages, for example "cameras".

    Raises:
        AssetError: the file is absent, not an .npz, cut short, or lacks a required array.
    """
    try:
        # opened here, because np.load leaves the file open when the archive is broken
        with open(path, "rb") as file, np.load(file, allow_pickle=False) as data:
            if not isinstance(data, np.lib.npyio.NpzFile):
                raise AssetError(f"{path}: expected {what} (.npz), found a single array")
            fields = {name: data[name] for name in data.files}
    except FileNotFoundError:
        raise AssetError(f"{path}: no such file; expected {what} (.npz)") from None
    except UNREADABLE as error:
        raise AssetError(
            f"{path}: expected {what} (.npz), found: {str(error) or type(error).__name__}"
        ) from None
    absent = set(required) - fields.keys()
    if absent:
        raise AssetError(f"{path}: no {sorted(absent)}; the file has {sorted(fields)}")
    return fields
