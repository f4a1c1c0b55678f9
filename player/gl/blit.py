"""Copies a box of pixels between framebuffers: the cheapest way to move pixels, on software and GPU alike.

moderngl's own copy takes whole framebuffers with their depth, which fails into a window whose depth has another
format, and costs what we do not need.
"""

import ctypes
from ctypes import c_int, c_uint
from weakref import WeakKeyDictionary

import moderngl

from player.gl.context import Context

READ_FRAMEBUFFER, DRAW_FRAMEBUFFER = 0x8CA8, 0x8CA9
COLOR_BUFFER_BIT, NEAREST = 0x4000, 0x2600
# left, first row, right, end row, in rows as GL counts them
Box = tuple[int, int, int, int]


class Blit:
    """glBlitFramebuffer of one context."""

    def __init__(self, context: Context):
        def function(name: str, *arguments: type) -> "ctypes._CFunctionType":
            return ctypes.CFUNCTYPE(None, *arguments)(context.driver.address(name))

        self._bind = function("glBindFramebuffer", c_uint, c_uint)
        self._blit = function("glBlitFramebuffer", *(c_int,) * 8, c_uint, c_uint)

    def __call__(
        self,
        source: moderngl.Framebuffer,
        target: moderngl.Framebuffer,
        box: Box,
        *,
        turned: int | None = None,
    ) -> None:
        """Copy the colours of a box, to the same place. Several samples become one, one becomes several.

        turned: the height of the target, to put the copy there upside down (not with several samples).
        Neither framebuffer is in use afterwards: call `use` on the next one.
        """
        left, low, right, high = box
        self._bind(READ_FRAMEBUFFER, source.glo)
        self._bind(DRAW_FRAMEBUFFER, target.glo)
        rows = (low, high) if turned is None else (turned - low, turned - high)
        self._blit(*box, left, rows[0], right, rows[1], COLOR_BUFFER_BIT, NEAREST)


def blit_of(context: Context) -> Blit:
    """The context's one Blit: its functions live as long as the context."""
    if context not in _made:
        _made[context] = Blit(context)
    return _made[context]


_made: WeakKeyDictionary[Context, Blit] = WeakKeyDictionary()
