"""Contexts without a display, what `selfscan doctor` says of them, and which GPU a number or a device file means."""

import ctypes
import json
import os
import platform
import subprocess
import sys
from ctypes import POINTER, c_int, c_uint, c_void_p

import numpy as np
import pytest

import player.doctor as doctor
import player.gl.context as contexts
from command.errors import AssetError
from player.doctor import Node, device_nodes, difference, doctor_main, hints, nvidia_driver, vendor_file
from player.gl.context import EglDevice, NoContextError, open_context

# (CUDA ordinal, DRM node, render node, maker, software): EGL counts as it likes, CUDA otherwise, as on real machines
CARDS = [
    (1, "/dev/dri/card3", "/dev/dri/renderD131", ("NVIDIA", "H100"), False),
    (0, "/dev/dri/card1", "/dev/dri/renderD129", ("NVIDIA", "RTX 4090"), False),
    (None, "/dev/dri/card0", "/dev/dri/renderD128", None, False),
    (None, None, None, None, True),
]


@pytest.fixture
def cards(monkeypatch):
    """The machine's EGL, with our cards in its list: whichever is taken,
    the software device draws. The handles taken.
    """
    real = contexts.Egl()
    software = next(device for device in real.devices() if device.software)
    get_display = real.function("eglGetPlatformDisplayEXT", c_void_p, c_uint, c_void_p, POINTER(c_int))
    taken: list[int] = []

    def devices(most, handles, count):
        for i in range(len(CARDS)):
            handles[i] = 0x1000 + i
        count._obj.value = len(CARDS)
        return 1

    def text(handle, name):
        cuda, card, render, made, is_software = CARDS[handle - 0x1000]
        known = [
            "EGL_EXT_device_drm" * bool(card), "EGL_EXT_device_drm_render_node" * bool(render),
            "EGL_NV_device_cuda" * (cuda is not None), "EGL_EXT_device_query_name" * bool(made),
            "EGL_MESA_device_software" * is_software,
        ]  # fmt: skip
        maker, model = made or ("", "")
        strings = {contexts.EGL_EXTENSIONS: " ".join(known), contexts.EGL_DRM_DEVICE_FILE: card,
                   contexts.EGL_DRM_RENDER_NODE_FILE: render, contexts.EGL_VENDOR: maker,
                   contexts.EGL_RENDERER: model}  # fmt: skip
        return (strings[name] or "").encode()

    def attribute(handle, name, value):
        cuda = CARDS[handle - 0x1000][0]
        assert name == contexts.EGL_CUDA_DEVICE
        value._obj.value = cuda
        return int(cuda is not None)

    def display(platform, device, attributes):
        taken.append(device)
        return get_display(platform, software.handle, None) or 0

    ours = {
        "eglQueryDevicesEXT": devices, "eglQueryDeviceStringEXT": text, "eglQueryDeviceAttribEXT": attribute,
        "eglGetPlatformDisplayEXT": display,
    }  # fmt: skip
    function = contexts.Egl.function
    monkeypatch.setattr(
        contexts.Egl, "function", lambda self, name, *kinds: ours.get(name) or function(self, name, *kinds)
    )
    return taken


@pytest.mark.parametrize(
    ("gpu", "index"),
    [(0, 1), (1, 0), (2, 2), (3, 3), ("/dev/dri/card1", 1), ("/dev/dri/renderD131", 0), ("/dev/dri/renderD128", 2)],
)
def test_a_gpu_is_found_by_cuda_ordinal_position_or_device_file(cards, gpu, index):
    context = open_context("egl", gpu)
    assert cards == [0x1000 + index]  # this one, and no other was tried
    assert context.attempts[-1].startswith(f"EGL device {index}")
    context.release()


def test_a_link_to_a_device_file_is_the_device(cards, tmp_path):
    (tmp_path / "my-card").symlink_to("/dev/dri/renderD129")
    open_context("egl", str(tmp_path / "my-card")).release()
    assert cards == [0x1001]


@pytest.mark.parametrize("gpu", [4, 9, "/dev/dri/renderD140"])
def test_a_gpu_that_is_not_listed_is_refused_with_the_list(cards, gpu):
    with pytest.raises(NoContextError, match=r"not among .*NVIDIA RTX 4090 /dev/dri/card1 /dev/dri/renderD129 CUDA 0"):
        open_context("auto", gpu)
    assert cards == []


def test_without_a_wish_cards_come_before_the_software_device(cards):
    open_context().release()
    assert cards == [0x1000]


def test_doctor_lists_devices_with_their_names(cards, tmp_path, capsys):
    assert doctor_main(["--json", str(tmp_path / "d.json")]) == 0
    said = capsys.readouterr().out
    found = json.loads((tmp_path / "d.json").read_text())
    assert found["egl_devices"] == [
        "EGL device 0 NVIDIA H100 /dev/dri/card3 /dev/dri/renderD131 CUDA 1",
        "EGL device 1 NVIDIA RTX 4090 /dev/dri/card1 /dev/dri/renderD129 CUDA 0",
        "EGL device 2 /dev/dri/card0 /dev/dri/renderD128",
        "EGL device 3 software",
    ]
    assert all(device in said for device in found["egl_devices"])
    assert found["winner"]["renderer"] in said


@pytest.fixture
def paper_only(monkeypatch):
    """One view mode: all of them are compared in tests/hard_cases."""
    monkeypatch.setattr("player.budget.ladder.views_of", lambda _avatar: ["off"])


