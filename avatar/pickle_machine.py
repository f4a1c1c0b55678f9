"""The stack machine that a pickle is a program for, with nothing behind it: every opcode of protocols 0 to 5."""

import codecs
import struct
from collections.abc import Callable
from typing import Any

from avatar.pickle_objects import ADMITTED, called, fill, pairs
from avatar.pickle_records import Settling
from avatar.pickle_values import Built, Name, Refused, Source, shown

_MARK = object()


class Machine:
    """Stack, marks and memo. Every opcode is known or refused by its name; steps and bytes are bounded."""

    def __init__(self, data: bytes, *, most_steps: int, most_bytes: int):
        self.source, self.most_steps = Source(data, most_bytes), most_steps
        self.stack: list[Any] = []
        self.memo: dict[int, Any] = {}

    def run(self) -> Any:
        for _ in range(self.most_steps):
            opcode = self.source.take(1)[0]
            if opcode == 0x2E:  # STOP
                value = self.pop()
                return Settling(self.source).settled(value, 0)
            step = STEPS.get(opcode)
            if step is None:
                name = UNREAD.get(opcode, f"byte {opcode:#04x}")
                raise Refused(f"{name} at byte {self.source.at - 1}, which no pickle of plain data has")
            step(self)
        raise Refused(f"more than {self.most_steps} objects; save arrays, not lists of numbers")

    # the stack

    def pop(self) -> Any:
        if not self.stack or self.stack[-1] is _MARK:
            raise Refused(f"an empty stack at byte {self.source.at}")
        return self.stack.pop()

    def top(self) -> Any:
        if not self.stack or self.stack[-1] is _MARK:
            raise Refused(f"an empty stack at byte {self.source.at}")
        return self.stack[-1]

    def since_mark(self) -> list[Any]:
        at = len(self.stack) - 1
        while at >= 0 and self.stack[at] is not _MARK:
            at -= 1
        if at < 0:
            raise Refused(f"no mark on the stack at byte {self.source.at}")
        items = self.stack[at + 1 :]
        del self.stack[at:]
        return items

    def remember(self, key: int) -> None:
        self.memo[key] = self.top()

    def recall(self, key: int) -> None:
        if key not in self.memo:
            raise Refused(f"a reference to object {key}, which is not there, at byte {self.source.at}")
        self.stack.append(self.memo[key])

    # containers

    def extend(self, items: list[Any]) -> None:
        target = self.top()
        if isinstance(target, Built) and target.kind == "set":
            target.value += items
        elif type(target) is list:
            target += items
        else:
            raise Refused(f"items for {shown(target)} at byte {self.source.at}, expected a list")

    def set_items(self, items: list[Any]) -> None:
        target = self.top()
        if type(target) is not dict or len(items) % 2:
            raise Refused(f"keys and values for {shown(target)} at byte {self.source.at}, expected a dict")
        target.update(pairs(items))

    def name(self, module: str, name: str) -> None:
        asked = Name(module, name)
        if asked not in ADMITTED:
            raise Refused(
                f"the name {str(asked)!r}, which is not one of NumPy arrays, SciPy CSC/CSR matrices and chumpy "
                "arrays; nothing was run: save the data as plain arrays"
            )
        self.stack.append(asked)


def _push(value: Callable[[Machine], Any]) -> Callable[[Machine], None]:
    return lambda m: m.stack.append(value(m))


def _counted(size: int, decode: Callable[[bytes], Any]) -> Callable[[Machine], None]:
    return lambda m: m.stack.append(decode(m.source.take(m.source.unsigned(size))))


def _utf8(data: bytes) -> str:
    return data.decode("utf-8", "replace")


def _latin1(data: bytes) -> str:
    return data.decode("latin1")


def _integer(data: bytes) -> int:
    if len(data) > 64:
        raise Refused(f"a whole number of {len(data)} bytes")
    return int.from_bytes(data, "little", signed=True)


def _integer_line(m: Machine) -> int | bool:
    line = m.source.text_line()
    if line in ("00", "01"):  # Python 2's False and True
        return line == "01"
    return _decimal(line.rstrip("L"))


def _decimal(line: str) -> int:
    if not line.lstrip("-").isdecimal() or len(line) > 30:
        raise Refused(f"{line[:20]!r} for a whole number")
    return int(line)


