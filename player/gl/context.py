"""OpenGL 3.3 core contexts without a display: EGL device, EGL surfaceless, OSMesa, each tried in turn.

Drivers are reached with ctypes and their functions handed to moderngl, so that no environment variable, no
import order and no display decides what a machine renders with. What was tried, what won and why the others
lost stays in `Context.attempts`. A window program passes the functions of its own window (`wrap_context`).
"""

import ctypes
import ctypes.util
import logging
import os
import time
from collections.abc import Callable
from ctypes import POINTER, byref, c_char_p, c_int, c_ubyte, c_uint, c_void_p
from dataclasses import dataclass
from typing import Any, cast

import moderngl

from command.errors import AssetError

log = logging.getLogger("selfscan.context")

EGL_PLATFORM_DEVICE, EGL_PLATFORM_SURFACELESS = 0x313F, 0x31DD
EGL_EXTENSIONS, EGL_VENDOR = 0x3055, 0x3053
EGL_DRM_DEVICE_FILE, EGL_DRM_RENDER_NODE_FILE = 0x3233, 0x3377
EGL_RENDERER, EGL_CUDA_DEVICE = 0x335F, 0x323A
EGL_OPENGL_API = 0x30A2
# a pixel buffer or window surface is never made; any config that can do desktop OpenGL will do
EGL_CONFIG = (0x3040, 0x0008, 0x3033, 0x0001, 0x3038)  # RENDERABLE_TYPE OPENGL_BIT, SURFACE_TYPE PBUFFER_BIT
EGL_CONTEXT = (0x3098, 3, 0x30FB, 3, 0x30FD, 1, 0x31B1, 1, 0x3038)  # 3.3, core, forward compatible
EGL_ERRORS = {
    0x3001: "EGL_NOT_INITIALIZED", 0x3002: "EGL_BAD_ACCESS", 0x3003: "EGL_BAD_ALLOC",
    0x3004: "EGL_BAD_ATTRIBUTE", 0x3005: "EGL_BAD_CONFIG", 0x3006: "EGL_BAD_CONTEXT",
    0x3008: "EGL_BAD_DISPLAY", 0x3009: "EGL_BAD_MATCH", 0x300C: "EGL_BAD_PARAMETER",
}  # fmt: skip
# OSMESA_FORMAT RGBA, DEPTH_BITS 0, STENCIL_BITS 0, PROFILE core, 3.3; we draw into framebuffer objects only
OSMESA_CONTEXT = (0x22, 0x1908, 0x30, 0, 0x31, 0, 0x33, 0x34, 0x36, 3, 0x37, 3, 0)
SOFTWARE_RENDERERS = ("llvmpipe", "softpipe", "swrast", "swiftshader", "software")


class NoContextError(AssetError):
    """No OpenGL 3.3 context could be made; the message lists what was tried and why each failed."""


@dataclass(frozen=True)
class EglDevice:
    """A device that EGL lists: its place in eglQueryDevicesEXT, its DRM node as /dev/dri/card0, its CUDA ordinal where
    the driver has one, whether it is Mesa's own rasteriser, its render node as /dev/dri/renderD128, and the card's
    maker and name where the driver has them."""

    index: int
    handle: int
    drm: str | None
    cuda: int | None
    software: bool
    render_node: str | None = None
    model: str | None = None

    def is_gpu(self, gpu: int | str) -> bool:
        """Whether --gpu means this device: a CUDA ordinal, else a position; or one of its DRM nodes."""
        if isinstance(gpu, str):
            nodes = [os.path.realpath(node) for node in (self.drm, self.render_node) if node]
            return os.path.realpath(gpu) in nodes
        return gpu == (self.index if self.cuda is None else self.cuda)

    def __str__(self) -> str:
        cuda = None if self.cuda is None else f"CUDA {self.cuda}"
        facts = (self.model, self.drm, self.render_node, cuda, "software" if self.software else None)
        return " ".join([f"EGL device {self.index}", *filter(None, facts)])


@dataclass
class Driver:
    """What a window system gives us: function addresses, and how to make current, let go and destroy."""

    name: str
    # moderngl asks for it by this name, and for the three methods
    load_opengl_function: Callable[[str], int]
    make_current: Callable[[], object]
    let_go: Callable[[], object]
    destroy: Callable[[], object]

    def __enter__(self) -> "Driver":
        return self

    def __exit__(self, *_error: object) -> None:
        pass

    def release(self) -> None:
        pass


