"""Arrays of .npz and .npy files that someone else may have written: the one reader of both.

Only members that are asked for are unpacked, and what an array takes is known from its header, and agrees with the
archive, before memory is spent on it. Pickled objects are never loaded from an .npz; those of an .npy are rebuilt by
files/unpickle.py.
"""

import io
import warnings
import weakref
import zipfile
from collections.abc import Collection, Iterator
from contextlib import closing, contextmanager
from math import prod
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from command.errors import AssetError
from files.input_file import MAX_BYTES, one_line, open_input, read_bytes, unusable
from files.unpickle import unpickled

# an archive may be longer than memory: its members are read by name or by rows
MAX_ARCHIVE_BYTES = 1 << 40
# an archive's list of members, and one reading from it
MAX_DIRECTORY_BYTES = 1 << 20
MAX_HEADER_BYTES = 10_000
CHUNK = 1 << 18
KINDS = "biufSU"


class _Bounded(io.BufferedReader):
    """A file that is read a little at a time: a zip may claim a directory of gigabytes."""

    def read(self, size: int | None = -1, /) -> bytes:
        most = MAX_DIRECTORY_BYTES + 1
        data = super().read(most if size is None or size < 0 else min(size, most))
        if len(data) > MAX_DIRECTORY_BYTES:
            raise zipfile.BadZipFile(f"a list of members of more than {MAX_DIRECTORY_BYTES} bytes")
        return data


class NpzFile:
    """An .npz, opened; arrays come out of it by name."""

    def __init__(self, path: Path | str, what: str):
        self.path, self.what = Path(path), f"{what} (.npz)"
        self.file = _Bounded(open_input(path, self.what, most=MAX_ARCHIVE_BYTES).detach())
        # a motion keeps its file open while it is played; a method of its own would keep it for ever
        weakref.finalize(self, self.file.close)
        try:
            with unusable(f"{path}: expected {self.what}, found"):
                self.archive: Any = zipfile.ZipFile(self.file)
        except AssetError:
            self.close()
            raise
        self.names = frozenset(n.removesuffix(".npy") for n in self.archive.namelist() if n.endswith(".npy"))

    def close(self) -> None:
        self.file.close()

    def member(self, name: str) -> "NpzMember":
        """An array of the file, its header read.

        Raises:
            AssetError: absent, damaged, of objects, or of another size than its header says.
        """
        if name not in self.names:
            raise AssetError(f"{self.path}: no {name}; the file has {_some(self.names)}")
        return NpzMember(self, name)


