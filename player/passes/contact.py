"""Contact darkening: what comes near the ground or another limb hides the sky from it (player/contact_capsules.py).

On the ground it is a pass of its own, under the avatars; on their surface the passes that draw them take it in, vertex
by vertex, in a variant of their program (shaders/contact.glsl).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import moderngl
import numpy as np

from avatar.baked_avatar import Avatar, Level
from avatar.camera import view_from_world
from avatar.settings import Above, AtLeast, AtMost, check
from player.blocks import BINDING, CAPSULES
from player.contact_capsules import LEAST, Capsules, capsules_of
from player.drawing import Drawing, Layer, Warming
from player.ground_plane import Sheet, draw_behind
from player.plan import Decision, Draft, Pass, Stage, State
from player.posed_mesh import vertex_order
from player.resources import Handle, PlanResources
from player.shader import uniform

# pixels; of a smaller avatar it cannot be seen
SMALLEST = 60
AWAY = Decision(State.SKIPPED, "nothing is near the ground, or it is out of view")
SMALL = Decision(State.SKIPPED, f"the avatar is less than {SMALLEST} pixels tall")
RUNS = Decision(State.RUNS, "asked for")
# on the ground capsules are as thick as the body: they are thin so as to stay inside it
GROWN = 2.0
ATTRIBUTES = ("1u4 1f4", "spared", "rest")
VERTEX = np.dtype([("spared", "u4"), ("rest", "f4")])


@dataclass(frozen=True)
class Contact:
    """How dark it gets, and where the ground is.

    Raises:
        ValueError: a value that is out of its range.
    """

    stage: ClassVar[Stage] = Stage.GROUND

    strength: Annotated[
        float, Above(0), AtMost(1), "share of the sky's light that is lost where all of it is hidden"
    ] = 0.8
    height: Annotated[float, AtLeast(-1e4), AtMost(1e4), "of the ground above the world's origin, metres"] = 0.0

    def __post_init__(self):
        check(self)

    def prepare(self, draft: Draft) -> None:
        """Before any pass is planned: avatars are drawn after the ground, and planned before it."""
        draft.contact = self.strength

    def passes(self, draft: Draft) -> Sequence[Pass]:
        image = draft.own_image(depth=draft.layer.image is None) if draft.canvas.own_image else None
        drawn_on = () if image is None else image.handles
        program = draft.program("plane.vert", "contact_floor.frag")
        array = draft.array(program)
        return tuple(
            FloorPass(
                f"contact: {draft.tag(index)} on the ground", (*drawn_on, touch.block, array), self, touch, draft.layer,
                program, array,
            )
            for index, touch in ((index, touched(draft, index)) for index in range(len(draft.avatars)))
            if touch is not None
        )  # fmt: skip


@dataclass(frozen=True)
class Touched:
    """One avatar's capsules in a plan."""

    avatar: int
    strength: float
    body: "LazyCapsules"
    # the capsules of this frame
    block: Handle[moderngl.Buffer]
    # of each vertex
    vertices: Handle[moderngl.Buffer]
    normals: Handle[moderngl.Buffer]

    @property
    def buffers(self) -> tuple[tuple[Any, ...], ...]:
        """What a vertex array gains; its normals where nothing else brings them."""
        return (self.vertices, *ATTRIBUTES), (self.normals, "3f4", "normal")

    def shows(self, drawing: Drawing) -> bool:
        return drawing.height(self.avatar) >= SMALLEST

    def bind(self, drawing: Drawing) -> None:
        """Bring the capsules of this frame to the GPU, unless another pass has, and bind them."""
        buffer = drawing.write(self.block, lambda: self._content(drawing))
        buffer.bind_to_uniform_block(BINDING["Capsules"][1])

    def warm(self, resources: PlanResources) -> None:
        buffer = resources[self.block]
        buffer.write(bytes(buffer.size))
        buffer.bind_to_uniform_block(BINDING["Capsules"][1])

    def _content(self, drawing: Drawing) -> bytes:
        capsules, block = self.body.capsules, np.zeros((), CAPSULES)
        starts, ends = capsules.posed(drawing.bones[self.avatar])
        along, count = ends - starts, len(starts)
        block["capsule_start"][:count, :3], block["capsule_start"][:count, 3] = starts, capsules.radii
        block["capsule_along"][:count, :3] = along
        block["capsule_along"][:count, 3] = 1 / np.maximum((along * along).sum(1), 1e-12)
        return block.tobytes()


