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
from jaxtyping import Int

from avatar.camera import view_from_world
from command.settings import Above, AtLeast, AtMost, settings
from player.draw.drawing import Drawing, Warming
from player.draw.plan import Addition, Decision, Draft, Pass, PassState, Stage
from player.draw.posed_mesh import normals_of
from player.draw.resources import Handle, Image, PlanResources
from player.effects.contact_capsules import LEAST, Capsules, capsules_of
from player.effects.ground_plane import PassBehind, Sheet, behind_parts, drawn_texture
from player.gl.blocks import CAPSULES
from player.gl.shader import set_uniforms

SMALLEST = 60  # pixels; of a smaller avatar it cannot be seen
AWAY = Decision(PassState.SKIPPED, "nothing is near the ground, or it is out of view")
SMALL = Decision(PassState.SKIPPED, f"the avatar is less than {SMALLEST} pixels tall")
RUNS = Decision(PassState.RUNS, "asked for")
# on the ground capsules are as thick as the body: they are thin so as to stay inside it
GROWN = 2.0
# texels a side of the ground that it darkens
SIDE = 64
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
        hidden = drawn_texture(draft, f"{tag} sky hidden from the ground", SIDE * SIDE, SIDE, touch.avatar)
        found = draft.array(draft.program("screen.vert", "contact_floor.frag"))
        parts = behind_parts(draft, "plane.vert", "laid.frag", block, *hidden.handles, found, samplers=("soft",))
        return ContactFloorPass(f"contact: {tag} on the ground", *parts, self, touch, block, hidden, found)


@dataclass(frozen=True)
class AvatarContact(Addition):
    avatar: int
    strength: float
    body: Callable[[], Capsules]  # fitted when they are first needed: a quarter of a second

    def shows(self, drawing: Drawing) -> bool:
        return drawing.height(self.avatar) >= SMALLEST

    def apply(self, drawing: Drawing, program: moderngl.Program) -> None:
        set_uniforms(program, darkening=self.strength)

    def content(self, drawing: Drawing, block: str) -> bytes:
        """The capsules of this frame."""
        return self.chosen(drawing, slice(None))

    def chosen(self, drawing: Drawing, which: slice | Int[np.ndarray, "near"]) -> bytes:
        """A block of some of the capsules."""
        capsules, block = self.body(), np.zeros((), CAPSULES)
        starts, ends = (points[which] for points in capsules.posed(drawing.bones[self.avatar]))
        along, count = ends - starts, len(starts)
        block["capsule_start"][:count, :3], block["capsule_start"][:count, 3] = starts, capsules.radii[which]
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

    stored = draft.vertices("contact", avatar, VERTEX.itemsize, vertices)
    buffers = (stored, "1u4 1f4", "spared", "rest"), normals_of(draft, avatar)
    return AvatarContact(buffers, (draft.block("Capsules", avatar),), avatar, asked.strength, body)


@dataclass(frozen=True)
class ContactFloorPass(PassBehind):
    """The ground under one avatar, where one of its capsules is near, by those that are."""

    settings: Contact
    contact: AvatarContact
    # the capsules near the ground
    block: Handle[moderngl.Buffer]
    # how much of the sky they hide, and what finds it
    hidden: Image
    found: Handle[moderngl.VertexArray]

    def decide(self, drawing: Drawing) -> Decision:
        under = self._under(drawing)
        if under is None or under.sheet.box(drawing.inputs.camera) is None:
            return AWAY
        return RUNS if self.contact.shows(drawing) else SMALL

    def draw(self, drawing: Drawing) -> None:
        """How much of the sky is hidden, texel by texel, then laid on the ground."""
        under, view = self._under(drawing), view_from_world(drawing.inputs.camera)
        assert under is not None
        sheet, near = under
        resources = drawing.resources
        drawing.bind(self.block, "Capsules", lambda: self.contact.chosen(drawing, near))
        columns = np.stack([view[:3, 0], view[:3, 2], view[:3] @ np.append(sheet.anchor, 1.0)])
        set_uniforms(
            resources[self.found].program, view_from_plane=columns, up=tuple(view[:3, 1].tolist()), grown=GROWN,
            texel=tuple(across / SIDE for across in sheet.reach[2:]), count=len(near),
        )  # fmt: skip
        self._find(resources)
        set_uniforms(resources[self.array].program, reach=sheet.reach, strength=self.settings.strength)
        self.draw_sheet(drawing, sheet)

    def render(self, resources: PlanResources) -> None:
        resources[self.hidden.color].use(0)
        super().render(resources)

    def warm(self, warming: Warming) -> None:
        warming.resources.bind_zeros(self.block, "Capsules")
        self._find(warming.resources)
        super().warm(warming)

    def _find(self, resources: PlanResources) -> None:
        """What the capsules that are bound hide of the sky."""
        resources[self.hidden.framebuffer].use()
        resources.context.gl.enable_only(0)
        resources[self.found].render(moderngl.TRIANGLES, vertices=3)

    def _under(self, drawing: Drawing) -> "Under | None":
        return drawing.once(self.block, lambda: self._find_under(drawing))

    def _find_under(self, drawing: Drawing) -> "Under | None":
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
        anchor = np.array([first[0], self.settings.height, first[1]])
        return Under(Sheet(anchor, (0.0, 0.0, *across.tolist())), near)


class Under(NamedTuple):
    """The ground that an avatar can darken, and which of its capsules do."""

    sheet: Sheet
    near: Int[np.ndarray, "near"]
