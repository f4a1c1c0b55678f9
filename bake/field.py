"""The field that is baked: asked with NumPy arrays, in pieces."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray as Array

from command.workers import on_all_cores
from geometry.isosurface import Detail
from train.fused import CanonicalField


class NumpyField(NamedTuple):
    """The field behind NumPy functions, asked in pieces so that memory stays bounded."""

    distance: Callable[[Float[Array, "n 3"]], Float[Array, "n"]]
    normal: Callable[[Float[Array, "n 3"]], Float[Array, "n 3"]]
    color: Callable[[Float[Array, "n 3"], Float[Array, "n 3"]], Float[Array, "n 3"]]
    # mean S and H in that colour, of points with their normals; None: the field's light is no factor of its own
    seen_light: Callable[[Float[Array, "n 3"], Float[Array, "n 3"]], Float[Array, "n 2"]] | None = None
    # the normals that it fell on; None as well
    light_normal: Callable[[Float[Array, "n 3"]], Float[Array, "n 3"]] | None = None
    # where its surface is finer than the grids it is taken from: the eyes
    details: tuple[Detail, ...] = ()


def numpy_field(field: CanonicalField, *, piece: int = 1 << 15) -> NumpyField:
    """The field behind functions that take and give float64, `piece` points at a time."""

    def ask(function: Callable[..., torch.Tensor], *arrays: Array) -> Array:
        """What a function of the field gives, asked on all cores."""

        def answer(start: int) -> Array:
            tensors = [torch.from_numpy(np.ascontiguousarray(a[start : start + piece], np.float32)) for a in arrays]
            return function(*tensors).detach().cpu().numpy().astype(np.float64)

        # a piece for each core: within one, most of the time is spent between torch's own parallel loops
        pieces = list(on_all_cores(answer, range(0, len(arrays[0]), piece)))
        return np.concatenate(pieces) if pieces else np.zeros((0, 3))

    seen, lit = field.seen_light, field.light_normal
    return NumpyField(
        lambda points: ask(field.distance, points).reshape(-1),
        lambda points: ask(field.normal, points),
        lambda points, directions: ask(field.color, points, directions),
        None if seen is None else lambda points, normals: ask(seen, points, normals),
        None if lit is None else lambda points: ask(lit, points),
        field.details,
    )
