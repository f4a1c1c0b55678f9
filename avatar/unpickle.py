"""Pickled data of arrays: body models (.pkl) and pose sequences, read without running anything in them.

A pickle is a program. It is read in three steps, each bounded by the work that all of it together makes:

1. `_check_program` walks the opcodes without executing any: known ones only, at most MAX_STEPS, no memo beyond them,
   and no dict key or set item whose hash could be made expensive (tuples in tuples, integers that collide).
2. The standard library's Unpickler executes it. Every name that it asks for has to be in ADMITTED, and is answered
   with a class that only remembers what it was called with. Nothing is imported.
3. `_Builder` makes values of what was remembered: NumPy arrays, dtypes and scalars from their bytes, SciPy's CSC and
   CSR matrices and chumpy's Ch and Select, which old body models hold, as plain arrays; at most MAX_BYTES together.

Text of Python 2 is read as latin1.
"""

import io
import pickle
import pickletools
import warnings
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from avatar.errors import AssetError
from avatar.input_file import one_line, read_bytes

# of a file, and of all arrays made from it
MAX_BYTES = 1 << 29
# text may take four times its bytes in memory
MAX_TEXT_BYTES = 1 << 27
# opcodes; each makes at most one object, of a few hundred bytes
MAX_STEPS = 1_000_000
# containers inside containers
MAX_DEPTH = 100
# of a whole number, and of one that is a key: whole numbers below 2^61 - 1 have hashes of their own
MAX_INTEGER, MAX_KEY = 1 << 512, 1 << 60

