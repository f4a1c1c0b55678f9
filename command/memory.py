"""What the C library does with freed memory: gives it back where images come and go, keeps it where large arrays do.

Both only where the library is glibc; elsewhere nothing is done.
"""

import ctypes

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD, M_MMAP_MAX = -1, -3, -4
LARGE = 4 << 20  # bytes: more than a frame, less than an atlas


def give_back_freed_memory() -> None:
    """Make the C library keep large blocks apart, so that freeing one returns it at once.

    glibc raises that bound with each large block that is freed, up to 32 MB. Decoded images then lie in its heap, which
    cannot shrink under what is above them: 46 MiB of a film's 280, kept for nothing.
    """
    _tune(M_MMAP_THRESHOLD, LARGE)


def keep_freed_memory() -> None:
    """Make the C library keep all it was given: arrays of millions of texels, made and freed at each step, would be
    mapped and cleared by the system anew every time, a tenth of a bake's processor seconds."""
    _tune(M_MMAP_MAX, 0)
    _tune(M_TRIM_THRESHOLD, -1)


def _tune(parameter: int, value: int) -> None:
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError, TypeError):  # Windows has no such library, macOS no such function
        return
    mallopt(ctypes.c_int(parameter), ctypes.c_int(value))
