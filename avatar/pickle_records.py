"""Finished values: built ones out of their wrappers, and dense arrays of SciPy's and chumpy's records."""

from typing import Any

import numpy as np

from avatar.pickle_objects import RECORDS
from avatar.pickle_values import Built, Name, Refused, Source, product, shown, valid_shape

MAX_DEPTH = 100  # containers inside containers


class Settling:
    """Takes the built values out of their wrappers, each once, and makes dense arrays of the records."""

    def __init__(self, source: Source):
        self.source = source
        # by id; `kept` keeps every object alive
        self.done: dict[int, Any] = {}
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
        self.source.spend(index.size * a.dtype.itemsize)
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
        self.source.spend(product(shape) * data.dtype.itemsize)
        matrix = np.zeros((outer, inner), data.dtype)
        np.add.at(matrix, (np.repeat(np.arange(outer), np.diff(start.astype(np.int64))), index), data)
        return matrix.T if built.kind == "csc" else matrix