_current: "Context | None" = None


class Context:
    """An OpenGL context of our own.

    gl         the moderngl context
    kind       "egl", "osmesa" or "window"
    renderer   GL_RENDERER of the driver
    software   True when no GPU draws
    attempts   one line each: what was tried, and why it lost or won
    """

    def __init__(self, driver: Driver, kind: str, attempts: list[str], *, standalone: bool = True):
        self.driver, self.kind = driver, kind
        self.released = False
        # whether programs draw once beforehand, so that no frame waits for a driver's compiler; one picture needs none
        self.warms = True
        self._screen: moderngl.Framebuffer | None = None
        self._functions: dict[str, Callable[..., None]] = {}
        self._claim()
        # moderngl's types know only its own loader
        self.gl = moderngl.create_context(context=cast(Any, driver), standalone=standalone)
        self.renderer: str = self.gl.info["GL_RENDERER"]
        self.software = any(name in self.renderer.lower() for name in SOFTWARE_RENDERERS)
        self.attempts = [*attempts, f"{driver.name}: {self.renderer}, OpenGL {self.gl.info['GL_VERSION']}"]

    def make_current(self) -> None:
        """Direct GL calls to this context. Cheap when it is current already."""
        if _current is not self:
            self._claim()

    def leave_framebuffer(self) -> None:
        """Bind the driver's own framebuffer, so that none of ours is freed while bound."""
        self.screen().use()

    def screen(self) -> moderngl.Framebuffer:
        """The driver's own framebuffer: a window's, or nothing to draw on."""
        if self._screen is None:
            self._screen = self.gl.detect_framebuffer(0)
        return self._screen

    def function(self, name: str, *arguments: type) -> Callable[..., None]:
        """A function of the driver that moderngl has no word for; made once."""
        if name not in self._functions:
            self._functions[name] = ctypes.CFUNCTYPE(None, *arguments)(self.driver.load_opengl_function(name))
        return self._functions[name]

    def milliseconds(self, work: Callable[[], object]) -> float:
        """How long some drawing takes, until the device is done."""
        self.gl.finish()
        start = time.perf_counter()
        work()
        self.gl.finish()
        return 1e3 * (time.perf_counter() - start)

    def _claim(self) -> None:
        # EGL and OSMesa of one Mesa share the current-context slot but not the knowledge of it: the one
        # before must let go, or eglMakeCurrent thinks nothing changed
        global _current
        if _current is not None and not _current.released:
            _current.driver.let_go()
        self.driver.make_current()
        _current = self

    def release(self) -> None:
        """Destroy the context with all that is left in it."""
        global _current
        if self.released:
            return
        self.make_current()
        self.gl.release()
        self.driver.let_go()
        self.driver.destroy()
        self.released = True
        _current = None

    def __enter__(self) -> "Context":
        self.make_current()
        return self

    def __exit__(self, *_error) -> None:
        self.release()


def open_context(kind: str = "auto", gpu: int | str | None = None) -> Context:
    """Open a context that needs no display: EGL device -> EGL surfaceless -> OSMesa.

    kind is "auto", "egl" or "osmesa". gpu picks the EGL device of that CUDA ordinal (else of that index), or of
    that DRM node (/dev/dri/renderD128); then no other device is tried.

    Raises:
        NoContextError: nothing worked; the message says what was tried and why it failed.
    """
    if kind not in ("auto", "egl", "osmesa"):
        raise ValueError(f"context should be auto, egl or osmesa, is {kind!r}")
    attempts: list[str] = []
    makers: list[tuple[str, str, Callable[[], Driver]]] = []
    if kind in ("auto", "egl"):
        try:
            egl = Egl()
            devices = [*_chosen_devices(egl, gpu, attempts), *([None] if gpu is None else [])]
            makers += [("egl", egl_name(device), lambda device=device: egl.driver(device)) for device in devices]
        except OSError as error:
            attempts.append(f"EGL: {error}")
    if kind in ("auto", "osmesa") and gpu is None:
        makers.append(("osmesa", "OSMesa", osmesa_driver))
    for family, label, make in makers:
        try:
            driver = make()
        except OSError as error:
            attempts.append(f"{label}: {error}")
            continue
        try:
            context = Context(driver, family, attempts)
        except Exception as error:  # moderngl raises bare Exception for every driver shortcoming
            attempts.append(f"{label}: {error}")
            driver.let_go()
            driver.destroy()
            continue
        for line in context.attempts:
            log.info("%s", line)
        return context
    tried = "; ".join(attempts) or "nothing to try"
    raise NoContextError(f"no OpenGL 3.3 context: {tried}. `selfscan doctor` names missing packages")


