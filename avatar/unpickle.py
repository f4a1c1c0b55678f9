"""Pickled data of arrays: body models (.pkl) and pose sequences, read without running anything in them.

A pickle is a program for a stack machine. This is that machine with nothing behind it: it knows plain values,
lists, tuples, dicts and sets, and a name that the program asks for is looked up in the short table ADMITTED,
never imported. NumPy arrays, dtypes and scalars are rebuilt from their bytes; SciPy's CSC and CSR matrices and
chumpy's Ch and Select, which old body models hold, become plain arrays. Any other name is refused.

Text of Python 2 is read as latin1. Files, steps and array bytes are bounded (MAX_BYTES, MAX_STEPS), so a file
that builds more than it holds is refused before the memory is spent.
"""

import codecs
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from avatar.errors import AssetError

MAX_BYTES = 1 << 29  # of a file, and of all arrays made from it
MAX_STEPS = 1_000_000  # a step makes at most one object, of a few hundred bytes
MAX_DEPTH = 100  # containers inside containers
NUMBER_TYPES = ("b1", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8", "f2", "f4", "f8")


class Name(NamedTuple):
    """A class or function that the pickle names."""

    module: str
    name: str

    def __str__(self) -> str:
        return f"{self.module}.{self.name}"[:100]


class Refused(Exception):
    """Why a pickle is not read; becomes the AssetError."""


class Built:
    """A value under construction: made by REDUCE or NEWOBJ, filled by BUILD, taken out at the end."""

    def __init__(self, kind: str, value: Any = None):
        self.kind, self.value = kind, value


_MARK = object()

_NUMPY = ("numpy.core", "numpy._core")
_BUILTIN = ("builtins", "__builtin__")
ADMITTED: dict[Name, str] = {
    **{Name(f"{core}.multiarray", "_reconstruct"): "array" for core in _NUMPY},
    **{Name(f"{core}.multiarray", "scalar"): "scalar" for core in _NUMPY},
    **{Name(f"{core}.numeric", "_frombuffer"): "frombuffer" for core in _NUMPY},
    Name("numpy", "ndarray"): "ndarray",
    Name("numpy", "dtype"): "dtype",
    Name("_codecs", "encode"): "encode",
    Name("copy_reg", "_reconstructor"): "reconstructor",
    Name("copyreg", "_reconstructor"): "reconstructor",
    Name("collections", "OrderedDict"): "dict",
    Name("collections", "defaultdict"): "defaultdict",
    **{Name(module, "object"): "object" for module in _BUILTIN},
    **{Name(module, "set"): "set" for module in _BUILTIN},
    **{Name(module, "frozenset"): "set" for module in _BUILTIN},
    **{Name(module, "list"): "list" for module in _BUILTIN},
    **{Name(module, "dict"): "dict" for module in _BUILTIN},
    **{Name(module, name): "bytes" for module in _BUILTIN for name in ("bytes", "bytearray")},
    **{Name(f"scipy.sparse.{m}", "csc_matrix"): "csc" for m in ("csc", "_csc")},
    **{Name(f"scipy.sparse.{m}", "csr_matrix"): "csr" for m in ("csr", "_csr")},
    **{Name(f"scipy.sparse.{m}", "csc_array"): "csc" for m in ("csc", "_csc")},
    **{Name(f"scipy.sparse.{m}", "csr_array"): "csr" for m in ("csr", "_csr")},
    Name("chumpy.ch", "Ch"): "ch",
    Name("chumpy.reordering", "Select"): "select",
}
RECORDS = ("csc", "csr", "ch", "select")  # objects whose state is a dict of fields


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
        return Machine(data).run()
    except Refused as error:
        raise AssetError(f"{path}: expected {what}, found: {error}") from None


class Machine:
    """The stack machine. Every opcode of protocols 0 to 5 is known or refused by its name."""

    def __init__(self, data: bytes):
        self.data, self.at = data, 0
        self.stack: list[Any] = []
        self.memo: dict[int, Any] = {}
        self.spent = 0  # bytes of arrays made

    def run(self) -> Any:
        for _ in range(MAX_STEPS):
            opcode = self.take(1)[0]
            if opcode == 0x2E:  # STOP
                value = self.pop()
                return Settling(self).settled(value, 0)
            step = STEPS.get(opcode)
            if step is None:
                name = UNREAD.get(opcode, f"byte {opcode:#04x}")
                raise Refused(f"{name} at byte {self.at - 1}, which no pickle of plain data has")
            step(self)
        raise Refused(f"more than {MAX_STEPS} objects; save arrays, not lists of numbers")

    # bytes of the file

    def take(self, count: int) -> bytes:
        end = self.at + count
        if count < 0 or end > len(self.data):
            raise Refused(f"the file ends at byte {len(self.data)}, {end - len(self.data)} too early")
        piece, self.at = self.data[self.at : end], end
        return piece

    def line(self) -> bytes:
        end = self.data.find(b"\n", self.at)
        if end < 0:
            raise Refused(f"the file ends within the line at byte {self.at}")
        piece, self.at = self.data[self.at : end], end + 1
        return piece

    def unsigned(self, size: int) -> int:
        return int.from_bytes(self.take(size), "little")

    def text_line(self) -> str:
        piece = self.line()
        return piece.rstrip(b"\r").decode("utf-8", "replace")

    # the stack

    def pop(self) -> Any:
        if not self.stack or self.stack[-1] is _MARK:
            raise Refused(f"an empty stack at byte {self.at}")
        return self.stack.pop()

    def top(self) -> Any:
        if not self.stack or self.stack[-1] is _MARK:
            raise Refused(f"an empty stack at byte {self.at}")
        return self.stack[-1]

    def since_mark(self) -> list[Any]:
        at = len(self.stack) - 1
        while at >= 0 and self.stack[at] is not _MARK:
            at -= 1
        if at < 0:
            raise Refused(f"no mark on the stack at byte {self.at}")
        items = self.stack[at + 1 :]
        del self.stack[at:]
        return items

    def spend(self, size: int) -> None:
        self.spent += size
        if self.spent > MAX_BYTES:
            raise Refused(f"arrays of more than {MAX_BYTES} bytes")

    def remember(self, key: int) -> None:
        self.memo[key] = self.top()

    def recall(self, key: int) -> None:
        if key not in self.memo:
            raise Refused(f"a reference to object {key}, which is not there, at byte {self.at}")
        self.stack.append(self.memo[key])

    # containers

    def extend(self, items: list[Any]) -> None:
        target = self.top()
        if isinstance(target, Built) and target.kind == "set":
            target.value += items
        elif type(target) is list:
            target += items
        else:
            raise Refused(f"items for {shown(target)} at byte {self.at}, expected a list")

    def set_items(self, items: list[Any]) -> None:
        target = self.top()
        if type(target) is not dict or len(items) % 2:
            raise Refused(f"keys and values for {shown(target)} at byte {self.at}, expected a dict")
        target.update(self.pairs(items))

    def pairs(self, items: list[Any]) -> dict[Any, Any]:
        keys = items[::2]
        for key in keys:
            # NumPy numbers may be keys; tuples may not: hashing nested ones costs without bound
            if isinstance(key, Built) and key.kind == "scalar":
                continue
            if type(key) not in (str, bytes, int, float, bool, type(None)):
                raise Refused(f"a dict key that is {shown(key)}, expected text or a number")
        keys = [key.value if isinstance(key, Built) else key for key in keys]
        return dict(zip(keys, items[1::2], strict=True))

    # names and objects

    def name(self, module: str, name: str) -> None:
        asked = Name(module, name)
        if asked not in ADMITTED:
            raise Refused(
                f"the name {str(asked)!r}, which is not one of NumPy arrays, SciPy CSC/CSR matrices and chumpy "
                "arrays; nothing was run: save the data as plain arrays"
            )
        self.stack.append(asked)

    def kind(self, value: Any) -> str:
        if not isinstance(value, Name):
            raise Refused(f"a call of {shown(value)} at byte {self.at}, expected a name")
        return ADMITTED[value]

    def call(self, name: Any, arguments: Any) -> Any:
        """What REDUCE and NEWOBJ make."""
        kind = self.kind(name)
        if type(arguments) is not tuple:
            raise Refused(f"arguments of {name} that are {shown(arguments)}, expected a tuple")
        try:
            return self.made(kind, name, arguments)
        except (TypeError, ValueError, IndexError, KeyError, OverflowError, UnicodeError) as error:
            raise Refused(f"{name} that cannot be rebuilt: {shown(error)}") from None

    def made(self, kind: str, name: Any, arguments: tuple) -> Any:
        if kind == "reconstructor":
            inner, base = arguments[:2]
            if self.kind(base) != "object" or self.kind(inner) not in RECORDS:
                raise ValueError(f"{inner} on {base}")
            return Built(self.kind(inner), {})
        if kind in RECORDS:
            if arguments:
                raise ValueError(f"{len(arguments)} arguments, expected a state")
            return Built(kind, {})
        if kind == "array":
            if self.kind(arguments[0]) != "ndarray":
                raise ValueError(f"a base class {arguments[0]}")
            return Built("array")
        if kind == "frombuffer":
            data, kind_of, shape, order = arguments
            dtype = dtype_of(kind_of)
            if dtype is None:
                raise ValueError("an object")
            return Built("array", self.array(raw(data), dtype, shape, order == "F"))
        if kind == "dtype":
            code = text(arguments[0]).lstrip("<>=|")
            if code not in (*NUMBER_TYPES, "O", "O8", "O4") and not (
                code[:1] in ("S", "U") and code[1:].isdecimal() and len(code) < 8
            ):
                raise Refused(f"an array of type {text(arguments[0])!r}, expected numbers or text")
            return Built("dtype", [code, "="])
        if kind == "scalar":
            dtype = dtype_of(arguments[0])
            if dtype is None:
                raise ValueError("an object")
            return Built("scalar", np.frombuffer(raw(arguments[1]), dtype, count=1)[0])
        if kind == "encode":
            content = text(arguments[0])
            if arguments[1:] and text(arguments[1]).lower().replace("-", "") not in ("latin1", "iso88591"):
                raise ValueError(f"encoding {shown(arguments[1])}")
            self.spend(len(content))
            return content.encode("latin1")
        if kind == "bytes":
            content = raw(arguments[0]) if arguments else b""
            self.spend(len(content))
            return content
        if kind == "set":
            return Built("set", list(plain_items(arguments)))
        if kind == "list":
            return list(plain_items(arguments))
        if kind == "defaultdict":
            return {}
        if kind == "dict":
            items = plain_items(arguments)
            if any(type(item) not in (tuple, list) or len(item) != 2 for item in items):
                raise ValueError("items that are not pairs")
            return self.pairs([part for item in items for part in item])
        raise Refused(f"a call of {name}")

    def build(self, target: Any, state: Any) -> None:
        """What BUILD does: gives an object its state."""
        try:
            if isinstance(target, Built) and target.kind == "dtype":
                order = text(state[1])
                if order not in "<>=|" or any(state[2:5]):
                    raise Refused("an array with named fields, expected plain numbers")
                target.value[1] = order
            elif isinstance(target, Built) and target.kind == "array" and target.value is None:
                _, shape, dtype, by_columns, data = state
                dtype = dtype_of(dtype)
                if dtype is None:  # an array of objects: its list
                    if type(data) is not list or not valid_shape(shape) or product(shape) != len(data):
                        raise ValueError("objects that do not fill the array")
                    target.value = data
                else:
                    target.value = self.array(raw(data), dtype, shape, bool(by_columns))
            elif isinstance(target, Built) and target.kind in RECORDS:
                state = state[0] if type(state) is tuple and state and type(state[0]) is dict else state
                if type(state) is not dict:
                    raise ValueError(f"a state that is {shown(state)}")
                target.value.update(state)
            else:
                raise ValueError("a state where none belongs")
        except (TypeError, ValueError, IndexError, KeyError, OverflowError) as error:
            raise Refused(f"{shown(target)} that cannot be rebuilt: {shown(error)}") from None

    def array(self, data: bytes, dtype: np.dtype, shape: Any, by_columns: bool) -> np.ndarray:
        if not valid_shape(shape):
            raise ValueError(f"shape {shown(shape)}")
        if product(shape) * dtype.itemsize != len(data) or dtype.itemsize == 0:
            raise ValueError(f"shape {shown(shape)} of {dtype} in {len(data)} bytes")
        self.spend(len(data))
        array = np.frombuffer(data, dtype).reshape(shape, order="F" if by_columns else "C")
        return array.astype(dtype.newbyteorder("=")) if not dtype.isnative else array


class Settling:
    """Takes the built values out of their wrappers, each once, and makes dense arrays of the records."""

    def __init__(self, machine: Machine):
        self.machine = machine
        self.done: dict[int, Any] = {}  # by id; the machine keeps every object alive through `kept`
        self.kept: list[Any] = []
        self.open: set[int] = set()

    def settled(self, value: Any, depth: int) -> Any:
        if type(value) not in (list, tuple, dict) and not isinstance(value, (Built, Name)):
            return value
        key = id(value)
        if key in self.done:
            return self.done[key]
        if depth > MAX_DEPTH or key in self.open:
            raise Refused("containers that hold themselves, or deeper than expected")
        self.open.add(key)
        result: Any
        if isinstance(value, Name):
            result = str(value)
        elif type(value) is dict:
            result = {k: self.settled(v, depth + 1) for k, v in value.items()}
        elif type(value) is list:
            result = [self.settled(v, depth + 1) for v in value]
        elif type(value) is tuple:
            result = tuple([self.settled(v, depth + 1) for v in value])
        else:
            result = self.taken_out(value, depth)
        self.open.discard(key)
        self.kept.append(value)
        self.done[key] = result
        return result

    def taken_out(self, built: Built, depth: int) -> Any:
        if built.kind == "dtype":
            return "".join(built.value[::-1])
        if built.kind not in RECORDS:
            return self.settled(built.value, depth + 1)
        try:
            if built.kind in ("csc", "csr"):
                return self.dense(built, depth)
            if built.kind == "ch":
                return self.numbers(built, "x", depth)
            return self.selected(built, depth)
        except KeyError as error:
            raise Refused(f"a {built.kind} object without {error}") from None
        except (TypeError, ValueError, IndexError, OverflowError) as error:
            raise Refused(f"a {built.kind} object that cannot be rebuilt: {shown(error)}") from None

    def numbers(self, built: Built, field: str, depth: int) -> np.ndarray:
        value = self.settled(built.value[field], depth + 1)
        if isinstance(value, (int, float, np.number)):
            return np.array(value)
        if not isinstance(value, np.ndarray):
            raise ValueError(f"{field} that is {shown(value)}")
        return value

    def selected(self, built: Built, depth: int) -> np.ndarray:
        """chumpy's Select: some elements of another array, perhaps in another shape."""
        a, index = self.numbers(built, "a", depth), self.numbers(built, "idxs", depth)
        if index.dtype.kind not in "iu" or (index.size and not (index.min() >= 0 and index.max() < a.size)):
            raise ValueError("indices outside of their array")
        self.machine.spend(index.size * a.dtype.itemsize)
        picked = a.ravel()[index]
        shape = self.settled(built.value.get("preferred_shape"), depth + 1)
        return picked if shape is None else picked.reshape(tuple(int(n) for n in np.atleast_1d(shape)))

    def dense(self, built: Built, depth: int) -> np.ndarray:
        """A compressed sparse matrix (columns or rows) as a plain one; repeated entries add up."""
        shape = self.settled(built.value.get("_shape", built.value.get("shape")), depth + 1)
        if type(shape) is not tuple or len(shape) != 2 or not valid_shape(shape):
            raise ValueError(f"shape {shown(shape)}")
        data = self.numbers(built, "data", depth)
        index, start = (self.numbers(built, name, depth) for name in ("indices", "indptr"))
        outer, inner = (shape[1], shape[0]) if built.kind == "csc" else (shape[0], shape[1])
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
        index, data = index[:count].astype(np.int64), data[:count]
        if count and not (index.min() >= 0 and index.max() < inner):
            raise ValueError("indices outside of the matrix")
        self.machine.spend(product(shape) * data.dtype.itemsize)
        matrix = np.zeros((outer, inner), data.dtype)
        np.add.at(matrix, (np.repeat(np.arange(outer), np.diff(start.astype(np.int64))), index), data)
        return matrix.T if built.kind == "csc" else matrix


def shown(value: Any) -> str:
    """A value for a message: its kind where it is large."""
    if isinstance(value, Built):
        return f"a {value.kind}"
    if isinstance(value, Exception):
        return str(value)[:120] or type(value).__name__
    if isinstance(value, (str, bytes, int, float, type(None))):
        return repr(value)[:60] if not isinstance(value, int) or abs(value) < 1 << 64 else "a long number"
    if type(value) is tuple and len(value) < 9 and all(type(v) is int and abs(v) < 1 << 64 for v in value):
        return repr(value)
    return f"a {type(value).__name__}"


def raw(value: Any) -> bytes:
    if isinstance(value, str):
        return value.encode("latin1")
    if isinstance(value, bytes):
        return value
    raise ValueError(f"bytes that are {shown(value)}")


def text(value: Any) -> str:
    if isinstance(value, bytes):
        return value.decode("latin1")
    if isinstance(value, str):
        return value
    raise ValueError(f"text that is {shown(value)}")


def dtype_of(value: Any) -> np.dtype | None:
    """The NumPy type, None for objects."""
    if not isinstance(value, Built) or value.kind != "dtype":
        raise ValueError(f"a type that is {shown(value)}")
    code, order = value.value
    return None if code[0] == "O" else np.dtype((order if order != "|" else "=") + code)


def plain_items(arguments: tuple) -> list[Any]:
    if not arguments:
        return []
    if len(arguments) != 1 or type(arguments[0]) not in (list, tuple):
        raise ValueError(f"arguments that are {shown(arguments)}")
    return list(arguments[0])


def valid_shape(shape: Any) -> bool:
    return (
        type(shape) is tuple and len(shape) <= 8 and all(type(n) is int and 0 <= n < 1 << 40 for n in shape)
    )


def product(shape: tuple) -> int:
    size = 1
    for n in shape:
        size *= n
    return size


def _push(value: Callable[[Machine], Any]) -> Callable[[Machine], None]:
    return lambda m: m.stack.append(value(m))


def _counted(size: int, decode: Callable[[bytes], Any]) -> Callable[[Machine], None]:
    return lambda m: m.stack.append(decode(m.take(m.unsigned(size))))


def _utf8(data: bytes) -> str:
    return data.decode("utf-8", "replace")


def _latin1(data: bytes) -> str:
    return data.decode("latin1")


def _integer(data: bytes) -> int:
    if len(data) > 64:
        raise Refused(f"a whole number of {len(data)} bytes")
    return int.from_bytes(data, "little", signed=True)


def _integer_line(m: Machine) -> int | bool:
    line = m.text_line()
    if line in ("00", "01"):  # Python 2's False and True
        return line == "01"
    return _decimal(line.rstrip("L"))


def _decimal(line: str) -> int:
    if not line.lstrip("-").isdecimal() or len(line) > 30:
        raise Refused(f"{line[:20]!r} for a whole number")
    return int(line)


def _float_line(m: Machine) -> float:
    line = m.text_line()
    try:
        return float(line)
    except ValueError:
        raise Refused(f"{line[:20]!r} for a number") from None


def _quoted(m: Machine) -> str:
    line = m.line().strip()
    if len(line) < 2 or line[:1] not in (b"'", b'"') or line[-1:] != line[:1]:
        raise Refused(f"text without quotes before byte {m.at}")
    try:
        return _latin1(codecs.escape_decode(line[1:-1])[0])  # type: ignore[attr-defined]
    except ValueError:
        raise Refused(f"text that is not one before byte {m.at}") from None


def _unicode_line(m: Machine) -> str:
    try:
        return m.line().decode("raw-unicode-escape")
    except ValueError:
        raise Refused(f"text that is not one before byte {m.at}") from None


def _dict(m: Machine) -> dict:
    items = m.since_mark()
    if len(items) % 2:
        raise Refused(f"a dict with a key and no value at byte {m.at}")
    return m.pairs(items)


def _tuple(count: int) -> Callable[[Machine], None]:
    return lambda m: m.stack.append(tuple([m.pop() for _ in range(count)][::-1]))


def _reduce(m: Machine) -> None:
    arguments, name = m.pop(), m.pop()
    m.stack.append(m.call(name, arguments))


def _new_object(m: Machine) -> None:
    _reduce(m)


def _new_object_with_keywords(m: Machine) -> None:
    if m.pop() != {}:
        raise Refused(f"keyword arguments at byte {m.at}")
    _reduce(m)


def _build(m: Machine) -> None:
    state = m.pop()
    m.build(m.top(), state)


def _global(m: Machine) -> None:
    module, name = m.text_line(), m.text_line()
    m.name(module, name)


def _stack_global(m: Machine) -> None:
    name, module = m.pop(), m.pop()
    if not isinstance(name, str) or not isinstance(module, str):
        raise Refused(f"a name that is not text at byte {m.at}")
    m.name(module, name)


def _object(m: Machine) -> None:
    items = m.since_mark()
    if not items:
        raise Refused(f"an object without a class at byte {m.at}")
    m.stack.append(m.call(items[0], tuple(items[1:])))


def _instance(m: Machine) -> None:
    items = m.since_mark()
    _global(m)
    m.stack.append(m.call(m.pop(), tuple(items)))


def _pop(m: Machine) -> None:
    if not m.stack:
        raise Refused(f"an empty stack at byte {m.at}")
    m.stack.pop()


def _append(m: Machine) -> None:
    item = m.pop()
    m.extend([item])


def _set_item(m: Machine) -> None:
    value, key = m.pop(), m.pop()
    m.set_items([key, value])


# pickletools' names of the opcodes beside each
STEPS: dict[int, Callable[[Machine], None]] = {
    ord("("): lambda m: m.stack.append(_MARK),  # MARK
    ord("0"): _pop,  # POP
    ord("1"): lambda m: void(m.since_mark()),  # POP_MARK
    ord("2"): _push(lambda m: m.top()),  # DUP
    ord("F"): _push(_float_line),  # FLOAT
    ord("I"): _push(_integer_line),  # INT
    ord("L"): _push(_integer_line),  # LONG
    ord("J"): _push(lambda m: int.from_bytes(m.take(4), "little", signed=True)),  # BININT
    ord("K"): _push(lambda m: m.unsigned(1)),  # BININT1
    ord("M"): _push(lambda m: m.unsigned(2)),  # BININT2
    ord("N"): _push(lambda m: None),  # NONE
    ord("G"): _push(lambda m: struct.unpack(">d", m.take(8))[0]),  # BINFLOAT
    ord("S"): _push(_quoted),  # STRING
    ord("T"): _counted(4, _latin1),  # BINSTRING
    ord("U"): _counted(1, _latin1),  # SHORT_BINSTRING
    ord("V"): _push(_unicode_line),  # UNICODE
    ord("X"): _counted(4, _utf8),  # BINUNICODE
    ord("B"): _counted(4, bytes),  # BINBYTES
    ord("C"): _counted(1, bytes),  # SHORT_BINBYTES
    ord("R"): _reduce,  # REDUCE
    ord("b"): _build,  # BUILD
    ord("c"): _global,  # GLOBAL
    ord("o"): _object,  # OBJ
    ord("i"): _instance,  # INST
    ord("a"): _append,  # APPEND
    ord("e"): lambda m: m.extend(m.since_mark()),  # APPENDS
    ord("d"): _push(_dict),  # DICT
    ord("}"): _push(lambda m: {}),  # EMPTY_DICT
    ord("l"): _push(lambda m: m.since_mark()),  # LIST
    ord("]"): _push(lambda m: []),  # EMPTY_LIST
    ord("t"): _push(lambda m: tuple(m.since_mark())),  # TUPLE
    ord(")"): _push(lambda m: ()),  # EMPTY_TUPLE
    ord("s"): _set_item,  # SETITEM
    ord("u"): lambda m: m.set_items(m.since_mark()),  # SETITEMS
    ord("p"): lambda m: m.remember(_decimal(m.text_line())),  # PUT
    ord("q"): lambda m: m.remember(m.unsigned(1)),  # BINPUT
    ord("r"): lambda m: m.remember(m.unsigned(4)),  # LONG_BINPUT
    ord("g"): lambda m: m.recall(_decimal(m.text_line())),  # GET
    ord("h"): lambda m: m.recall(m.unsigned(1)),  # BINGET
    ord("j"): lambda m: m.recall(m.unsigned(4)),  # LONG_BINGET
    0x80: lambda m: void(m.take(1)),  # PROTO
    0x81: _new_object,  # NEWOBJ
    0x85: _tuple(1),  # TUPLE1
    0x86: _tuple(2),  # TUPLE2
    0x87: _tuple(3),  # TUPLE3
    0x88: _push(lambda m: True),  # NEWTRUE
    0x89: _push(lambda m: False),  # NEWFALSE
    0x8A: _counted(1, _integer),  # LONG1
    0x8B: _counted(4, _integer),  # LONG4
    0x8C: _counted(1, _utf8),  # SHORT_BINUNICODE
    0x8D: _counted(8, _utf8),  # BINUNICODE8
    0x8E: _counted(8, bytes),  # BINBYTES8
    0x8F: _push(lambda m: Built("set", [])),  # EMPTY_SET
    0x90: lambda m: m.extend(m.since_mark()),  # ADDITEMS
    0x91: _push(lambda m: Built("set", m.since_mark())),  # FROZENSET
    0x92: _new_object_with_keywords,  # NEWOBJ_EX
    0x93: _stack_global,  # STACK_GLOBAL
    0x94: lambda m: m.remember(len(m.memo)),  # MEMOIZE
    0x95: lambda m: void(m.take(8)),  # FRAME
    0x96: _counted(8, bytes),  # BYTEARRAY8
}
UNREAD = {
    ord("P"): "PERSID", ord("Q"): "BINPERSID", 0x82: "EXT1", 0x83: "EXT2", 0x84: "EXT4",
    0x97: "NEXT_BUFFER", 0x98: "READONLY_BUFFER",
}  # fmt: skip


def void(_: object) -> None:
    """A step whose value is not kept."""
