"""How a bake shares the processor's cores."""

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import TypeVar

import torch

T = TypeVar("T")
U = TypeVar("U")


def on_all_cores(function: Callable[[T], U], items: Iterable[T]) -> Iterator[U]:
    """What `function` gives for each item, in their order; items are asked for only as cores become free."""
    count = os.cpu_count() or 1
    waiting = deque()
    with ThreadPoolExecutor(count) as cores:
        for item in items:
            waiting.append(cores.submit(function, item))
            if len(waiting) > count:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()


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