class LazyCapsules:
    """Capsules of an avatar, fitted when they are first needed: a quarter of a second."""

    def __init__(self, avatar: Avatar, level: Level):
        self._of: tuple[Avatar, Level] = avatar, level
        self._found: Capsules | None = None

    @property
    def capsules(self) -> Capsules:
        if self._found is None:
            self._found = capsules_of(*self._of)
        return self._found


def touched(draft: Draft, avatar: int) -> Touched | None:
    """What darkens an avatar of the plan; None: nothing is to."""
    if draft.contact is None:
        return None
    level, first = draft.levels[avatar], draft.first(avatar)
    tag, shared = draft.tag(avatar), draft.tag(first)
    body = draft.keep(("capsules", first, draft.level), lambda: LazyCapsules(draft.avatars[avatar], level))

    def vertices(made: PlanResources) -> bytes:
        out, order = np.zeros(len(level.positions), VERTEX), vertex_order(made, level)[0]
        out["spared"], out["rest"] = body.capsules.spared, body.capsules.rest
        return out[order].tobytes()

    return Touched(
        avatar, draft.contact, body,
        draft.buffer(f"{tag} capsules", CAPSULES.itemsize, avatar),
        draft.buffer(f"{shared} contact", VERTEX.itemsize * len(level.positions), first, draft.level, content=vertices),
        draft.buffer(
            f"{shared} normals", level.normals.nbytes, first, draft.level,
            content=lambda made: level.normals[vertex_order(made, level)[0]].tobytes(),
        ),
    )  # fmt: skip


@dataclass(frozen=True)
class FloorPass:
    name: str
    uses: tuple[Handle[Any], ...]
    contact: Contact
    touched: Touched
    layer: Layer
    program: Handle[moderngl.Program]
    array: Handle[moderngl.VertexArray]

    def decide(self, drawing: Drawing) -> Decision:
        sheet = self._sheet(drawing)
        if sheet is None or sheet.box(drawing.inputs.camera) is None:
            return AWAY
        return RUNS if self.touched.shows(drawing) else SMALL

    def draw(self, drawing: Drawing) -> None:
        sheet, resources, camera = self._sheet(drawing), drawing.resources, drawing.inputs.camera
        assert sheet is not None
        self.touched.bind(drawing)
        program, view = resources[self.program], view_from_world(camera)
        columns = np.stack([view[:3, 0], view[:3, 2], view[:3] @ np.append(sheet.anchor, 1.0)])
        uniform(program, "view_from_plane").write(np.ascontiguousarray(columns, np.float32).tobytes())
        uniform(program, "up").value = tuple(view[:3, 1].tolist())
        uniform(program, "grown").value = GROWN
        uniform(program, "strength").value = self.contact.strength
        uniform(program, "reach").value = sheet.reach

        def draw(flipped: bool) -> None:
            sheet.apply(program, camera, flipped=flipped)
            resources[self.array].render(moderngl.TRIANGLE_STRIP, vertices=4)

        draw_behind(drawing, self.layer, draw)

    def warm(self, warming: Warming) -> None:
        if warming.framebuffer is not None:
            warming.framebuffer.use()
            warming.resources.context.gl.enable_only(moderngl.BLEND)
            self.touched.warm(warming.resources)
            warming.resources[self.array].render(moderngl.TRIANGLE_STRIP, vertices=4)

    def _sheet(self, drawing: Drawing) -> Sheet | None:
        """The ground under what is near it."""
        capsules = self.touched.body.capsules
        world_from_view = np.linalg.inv(view_from_world(drawing.inputs.camera))
        ends = np.stack(capsules.posed(drawing.bones[self.touched.avatar]))
        ends = ends @ world_from_view[:3, :3].T + world_from_view[:3, 3]
        above = ends[..., 1] - self.contact.height
        # o = h r^2 / l^3 of what is h above the ground: LEAST at this distance
        radii = GROWN * capsules.radii
        reach = np.maximum(np.cbrt(np.maximum(above.max(0), 0) * radii**2 / LEAST), radii)
        near = (radii > 0) & (above.min(0) < reach) & (above.max(0) > -radii)
        if not near.any():
            return None
        flat, reach = ends[:, near][..., [0, 2]], reach[near, None]
        low, high = (flat.min(0) - reach).min(0), (flat.max(0) + reach).max(0)
        anchor = np.array([low[0], self.contact.height, low[1]])
        return Sheet(anchor, (0.0, 0.0, float(high[0] - low[0]), float(high[1] - low[1])))