def _float_line(m: Machine) -> float:
    line = m.source.text_line()
    try:
        return float(line)
    except ValueError:
        raise Refused(f"{line[:20]!r} for a number") from None


def _quoted(m: Machine) -> str:
    line = m.source.line().strip()
    if len(line) < 2 or line[:1] not in (b"'", b'"') or line[-1:] != line[:1]:
        raise Refused(f"text without quotes before byte {m.source.at}")
    try:
        return _latin1(codecs.escape_decode(line[1:-1])[0])  # type: ignore[attr-defined]
    except ValueError:
        raise Refused(f"text that is not one before byte {m.source.at}") from None


def _unicode_line(m: Machine) -> str:
    try:
        return m.source.line().decode("raw-unicode-escape")
    except ValueError:
        raise Refused(f"text that is not one before byte {m.source.at}") from None


def _dict(m: Machine) -> dict:
    items = m.since_mark()
    if len(items) % 2:
        raise Refused(f"a dict with a key and no value at byte {m.source.at}")
    return pairs(items)


def _tuple(count: int) -> Callable[[Machine], None]:
    return lambda m: m.stack.append(tuple([m.pop() for _ in range(count)][::-1]))


def _reduce(m: Machine) -> None:
    arguments, name = m.pop(), m.pop()
    m.stack.append(called(m.source, name, arguments))


def _new_object(m: Machine) -> None:
    _reduce(m)


def _new_object_with_keywords(m: Machine) -> None:
    if m.pop() != {}:
        raise Refused(f"keyword arguments at byte {m.source.at}")
    _reduce(m)


def _build(m: Machine) -> None:
    state = m.pop()
    fill(m.source, m.top(), state)


def _global(m: Machine) -> None:
    module, name = m.source.text_line(), m.source.text_line()
    m.name(module, name)


def _stack_global(m: Machine) -> None:
    name, module = m.pop(), m.pop()
    if not isinstance(name, str) or not isinstance(module, str):
        raise Refused(f"a name that is not text at byte {m.source.at}")
    m.name(module, name)


def _object(m: Machine) -> None:
    items = m.since_mark()
    if not items:
        raise Refused(f"an object without a class at byte {m.source.at}")
    m.stack.append(called(m.source, items[0], tuple(items[1:])))


def _instance(m: Machine) -> None:
    items = m.since_mark()
    _global(m)
    m.stack.append(called(m.source, m.pop(), tuple(items)))


def _pop(m: Machine) -> None:
    if not m.stack:
        raise Refused(f"an empty stack at byte {m.source.at}")
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
    ord("J"): _push(lambda m: int.from_bytes(m.source.take(4), "little", signed=True)),  # BININT
    ord("K"): _push(lambda m: m.source.unsigned(1)),  # BININT1
    ord("M"): _push(lambda m: m.source.unsigned(2)),  # BININT2
    ord("N"): _push(lambda m: None),  # NONE
    ord("G"): _push(lambda m: struct.unpack(">d", m.source.take(8))[0]),  # BINFLOAT
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
    ord("p"): lambda m: m.remember(_decimal(m.source.text_line())),  # PUT
    ord("q"): lambda m: m.remember(m.source.unsigned(1)),  # BINPUT
    ord("r"): lambda m: m.remember(m.source.unsigned(4)),  # LONG_BINPUT
    ord("g"): lambda m: m.recall(_decimal(m.source.text_line())),  # GET
    ord("h"): lambda m: m.recall(m.source.unsigned(1)),  # BINGET
    ord("j"): lambda m: m.recall(m.source.unsigned(4)),  # LONG_BINGET
    0x80: lambda m: void(m.source.take(1)),  # PROTO
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
    0x95: lambda m: void(m.source.take(8)),  # FRAME
    0x96: _counted(8, bytes),  # BYTEARRAY8
}
UNREAD = {
    ord("P"): "PERSID", ord("Q"): "BINPERSID", 0x82: "EXT1", 0x83: "EXT2", 0x84: "EXT4",
    0x97: "NEXT_BUFFER", 0x98: "READONLY_BUFFER",
}  # fmt: skip


def void(_: object) -> None:
    """A step whose value is not kept."""
