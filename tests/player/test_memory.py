"""Freed images go back to the system."""

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
from player.gl.memory import give_back_freed_memory

class Mallinfo2(ctypes.Structure):
    _fields_ = [(name, ctypes.c_size_t) for name in (
        "arena", "ordblks", "smblks", "hblks", "hblkhd", "usmblks", "fsmblks", "uordblks", "fordblks", "keepcost")]

ask = ctypes.CDLL(None).mallinfo2
ask.restype = Mallinfo2
if sys.argv[1] == "give back":
    give_back_freed_memory()
np.ones(3 << 20)  # freeing it tells glibc to keep blocks of that size in its heap
before = ask().arena
image = np.ones(1 << 20)
small = [np.ones(1 << 10) for _ in range(99)]  # above it in the heap
del image
print(ask().arena - before)  # bytes of the heap, which the system may have moved elsewhere
"""


@pytest.mark.skipif(
    platform.libc_ver()[0] != "glibc" or not hasattr(ctypes.CDLL(None), "mallinfo2"),
    reason="of the GNU C library, 2.33 or newer",
)
def test_a_large_block_goes_back_though_small_ones_were_made_after_it():
    # Dask leaves a setting of the allocator in the environment
    environment = {key: value for key, value in os.environ.items() if not key.startswith("MALLOC_")}
    kept = {
        way: int(
            subprocess.run([sys.executable, "-c", KEPT, way], check=True, capture_output=True, env=environment).stdout
        )
        for way in ("as it is", "give back")
    }
    assert kept["as it is"] > 8e6 and kept["give back"] < 2e6


def test_elsewhere_nothing_is_done(monkeypatch):
    from player.gl import memory

    monkeypatch.setattr(memory.ctypes, "CDLL", lambda _name: object())
    memory.give_back_freed_memory()
