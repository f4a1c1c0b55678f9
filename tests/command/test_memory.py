"""Freed images go back to the system, freed arrays stay."""

import ctypes
import os
import platform
import subprocess
import sys

import pytest

KEPT = """
import ctypes
import sys
import numpy as np
from command.memory import give_back_freed_memory, keep_freed_memory

class Mallinfo2(ctypes.Structure):
    _fields_ = [(name, ctypes.c_size_t) for name in (
        "arena", "ordblks", "smblks", "hblks", "hblkhd", "usmblks", "fsmblks", "uordblks", "fordblks", "keepcost")]

ask = ctypes.CDLL(None).mallinfo2
ask.restype = Mallinfo2
if sys.argv[1] == "give back":
    give_back_freed_memory()
elif sys.argv[1] == "keep":
    keep_freed_memory()
np.ones(3 << 20)  # freeing it tells glibc to keep blocks of that size in its heap
before = ask().arena
image = np.ones(1 << 20)
small = [np.ones(1 << 10) for _ in range(99)]  # above it in the heap
del image
arena = ask().arena - before  # bytes of the heap, which the system may have moved elsewhere
arrays = [np.ones(8 << 20) for _ in range(4)]
kept = ask().arena
del arrays
print(arena, ask().arena / kept if kept > 4 * 64e6 else 0)
"""


@pytest.mark.skipif(
    platform.libc_ver()[0] != "glibc" or not hasattr(ctypes.CDLL(None), "mallinfo2"),
    reason="of the GNU C library, 2.33 or newer",
)
def test_a_large_block_goes_back_though_small_ones_were_made_after_it_and_stays_where_it_is_to_be_kept():
    # Dask leaves a setting of the allocator in the environment
    environment = {key: value for key, value in os.environ.items() if not key.startswith("MALLOC_")}
    heap, share = {}, {}
    for way in ("as it is", "give back", "keep"):
        done = subprocess.run([sys.executable, "-c", KEPT, way], check=True, capture_output=True, env=environment)
        heap[way], share[way] = map(float, done.stdout.split())
    assert heap["as it is"] > 8e6 and heap["give back"] < 2e6
    assert share == {"as it is": 0, "give back": 0, "keep": 1}


def test_elsewhere_nothing_is_done(monkeypatch):
    from command import memory

    monkeypatch.setattr(memory.ctypes, "CDLL", lambda _name: object())
    memory.give_back_freed_memory()
    memory.keep_freed_memory()