class NpzMember:
    """One array of an .npz, read whole, or by rows in constant memory: in order, or where the archive is not compressed
    in any order, each for what it takes itself."""

    def __init__(self, npz: NpzFile, name: str):
        self.npz, self.name = npz, name
        self.file: Any = None
        self.whole: Array | None = None
        self.checked = False
        info = npz.archive.getinfo(f"{name}.npy")
        with self._reading() as file:
            # others may take any amount of memory to unpack
            if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
                raise ValueError(f"compression method {info.compress_type}")
            self.header = _npy_header(file)
        self.shape, self.dtype = self.header.shape, self.header.dtype
        self.header.check(info.file_size, f"{npz.path}: {name}")
        # numbers of a row
        self.row = prod(self.shape[1:])
        # place of the first in the file; None: it has to be unpacked from its start
        plain = info.compress_type == zipfile.ZIP_STORED and not info.flag_bits & 1
        self.first_at = _stored_at(npz.file, info, self.header.length) if plain else None

    @contextmanager
    def _reading(self) -> Iterator[io.BufferedIOBase]:
        """The member from its start; what a damaged archive raises names file and field."""
        with self._damage(), self.npz.archive.open(f"{self.name}.npy") as file:
            yield file

    def _damage(self):
        return unusable(f"{self.npz.path}: {self.name} cannot be read, the file is damaged or cut short")

    def all(self, most: int = MAX_BYTES) -> Array:
        """The whole array; refused above `most` bytes."""
        if self.header.bytes > most:
            raise AssetError(
                f"{self.npz.path}: {self.name} {self.shape} should take at most {most} bytes, takes {self.header.bytes}"
            )
        with self._reading() as file:
            file.read(self.header.length)
            return _array(file, self.header)

    def _check(self) -> None:
        """Read a plain member once to its end, where its checksum is compared; one of gigabytes is believed."""
        if not self.checked and self.header.bytes <= MAX_BYTES:
            with self.npz.archive.open(f"{self.name}.npy") as file:
                while file.read(CHUNK):
                    pass
        self.checked = True

    def rows(self, start: int, stop: int) -> Float[Array, "rows columns"]:
        """Rows start .. stop - 1 as float64, flattened to two dimensions."""
        # rows of an array in Fortran order are spread over the file: it is held whole, and so has to be small
        if self.header.by_columns and len(self.shape) > 1:
            if self.whole is None:
                self.whole = self.all()
            return self.whole[start:stop].reshape(stop - start, self.row).astype(np.float64)
        begin = start * self.row * self.dtype.itemsize
        block = self.header._replace(shape=(stop - start, self.row), by_columns=False)
        # a signalling NaN would print a warning; who reads the rows names it
        with self._damage(), np.errstate(invalid="ignore"):
            next_row = self.header.length if self.file is None else self.file.tell()
            if self.first_at is not None and self.header.length + begin != next_row:
                self._check()
                self.npz.file.seek(self.first_at + begin)
                return _array(self.npz.file, block).astype(np.float64)
            if self.file is None:
                self.file = self.npz.archive.open(f"{self.name}.npy")
                self.file.MAX_SEEK_READ = CHUNK
            self.file.seek(self.header.length + begin)
            return _array(self.file, block).astype(np.float64)


def read_npz(
    path: Path | str, what: str, required: Collection[str], optional: Collection[str] = (), *, most: int = MAX_BYTES
) -> dict[str, Array]:
    """The arrays of these names, those that are `optional` where the file has them; nothing else is unpacked.

    `what` names the expected content in messages, for example "cameras".

    Raises:
        AssetError: the file is absent, not an .npz, cut short, lacks a required array, or the arrays take more
            than `most` bytes together.
    """
    with closing(NpzFile(path, what)) as npz:
        absent = set(required) - npz.names
        if absent:
            raise AssetError(f"{path}: no {', '.join(sorted(absent))}; the file has {_some(npz.names)}")
        members = [npz.member(name) for name in (*required, *optional) if name in npz.names]
        total = sum(member.header.bytes for member in members)
        if total > most:
            raise AssetError(f"{path}: {what} should take at most {most} bytes, would take {total}")
        return {member.name: member.all(most) for member in members}


def read_npy(path: Path | str, what: str) -> Array | list:
    """The array of an .npy file. An array of objects comes as the flat list of what it holds.

    Objects are a pickle, which is never run: arrays, numbers, text, lists and dicts are rebuilt from their bytes
    (files/unpickle.py), and a dict saved by `np.save` is the only item of its list.

    Raises:
        AssetError: absent, damaged, of another length than its header says, or naming anything but data.
    """
    path = Path(path)
    file = io.BytesIO(read_bytes(path, f"{what} (.npy)"))
    with unusable(f"{path}: expected {what} (.npy), found"):
        header = _npy_header(file)
    if header.dtype == np.dtype(object):
        held = unpickled(file.read(), path, what)
        return held if isinstance(held, list) else [held]
    header.check(len(file.getbuffer()), f"{path}: {what}")
    with unusable(f"{path}: expected {what} (.npy), found"):
        return _array(file, header)


def field(path: Path | str, fields: dict[str, Array], name: str, shape: tuple[int | None, ...]) -> Array:
    """An array of numbers or truth values of this shape (None: any length), all finite.

    Raises:
        AssetError: it is not; the message names file and field.
    """
    if name not in fields:
        raise AssetError(f"{path}: no {name}; the file has {_some(fields)}")
    array = fields[name]
    if array.dtype.kind not in "biuf":
        raise AssetError(f"{path}: {name} should be numbers, is {array.dtype}")
    if array.ndim != len(shape) or any(want not in (None, have) for want, have in zip(shape, array.shape, strict=True)):
        expected = "(" + ", ".join("any" if n is None else str(n) for n in shape) + ")"
        raise AssetError(f"{path}: {name} should be {expected}, is {array.shape}")
    if not np.isfinite(array).all():
        first = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise AssetError(f"{path}: {name} is not finite, first at {first}")
    return array