def test_compare_notices_a_way_that_draws_otherwise_or_not_at_all(osmesa, paper_only, monkeypatch):
    drawn = doctor._in_window

    def darker(*arguments, null):
        pictures, renderer = drawn(*arguments, null=null)
        return [picture // 2 for picture in pictures], renderer

    monkeypatch.setattr(doctor, "_in_window", darker)
    compared = doctor.compare(size=64)
    assert not compared["equal"] and compared["worst"] > 20 and "NOT equal" in compared["text"]

    def none(*_arguments, null):
        raise AssetError("no window: nothing there")

    monkeypatch.setattr(doctor, "_in_window", none)
    compared = doctor.compare(size=64)
    assert not compared["equal"] and compared["worst"] <= 1
    assert "window on the null platform does not work: no window: nothing there" in compared["text"]


def test_a_difference_inside_counts_and_one_at_the_silhouette_does_not():
    image = np.zeros((20, 20, 4), np.uint8)
    image[5:15, 5:15] = (100, 120, 140, 255)
    moved, spot, opaque = image.copy(), image.copy(), image.copy()
    moved[4, 5:15] = image[5, 5:15]  # a row more: the silhouette lies one pixel farther
    spot[10, 10, 1] += 7
    opaque[..., 3] = 255  # as a window has it
    assert difference(image, moved)[0] == 0
    assert difference(image, spot)[0] == 7
    assert difference(image, opaque)[0] == 0
    far = image.copy()
    far[2:5, 5:15] = image[5, 5:15]  # three rows more
    assert difference(image, far)[0] > 100


GPU = EglDevice(0, 1, None, 0, False)
SOFTWARE = EglDevice(1, 2, None, None, True)
MESA = {"file": "50_mesa.json", "library": "libEGL_mesa.so.0", "wrong": None}
NVIDIA = {"file": "10_nvidia.json", "library": "libEGL_nvidia.so.0", "wrong": None}
FACTS = {"devices": [SOFTWARE], "nodes": [], "nvidia": None, "vendors": [MESA], "software": True, "container": False}


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({}, []),
        ({"container": True}, ["--device /dev/dri"]),
        ({"nvidia": "NVRM", "container": True}, ["NVIDIA_DRIVER_CAPABILITIES=graphics", "10_nvidia.json"]),
        ({"nvidia": "NVRM"}, ["10_nvidia.json"]),
        ({"nvidia": "NVRM", "vendors": [MESA, NVIDIA], "container": True}, ["NVIDIA_DRIVER_CAPABILITIES"]),
        ({"nvidia": "NVRM", "devices": [GPU], "vendors": [NVIDIA], "software": False}, []),
        ({"nodes": [Node("/dev/dri/renderD128", False)]}, ["usermod -aG render"]),
        ({"nodes": [Node("/dev/dri/renderD128", False)], "container": True}, ["--group-add render"]),
        ({"nodes": [Node("/dev/dri/renderD128", True)], "container": True}, []),
        ({"vendors": [{**NVIDIA, "wrong": "cannot open"}]}, ["10_nvidia.json: its driver does not load: cannot open"]),
        ({"devices": [GPU, SOFTWARE]}, ["is there and does not draw"]),
    ],
)
def test_hints_name_what_to_do_and_nothing_else(changes, expected):
    said = hints(**{**FACTS, **changes})
    assert len(said) == len(expected)
    assert all(word in line for word, line in zip(expected, said, strict=True))


def test_the_files_that_hints_are_made_of_are_read(tmp_path):
    (tmp_path / "dri").mkdir()
    for name in ("dri/renderD128", "dri/card0", "nvidia0", "nvidiactl"):
        (tmp_path / name).write_bytes(b"")
    assert device_nodes(tmp_path) == [Node(str(tmp_path / name), True) for name in ("dri/renderD128", "nvidia0")]
    (tmp_path / "version").write_text("NVRM version: NVIDIA 580\nGCC\n")
    assert nvidia_driver(tmp_path / "version") == "NVRM version: NVIDIA 580"
    assert nvidia_driver(tmp_path / "none") is None
    (tmp_path / "v.json").write_text('{"ICD": {"library_path": "libNoSuchThing.so.0"}}')
    assert "libNoSuchThing" in str(vendor_file(tmp_path / "v.json")["wrong"])
    (tmp_path / "v.json").write_text("{")
    assert vendor_file(tmp_path / "v.json")["wrong"]


def missing(*_names):
    raise OSError("not installed")


def test_doctor_names_missing_packages(monkeypatch, capsys):
    monkeypatch.setattr(doctor, "_library", missing)
    monkeypatch.setattr(contexts, "_library", missing)
    assert doctor_main([]) == 1
    said = capsys.readouterr().out
    assert "sudo apt-get install libegl1 libgl1 libosmesa6" in said
    assert "no context works" in said


def test_a_context_opens_without_a_display_an_unknown_kind_is_refused_and_all_tried_is_named(monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    context = open_context()
    assert context.gl.version_code >= 330
    assert context.renderer in context.attempts[-1]
    context.release()
    with pytest.raises(ValueError, match="'vulkan'"):
        open_context("vulkan")
    monkeypatch.setattr(contexts, "_library", missing)
    with pytest.raises(NoContextError, match=r"EGL: not installed; OSMesa: not installed.*doctor"):
        open_context()


def test_osmesa_takes_over_where_egl_is_missing_and_the_log_says_why(osmesa, monkeypatch, caplog):
    monkeypatch.setattr(contexts, "Egl", missing)
    with caplog.at_level("INFO", logger="selfscan.context"):
        context = open_context()
    assert context.kind == "osmesa"
    assert "not installed" in caplog.text and "OSMesa: llvmpipe" in caplog.text
    context.release()


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
