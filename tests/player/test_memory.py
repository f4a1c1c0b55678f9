"""Freed images go back to the system."""

import platform
import subprocess
import sys

import pytest

KEPT = """
import sys
import numpy as np
from player.memory import give_back_freed_memory

def resident():
    return int(open("/proc/self/statm").read().split()[1]) * 4096

if sys.argv[1] == "give back":
    give_back_freed_memory()
np.ones(3 << 20)  # freeing it tells glibc to keep blocks of that size in its heap
before = resident()
image = np.ones(1 << 20)
small = [np.ones(1 << 10) for _ in range(99)]  # above it in the heap
del image
print(resident() - before)
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="of the GNU C library")
def test_a_large_block_goes_back_though_small_ones_were_made_after_it():
    kept = {
        way: int(subprocess.run([sys.executable, "-c", KEPT, way], check=True, capture_output=True).stdout)
        for way in ("as it is", "give back")
    }
    assert kept["as it is"] > 8e6 and kept["give back"] < 2e6


def test_elsewhere_nothing_is_done(monkeypatch):
    from player import memory

    monkeypatch.setattr(memory.ctypes, "CDLL", lambda _name: object())
    memory.give_back_freed_memory()
