"""Contact darkening: what comes near the ground or another limb hides the sky from it (contact_capsules.py).

On the ground it is a pass of its own, under the avatars; on their surface the passes that draw them take it in, vertex
by vertex, in a variant of their program (shaders/contact.glsl).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Annotated, ClassVar, NamedTuple

import moderngl
import numpy as np
from jaxtyping import Float, Int, UInt32

from avatar.camera import view_from_world
from command.settings import Above, AtLeast, AtMost, settings
from player.draw.drawing import Drawing
from player.draw.plan import Attributes, Decision, Draft, Pass, PassState, Stage
from player.draw.posed_mesh import normals_of
from player.draw.resources import Handle, PlanResources
from player.effects.contact_capsules import LEAST, Capsules, capsules_of
from player.effects.ground_plane import PassBehind, Sheet, draw_behind
from player.gl.blocks import CAPSULES
from player.gl.shader import set_uniforms

SMALLEST = 60  # pixels; of a smaller avatar it cannot be seen
AWAY = Decision(PassState.SKIPPED, "nothing is near the ground, or it is out of view")
SMALL = Decision(PassState.SKIPPED, f"the avatar is less than {SMALLEST} pixels tall")
RUNS = Decision(PassState.RUNS, "asked for")
# on the ground capsules are as thick as the body: they are thin so as to stay inside it
GROWN = 2.0
# cells of the ground each way, drawn where a capsule reaches; shaders/contact_floor.vert
CELLS = 24
# low capsules that a cell's pixels look at, at most: cells are drawn in as many goes
COUNTS = (0, 1, 2, 4, 6)
# in widths of a cell: what stays this high above the ground is looked at in the corners of cells
HIGH = 3.0
ATTRIBUTES = ("1u4 1f4", "spared", "rest")
VERTEX = np.dtype([("spared", "u4"), ("rest", "f4")])


@settings
class Contact:
    """How dark it gets, and where the ground is."""

    stage: ClassVar[Stage] = Stage.GROUND

    strength: Annotated[float, Above(0), AtMost(1),
        "share of the sky's light that is lost where all of it is hidden"] = 0.8
    height: Annotated[float, AtLeast(-1e4), AtMost(1e4), "of the ground above the world's origin, metres"] = 0.0

    def passes(self, draft: Draft) -> Sequence[Pass]:
        touches = [contact_of(draft, index) for index in range(len(draft.avatars))]
        return tuple(self._floor(draft, touch) for touch in touches if touch is not None)

    def _floor(self, draft: Draft, touch: "AvatarContact") -> "ContactFloorPass":
        tag = draft.tag(touch.avatar)
        block = draft.buffer(f"{tag} capsules near the ground", CAPSULES.itemsize, touch.avatar)
        cells = draft.buffer(f"{tag} ground cells", 24 * CELLS**2, touch.avatar)
        program = draft.program("contact_floor.vert", "contact_floor.frag")
        array = draft.array(program, faces=cells)
        uses = (*draft.behind_avatars, block, cells, array)
        name = f"contact: {tag} on the ground"
        return ContactFloorPass(name, uses, draft.layer, program, array, self, touch, block, cells)


@dataclass(frozen=True)
class AvatarContact:
    """One avatar's capsules in a plan."""

    avatar: int
    strength: float
    body: Callable[[], Capsules]  # fitted when they are first needed: a quarter of a second
    block: Handle[moderngl.Buffer]  # the capsules of this frame
    vertices: Handle[moderngl.Buffer]  # what each does not take from its own limb
    normals: Handle[moderngl.Buffer]

    @property
    def buffers(self) -> tuple[Attributes, ...]:
        """What a vertex array gains; its normals where nothing else brings them."""
        return (self.vertices, *ATTRIBUTES), (self.normals, "3f4", "normal")

    def shows(self, drawing: Drawing) -> bool:
        return drawing.height(self.avatar) >= SMALLEST

    def bind(self, drawing: Drawing) -> None:
        """Bring the capsules of this frame to the GPU, unless another pass has, and bind them."""
        drawing.bind(self.block, "Capsules", lambda: self.content(drawing))

    def warm(self, resources: PlanResources) -> None:
        resources.bind_zeros(self.block, "Capsules")

    def content(self, drawing: Drawing, chosen: slice | Int[np.ndarray, "near"] = slice(None)) -> bytes:
        """The block of the capsules, or of some of them."""
        capsules, block = self.body(), np.zeros((), CAPSULES)
        starts, ends = (points[chosen] for points in capsules.posed(drawing.bones[self.avatar]))
        along, count = ends - starts, len(starts)
        block["capsule_start"][:count, :3], block["capsule_start"][:count, 3] = starts, capsules.radii[chosen]
        block["capsule_along"][:count, :3] = along
        block["capsule_along"][:count, 3] = 1 / np.maximum((along * along).sum(1), 1e-12)
        return block.tobytes()


