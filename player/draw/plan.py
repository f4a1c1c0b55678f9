"""What is drawn, as passes and the resources they read: decided from data alone, before any GL object is made.

Nothing that no pass reads is in the plan, and the renderer makes exactly what the plan holds: no program, buffer
or texture for an effect that is not asked for. A pass that is asked for but cannot show in a frame (an avatar out
of view, view dependence of one forty pixels tall) is skipped for that frame and keeps its resources. Skipping a pass
skips whatever only it needs, so a frame in which an effect cannot show is, byte for byte and draw for draw, the frame
of a scene that never asked for it.

`player/effects/` holds the effects, one a file; `resolve` in `player/scene/effects.py` asks each for its passes.
"""

import re
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum, StrEnum
from functools import cache
from typing import Any, ClassVar, NamedTuple, Protocol, TypeVar, runtime_checkable

import moderngl
import numpy as np

from avatar.baked_avatar import Avatar, Level
from avatar.skeleton import JOINTS
from player.draw.drawing import Drawing, FrameInputs, Layer, Pose, Warming
from player.draw.mesh import attributes_read, draw_order
from player.draw.resources import AnyHandle, Handle, Image, PlanResources
from player.gl.blocks import BINDING, FRAME, bind_block, block_bytes
from player.gl.shader import compile_program
from player.gl.tiles import Patches

T = TypeVar("T")
# what effects keep from one plan to the next, by a key of their own
Kept = Mapping[Hashable, Any]
# a buffer of a vertex array, its format, and the names of its attributes
Attributes = tuple[Any, ...]
Attachment = moderngl.Texture | moderngl.Renderbuffer
# samples of MSAA, asked for as a number, never as the device's maximum, so that machines agree
SAMPLES = 4
# the texture unit that face.glsl reads; lower ones are those of other samplers
FACE_UNIT = 7
MARGIN = 2  # pixels round an avatar that antialiasing can change


class Stage(IntEnum):
    BACKGROUND = 0
    # what avatars stand on
    GROUND = 1
    # avatars, and what stands among them
    AVATARS = 2
    # the finished picture is filtered
    PICTURE = 3


class PassState(StrEnum):
    RUNS = "runs"
    # its last result still holds
    KEPT = "kept"
    # it cannot show in this frame
    SKIPPED = "skipped"
    NOT_ASKED = "not asked for"


class Decision(NamedTuple):
    """What becomes of a pass in a frame, and why, for people to read."""

    state: PassState
    why: str

    @property
    def runs(self) -> bool:
        return self.state is PassState.RUNS


OUT_OF_VIEW = Decision(PassState.SKIPPED, "out of view")
NONE_IN_VIEW = Decision(PassState.SKIPPED, "no avatar in view")


@dataclass(frozen=True)
class Pass(ABC):
    """One step of a frame. The renderer knows an effect by these verbs alone; all but the first two may stay empty."""

    # for people: `--explain` prints it
    name: str
    # all it reads and writes
    uses: tuple[AnyHandle, ...]

    @abstractmethod
    def decide(self, drawing: Drawing) -> Decision:
        """Whether it can show in this frame."""

    @abstractmethod
    def draw(self, drawing: Drawing) -> None: ...

    def warm(self, warming: Warming) -> None:  # noqa: B027
        """Draw next to nothing with the real state: drivers compile at the first draw, some 90 ms in software."""

    def move(self, poses: Sequence[Pose], seconds: float) -> None:  # noqa: B027
        """Go on to these poses, one an avatar, at a moment: the step of a simulation."""

    def reach(self, avatar: int, pose: Pose) -> float:
        """Metres by which it moves an avatar's surface at most, in this pose."""
        return 0.0

    def cost(self, drawn: float, inputs: FrameInputs, frame: Callable[[], float]) -> float:
        """Milliseconds it costs, of those that drawing it takes and those of a whole frame, which `frame` measures."""
        return drawn


