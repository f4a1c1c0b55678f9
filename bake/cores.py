"""How a bake shares the processor's cores."""

from collections.abc import Iterator
from contextlib import contextmanager

import torch


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
