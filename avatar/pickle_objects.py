"""The few names a pickle may ask for, and what is made of each: none of them is imported or called.

NumPy arrays, dtypes and scalars are rebuilt from their bytes, plain containers from their items. SciPy's and
chumpy's objects are kept as records of their fields (avatar/pickle_records.py makes arrays of them).
"""

from typing import Any

import numpy as np

from avatar.pickle_values import (
    Built,
    Name,
    Refused,
    Source,
    dtype_of,
    plain_items,
    product,
    raw,
    shown,
    text,
    valid_shape,
)

NUMBER_TYPES = ("b1", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8", "f2", "f4", "f8")

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
# objects whose state is a dict of fields
RECORDS = ("csc", "csr", "ch", "select")


def pairs(items: list[Any]) -> dict[Any, Any]:
    keys = items[::2]
    for key in keys:
        # NumPy numbers may be keys; tuples may not: hashing nested ones costs without bound
        if isinstance(key, Built) and key.kind == "scalar":
            continue
        if type(key) not in (str, bytes, int, float, bool, type(None)):
            raise Refused(f"a dict key that is {shown(key)}, expected text or a number")
    keys = [key.value if isinstance(key, Built) else key for key in keys]
    return dict(zip(keys, items[1::2], strict=True))


def kind_of_name(source: Source, value: Any) -> str:
    if not isinstance(value, Name):
        raise Refused(f"a call of {shown(value)} at byte {source.at}, expected a name")
    return ADMITTED[value]


def called(source: Source, name: Any, arguments: Any) -> Any:
    """What REDUCE and NEWOBJ make."""
    kind = kind_of_name(source, name)
    if type(arguments) is not tuple:
        raise Refused(f"arguments of {name} that are {shown(arguments)}, expected a tuple")
    try:
        return _made(source, kind, name, arguments)
    except (TypeError, ValueError, IndexError, KeyError, OverflowError, UnicodeError) as error:
        raise Refused(f"{name} that cannot be rebuilt: {shown(error)}") from None


def _made(source: Source, kind: str, name: Any, arguments: tuple) -> Any:
    if kind == "reconstructor":
        inner, base = arguments[:2]
        if kind_of_name(source, base) != "object" or kind_of_name(source, inner) not in RECORDS:
            raise ValueError(f"{inner} on {base}")
        return Built(kind_of_name(source, inner), {})
    if kind in RECORDS:
        if arguments:
            raise ValueError(f"{len(arguments)} arguments, expected a state")
        return Built(kind, {})
    if kind == "array":
        if kind_of_name(source, arguments[0]) != "ndarray":
            raise ValueError(f"a base class {arguments[0]}")
        return Built("array")
    if kind == "frombuffer":
        data, kind_of, shape, order = arguments
        dtype = dtype_of(kind_of)
        if dtype is None:
            raise ValueError("an object")
        return Built("array", _array(source, raw(data), dtype, shape, order == "F"))
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
        source.spend(len(content))
        return content.encode("latin1")
    if kind == "bytes":
        content = raw(arguments[0]) if arguments else b""
        source.spend(len(content))
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
        return pairs([part for item in items for part in item])
    raise Refused(f"a call of {name}")


def fill(source: Source, target: Any, state: Any) -> None:
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
            # an array of objects: its list
            if dtype is None:
                if type(data) is not list or not valid_shape(shape) or product(shape) != len(data):
                    raise ValueError("objects that do not fill the array")
                target.value = data
            else:
                target.value = _array(source, raw(data), dtype, shape, bool(by_columns))
        elif isinstance(target, Built) and target.kind in RECORDS:
            state = state[0] if type(state) is tuple and state and type(state[0]) is dict else state
            if type(state) is not dict:
                raise ValueError(f"a state that is {shown(state)}")
            target.value.update(state)
        else:
            raise ValueError("a state where none belongs")
    except (TypeError, ValueError, IndexError, KeyError, OverflowError) as error:
        raise Refused(f"{shown(target)} that cannot be rebuilt: {shown(error)}") from None


def _array(source: Source, data: bytes, dtype: np.dtype, shape: Any, by_columns: bool) -> np.ndarray:
    if not valid_shape(shape):
        raise ValueError(f"shape {shown(shape)}")
    if product(shape) * dtype.itemsize != len(data) or dtype.itemsize == 0:
        raise ValueError(f"shape {shown(shape)} of {dtype} in {len(data)} bytes")
    source.spend(len(data))
    array = np.frombuffer(data, dtype).reshape(shape, order="F" if by_columns else "C")
    return array.astype(dtype.newbyteorder("=")) if not dtype.isnative else array