def contact_of(draft: Draft, avatar: int) -> AvatarContact | None:
    """What darkens an avatar of the plan; None: nothing is to."""
    asked = draft.asked(Contact)
    if asked is None:
        return None
    who, level = draft.avatars[avatar], draft.levels[avatar]
    key = ("capsules", draft.first(avatar), draft.detail[avatar])
    body = draft.keep(key, lambda: cache(lambda: capsules_of(who, level)))

    def vertices() -> np.ndarray:
        out = np.zeros(len(level.positions), VERTEX)
        out["spared"], out["rest"] = body().spared, body().rest
        return out

    block = draft.buffer(f"{draft.tag(avatar)} capsules", CAPSULES.itemsize, avatar)
    stored = draft.vertices("contact", avatar, VERTEX.itemsize, vertices)
    return AvatarContact(avatar, asked.strength, body, block, stored, normals_of(draft, avatar))


@dataclass(frozen=True)
class ContactFloorPass(PassBehind):
    """The ground under one avatar, where one of its capsules is near, by those that are."""

    settings: Contact
    contact: AvatarContact
    # the capsules near the ground, and the triangles of the cells they reach
    block: Handle[moderngl.Buffer]
    cells: Handle[moderngl.Buffer]

    def decide(self, drawing: Drawing) -> Decision:
        under = self._under(drawing)
        if under is None or under.sheet.box(drawing.inputs.camera) is None:
            return AWAY
        return RUNS if self.contact.shows(drawing) else SMALL

    def draw(self, drawing: Drawing) -> None:
        """The cells that a capsule reaches, those that need few of them apart from those that need all."""
        under, resources, camera = self._under(drawing), drawing.resources, drawing.inputs.camera
        assert under is not None
        sheet = under.sheet
        drawing.bind(self.block, "Capsules", lambda: self.contact.content(drawing, under.near))
        triangles, batches = under.triangles()
        drawing.write(self.cells, lambda: triangles)
        program, view = resources[self.program], view_from_world(camera)
        columns = np.stack([view[:3, 0], view[:3, 2], view[:3] @ np.append(sheet.anchor, 1.0)])
        set_uniforms(
            program, view_from_plane=columns, up=tuple(view[:3, 1].tolist()), grown=GROWN, across=sheet.reach[2:],
            strength=self.settings.strength, high=(under.low, len(under.near)),
        )  # fmt: skip

        def draw(flipped: bool) -> None:
            sheet.apply(program, camera, flipped=flipped)
            first = 0
            for count, size in batches:
                set_uniforms(program, count=count)
                resources[self.array].render(vertices=3 * size, first=3 * first)
                first += size

        draw_behind(drawing, self.layer, draw)

    def render(self, resources: PlanResources) -> None:
        """One triangle that darkens nothing."""
        resources.bind_zeros(self.block, "Capsules")
        resources[self.cells].write(bytes(self.cells.bytes))
        resources[self.array].render(vertices=3)

    def _under(self, drawing: Drawing) -> "Under | None":
        """The ground under what is near it."""
        capsules = self.contact.body()
        world_from_view = np.linalg.inv(view_from_world(drawing.inputs.camera))
        ends = np.stack(capsules.posed(drawing.bones[self.contact.avatar]))
        ends = ends @ world_from_view[:3, :3].T + world_from_view[:3, 3]
        above = ends[..., 1] - self.settings.height
        # o = h r^2 / (d^2 + h^2)^(3/2) of what is h above the ground: LEAST at d^2 = c h^(2/3) - h^2, which is largest
        # at h = (c / 3)^(3/4), or at the end nearer to that
        radii = GROWN * capsules.radii
        low, high = np.maximum(above.min(0), 0), np.maximum(above.max(0), 0)
        c = np.cbrt((radii**2 / LEAST) ** 2)
        at = np.clip((c / 3) ** 0.75, low, high)
        reach = np.sqrt(np.maximum(c * np.cbrt(at * at) - at * at, 0))
        reach = np.where(low < radii, np.maximum(reach, radii), reach)
        near = np.flatnonzero((high > 0) & (reach > 0))
        if not len(near):
            return None
        flat = ends[:, near][..., [0, 2]]
        first = (flat.min(0) - reach[near, None]).min(0)
        across = (flat.max(0) + reach[near, None]).max(0) - first
        is_high = low[near] > HIGH * across.max() / CELLS
        # the low ones first, and of these the far reaching: most cells need no others
        order = np.lexsort((-reach[near], is_high))
        near, flat = near[order], flat[:, order] - first
        anchor = np.array([first[0], self.settings.height, first[1]])
        sheet = Sheet(anchor, (0.0, 0.0, *across.tolist()))
        return Under(sheet, near, flat, reach[near], int((~is_high).sum()))


