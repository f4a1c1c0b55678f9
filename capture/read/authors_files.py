"""Fields of the authors' .npy files: arrays of numbers, and dicts that np.save pickled, none of which is ever run."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy import ndarray as Array

from command.errors import AssetError
from files import npz
from files.npz import read_npy


def numbers(path: Path, what: str, shape: tuple[int | None, ...]) -> Array:
    """A numeric array file as float64 of the given shape (None: any)."""
    array = read_npy(path, what)
    if isinstance(array, list):
        raise AssetError(f"{path}: expected {what}, numbers, found objects")
    return npz.field(path, {what: array}, what, shape).astype(np.float64)


def record(path: Path, what: str) -> dict[str, Any]:
    """The dict that np.save pickled."""
    held = read_npy(path, what)
    if not isinstance(held, list) or len(held) != 1 or not isinstance(held[0], dict):
        raise AssetError(f"{path}: expected {what}, one dict saved with np.save")
    return held[0]


def field(path: Path, fields: dict[str, Any], name: str, shape: tuple[int, ...]) -> Array:
    """A field as numbers of a shape; leading and trailing axes of length 1 do not matter."""
    if name not in fields:
        raise AssetError(f"{path}: no {name}; it has {sorted(map(str, fields))[:12]}")
    try:
        array = np.asarray(fields[name], np.float64)
    except (TypeError, ValueError):
        raise AssetError(f"{path}: {name} should be numbers {shape}, is {str(fields[name])[:60]}") from None
    long_axes, expected = ([n for n in sizes if n != 1] for sizes in (array.shape, shape))
    if long_axes != expected:
        raise AssetError(f"{path}: {name} should be {shape}, is {array.shape}")
    if not np.isfinite(array).all():
        raise AssetError(f"{path}: {name} is not finite")
    return array.reshape(shape)
