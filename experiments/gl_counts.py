"""Counts of OpenGL objects, calls and bytes, taken where every call passes: at the function loader.

moderngl asks its context object for each GL function by name. Where contexts are counted it gets a small thunk for
those that create, delete, draw or move bytes, and the driver's own address for all others. So the counts see what
Python wrappers cannot: an attachment that outlives its framebuffer, a program compiled but never used. Equipment of
tests and measurements: no command counts.
"""

import ctypes
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from ctypes import POINTER, c_int, c_size_t, c_uint, c_void_p
from weakref import WeakKeyDictionary

from player.gl.context import Context, Driver

GENERATED = ("Buffers", "Textures", "Framebuffers", "Renderbuffers", "VertexArrays", "Queries", "Samplers")
KIND = {name: name.removesuffix("s").replace("VertexArray", "vertex_array").replace("Querie", "query").lower()
        for name in GENERATED}  # fmt: skip
UNIFORMS = tuple(f"glUniform{n}{t}{v}" for n in "1234" for t in ("f", "i", "ui") for v in ("", "v")) + tuple(
    f"glUniformMatrix{n}fv" for n in ("2", "3", "4", "2x3", "2x4", "3x2", "3x4", "4x2", "4x3")
)
DRAWS = {
    "glDrawArrays": (c_uint, c_int, c_int),
    "glDrawElements": (c_uint, c_int, c_uint, c_void_p),
    "glDrawArraysInstanced": (c_uint, c_int, c_int, c_int),
    "glDrawElementsInstanced": (c_uint, c_int, c_uint, c_void_p, c_int),
}
TEXTURE_MAX_LEVEL, FLOAT = 0x813D, 0x1406
# bytes a texel of internal formats; 4 for the rest, which is what drivers do with RGB8 too
TEXEL_BYTES = {0x8814: 16, 0x881A: 8, 0x8815: 12, 0x822B: 2, 0x8229: 1, 0x8230: 8, 0x81A6: 4, 0x8CAC: 4}


_counts: "WeakKeyDictionary[Context, Counts]" = WeakKeyDictionary()


@contextmanager
def counting() -> Iterator[None]:
    """Every context that is opened in this block is counted, a window's too, as long as it lives."""
    plain = Context.__init__

    def counted(self: Context, driver: Driver, *rest, **named) -> None:
        counts, address = Counts(), driver.load_opengl_function
        driver.load_opengl_function = lambda name: counts.wrap(name, address(name))
        _counts[self] = counts
        plain(self, driver, *rest, **named)

    Context.__init__ = counted
    try:
        yield
    finally:
        Context.__init__ = plain


def counts_of(context: Context) -> "Counts":
    """The counts of a context that was opened in a `counting` block."""
    return _counts[context]


