"""The field that is baked: asked with NumPy arrays, in pieces, on all cores."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import torch
from numpy import ndarray as Array

from command.workers import on_all_cores
from train.fused import CanonicalField

NumpyField = CanonicalField[Array]
# points asked at once
PIECE = 1 << 15


def numpy_field(field: CanonicalField[torch.Tensor]) -> NumpyField:
    """The field behind functions that take and give float64."""

    def asked(function: Callable[..., torch.Tensor]) -> Callable[..., Array]:
        """The function of tensors as one of arrays."""

        def answers(*arrays: Array) -> Array:
            """What the function gives; a piece for each core: within one, most of the time is spent between torch's own
            parallel loops."""

            def answer(start: int) -> Array:
                tensors = [torch.from_numpy(np.ascontiguousarray(a[start : start + PIECE], np.float32)) for a in arrays]
                return function(*tensors).detach().cpu().numpy().astype(np.float64)

            pieces = list(on_all_cores(answer, range(0, len(arrays[0]), PIECE)))
            return np.concatenate(pieces) if pieces else np.zeros((0, 3))

        return answers

    distance, seen, lit = asked(field.distance), field.seen_light, field.light_normal
    return NumpyField(
        lambda points: distance(points).reshape(-1), asked(field.normal), asked(field.color),
        None if seen is None else asked(seen), None if lit is None else asked(lit), field.details,
    )  # fmt: skip


@contextmanager
def one_thread() -> Iterator[None]:
    """Torch on one thread: on a machine that others use too, its threads wait for each other by spinning, and a
    picture of the field was measured to take seven times its processor seconds on two."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