NUMBER_TYPES = ("b1", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8", "f2", "f4", "f8")
_NUMPY, _BUILTIN = ("numpy.core", "numpy._core"), ("builtins", "__builtin__")
_SPARSE = ("csc_matrix", "csr_matrix", "csc_array", "csr_array")
# (module, name) and what is made of it
ADMITTED = {
    **{(f"{core}.multiarray", "_reconstruct"): "array" for core in _NUMPY},
    **{(f"{core}.multiarray", "scalar"): "scalar" for core in _NUMPY},
    **{(f"{core}.numeric", "_frombuffer"): "frombuffer" for core in _NUMPY},
    ("numpy", "ndarray"): "ndarray",
    ("numpy", "dtype"): "dtype",
    ("_codecs", "encode"): "encode",
    **{(module, "_reconstructor"): "reconstructor" for module in ("copy_reg", "copyreg")},
    ("collections", "OrderedDict"): "dict",
    ("collections", "defaultdict"): "defaultdict",
    **{(module, name): name for module in _BUILTIN for name in ("object", "set", "list", "dict", "bytes")},
    **{(module, "frozenset"): "set" for module in _BUILTIN},
    **{(module, "bytearray"): "bytes" for module in _BUILTIN},
    **{(f"scipy.sparse.{under}{name[:3]}", name): name[:3] for name in _SPARSE for under in ("", "_")},
    ("chumpy.ch", "Ch"): "ch",
    ("chumpy.reordering", "Select"): "select",
}
# objects whose state is a dict of fields
RECORDS = ("csc", "csr", "ch", "select")


class Refused(Exception):
    """Why a pickle is not read; becomes the AssetError."""


def read_pickle(path: Path | str, what: str) -> Any:
    """What the pickle at `path` holds: dicts, lists, tuples, text, bytes, numbers and NumPy arrays; sets as lists.

    `what` names the expected content in messages, for example "an SMPL+H model".

    Raises:
        AssetError: absent, too large, damaged, or it names something that is not admitted; nothing was run.
    """
    return unpickled(read_bytes(path, f"{what} (.pkl)", most=MAX_BYTES), path, f"{what} (.pkl)")


def unpickled(data: bytes, path: Path | str, what: str) -> Any:
    """What the pickle `data`, a part of the file at `path`, holds; AssetError as in `read_pickle`."""
    try:
        with warnings.catch_warnings():
            # of escapes that Python 2 let pass
            warnings.simplefilter("ignore", DeprecationWarning)
            _check_program(data)
            made = _executed(data)
        return _Builder().settled(made, 0)
    except Refused as error:
        raise AssetError(f"{path}: expected {what}, found: {error}") from None


# 1. the program, walked

_OPCODES = {ord(opcode.code): opcode for opcode in pickletools.opcodes}
_REFUSED = ("PERSID", "BINPERSID", "EXT1", "EXT2", "EXT4", "NEXT_BUFFER", "READONLY_BUFFER", "NEWOBJ_EX")
_MARK, _TUPLE, _NUMBER, _OTHER = "a mark", "a tuple", "a fraction or a long number", "an object"


def _check_program(data: bytes) -> None:
    """Walk the opcodes with a stack of kinds of values, as the Unpickler will with values."""
    program, stack, memo = io.BytesIO(data), list[str](), dict[int, str]()
    text = 0
    for _ in range(MAX_STEPS):
        at = program.tell()
        code = program.read(1)
        opcode = _OPCODES.get(code[0]) if code else None
        name = opcode.name if opcode is not None else repr(code)
        if not code:
            raise Refused(f"the file ends at byte {at}, before the pickle does")
        if opcode is None or name in _REFUSED:
            raise Refused(f"{name} at byte {at}, which no pickle of plain data has")
        try:
            # its text of Python 2 is no concern here
            argument: Any = (
                program.readline() if name == "STRING" else opcode.arg.reader(program) if opcode.arg else None
            )
        except ValueError as error:
            raise Refused(f"{name} at byte {at}: {one_line(error)}") from None
        if isinstance(argument, str):
            text += len(argument)
            if text > MAX_TEXT_BYTES:
                raise Refused(f"text of more than {MAX_TEXT_BYTES} letters")
        if name in ("PUT", "BINPUT", "LONG_BINPUT", "MEMOIZE"):
            key: Any = len(memo) if argument is None else argument
            if not 0 <= key < MAX_STEPS or not stack:
                raise Refused(f"object {key} to be remembered at byte {at}")
            memo[key] = stack[-1]
        elif name in ("GET", "BINGET", "LONG_BINGET"):
            if argument not in memo:
                raise Refused(f"a reference to object {argument}, which is not there, at byte {at}")
            stack.append(memo[argument])
        else:
            stack += _after(opcode, argument, at, stack)
        if name == "STOP":
            return
    raise Refused(f"more than {MAX_STEPS} objects; save arrays, not lists of numbers")


def _after(opcode: pickletools.OpcodeInfo, argument: Any, at: int, stack: list[str]) -> list[str]:
    """Takes from the stack what an opcode takes; the kinds that it leaves instead."""
    before, name = opcode.stack_before, opcode.name
    items: list[str] = []
    single = len(before)
    if pickletools.markobject in before:
        while stack and stack[-1] != _MARK:
            items.append(stack.pop())
        if not stack:
            raise Refused(f"{name} without a mark at byte {at}")
        stack.pop()
        items.reverse()
        # what lies under the mark
        single = before.index(pickletools.markobject)
    if len(stack) < single or (_MARK in stack[len(stack) - single :] and name != "POP"):
        raise Refused(f"{name} on an empty stack at byte {at}")
    taken = stack[len(stack) - single :]
    del stack[len(stack) - single :]
    hashed = items[::2] if name in ("DICT", "SETITEMS") else items if name in ("ADDITEMS", "FROZENSET") else []
    hashed = taken[1:2] if name == "SETITEM" else hashed
    for kind in (_TUPLE, _NUMBER):
        if kind in hashed:
            raise Refused(f"a key that is {kind} at byte {at}, expected text or a whole number")
    if name == "DUP":
        return 2 * taken
    if name in ("BUILD", "APPEND", "APPENDS", "SETITEM", "SETITEMS", "ADDITEMS"):
        return taken[:1]
    return [_kind(after, argument, at) for after in opcode.stack_after]


def _kind(after: pickletools.StackObject, argument: Any, at: int) -> str:
    if after is pickletools.markobject:
        return _MARK
    if after is pickletools.pytuple:
        return _TUPLE
    if isinstance(argument, int) and abs(argument) >= MAX_INTEGER:
        raise Refused(f"a whole number of {argument.bit_length()} bits at byte {at}")
    if isinstance(argument, float) or (isinstance(argument, int) and abs(argument) >= MAX_KEY):
        return _NUMBER
    return _OTHER


# 2. the program, executed


class _Call:
    """What the program makes by a name: the arguments and the state it gave, neither looked at yet."""

    __slots__ = ("arguments", "items", "state")
    kind, name = "", ""

    def __new__(cls, *arguments: Any) -> "_Call":
        made = super().__new__(cls)
        made.arguments, made.state, made.items = arguments, None, None
        return made

    def __setstate__(self, state: Any) -> None:
        self.state = state

    def __setitem__(self, key: Any, value: Any) -> None:
        self.items = self.items if self.items is not None else []
        self.items.append((key, value))


class _Reader(pickle.Unpickler):
    """The standard Unpickler, for which every admitted name is a class of its own that remembers."""

    def find_class(self, module: str, name: str) -> type[_Call]:
        full = f"{module}.{name}"[:100]
        if (module, name) not in ADMITTED:
            raise Refused(
                f"the name {full!r}, which is not one of NumPy arrays, SciPy CSC/CSR matrices and chumpy arrays; "
                "nothing was run: save the data as plain arrays"
            )
        return type("_Call", (_Call,), {"__slots__": (), "kind": ADMITTED[module, name], "name": full})


def _executed(data: bytes) -> Any:
    try:
        return _Reader(io.BytesIO(data), fix_imports=False, encoding="latin1").load()
    except Refused:
        raise
    # objects that do not go together fail in many ways: TypeError, AttributeError, IndexError ...
    except Exception as error:
        raise Refused(one_line(error)) from None


# 3. values of what was made


class _Builder:
    """Makes each value once, however often it is referred to, and counts what all of them take."""

    def __init__(self) -> None:
        # by id of the unsettled, all of which are held by the whole
        self.done: dict[int, Any] = {}
        self.open: set[int] = set()
        self.spent = self.counted = 0

    def spend(self, size: int) -> None:
        self.spent += size
        if self.spent > MAX_BYTES:
            raise Refused(f"arrays of more than {MAX_BYTES} bytes")

    def count(self, items: int) -> None:
        self.counted += items
        if self.counted > 2 * MAX_STEPS:
            raise Refused(f"containers of more than {2 * MAX_STEPS} items together")

    def settled(self, value: Any, depth: int) -> Any:
        if isinstance(value, type):
            return value.name
        if type(value) is bytearray:
            self.spend(len(value))
            return bytes(value)
        if not isinstance(value, (list, tuple, dict, set, frozenset, _Call)):
            return value
        key = id(value)
        if key in self.done:
            return self.done[key]
        if depth > MAX_DEPTH or key in self.open:
            raise Refused("containers that hold themselves, or deeper than expected")
        self.open.add(key)
        if isinstance(value, dict):
            result = self.make_dict(list(value.items()), depth)
        elif isinstance(value, _Call):
            try:
                result = getattr(self, f"make_{value.kind}")(value, depth)
            except (TypeError, ValueError, IndexError, KeyError, OverflowError, AttributeError) as error:
                raise Refused(f"{value.name} that cannot be rebuilt: {one_line(error)}") from None
        else:
            self.count(len(value))
            result = [self.settled(v, depth + 1) for v in value]
            result = tuple(result) if type(value) is tuple else result
        self.open.discard(key)
        self.done[key] = result
        return result

    def make_dict(self, made: Any, depth: int) -> dict[Any, Any]:
        items = made
        if isinstance(made, _Call):
            items = [*self.plain_items(made), *(made.items or [])] if made.kind == "dict" else made.items or []
        self.count(len(items))
        result = {}
        for key, value in items:
            key = self.settled(key, depth + 1)
            whole = isinstance(key, (int, np.integer, np.bool_)) and abs(int(key)) < MAX_KEY
            if not whole and not isinstance(key, (str, bytes, type(None))):
                raise Refused(f"a key that is a {type(key).__name__}, expected text or a whole number")
            result[key] = self.settled(value, depth + 1)
        return result

    make_defaultdict = make_dict

    def plain_items(self, made: _Call) -> list[Any]:
        """The items that a container is made of."""
        if not made.arguments:
            return []
        (items,) = made.arguments
        if not isinstance(items, (list, tuple, dict, set, frozenset)):
            raise ValueError(f"items that are a {type(items).__name__}")
        self.count(len(items))
        return list(items.items()) if isinstance(items, dict) else list(items)

    def make_set(self, made: _Call, depth: int) -> list[Any]:
        return [self.settled(item, depth + 1) for item in self.plain_items(made)]

    make_list = make_set

    def make_encode(self, made: _Call, depth: int) -> bytes:
        if [_text(name).lower().replace("-", "") for name in made.arguments[1:]] not in ([], ["latin1"], ["iso88591"]):
            raise ValueError(f"encoding {one_line(made.arguments[1])}")
        content = _text(made.arguments[0])
        self.spend(len(content))
        return content.encode("latin1")

    def make_bytes(self, made: _Call, depth: int) -> bytes:
        content = self.raw(made.arguments[0], depth) if made.arguments else b""
        self.spend(len(content))
        return content

    def raw(self, value: Any, depth: int) -> bytes:
        value = self.settled(value, depth + 1)
        if isinstance(value, str):
            self.spend(len(value))
            return value.encode("latin1")
        if isinstance(value, bytes):
            return value
        raise ValueError(f"bytes that are a {type(value).__name__}")

    def dtype(self, made: Any) -> np.dtype | None:
        """A NumPy type, None for objects."""
        if not isinstance(made, _Call) or made.kind != "dtype":
            raise ValueError(f"a type that is a {type(made).__name__}")
        code = _text(made.arguments[0]).lstrip("<>=|")
        letters = code[:1] in ("S", "U") and code[1:].isdecimal() and len(code) < 8
        if not letters and code not in (*NUMBER_TYPES, "O", "O8", "O4"):
            raise Refused(f"an array of type {code[:20]!r}, expected numbers or text")
        order = _text(made.state[1]) if made.state is not None else "="
        if order not in ("<", ">", "=", "|") or (made.state is not None and any(made.state[2:5])):
            raise Refused("an array with named fields, expected plain numbers")
        return None if code[0] == "O" else np.dtype((order if order != "|" else "=") + code)

    def make_dtype(self, made: _Call, depth: int) -> str:
        return str(self.dtype(made))

    def make_scalar(self, made: _Call, depth: int) -> Any:
        dtype = self.dtype(made.arguments[0])
        if dtype is None:
            raise ValueError("an object")
        return np.frombuffer(self.raw(made.arguments[1], depth), dtype, count=1)[0]

    def make_array(self, made: _Call, depth: int) -> Any:
        if _kind_named(made.arguments[0]) != "ndarray":
            raise ValueError(f"a base class {one_line(made.arguments[0])}")
        _, shape, dtype, by_columns, data = made.state
        dtype = self.dtype(dtype)
        if dtype is not None:
            return self.numbers_of(self.raw(data, depth), dtype, shape, bool(by_columns))
        # an array of objects: its list
        if type(data) is not list or not _valid_shape(shape) or prod(shape) != len(data):
            raise ValueError("objects that do not fill the array")
        return self.settled(data, depth + 1)

    def make_frombuffer(self, made: _Call, depth: int) -> np.ndarray:
        data, dtype, shape, order = made.arguments
        kind = self.dtype(dtype)
        if kind is None:
            raise ValueError("an object")
        return self.numbers_of(self.raw(data, depth), kind, shape, order == "F")

    def numbers_of(self, data: bytes, dtype: np.dtype, shape: Any, by_columns: bool) -> np.ndarray:
        if not _valid_shape(shape):
            raise ValueError("a shape that is none")
        if prod(shape) * dtype.itemsize != len(data) or dtype.itemsize == 0:
            raise ValueError(f"shape {shape} of {dtype} in {len(data)} bytes")
        self.spend(len(data))
        array = np.frombuffer(data, dtype).reshape(shape, order="F" if by_columns else "C")
        return array.astype(dtype.newbyteorder("="), copy=False)

    def make_reconstructor(self, made: _Call, depth: int) -> np.ndarray:
        kind, base = (_kind_named(value) for value in made.arguments[:2])
        if base != "object" or kind not in RECORDS:
            raise ValueError(f"{kind} on {base}")
        return getattr(self, f"make_{kind}")(made, depth)

    def fields(self, made: _Call) -> dict[str, Any]:
        state = made.state
        state = state[0] if type(state) is tuple and state else state
        if not isinstance(state, dict):
            raise ValueError(f"a state that is a {type(state).__name__}")
        return state

    def make_ch(self, made: _Call, depth: int) -> np.ndarray:
        return self.numbers(self.fields(made), "x", depth)

    def make_select(self, made: _Call, depth: int) -> np.ndarray:
        """chumpy's Select: some elements of another array, perhaps in another shape."""
        fields = self.fields(made)
        a, index = self.numbers(fields, "a", depth), self.numbers(fields, "idxs", depth)
        if index.dtype.kind not in "iu" or (index.size and not (index.min() >= 0 and index.max() < a.size)):
            raise ValueError("indices outside of their array")
        self.spend(a.nbytes + index.size * (8 + a.dtype.itemsize))
        picked = a.ravel()[index]
        shape = self.settled(fields.get("preferred_shape"), depth + 1)
        return picked if shape is None else picked.reshape(tuple(int(n) for n in np.atleast_1d(shape)))

    def make_csc(self, made: _Call, depth: int) -> np.ndarray:
        return self.dense(made, depth, by_columns=True)

    def make_csr(self, made: _Call, depth: int) -> np.ndarray:
        return self.dense(made, depth, by_columns=False)

    def dense(self, made: _Call, depth: int, *, by_columns: bool) -> np.ndarray:
        """A compressed sparse matrix as a plain one; repeated entries add up."""
        fields = self.fields(made)
        shape = self.settled(fields.get("_shape", fields.get("shape")), depth + 1)
        if not _valid_shape(shape) or len(shape) != 2:
            raise ValueError("a shape that is none")
        data, index, start = (self.numbers(fields, name, depth) for name in ("data", "indices", "indptr"))
        outer, inner = shape[::-1] if by_columns else shape
        if (
            data.ndim != 1
            or data.dtype.kind not in "fiu"
            or any(a.ndim != 1 or a.dtype.kind not in "iu" for a in (index, start))
            or len(start) != outer + 1
            or start[0] != 0
            or start[-1] > min(len(data), len(index))
            or (np.diff(start.astype(np.int64)) < 0).any()
        ):
            raise ValueError("pointers that do not fit the data")
        count = int(start[-1])
        self.spend(prod(shape) * data.dtype.itemsize + 24 * (count + outer))
        index, data = index[:count].astype(np.int64), data[:count]
        if count and not (index.min() >= 0 and index.max() < inner):
            raise ValueError("indices outside of the matrix")
        matrix = np.zeros((outer, inner), data.dtype)
        np.add.at(matrix, (np.repeat(np.arange(outer), np.diff(start.astype(np.int64))), index), data)
        return matrix.T if by_columns else matrix

    def numbers(self, fields: dict[str, Any], name: str, depth: int) -> np.ndarray:
        value = self.settled(fields[name], depth + 1)
        if isinstance(value, (int, float, np.number)):
            return np.array(value)
        if not isinstance(value, np.ndarray):
            raise ValueError(f"{name} that is a {type(value).__name__}")
        return value


def _kind_named(value: Any) -> str:
    """What an admitted name stands for."""
    if not (isinstance(value, type) and issubclass(value, _Call)):
        raise ValueError(f"a {type(value).__name__}, expected a name")
    return value.kind


def _text(value: Any) -> str:
    if isinstance(value, bytes):
        return value.decode("latin1")
    if isinstance(value, str):
        return value
    raise ValueError(f"text that is a {type(value).__name__}")


def _valid_shape(shape: Any) -> bool:
    return type(shape) is tuple and len(shape) <= 8 and all(type(n) is int and 0 <= n < 1 << 40 for n in shape)
