"""Pickled data of arrays: body models (.pkl) and pose sequences, read without running anything in them.

A pickle is a program for a stack machine. The standard library's `pickletools` reads its opcodes; here those that data
need are carried out on plain values, at most MAX_STEPS of them, and nothing is ever imported or called by a name: each
name has to be in ADMITTED, which says what is made of it. NumPy arrays, types and scalars are made of their bytes;
SciPy's CSC and CSR matrices and chumpy's Ch and Select, which old body models hold, become plain arrays; sets become
lists; at most MAX_BYTES together. Text of Python 2 is read as latin1.
"""

import codecs
import io
import pickletools
import warnings
from math import prod
from pathlib import Path
from typing import Any, TypeGuard

import numpy as np

from command.errors import AssetError
from files.input_file import one_line, read_bytes

# What a pickle holds: data of any kind, bounded by the numbers below
Value = Any
# A file, and all arrays made from it
MAX_BYTES = 1 << 29
# Text may take four times its bytes in memory
MAX_TEXT_BYTES = 1 << 27
# Opcodes; each makes at most one object, of a few hundred bytes
MAX_STEPS = 1_000_000
# Containers inside containers
MAX_DEPTH = 100
# A whole number, and one that is a key: whole numbers below 2^61 - 1 have hashes of their own
MAX_INTEGER, MAX_KEY = 1 << 512, 1 << 60

