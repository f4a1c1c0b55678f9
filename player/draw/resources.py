"""GL objects as typed handles: a plan says what it needs, `PlanResources` makes exactly that and frees the rest.

A handle is a value. Two handles are one object where everything in them is equal, in one plan and from one plan to the
next: so a change of plan makes only what is new. What an object is made of (the attachments of a framebuffer, program
and buffers of a vertex array) is part of its handle.
"""

from collections.abc import Callable, Hashable, Iterable
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

import moderngl

from player.gl.blocks import BINDING
from player.gl.context import Context

T = TypeVar("T")


@dataclass(frozen=True)
class Handle(Generic[T]):
    """A GL object that a plan owns."""

    kind: type[T]
    # for people: nothing reads it
    name: str
    bytes: int
    # size, samples, level of detail, other handles: what makes it another than those of its name
    depends_on: tuple[Hashable, ...]
    make: Callable[["PlanResources"], T] = field(compare=False, repr=False)

    def __post_init__(self):
        # it is looked up many times a frame
        object.__setattr__(self, "_hash", hash((self.kind, self.name, self.bytes, self.depends_on)))

    def __hash__(self) -> int:
        return self.__dict__["_hash"]


AnyHandle = Handle[Any]


@dataclass(frozen=True)
class Image:
    """A framebuffer with its attachments, textures where a pass reads them."""

    size: tuple[int, int]
    framebuffer: Handle[moderngl.Framebuffer]
    color: AnyHandle
    depth: AnyHandle | None

    @property
    def attachments(self) -> tuple[AnyHandle, ...]:
        return (self.color,) if self.depth is None else (self.color, self.depth)

    @property
    def handles(self) -> tuple[AnyHandle, ...]:
        return (self.framebuffer, *self.attachments)


class PlanResources:
    def __init__(self, context: Context):
        self.context = context
        self._made: dict[AnyHandle, Any] = {}
        # what a pass drew into an object that it keeps from frame to frame, in the pass's own terms
        self.holds: dict[AnyHandle, Hashable] = {}
        # what making several objects shares
        self._shared: dict[Hashable, Any] = {}

    def __getitem__(self, handle: Handle[T]) -> T:
        return self._made[handle]

    def apply(self, handles: Iterable[AnyHandle]) -> set[AnyHandle]:
        """Free what is not among the handles, make what is new, attachments before framebuffers. Returns the new."""
        wanted = dict.fromkeys(handles)
        # none of ours is freed while bound
        self.context.leave_framebuffer()
        for handle in reversed([handle for handle in self._made if handle not in wanted]):
            self._made.pop(handle).release()
            self.holds.pop(handle, None)
        new = [handle for handle in wanted if handle not in self._made]
        for handle in new:
            self._made[handle] = handle.make(self)
        self._shared.clear()
        # keys are the new plan's own: finding a key that is the same object compares nothing
        self._made = {handle: self._made[handle] for handle in wanted}
        return set(new)

    def shared(self, key: Hashable, make: Callable[[], T]) -> T:
        """A value that several objects are made of, computed once; forgotten when all are made."""
        if key not in self._shared:
            self._shared[key] = make()
        return self._shared[key]

    def bind_zeros(self, handle: Handle[moderngl.Buffer], block: str) -> None:
        """Bind a uniform block of zeros, for a draw that is to show nothing."""
        self[handle].write(bytes(self[handle].size))
        self[handle].bind_to_uniform_block(BINDING[block][1])

    def release(self) -> None:
        self.apply(())