class Under(NamedTuple):
    """The ground that an avatar can darken."""

    sheet: Sheet
    # which of its capsules: the low ones first, of these the farthest reaching
    near: Int[np.ndarray, "near"]
    # where these stand on the sheet, and how far they reach, metres
    ends: Float[np.ndarray, "2 near 2"]
    reach: Float[np.ndarray, "near"]
    # how many are low
    low: int

    def triangles(self) -> tuple[UInt32[np.ndarray, "triangles 3"], list[tuple[int, int]]]:
        """Triangles of the cells that a capsule reaches, all within its reach of its middle line; and in their order,
        how many of the low capsules how many of the triangles need: COUNTS, and all."""
        side = np.array(self.sheet.reach[2:]) / CELLS
        column, row = np.meshgrid(np.arange(CELLS), np.arange(CELLS))
        middle = (np.stack([column, row], -1).reshape(-1, 1, 2) + 0.5) * side
        start, along = self.ends[0], self.ends[1] - self.ends[0]
        share = ((middle - start) * along).sum(-1) / np.maximum((along * along).sum(-1), 1e-12)
        away = np.linalg.norm(middle - start - np.clip(share, 0, 1)[..., None] * along, axis=-1)
        reached = away <= self.reach + 0.5 * np.linalg.norm(side)
        seen = reached.any(1)
        # one more than the last low one that reaches it, 0 where none does
        needs = (reached[:, : self.low] * np.arange(1, self.low + 1)).max(1, initial=0)
        counts = [*(count for count in COUNTS if count < self.low), self.low]
        batch = np.searchsorted(counts, needs)
        order = np.flatnonzero(seen)[np.argsort(batch[seen], kind="stable")]
        a = (column + (CELLS + 1) * row).reshape(-1)[order].astype(np.uint32)
        b, c, d = a + 1, a + CELLS + 1, a + CELLS + 2
        sizes = np.bincount(batch[order], minlength=len(counts)).tolist()
        batches = [(count, 2 * size) for count, size in zip(counts, sizes, strict=True) if size]
        return np.stack([a, b, c, c, b, d], 1).reshape(-1, 3), batches
