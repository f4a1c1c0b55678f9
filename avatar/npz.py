"""Reading the arrays of .npz and .npy files that someone else may have written."""

import io
import tokenize
import zipfile
import zlib
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np

from avatar.errors import AssetError
from avatar.unpickle import MAX_BYTES, unpickled

UNREADABLE = (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile, zlib.error, AttributeError,
              NotImplementedError, RuntimeError, MemoryError, OverflowError)  # fmt: skip
HEADER_ERRORS = (*UNREADABLE, SyntaxError, TypeError, tokenize.TokenError)  # what NumPy's header parser lets through


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
        raise AssetError(f"{path}: expected {what} (.npz), found: {str(error) or type(error).__name__}") from None
    absent = set(required) - fields.keys()
    if absent:
        raise AssetError(f"{path}: no {sorted(absent)}; the file has {sorted(fields)}")
    return fields


def read_npy(path: Path | str, what: str) -> Any:
    """The array of an .npy file. An array of objects comes as the flat list of what it holds.

    Objects are a pickle, which is never run: arrays, numbers, text, lists and dicts are rebuilt from their bytes
    (avatar/unpickle.py), and a dict saved by `np.save` is the only item of its list.

    Raises:
        AssetError: absent, damaged, of another length than its header says, or naming anything but data.
    """
    path = Path(path)
    try:
        if not path.is_file():
            raise AssetError(f"{path}: no such file; expected {what} (.npy)")
        if path.stat().st_size > MAX_BYTES:
            raise AssetError(f"{path}: expected {what} of at most {MAX_BYTES} bytes")
        data = path.read_bytes()
    except OSError as error:
        raise AssetError(f"{path}: cannot be read: {error.strerror}") from None
    file = io.BytesIO(data)
    try:
        version = np.lib.format.read_magic(file)
        if version not in ((1, 0), (2, 0)):
            raise ValueError(f"format {version}")
        one = version == (1, 0)
        read_header = np.lib.format.read_array_header_1_0 if one else np.lib.format.read_array_header_2_0
        shape, by_columns, dtype = read_header(file)
    except HEADER_ERRORS as error:
        raise AssetError(f"{path}: expected {what} (.npy), found: {str(error)[:120]}") from None
    content = data[file.tell() :]
    if dtype == np.dtype(object):
        held = unpickled(content, path, what)
        return held if isinstance(held, list) else [held]
    if dtype.kind not in "biufSU":
        raise AssetError(f"{path}: expected {what}, numbers or text, found {dtype}")
    size = dtype.itemsize
    for n in shape:
        size *= int(n)
    if size != len(content) or min(shape, default=0) < 0:
        raise AssetError(f"{path}: {what} {shape} should take {size} bytes, the file has {len(content)}")
    array = np.frombuffer(content, dtype).reshape(shape, order="F" if by_columns else "C")
    return array.astype(dtype.newbyteorder("="))
