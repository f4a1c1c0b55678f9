"""What is made once a process."""

from dataclasses import dataclass

import numpy as np
import pytest

from avatar.constant import constant


@dataclass(frozen=True)
class Pair:
    first: np.ndarray
    rest: dict[str, tuple[np.ndarray, ...]]


@constant
def pair(size: int) -> Pair:
    return Pair(np.zeros(size), {"a": (np.ones(size),)})


def test_a_constant_is_made_once_and_none_of_its_arrays_can_be_written():
    assert pair(3) is pair(3) is not pair(4)
    for array in (pair(3).first, pair(3).rest["a"][0]):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 5