def indices(
    path: Path | str, fields: dict[str, Array], name: str, shape: tuple[int | None, ...], count: int, of: str
) -> Int[Array, "..."]:
    """An array of this shape that picks from `count` things, called `of` in messages: whole numbers below `count`.

    Raises:
        AssetError: it does not; the message names file and field.
    """
    array = field(path, fields, name, shape)
    if array.size and not (array.min() >= 0 and array.max() < count and (array == np.floor(array)).all()):
        found = f"{array.min():.6g} to {array.max():.6g}"
        raise AssetError(f"{path}: {name} should index {count} {of} by whole numbers, holds {found}")
    return array.astype(np.int64)


class _Header(NamedTuple):
    """What stands before the numbers of an .npy."""

    shape: tuple[int, ...]
    by_columns: bool
    dtype: np.dtype
    length: int  # bytes of the header itself

    @property
    def bytes(self) -> int:
        """What the array takes; the shape's numbers may be of any size."""
        return prod(self.shape) * self.dtype.itemsize

    def check(self, size: int, place: str) -> None:
        """Refuse objects, and an array that does not fill its member of `size` bytes; `place` begins the message."""
        if self.dtype.kind not in KINDS:
            raise AssetError(f"{place} should hold numbers or text, holds {self.dtype} (pickles are not read)")
        if self.bytes != size - self.length:
            raise AssetError(f"{place} {self.shape} should take {self.bytes} bytes, there are {size - self.length}")


def _npy_header(file: io.BufferedIOBase) -> _Header:
    """The header of an .npy. Whatever is wrong raises; nothing large is read."""
    version = np.lib.format.read_magic(file)
    if version not in ((1, 0), (2, 0)):
        raise ValueError(f"a header of .npy format {version}, expected 1.0 or 2.0")
    counted = file.read(2 if version == (1, 0) else 4)
    size = int.from_bytes(counted, "little")
    if size > MAX_HEADER_BYTES:
        raise ValueError(f"an .npy header of {size} bytes")
    text = io.BytesIO(counted + file.read(size))
    # NumPy warns of headers written by Python 2, which are understood
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, by_columns, dtype = read(text)
    if min(shape, default=0) < 0:
        raise ValueError(f"the shape {one_line(shape)}")
    if dtype.itemsize == 0:
        raise ValueError("an array of empty items")
    return _Header(shape, by_columns, dtype, 8 + len(counted) + size)


def _array(file: io.BufferedIOBase, header: _Header) -> Array:
    """The numbers that a header announces, in this machine's byte order."""
    data = np.empty(header.bytes, np.uint8)
    at = 0
    while at < len(data):
        part = file.read(min(CHUNK, len(data) - at))
        if not part:
            raise EOFError(f"{len(data) - at} bytes are missing")
        data[at : at + len(part)] = np.frombuffer(part, np.uint8)
        at += len(part)
    array = data.view(header.dtype).reshape(header.shape, order="F" if header.by_columns else "C")
    return array.astype(header.dtype.newbyteorder("="), copy=False)


def _stored_at(file: io.BufferedReader, info: zipfile.ZipInfo, header: int) -> int:
    """Place in the file of a plain member's numbers: behind the archive's header, whose name and extra field may have
    other lengths than in the list of members, and the array's own of `header` bytes."""
    file.seek(info.header_offset + 26)
    name, extra = file.read(2), file.read(2)
    return info.header_offset + 30 + int.from_bytes(name, "little") + int.from_bytes(extra, "little") + header


def _some(names: Collection[str]) -> str:
    """Names of fields, so many as fit a line."""
    listed = ", ".join(sorted(name[:40] for name in names)[:20]) or "no arrays"
    return f"{listed} ..." if len(names) > 20 else listed