@dataclass(frozen=True)
class Addition:
    """What a program that draws an avatar reads, and what effects add to that: it knows them by these verbs alone."""

    # attributes of the vertices
    buffers: tuple[Attributes, ...]
    # uniform blocks by their names
    blocks: tuple[tuple[str, Handle[moderngl.Buffer]], ...]

    @property
    def handles(self) -> tuple[AnyHandle, ...]:
        """All it reads."""
        return (*(handle for _, handle in self.blocks), *(buffer[0] for buffer in self.buffers))

    def shows(self, drawing: Drawing) -> bool:
        """Whether it can be seen in this frame."""
        return True

    def content(self, drawing: Drawing, block: str) -> bytes | np.ndarray:
        """What one of its blocks holds in this frame."""
        raise AssertionError("it has no block")

    def bind(self, drawing: Drawing) -> None:
        """Bring what it is in this frame to the GPU, unless another pass has, and bind it."""
        for name, handle in self.blocks:
            drawing.bind(handle, name, lambda: self.content(drawing, name))

    def apply(self, drawing: Drawing, program: moderngl.Program) -> None:
        """Give a program its uniforms."""

    def warm(self, resources: PlanResources) -> None:
        """Bind what adds nothing."""
        for name, handle in self.blocks:
            resources.bind_zeros(handle, name)


@runtime_checkable
class Effect(Protocol):
    """What a scene asks for, as a frozen record of its settings."""

    stage: ClassVar[Stage]

    def passes(self, draft: "Draft") -> Sequence[Pass]:
        """Its passes in drawing order, whatever they own declared to the draft. Asked again when the plan changes."""
        ...


@dataclass(frozen=True)
class Absent(Pass):
    """A pass that is not in the plan, and why; `state` of one whose work is done before anything is drawn."""

    uses: tuple[AnyHandle, ...] = field(default=(), init=False)
    why: str = "not asked for"
    state: PassState = PassState.NOT_ASKED

    def decide(self, drawing: Drawing) -> Decision:
        return Decision(self.state, self.why)

    def draw(self, drawing: Drawing) -> None:
        raise AssertionError("it never runs")


@dataclass(frozen=True)
class Plan:
    """Passes in drawing order with the resources they need."""

    passes: tuple[Pass, ...]
    # those among them that filter the finished picture
    filters: tuple[Pass, ...]
    # in an order in which they can be made
    handles: tuple[AnyHandle, ...]
    frame: Handle[moderngl.Buffer]
    # the renderer's own image, and the background at its size
    image: Image | None
    background: Handle[moderngl.Framebuffer] | None
    margin: int  # pixels round an avatar that something can draw on
    # the view mode of each avatar that is drawn with view dependence
    views: Mapping[int, str]
    # avatars that a pass simulates from one moment to the next
    moved: frozenset[int]
    # what lives as long as an effect is asked for and is no GL object: an open film, particles
    kept: Kept

    @property
    def bytes(self) -> int:
        return sum(handle.bytes for handle in self.handles)

    def objects(self) -> dict[str, int]:
        """Live GL objects by kind, when exactly this plan is made: tests hold the counts against it."""
        names = (re.sub(r"\B(?=[A-Z])", "_", handle.kind.__name__).lower() for handle in self.handles)
        return dict(Counter(names))


@dataclass(frozen=True)
class Canvas:
    """Where a plan is to run: facts of the device and of the image, none of them a GL object."""

    size: tuple[int, int] | None  # pixels; None: a window that has not said yet
    own_image: bool = True  # False: a window is drawn into
    software: bool = True
    max_samples: int = SAMPLES


