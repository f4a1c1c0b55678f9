import ctypes
import os
import platform
import subprocess
import sys

import pytest

import player.gl.context as contexts
from player.gl.context import NoContextError, open_context


def test_a_context_opens_without_a_display(monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    context = open_context()
    assert context.gl.version_code >= 330
    assert context.renderer in context.attempts[-1]
    context.release()


def test_an_unknown_kind_is_refused():
    with pytest.raises(ValueError, match="'vulkan'"):
        open_context("vulkan")


def test_osmesa_takes_over_where_egl_is_missing_and_the_log_says_why(osmesa, monkeypatch, caplog):
    def missing():
        raise OSError("libEGL.so.1: cannot open shared object file")

    monkeypatch.setattr(contexts, "Egl", missing)
    with caplog.at_level("INFO", logger="selfscan.context"):
        context = open_context()
    assert context.kind == "osmesa"
    assert "libEGL.so.1" in caplog.text and "OSMesa: llvmpipe" in caplog.text
    context.release()


def test_with_no_driver_at_all_everything_tried_is_named(monkeypatch):
    def missing(*_names):
        raise OSError("not installed")

    monkeypatch.setattr(contexts, "_library", missing)
    with pytest.raises(NoContextError, match=r"EGL: not installed; OSMesa: not installed.*doctor"):
        open_context()


def test_two_contexts_of_one_mesa_take_turns(osmesa):
    contexts_ = [open_context("egl"), open_context("osmesa")]
    targets = []
    for context in contexts_:
        context.make_current()
        targets.append(context.gl.framebuffer([context.gl.renderbuffer((2, 2), 4)]))
    for turn in range(4):
        context, target = contexts_[turn % 2], targets[turn % 2]
        context.make_current()
        target.use()
        target.clear(turn / 255, 0, 0, 1)
        assert target.read(components=1)[0] == turn and context.gl.error == "GL_NO_ERROR"
    for context in contexts_:
        context.release()


def test_counts_see_objects_calls_and_bytes():
    context = open_context()
    counts, gl = context.counts, context.gl
    buffer = gl.buffer(bytes(100))
    texture = gl.texture((8, 4), 4, bytes(128))
    assert counts.objects() == {"buffer": 1, "texture": 1}
    assert counts.uploaded == 228 and counts.live_bytes == 228
    buffer.write(bytes(50))
    assert counts.uploaded == 278
    buffer.release()
    assert counts.objects() == {"texture": 1} and counts.live_bytes == 128
    texture.release()
    assert counts.objects() == {} and counts.live_bytes == 0
    context.release()


def test_an_attachment_that_outlives_its_framebuffer_is_seen():
    context = open_context()
    gl = context.gl
    target = gl.framebuffer([gl.texture((4, 4), 4)], gl.depth_renderbuffer((4, 4)))
    target.release()
    assert context.counts.objects() == {"texture": 1, "renderbuffer": 1}
    context.release()


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