def wrap_context(address: Callable[[str], int], make_current: Callable[[], None], name: str) -> Context:
    """A context around a window's: `address` finds GL functions, the window owns the context itself."""
    driver = Driver(name, address, make_current, lambda: None, lambda: None)
    return Context(driver, "window", [], standalone=False)


def _chosen_devices(egl: "Egl", gpu: int | str | None, attempts: list[str]) -> list[EglDevice]:
    try:
        devices = egl.devices()
    except OSError as error:
        attempts.append(f"EGL devices: {error}")
        return []
    if not devices:
        attempts.append("EGL devices: none listed (no vendor file in /usr/share/glvnd/egl_vendor.d?)")
    if gpu is None:
        # software last: it answers first on some machines and is the commonest cause of "slow"
        return sorted(devices, key=lambda device: device.software)
    chosen = [device for device in devices if device.is_gpu(gpu)]
    # a driver that counts as CUDA does has the first word on a number
    chosen = [device for device in chosen if device.cuda is not None] or chosen
    if not chosen:
        attempts.append(f"--gpu {gpu}: not among {[str(device) for device in devices]}")
    return chosen


def _library(*names: str) -> ctypes.CDLL:
    """The first of the shared libraries that loads. find_library needs a compiler on slim images: names first."""
    reasons = []
    for name in names:
        try:
            return ctypes.CDLL(name, mode=ctypes.RTLD_GLOBAL)
        except OSError as error:
            reasons.append(str(error))
    found = ctypes.util.find_library(names[-1].removeprefix("lib").split(".so")[0])
    if found:
        return ctypes.CDLL(found)
    raise OSError(reasons[0])


class Egl:
    """libEGL, with the calls we need declared."""

    def __init__(self):
        self.library = _library("libEGL.so.1", "libEGL.so")
        lib = self.library
        lib.eglGetProcAddress.restype, lib.eglGetProcAddress.argtypes = c_void_p, [c_char_p]
        lib.eglQueryString.restype, lib.eglQueryString.argtypes = c_char_p, [c_void_p, c_int]
        lib.eglInitialize.argtypes = [c_void_p, POINTER(c_int), POINTER(c_int)]
        lib.eglChooseConfig.argtypes = [c_void_p, POINTER(c_int), POINTER(c_void_p), c_int, POINTER(c_int)]
        lib.eglCreateContext.restype = c_void_p
        lib.eglCreateContext.argtypes = [c_void_p, c_void_p, c_void_p, POINTER(c_int)]
        lib.eglMakeCurrent.argtypes = [c_void_p] * 4
        lib.eglDestroyContext.argtypes = [c_void_p] * 2
        lib.eglBindAPI.argtypes = [c_uint]
        extensions = lib.eglQueryString(None, EGL_EXTENSIONS)
        self.client_extensions = set((extensions or b"").decode().split())

    def function(self, name: str, result, *arguments):
        address = self.library.eglGetProcAddress(name.encode())
        if not address:
            raise OSError(f"this EGL has no {name}")
        return ctypes.CFUNCTYPE(result, *arguments)(address)

    def devices(self) -> list[EglDevice]:
        """Every device EGL lists, in its order."""
        query = self.function("eglQueryDevicesEXT", c_uint, c_int, POINTER(c_void_p), POINTER(c_int))
        text = self.function("eglQueryDeviceStringEXT", c_char_p, c_void_p, c_int)
        attribute = self.function("eglQueryDeviceAttribEXT", c_uint, c_void_p, c_int, POINTER(c_void_p))
        handles, count = (c_void_p * 64)(), c_int()
        self._need(query(64, handles, byref(count)), "eglQueryDevicesEXT")
        devices = []
        for index in range(count.value):
            handle = handles[index]
            known = set((text(handle, EGL_EXTENSIONS) or b"").decode().split())
            drm = text(handle, EGL_DRM_DEVICE_FILE) if "EGL_EXT_device_drm" in known else None
            cuda, value = None, c_void_p()
            if "EGL_NV_device_cuda" in known and attribute(handle, EGL_CUDA_DEVICE, byref(value)):
                cuda = value.value or 0
            node = text(handle, EGL_DRM_RENDER_NODE_FILE) if "EGL_EXT_device_drm_render_node" in known else None
            named = "EGL_EXT_device_query_name" in known
            names = [text(handle, name) for name in (EGL_VENDOR, EGL_RENDERER)] if named else []
            model = " ".join(name.decode("utf-8", "replace") for name in names if name)
            drm, node = (one.decode() if one else None for one in (drm, node))
            software = "EGL_MESA_device_software" in known
            devices.append(EglDevice(index, handle, drm, cuda, software, node, model or None))
        return devices

    def error(self) -> str:
        code = self.library.eglGetError()
        return EGL_ERRORS.get(code, f"error {code:#x}")

    def _need(self, result: int | None, call: str) -> None:
        if not result:
            raise OSError(f"{call}: {self.error()}")

    def driver(self, device: EglDevice | None) -> Driver:
        """A 3.3 core context with no surface, of Mesa's own platform without a device. An OSError says which call
        refused and why."""
        lib, platform = self.library, EGL_PLATFORM_DEVICE if device else EGL_PLATFORM_SURFACELESS
        if device is None and "EGL_MESA_platform_surfaceless" not in self.client_extensions:
            raise OSError("this EGL has no EGL_MESA_platform_surfaceless")
        get_display = self.function("eglGetPlatformDisplayEXT", c_void_p, c_uint, c_void_p, POINTER(c_int))
        display = get_display(platform, device.handle if device else None, None)
        self._need(display, "eglGetPlatformDisplayEXT")
        self._need(lib.eglInitialize(display, None, None), "eglInitialize")
        self._need(lib.eglBindAPI(EGL_OPENGL_API), "eglBindAPI")
        config, count = c_void_p(), c_int()
        wanted = (c_int * len(EGL_CONFIG))(*EGL_CONFIG)
        if not lib.eglChooseConfig(display, wanted, byref(config), 1, byref(count)) or not count.value:
            raise OSError(f"eglChooseConfig: no config with desktop OpenGL ({self.error()})")
        asked = (c_int * len(EGL_CONTEXT))(*EGL_CONTEXT)
        context = lib.eglCreateContext(display, config, None, asked)
        self._need(context, "eglCreateContext")

        def make_current() -> None:
            lib.eglBindAPI(EGL_OPENGL_API)
            self._need(lib.eglMakeCurrent(display, None, None, context), "eglMakeCurrent")

        let_go = lambda: lib.eglMakeCurrent(display, None, None, None)
        destroy = lambda: lib.eglDestroyContext(display, context)
        address = lambda function: lib.eglGetProcAddress(function.encode()) or 0
        return Driver(egl_name(device), address, make_current, let_go, destroy)


