"""Memory that goes back to the system when it is freed."""

import ctypes

M_MMAP_THRESHOLD = -3
LARGE = 4 << 20  # bytes: more than a frame, less than an atlas


def give_back_freed_memory() -> None:
    """Make the C library keep large blocks apart, so that freeing one returns it at once.

    glibc raises that bound with each large block that is freed, up to 32 MB. Decoded images then lie in its heap, which
    cannot shrink under what is above them: 46 MiB of a film's 280, kept for nothing. Elsewhere nothing is done.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError, TypeError):  # Windows has no such library, macOS no such function
        return
    mallopt(ctypes.c_int(M_MMAP_THRESHOLD), ctypes.c_int(LARGE))