class Counts:
    """Live objects by kind, calls and bytes of one context.

    live[kind] is the set of object names now alive (kind: buffer, texture, framebuffer, renderbuffer,
    vertex_array, query, sampler, program, shader). calls counts `draw`, `uniform`, `clear`, `blit`, `read`,
    `create`. uploaded is in bytes since the context was made; live_bytes sums buffers, textures (with their
    mipmaps) and renderbuffers that are alive.
    """

    def __init__(self):
        self.live: dict[str, set[int]] = {kind: set() for kind in (*KIND.values(), "program", "shader")}
        self.calls: Counter[str] = Counter()
        self.uploaded = 0
        self._sizes: dict[tuple[str, int], dict[int, int]] = {}
        self._bound: dict[tuple[str, int], int] = {}
        self._extents: dict[int, tuple[int, int]] = {}  # of textures
        self._max_level: dict[int, int] = {}
        # ctypes callbacks die with their last reference
        self._thunks: list[object] = []

    def objects(self) -> dict[str, int]:
        """Live objects by kind, without the kinds that have none."""
        return {kind: len(names) for kind, names in self.live.items() if names}

    @property
    def live_bytes(self) -> int:
        return sum(sum(levels.values()) for levels in self._sizes.values())

    def wrap(self, name: str, address: int) -> int:
        """The address moderngl shall call for GL function `name`: a counting thunk, or the driver's own."""
        short = name.removeprefix("gl")
        if not address:
            return 0
        if short.removeprefix("Gen") in GENERATED:
            return self._thunk(address, None, (c_int, POINTER(c_uint)), self._generated(short[3:]))
        if short.removeprefix("Delete") in GENERATED:
            return self._thunk(address, None, (c_int, POINTER(c_uint)), self._deleted(short[6:]))
        if name in ("glCreateProgram", "glCreateShader"):
            argument_types = () if name == "glCreateProgram" else (c_uint,)
            return self._created(address, argument_types, short[6:].lower())
        if name in ("glDeleteProgram", "glDeleteShader"):
            live = self.live[short[6:].lower()]
            return self._thunk(address, None, (c_uint,), live.discard)
        if name in DRAWS:
            return self._thunk(address, None, DRAWS[name], self._called("draw"))
        if name in UNIFORMS:
            return self._uniform(name, address)
        if name == "glClear":
            return self._thunk(address, None, (c_uint,), self._called("clear"))
        if name == "glBlitFramebuffer":
            return self._thunk(address, None, (c_int,) * 8 + (c_uint, c_uint), self._called("blit"))
        if name == "glReadPixels":
            return self._thunk(address, None, (c_int,) * 4 + (c_uint, c_uint, c_void_p), self._called("read"))
        if name == "glBindBuffer":
            return self._thunk(address, None, (c_uint, c_uint), self._binds("buffer"))
        if name == "glBindTexture":
            return self._thunk(address, None, (c_uint, c_uint), self._binds("texture"))
        if name == "glBindRenderbuffer":
            return self._thunk(address, None, (c_uint, c_uint), self._binds("renderbuffer"))
        if name == "glBufferData":
            return self._thunk(address, None, (c_uint, c_size_t, c_void_p, c_uint), self._buffer_data)
        if name == "glBufferSubData":
            return self._thunk(address, None, (c_uint, c_size_t, c_size_t, c_void_p), self._buffer_sub_data)
        if name == "glTexImage2D":
            signature = (c_uint, c_int, c_int, c_int, c_int, c_int, c_uint, c_uint, c_void_p)
            return self._thunk(address, None, signature, self._tex_image)
        if name == "glTexSubImage2D":
            signature = (c_uint, c_int, c_int, c_int, c_int, c_int, c_uint, c_uint, c_void_p)
            return self._thunk(address, None, signature, self._tex_sub_image)
        if name == "glTexParameteri":
            return self._thunk(address, None, (c_uint, c_uint, c_int), self._tex_parameter)
        if name == "glGenerateMipmap":
            return self._thunk(address, None, (c_uint,), self._mipmaps)
        if name == "glRenderbufferStorage":
            return self._thunk(address, None, (c_uint, c_uint, c_int, c_int), self._renderbuffer)
        if name == "glRenderbufferStorageMultisample":
            return self._thunk(address, None, (c_uint, c_int, c_uint, c_int, c_int), self._renderbuffer_samples)
        return address

    def _thunk(self, address: int, result, argument_types: tuple, after: Callable[..., object]) -> int:
        kind = ctypes.CFUNCTYPE(result, *argument_types)
        call = kind(address)

        def counted(*arguments):
            value = call(*arguments)
            after(*arguments)
            return value

        thunk = kind(counted)
        self._thunks += [call, thunk]
        return ctypes.cast(thunk, c_void_p).value or 0

    def _created(self, address: int, argument_types: tuple, kind: str) -> int:
        prototype = ctypes.CFUNCTYPE(c_uint, *argument_types)
        call = prototype(address)

        def counted(*arguments):
            name = call(*arguments)
            self.live[kind].add(name)
            self.calls["create"] += 1
            return name

        thunk = prototype(counted)
        self._thunks += [call, thunk]
        return ctypes.cast(thunk, c_void_p).value or 0

    def _uniform(self, name: str, address: int) -> int:
        # only the array forms are ever used by moderngl; the scalar ones would need a signature each
        if not name.endswith("v"):
            return address
        matrix = (ctypes.c_ubyte,) if "Matrix" in name else ()
        return self._thunk(address, None, (c_int, c_int, *matrix, c_void_p), self._called("uniform"))

    def _called(self, what: str) -> Callable[..., None]:
        def count(*_arguments):
            self.calls[what] += 1

        return count

    def _generated(self, what: str) -> Callable[..., None]:
        live = self.live[KIND[what]]

        def count(number, names):
            live.update(names[i] for i in range(number))
            self.calls["create"] += number

        return count

    def _deleted(self, what: str) -> Callable[..., None]:
        kind = KIND[what]

        def count(number, names):
            for i in range(number):
                self.live[kind].discard(names[i])
                self._sizes.pop((kind, names[i]), None)

        return count

    def _binds(self, kind: str) -> Callable[..., None]:
        def bind(target, name):
            self._bound[kind, target] = name

        return bind

    def _allocate(self, kind: str, target: int, level: int, size: int) -> None:
        name = self._bound.get((kind, target), 0)
        if name:
            self._sizes.setdefault((kind, name), {})[level] = size

    def _buffer_data(self, target, size, data, _usage):
        self._allocate("buffer", target, 0, size)
        self.uploaded += size if data else 0

    def _buffer_sub_data(self, _target, _offset, size, _data):
        self.uploaded += size

    def _tex_image(self, target, level, internal, width, height, _border, _format, _type, data):
        size = width * height * TEXEL_BYTES.get(internal, 4)
        if level == 0:
            self._extents[self._bound.get(("texture", target), 0)] = (width, height)
        self._allocate("texture", target, level, size)
        self.uploaded += size if data else 0

    def _tex_parameter(self, target, parameter, value):
        if parameter == TEXTURE_MAX_LEVEL:
            self._max_level[self._bound.get(("texture", target), 0)] = value

    def _mipmaps(self, target):
        name = self._bound.get(("texture", target), 0)
        levels = self._sizes.get(("texture", name), {})
        width, height = self._extents.get(name, (1, 1))
        texel = levels.get(0, 0) // (width * height)
        for level in range(1, min(self._max_level.get(name, 1000), (max(width, height)).bit_length() - 1) + 1):
            levels[level] = max(width >> level, 1) * max(height >> level, 1) * texel

    def _tex_sub_image(self, _target, _level, _x, _y, width, height, _format, type_, _data):
        self.uploaded += width * height * (16 if type_ == FLOAT else 4)

    def _renderbuffer(self, target, _internal, width, height):
        self._allocate("renderbuffer", target, 0, width * height * 4)

    def _renderbuffer_samples(self, target, samples, _internal, width, height):
        self._allocate("renderbuffer", target, 0, width * height * 4 * max(samples, 1))