def egl_name(device: EglDevice | None) -> str:
    """What people call a way to EGL."""
    return "EGL surfaceless" if device is None else str(device)


def osmesa_driver() -> Driver:
    """Mesa's off-screen driver: memory only, no EGL, no device files. Mesa 25.1 removed it."""
    lib = _library("libOSMesa.so.8", "libOSMesa.so.6", "libOSMesa.so")
    lib.OSMesaGetProcAddress.restype, lib.OSMesaGetProcAddress.argtypes = c_void_p, [c_char_p]
    lib.OSMesaCreateContextAttribs.restype = c_void_p
    lib.OSMesaCreateContextAttribs.argtypes = [POINTER(c_int), c_void_p]
    lib.OSMesaMakeCurrent.restype = c_ubyte
    lib.OSMesaMakeCurrent.argtypes = [c_void_p, c_void_p, c_uint, c_int, c_int]
    lib.OSMesaDestroyContext.argtypes = [c_void_p]
    context = lib.OSMesaCreateContextAttribs((c_int * len(OSMESA_CONTEXT))(*OSMESA_CONTEXT), None)
    if not context:
        raise OSError("OSMesaCreateContextAttribs: no 3.3 core context")
    # OSMesa wants some memory to call its screen, which lives as long as what makes it current
    canvas = (c_ubyte * (16 * 16 * 4))()

    def make_current() -> None:
        if not lib.OSMesaMakeCurrent(context, canvas, 0x1401, 16, 16):
            raise OSError("OSMesaMakeCurrent failed")

    let_go = lambda: lib.OSMesaMakeCurrent(None, None, 0, 0, 0)
    destroy = lambda: lib.OSMesaDestroyContext(context)
    address = lambda function: lib.OSMesaGetProcAddress(function.encode()) or 0
    return Driver("OSMesa", address, make_current, let_go, destroy)