NUMBER_TYPES = ("b1", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8", "f2", "f4", "f8")
_CORES, _BUILTIN = ("numpy.core", "numpy._core"), ("builtins", "__builtin__")
_SPARSE = ("csc_matrix", "csr_matrix", "csc_array", "csr_array")
# (module, name) and what is made of it
ADMITTED = {
    **{(f"{core}.multiarray", "_reconstruct"): "array" for core in _CORES},
    **{(f"{core}.multiarray", "scalar"): "scalar" for core in _CORES},
    **{(f"{core}.numeric", "_frombuffer"): "frombuffer" for core in _CORES},
    ("numpy", "ndarray"): "ndarray",
    ("numpy", "dtype"): "dtype",
    ("_codecs", "encode"): "bytes",
    **{(module, "_reconstructor"): "reconstructor" for module in ("copy_reg", "copyreg")},
    **{("collections", name): "dict" for name in ("OrderedDict", "defaultdict")},
    **{(module, name): name for module in _BUILTIN for name in ("object", "list", "dict", "bytes")},
    **{(module, name): "list" for module in _BUILTIN for name in ("set", "frozenset")},
    **{(module, "bytearray"): "bytes" for module in _BUILTIN},
    **{(f"scipy.sparse.{under}{name[:3]}", name): name[:3] for name in _SPARSE for under in ("", "_")},
    ("chumpy.ch", "Ch"): "ch",
    ("chumpy.reordering", "Select"): "select",
}
# What becomes a value when its state arrives; but for arrays and types the state is a dict of fields
BUILT = ("array", "dtype", "csc", "csr", "ch", "select")
CONSTANTS = {"NONE": None, "NEWTRUE": True, "NEWFALSE": False, "EMPTY_TUPLE": ()}
DAMAGE = (TypeError, ValueError, IndexError, KeyError, OverflowError, AttributeError)
_OPCODES = {opcode.code.encode("latin1"): opcode for opcode in pickletools.opcodes}


class Unreadable(Exception):
    """Why a pickle is not read; becomes the AssetError."""


def read_pickle(path: Path | str, what: str) -> Value:
    """What the pickle at `path` holds: dicts, lists, tuples, text, bytes, numbers and NumPy arrays; sets as lists.

    `what` names the expected content in messages, for example "an SMPL+H model".

    Raises:
        AssetError: absent, too large, damaged, or it names something that is not admitted; nothing was run.
    """
    return unpickled(read_bytes(path, f"{what} (.pkl)", most=MAX_BYTES), path, f"{what} (.pkl)")


def unpickled(data: bytes, path: Path | str, what: str) -> Value:
    """What the pickle `data`, a part of the file at `path`, holds; AssetError as in `read_pickle`."""
    try:
        with warnings.catch_warnings():
            # Escapes that Python 2 let pass
            warnings.simplefilter("ignore", DeprecationWarning)
            value = _Machine().run(data)
        _check_extent(value, 0, {})
        return value
    except Unreadable as error:
        raise AssetError(f"{path}: expected {what}, found: {error}") from None


class _Name(str):
    """A name that the program asked for, and the kind of thing that is made of it."""

    kind = ""


class _Unbuilt:
    """A value whose state has not arrived yet, and then that value."""

    def __init__(self, name: _Name, arguments: tuple):
        self.name, self.arguments = name, arguments
        self.value: Value = None


class _Machine:
    """The stack, its marks and the memo of a program; counts what all values take."""

    def __init__(self) -> None:
        self.stack: list[Value] = []
        self.marks: list[int] = []
        self.memo: dict[int, Value] = {}
        self.bytes = self.text = self.items = self.unbuilt = 0

    def run(self, data: bytes) -> Value:
        """The value that the program leaves."""
        program, at, name = io.BytesIO(data), 0, ""
        try:
            for _ in range(MAX_STEPS):
                at = program.tell()
                code = program.read(1)
                opcode = _OPCODES.get(code)
                name = opcode.name if opcode is not None else repr(code)
                argument: Value = None
                if opcode is not None and opcode.arg is not None:
                    # pickletools takes text of Python 2 for ASCII
                    argument = _quoted(program) if name == "STRING" else opcode.arg.reader(program)
                if name == "STOP":
                    value = self.pop()
                    if self.unbuilt:
                        raise Unreadable("something whose state is missing")
                    return value
                self.step(name, argument)
        except (Unreadable, *DAMAGE) as error:
            why = error if isinstance(error, Unreadable) else one_line(error)
            found = f"the file ends at byte {at}" if name == "b''" else f"{name} at byte {at}: {why}"
            raise Unreadable(found) from None
        raise Unreadable(f"more than {MAX_STEPS} objects; save arrays, not lists of numbers")

    def step(self, name: str, argument: Value) -> None:
        """Carry out one opcode."""
        match name:
            case "PROTO" | "FRAME":
                pass
            case "MARK":
                self.marks.append(len(self.stack))
            case "POP":
                self.pop()
            case "NONE" | "NEWTRUE" | "NEWFALSE" | "EMPTY_TUPLE":
                self.stack.append(CONSTANTS[name])
            case "EMPTY_LIST" | "EMPTY_SET" | "EMPTY_DICT":
                self.stack.append({} if name == "EMPTY_DICT" else [])
            case "LIST" | "FROZENSET":
                self.stack.append(self.marked())
            case "TUPLE":
                self.stack.append(tuple(self.marked()))
            case "TUPLE1" | "TUPLE2" | "TUPLE3":
                self.stack.append(tuple([self.pop() for _ in range(int(name[-1]))][::-1]))
            case "DICT":
                self.stack.append(_filled({}, self.marked()))
            case "APPEND" | "APPENDS" | "ADDITEMS":
                items = [self.pop()] if name == "APPEND" else self.marked()
                self.top(list).extend(items)
            case "SETITEM" | "SETITEMS":
                items = [self.pop(), self.pop()][::-1] if name == "SETITEM" else self.marked()
                _filled(self.top(dict), items)
            case "PUT" | "BINPUT" | "LONG_BINPUT" | "MEMOIZE":
                self.memo[len(self.memo) if argument is None else argument] = self.top(object)
            case "GET" | "BINGET" | "LONG_BINGET":
                if argument not in self.memo:
                    raise Unreadable(f"a reference to object {argument}, which is not there")
                self.stack.append(_finished(self.memo[argument]))
            case "GLOBAL":
                self.stack.append(_admitted(*argument.split(" ", 1)))
            case "STACK_GLOBAL":
                attribute, module = self.pop(), self.pop()
                self.stack.append(_admitted(_text(module), _text(attribute)))
            case "REDUCE" | "NEWOBJ":
                arguments, callee = self.pop(), self.pop()
                self.stack.append(self.made(callee, arguments))
            case "BUILD":
                state, unbuilt = self.pop(), self.top(_Unbuilt)
                self.stack[-1] = self.built(unbuilt, state)
            case _ if argument is not None and name not in ("PERSID", "EXT1", "EXT2", "EXT4", "INST"):
                self.stack.append(self.constant(argument))
            case _:
                raise Unreadable("no pickle of plain data has this")

    def top(self, kind: type) -> Value:
        if len(self.stack) <= (self.marks[-1] if self.marks else 0):
            raise Unreadable("an empty stack")
        if not isinstance(self.stack[-1], kind):
            raise Unreadable(f"on a {type(self.stack[-1]).__name__}")
        return self.stack[-1]

    def pop(self) -> Value:
        self.top(object)
        return _finished(self.stack.pop())

    def marked(self) -> list[Value]:
        """What lies above the last mark, taken from the stack with it."""
        if not self.marks:
            raise Unreadable("without a mark")
        start = self.marks.pop()
        items = [_finished(value) for value in self.stack[start:]]
        del self.stack[start:]
        return items

    def constant(self, value: Value) -> Value:
        if isinstance(value, str):
            self.text += len(value)
            if self.text > MAX_TEXT_BYTES:
                raise Unreadable(f"text of more than {MAX_TEXT_BYTES} letters")
        if isinstance(value, int) and abs(value) >= MAX_INTEGER:
            raise Unreadable(f"a whole number of {value.bit_length()} bits")
        return bytes(value) if isinstance(value, bytearray) else value

    def spend(self, size: int) -> None:
        self.bytes += size
        if self.bytes > MAX_BYTES:
            raise Unreadable(f"arrays of more than {MAX_BYTES} bytes")

    def made(self, name: Value, arguments: Value) -> Value:
        """What the program makes by a name; some of it waits for its state."""
        if isinstance(name, _Name) and name.kind == "reconstructor":
            name, base = arguments[:2]
            if _kind(base) != "object" or _kind(name) not in BUILT[2:]:
                raise Unreadable(f"{name} that cannot be rebuilt")
        kind = _kind(name)
        try:
            if kind in BUILT:
                if kind == "dtype":
                    _dtype(arguments, "=")
                if kind == "array" and _kind(arguments[0]) != "ndarray":
                    raise ValueError(f"a base class {one_line(arguments[0])}")
                self.unbuilt += 1
                return _Unbuilt(name, arguments)
            if kind in ("list", "dict"):
                # a defaultdict is given what makes its defaults, which are not data
                return self.container(kind, *(() if name.endswith("defaultdict") else arguments))
            if kind == "bytes":
                return self.encoded(*arguments)
            if kind == "scalar":
                return self.numbers(_raw(arguments[1]), arguments[0], (), False)[()]
            if kind == "frombuffer":
                data, dtype, shape, order = arguments
                return self.numbers(_raw(data), dtype, shape, order == "F")
            raise ValueError("it is no value")
        except DAMAGE as error:
            raise Unreadable(f"{name} that cannot be rebuilt: {one_line(error)}") from None

    def container(self, kind: str, items: Value = ()) -> list | dict:
        """A list or dict of items, which are counted."""
        if not isinstance(items, (list, tuple, dict)):
            raise ValueError(f"items that are a {type(items).__name__}")
        self.items += len(items)
        if self.items > 2 * MAX_STEPS:
            raise Unreadable(f"containers of more than {2 * MAX_STEPS} items together")
        if kind == "list":
            return list(items)
        pairs = items.items() if isinstance(items, dict) else items
        return _filled({}, [part for key, value in pairs for part in (key, value)])

    def encoded(self, content: Value = b"", encoding: Value = "latin1") -> bytes:
        if _text(encoding).lower().replace("-", "") not in ("latin1", "iso88591"):
            raise ValueError(f"encoding {one_line(encoding)}")
        content = _raw(content)
        self.spend(len(content))
        return content

    def numbers(self, data: bytes, dtype: Value, shape: Value, by_columns: bool) -> np.ndarray:
        if not isinstance(dtype, np.dtype) or dtype.hasobject:
            raise ValueError(f"a type that is {one_line(dtype)}")
        if not _is_shape(shape) or prod(shape) * dtype.itemsize != len(data) or dtype.itemsize == 0:
            raise ValueError(f"shape {one_line(shape)} of {dtype} in {len(data)} bytes")
        self.spend(len(data))
        array = np.frombuffer(data, dtype).reshape(shape, order="F" if by_columns else "C")
        return array.astype(dtype.newbyteorder("="), copy=False)

    def built(self, unbuilt: _Unbuilt, state: Value) -> Value:
        """The value of what was called before, by its state."""
        if unbuilt.value is not None:
            raise Unreadable("a second state")
        kind = unbuilt.name.kind
        try:
            if kind == "dtype":
                if any(state[2:5]):
                    raise Unreadable("an array with named fields, expected plain numbers")
                value = _dtype(unbuilt.arguments, _text(state[1]))
            elif kind == "array":
                _, shape, dtype, by_columns, data = state
                value = data
                if not isinstance(data, list):
                    value = self.numbers(_raw(data), dtype, shape, bool(by_columns))
                elif not _is_shape(shape) or prod(shape) != len(data):
                    raise ValueError("objects that do not fill the array")
            else:
                state = state[0] if type(state) is tuple and state else state
                if not isinstance(state, dict):
                    raise ValueError(f"a state that is a {type(state).__name__}")
                make = {"ch": lambda fields: _numbers_in(fields, "x"), "select": self.selected}
                value = make[kind](state) if kind in make else self.dense(state, by_columns=kind == "csc")
        except DAMAGE as error:
            raise Unreadable(f"{unbuilt.name} that cannot be rebuilt: {one_line(error)}") from None
        unbuilt.value = value
        self.unbuilt -= 1
        return value

    def selected(self, fields: dict[str, Value]) -> np.ndarray:
        """chumpy's Select: some elements of another array, perhaps in another shape."""
        a, index = _numbers_in(fields, "a"), _numbers_in(fields, "idxs")
        _check_index(index, a.size)
        self.spend(a.nbytes + index.size * (8 + a.dtype.itemsize))
        shape = fields.get("preferred_shape")
        picked = a.ravel()[index]
        return picked if shape is None else picked.reshape(tuple(int(n) for n in np.atleast_1d(shape)))

    def dense(self, fields: dict[str, Value], *, by_columns: bool) -> np.ndarray:
        """A compressed sparse matrix as a plain one; repeated entries add up."""
        shape = fields.get("_shape", fields.get("shape"))
        if not _is_shape(shape) or len(shape) != 2:
            raise ValueError("a shape that is none")
        data, index, start = (_numbers_in(fields, name) for name in ("data", "indices", "indptr"))
        outer, inner = shape[::-1] if by_columns else shape
        kinds = data.dtype.kind in "fiu" and start.dtype.kind in "iu"
        if not kinds or (data.ndim, start.shape) != (1, (outer + 1,)):
            raise ValueError("pointers that do not fit the data")
        start = start.astype(np.int64)
        count = int(start[-1])
        if start[0] != 0 or count > len(data) or index.ndim != 1 or count > len(index) or (np.diff(start) < 0).any():
            raise ValueError("pointers that do not fit the data")
        _check_index(index[:count], inner)
        self.spend(prod(shape) * data.dtype.itemsize + 24 * (count + outer))
        matrix = np.zeros((outer, inner), data.dtype)
        np.add.at(matrix, (np.repeat(np.arange(outer), np.diff(start)), index[:count]), data[:count])
        return matrix.T if by_columns else matrix


def _finished(value: Value) -> Value:
    """The value itself, where it was waiting for its state."""
    if not isinstance(value, _Unbuilt):
        return value
    if value.value is None:
        raise Unreadable(f"{value.name} that cannot be rebuilt: a state that is a NoneType")
    return value.value


def _kind(name: Value) -> str:
    if not isinstance(name, _Name):
        raise Unreadable(f"a call of a {type(name).__name__}")
    return name.kind


def _admitted(module: str, name: str) -> _Name:
    full = f"{module}.{name}"[:100]
    if (module, name) not in ADMITTED:
        raise Unreadable(
            f"the name {full!r}, which is not one of NumPy arrays, SciPy CSC/CSR matrices and chumpy arrays; "
            "nothing was run: save the data as plain arrays"
        )
    made = _Name(full)
    made.kind = ADMITTED[module, name]
    return made


def _filled(into: dict, items: list[Value]) -> dict:
    """A dict with keys and values put in, in turn; keys are of kinds whose hashes cannot be made expensive."""
    for key, value in zip(items[::2], items[1::2], strict=True):
        whole = isinstance(key, (int, np.integer)) and abs(int(key)) < MAX_KEY
        if not whole and not isinstance(key, (str, bytes, type(None))):
            raise Unreadable(f"a key that is a {type(key).__name__}, expected text or a whole number")
        into[key] = value
    return into


def _dtype(arguments: tuple, order: str) -> np.dtype:
    """A NumPy type by its code, such as f8, S6 or O, and its byte order."""
    code = _text(arguments[0]).lstrip("<>=|")
    letters = code[:1] in ("S", "U") and code[1:].isdecimal() and len(code) < 8
    if not letters and code not in (*NUMBER_TYPES, "O", "O8", "O4"):
        raise Unreadable(f"an array of type {code[:20]!r}, expected numbers or text")
    if order not in ("<", ">", "=", "|"):
        raise ValueError(f"byte order {order!r}")
    return np.dtype(object) if code[0] == "O" else np.dtype((order if order != "|" else "=") + code)


def _numbers_in(fields: dict[str, Value], name: str) -> np.ndarray:
    value = fields[name]
    if not isinstance(value, (int, float, np.number, np.ndarray)):
        raise ValueError(f"{name} that is a {type(value).__name__}")
    return np.asarray(value)


def _check_index(index: np.ndarray, size: int) -> None:
    if index.dtype.kind not in "iu" or (index.size and not (index.min() >= 0 and index.max() < size)):
        raise ValueError("indices outside of their array")


def _check_extent(value: Value, depth: int, known: dict[int, tuple[int, int]]) -> tuple[int, int]:
    """Items and height of a value, what is shared counted wherever it stands: what a walk over it would cost.

    `known` is by id; all values are held by the whole.
    """
    if not isinstance(value, (list, tuple, dict)):
        return 1, 0
    if id(value) not in known:
        known[id(value)] = (0, MAX_DEPTH)
        inner = value.values() if isinstance(value, dict) else value
        parts = [_check_extent(item, depth + 1, known) for item in inner] if depth < MAX_DEPTH else [(0, MAX_DEPTH)]
        known[id(value)] = (1 + sum(size for size, _ in parts), 1 + max((height for _, height in parts), default=0))
    size, height = known[id(value)]
    if height > MAX_DEPTH - depth:
        raise Unreadable("containers that hold themselves, or deeper than expected")
    if size > 2 * MAX_STEPS:
        raise Unreadable(f"containers of more than {2 * MAX_STEPS} items together")
    return size, height


def _quoted(program: io.BytesIO) -> str:
    """The text of Python 2 in quotes, with escapes."""
    line = program.readline().rstrip(b"\n")
    if len(line) < 2 or line[:1] not in (b"'", b'"') or line[-1:] != line[:1]:
        raise Unreadable("its argument must be quoted")
    return codecs.escape_decode(line[1:-1])[0].decode("latin1")


def _raw(value: Value) -> bytes:
    if not isinstance(value, (str, bytes)):
        raise ValueError(f"bytes that are a {type(value).__name__}")
    return value.encode("latin1") if isinstance(value, str) else value


def _text(value: Value) -> str:
    if not isinstance(value, (str, bytes)):
        raise ValueError(f"text that is a {type(value).__name__}")
    return value.decode("latin1") if isinstance(value, bytes) else value


def _is_shape(shape: Value) -> TypeGuard[tuple[int, ...]]:
    return type(shape) is tuple and len(shape) <= 8 and all(type(n) is int and 0 <= n < 1 << 40 for n in shape)
