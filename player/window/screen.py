"""A glfw window with OpenGL in it, its sizes and pixels: on a display, or on glfw's null platform drawn by OSMesa."""

from ctypes import c_int, c_uint, c_void_p
from typing import Any

import glfw
import moderngl
import numpy as np
from jaxtyping import UInt8

from command.errors import AssetError
from player.gl.context import wrap_context

# height of letters, pixels of a usual screen
LETTER = 15.0
RGBA, UNSIGNED_BYTE = 0x1908, 0x1401


class Screen:
    """The window itself. Sizes are in units, which the pointer counts, or in pixels of the framebuffer: on screens of
    high density a unit is several pixels, or letters are larger."""

    def __init__(self, size: tuple[int, int], *, null: bool):
        self.handle = open_window(size, null)
        name = "glfw null + OSMesa" if null else "window"
        self.context = wrap_context(address_of, lambda: glfw.make_context_current(self.handle), name)
        self._drawn_size = (0, 0)
        # left, top, width and height, units, to go back to from the full screen; None: it is not full
        self._windowed: tuple[int, int, int, int] | None = None

    @property
    def full(self) -> bool:
        """Whether the window has the whole screen."""
        return self._windowed is not None

    def toggle_full(self) -> None:
        """The whole of the screen that has most of the window, or the window as it was before."""
        if self._windowed is not None:
            # its types do not know that a window may belong to none
            no_monitor: Any = None
            glfw.set_window_monitor(self.handle, no_monitor, *self._windowed, glfw.DONT_CARE)
            self._windowed = None
            return
        left, top, wide, high = (*glfw.get_window_pos(self.handle), *self.units)

        def shared(monitor: Any) -> int:
            x, y, w, h = glfw.get_monitor_workarea(monitor)
            return max(min(left + wide, x + w) - max(left, x), 0) * max(min(top + high, y + h) - max(top, y), 0)

        if monitor := max(glfw.get_monitors(), key=shared, default=None):
            size, rate = glfw.get_video_mode(monitor).size, glfw.get_video_mode(monitor).refresh_rate
            self._windowed = left, top, wide, high
            glfw.set_window_monitor(self.handle, monitor, 0, 0, *size, rate)

    @property
    def size(self) -> tuple[int, int]:
        """Of the framebuffer, pixels; (0, 0) when minimised."""
        return glfw.get_framebuffer_size(self.handle)

    @property
    def units(self) -> tuple[int, int]:
        """Of the window as the pointer counts it."""
        return glfw.get_window_size(self.handle)

    def pixel(self, x: float | int, y: float | int) -> tuple[float, float]:
        """A place in units as pixels."""
        (wide, high), (across, down) = self.units, self.size
        return x * across / max(wide, 1), y * down / max(high, 1)

    @property
    def scale(self) -> float:
        """Pixels a unit."""
        return self.pixel(1.0, 1.0)[0]

    def begin(self) -> moderngl.Framebuffer:
        """What a frame is drawn into. OSMesa takes the window's memory when it is made current."""
        if self.size != self._drawn_size:
            glfw.make_context_current(self.handle)
            self._drawn_size = self.size
        return self.context.screen()

    def read(self, area: tuple[int, int, int, int]) -> UInt8[np.ndarray, "height width 4"]:
        """What is drawn in an area (left, top, width, height); row 0 on top, opaque.

        moderngl's own `read` names an attachment, which a window does not have: GL errs.
        """
        left, top, width, height = area
        self.context.make_current()
        self.context.screen().use()
        rows = np.empty((height, width, 4), np.uint8)
        # rows of whole words, whatever the alignment
        read = self.context.function("glReadPixels", *(c_int,) * 4, c_uint, c_uint, c_void_p)
        read(left, self.size[1] - top - height, width, height, RGBA, UNSIGNED_BYTE, rows.ctypes.data)
        image = rows[::-1].copy()
        image[..., 3] = 255
        return image

    def close(self) -> None:
        self.context.release()
        glfw.destroy_window(self.handle)
        glfw.terminate()


def density(handle: Any) -> float:
    """How many window units a usual screen's pixel is: where units are pixels, what the system scales text by."""
    scale = glfw.get_window_content_scale(handle)[0]
    units, pixels = glfw.get_window_size(handle)[0], glfw.get_framebuffer_size(handle)[0]
    return min(max(scale * units / max(pixels, 1), 0.5), 4.0) if scale > 0 and units else 1.0


def open_window(size: tuple[int, int], null: bool):
    """A glfw window with an OpenGL 3.3 core context, current.

    Raises:
        AssetError: there is no display, or the driver has no OpenGL 3.3.
    """
    reasons: list[str] = []

    def note(_code: int, text: Any) -> None:
        reasons.append(text.decode("utf-8", "replace"))

    glfw.set_error_callback(note)
    glfw.init_hint(glfw.PLATFORM, glfw.PLATFORM_NULL if null else glfw.ANY_PLATFORM)
    if not glfw.init():
        raise AssetError(f"no window: {'; '.join(reasons) or 'no display'}; `selfscan render` needs none")
    glfw.default_window_hints()
    glfw.window_hint(glfw.CONTEXT_VERSION_MAJOR, 3)
    glfw.window_hint(glfw.CONTEXT_VERSION_MINOR, 3)
    glfw.window_hint(glfw.OPENGL_PROFILE, glfw.OPENGL_CORE_PROFILE)
    if null:
        glfw.window_hint(glfw.CONTEXT_CREATION_API, glfw.OSMESA_CONTEXT_API)
    else:
        glfw.window_hint(glfw.OPENGL_FORWARD_COMPAT, True)  # macOS asks for it; glfw's OSMesa refuses it
    window = glfw.create_window(*size, "selfscan", None, None)
    if not window:
        glfw.terminate()
        raise AssetError(f"no window: {'; '.join(reasons) or 'unknown reason'}; `selfscan doctor` says more")
    glfw.make_context_current(window)
    return window


def address_of(name: str) -> int:
    """Of a function of OpenGL in the window that is current; 0: there is none."""
    found: Any = glfw.get_proc_address(name)
    return found or 0