class Draft:
    """A plan being written. Effects are asked from the last to the first: a filter says where those before it draw.

    avatars, detail: who is drawn, and the number of each one's level of detail; dual: with dual quaternions. `effects`
    are all that the scene asks for, the background too; `kept` is an earlier plan's; `faces`: whose face has moved.
    """

    def __init__(
        self, avatars: Sequence[Avatar], canvas: Canvas, *, detail: Sequence[int], dual: bool = False,
        effects: Iterable[Effect] = (), kept: Kept, faces: frozenset[int] = frozenset(),
    ):  # fmt: skip
        self.avatars, self.canvas, self.detail, self.dual = tuple(avatars), canvas, tuple(detail), dual
        self.levels: tuple[Level, ...] = tuple(who.level(number) for who, number in zip(avatars, detail, strict=True))
        numbers = [id(who) for who in avatars]
        self._first = [numbers.index(number) for number in numbers]
        # the most that an avatar has: those with and without helper joints share programs
        self.bones = max((level.bones for level in self.levels), default=len(JOINTS))
        # the most joints that a vertex follows, in all levels: these share programs too
        self.influences = max((one.influences for who in self.avatars for one in who.levels), default=4)
        self.faces = faces
        # where avatars are drawn
        self.layer = Layer()
        self.image: Image | None = None
        self.background: Image | None = None
        # pixels round an avatar's surface that an effect can draw on
        self.margin = MARGIN
        self.views: dict[int, str] = {}
        self.moved: set[int] = set()
        self._effects: dict[type, Effect] = {type(effect): effect for effect in effects}
        self.kept: dict[Hashable, Any] = {}
        self._kept_before = kept
        self.handles: dict[AnyHandle, None] = {}
        self.frame = self.buffer("frame", FRAME.itemsize)

    def asked(self, kind: type[T]) -> T | None:
        """The settings of an effect that the scene asks for, for the passes of another; None: it does not."""
        effect = self._effects.get(kind)
        return effect if isinstance(effect, kind) else None

    def need(self, handle: Handle[T]) -> Handle[T]:
        self.handles.setdefault(handle)
        return handle

    def keep(self, key: Hashable, make: Callable[[], T]) -> T:
        """What an earlier plan kept by this key, else made now. What a plan does not ask for again is closed."""
        if key not in self.kept:
            self.kept[key] = self._kept_before[key] if key in self._kept_before else make()
        return self.kept[key]

    def patches(self) -> Callable[[], list[Patches]]:
        """Pieces of each avatar's surface, for passes that draw where it can be; found when they are first needed."""
        levels = self.levels
        return self.keep((Patches, self.detail), lambda: cache(lambda: [Patches(level) for level in levels]))

    def tag(self, avatar: int) -> str:
        """What people call an avatar of the scene."""
        return f"avatar {avatar + 1}" if len(self.avatars) > 1 else "avatar"

    def first(self, avatar: int) -> int:
        """The first avatar of the scene that is the same object: what no pose changes is made once, for that one."""
        return self._first[avatar]

    @property
    def drawn_on(self) -> tuple[AnyHandle, ...]:
        """What every pass on the avatars' layer writes and reads."""
        image = self.layer.image or self.image
        return (*(() if image is None else image.handles), self.frame)

    def buffer(
        self, name: str, size: int, *depends_on: Hashable, content: Callable[[PlanResources], bytes] | None = None
    ) -> Handle[moderngl.Buffer]:
        """A buffer of `size` bytes: with this content, else to be written in each frame."""

        def make(resources: PlanResources) -> moderngl.Buffer:
            gl = resources.context.gl
            return gl.buffer(reserve=size, dynamic=True) if content is None else gl.buffer(content(resources))

        return self.need(Handle(moderngl.Buffer, name, size, depends_on, make))

    def vertices(
        self, name: str, avatar: int, item_bytes: int, content: Callable[[], np.ndarray], level: int | None = None
    ) -> Handle[moderngl.Buffer]:
        """What an avatar's vertices hold, given in the file's order, at the plan's level of detail or another; made
        once for avatars that are the same."""
        first, number = self.first(avatar), self.detail[avatar] if level is None else level
        mesh = self.avatars[avatar].level(number)
        return self.buffer(
            f"{self.tag(first)} {name}", item_bytes * len(mesh.positions), first, number,
            content=lambda made: content()[vertex_order(made, mesh)[0]].tobytes(),
        )  # fmt: skip

    def block(self, name: str, avatar: int) -> tuple[str, Handle[moderngl.Buffer]]:
        """A uniform block of one avatar, to be written in each frame."""
        size = block_bytes(name, self.bones)
        return name, self.buffer(f"{self.tag(avatar)} {name.lower()}", size, avatar)

    def texture(
        self, name: str, size: int, *depends_on: Hashable, make: Callable[[PlanResources], moderngl.Texture]
    ) -> Handle[moderngl.Texture]:
        return self.need(Handle(moderngl.Texture, name, size, depends_on, make))

    def program(
        self, vertex: str, fragment: str, *, samplers: Sequence[str] = (), avatar: int | None = None,
        constants: Callable[[], Mapping[str, str]] = dict, **defines: int,
    ) -> Handle[moderngl.Program]:  # fmt: skip
        """Two shaders in a variant. A sampler reads the texture unit of its place among `samplers`. `constants` are
        includes written for one avatar; without them avatars share the program."""

        counts = f"const int BONE_COUNT = {self.bones};\nconst int INFLUENCES = {self.influences};\n"

        def make(resources: PlanResources) -> moderngl.Program:
            """Compile it, and give its blocks and samplers their places."""
            generated = {**constants(), "counts.glsl": counts}
            program = compile_program(resources.context.gl, vertex, fragment, defines, generated)
            for block in BINDING:
                bind_block(program, block, self.bones)
            for unit, sampler in [*enumerate(samplers), (FACE_UNIT, "face_offsets")]:
                found = program.get(sampler, None)
                if isinstance(found, moderngl.Uniform):
                    found.value = unit
            return program

        depends_on = (vertex, fragment, avatar, *defines.items(), counts)
        return self.need(Handle(moderngl.Program, f"{vertex} {fragment}", 0, depends_on, make))

    def array(
        self, program: Handle[moderngl.Program], *buffers: Attributes, faces: Handle[moderngl.Buffer] | None = None
    ) -> Handle[moderngl.VertexArray]:
        """A vertex array: the attributes of its vertices, and triangles."""

        def make(resources: PlanResources) -> moderngl.VertexArray:
            made, index = resources[program], None if faces is None else resources[faces]
            content = [(resources[handle], *attributes_read(made, *rest)) for handle, *rest in buffers]
            return resources.context.gl.vertex_array(made, content, index)

        return self.need(Handle(moderngl.VertexArray, program.name, 0, (program, *buffers, faces), make))

    def framebuffer(
        self, name: str, size: tuple[int, int], *, depth: bool, textures: bool = False, samples: int = 0
    ) -> Image:
        """An image to draw on, with depth or without; its parts are textures where a pass reads them."""
        kind: type[Attachment] = moderngl.Texture if textures else moderngl.Renderbuffer
        pixels, shape = 4 * size[0] * size[1] * max(samples, 1), (*size, samples)

        def color_of(resources: PlanResources) -> Attachment:
            gl = resources.context.gl
            return clamped(gl.texture(size, 4)) if textures else gl.renderbuffer(size, samples=samples)

        def depth_of(resources: PlanResources) -> Attachment:
            if not textures:
                return resources.context.gl.depth_renderbuffer(size, samples=samples)
            texture = clamped(resources.context.gl.depth_texture(size))
            # it is read as a number
            texture.compare_func, texture.filter = "", (moderngl.NEAREST, moderngl.NEAREST)
            return texture

        color = self.need(Handle(kind, f"{name} color", pixels, shape, color_of))
        behind = self.need(Handle(kind, f"{name} depth", pixels, shape, depth_of)) if depth else None

        def make(resources: PlanResources) -> moderngl.Framebuffer:
            attached = None if behind is None else resources[behind]
            return resources.context.gl.framebuffer([resources[color]], attached)

        return Image(size, self.need(Handle(moderngl.Framebuffer, name, 0, (color, behind), make)), color, behind)

    def own_image(self, *, depth: bool) -> Image:
        """The renderer's own image; with depth where avatars are drawn straight on it."""
        assert self.canvas.size is not None
        if self.image is None:
            self.image = self.framebuffer("image", self.canvas.size, depth=depth)
        return self.image

    @property
    def behind_avatars(self) -> tuple[AnyHandle, ...]:
        """What a pass writes that draws on the picture before the avatars are drawn; a window is nothing of ours."""
        return self.own_image(depth=self.layer.image is None).handles if self.canvas.own_image else ()

    def result(self, stages: Sequence[tuple[Stage, Sequence[Pass]]]) -> Plan:
        """The plan of these passes, in drawing order."""
        passes = tuple(item for _, some in stages for item in some)
        last = [item for stage, some in stages if stage is Stage.PICTURE for item in some]
        filters = tuple(item for item in last if not isinstance(item, Absent))
        background = None if self.background is None else self.background.framebuffer
        return Plan(
            passes, filters, tuple(self.handles), self.frame, self.image, background, self.margin, self.views,
            frozenset(self.moved), self.kept,
        )  # fmt: skip


def vertex_order(made: PlanResources, mesh: Level) -> tuple[np.ndarray, np.ndarray]:
    """The order in which vertices are stored, and the faces that count so."""
    return made.shared(("order", id(mesh)), lambda: draw_order(mesh.positions, mesh.faces))


@runtime_checkable
class Closable(Protocol):
    """What has to be closed when no plan keeps it any longer."""

    def close(self) -> None: ...


def close_all(kept: Iterable[object]) -> None:
    """Close what a plan kept and no later one does."""
    for one in kept:
        if isinstance(one, Closable):
            one.close()


def clamped(texture: moderngl.Texture) -> moderngl.Texture:
    """A texture that ends at its edges, not repeated."""
    texture.repeat_x = texture.repeat_y = False
    return texture
