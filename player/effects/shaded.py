"""The pass that draws an avatar, and how its program is varied by what a scene calls for: other light, contact
darkening, loose parts. What cannot show in a frame leaves it with the program that never heard of it."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import moderngl

from player.draw.drawing import Drawing, Layer, Warming
from player.draw.plan import Attributes, Decision, Draft, Pass, PassState
from player.draw.posed_mesh import PosedMesh
from player.draw.resources import AnyHandle, Handle, PlanResources
from player.effects.contact import AvatarContact, contact_of
from player.effects.light import AvatarLight, light_note, light_of
from player.effects.secondary_motion import LooseOffsets, offsets_of
from player.gl.shader import set_uniforms

MIN_HEIGHT = 40  # pixels; view dependence of a smaller avatar cannot be seen
OUT_OF_VIEW = Decision(PassState.SKIPPED, "out of view")
TOO_SMALL = Decision(PassState.SKIPPED, f"the avatar is less than {MIN_HEIGHT} pixels tall")
VIEW_DRAWS_IT = Decision(PassState.SKIPPED, "the view pass draws this avatar")


class Variant(NamedTuple):
    array: Handle[moderngl.VertexArray]
    program: Handle[moderngl.Program]
    light: AvatarLight | None
    contact: AvatarContact | None
    loose: LooseOffsets | None

    def shows(self, drawing: Drawing) -> bool:
        """Whether all that it adds to the plain one can be seen in this frame."""
        return all(one is None or one.shows(drawing) for one in (self.contact, self.loose))

    def apply(self, drawing: Drawing) -> None:
        """Give the program what holds in this frame."""
        program = drawing.resources[self.program]
        if self.light is not None:
            self.light.apply(program, drawing.inputs.camera)
        if self.contact is not None:
            self.contact.bind(drawing)
            set_uniforms(program, darkening=self.contact.strength)
        if self.loose is not None:
            self.loose.bind(drawing)


class AvatarShading(NamedTuple):
    """The variants of one avatar, from all that is asked for to none of it: darkened where contact can be seen, moved
    where loose parts are."""

    variants: tuple[Variant, ...]
    # for people: the end of a pass's reason
    note: str

    def variant(self, drawing: Drawing) -> Variant:
        return next(variant for variant in self.variants if variant.shows(drawing))

    def warm(self, resources: PlanResources) -> None:
        """Draw a triangle with each variant, to what is bound."""
        for variant in self.variants:
            for one in (variant.contact, variant.loose):
                if one is not None:
                    one.warm(resources)
            resources[variant.array].render(vertices=3)

    @property
    def handles(self) -> tuple[AnyHandle, ...]:
        """What its variants read, each object once."""
        light, contact, loose = self.variants[0][2:]
        out: list[AnyHandle] = [handle for variant in self.variants for handle in variant[:2]]
        out += [] if light is None else [light.vertices]
        out += [] if contact is None else [contact.block, contact.vertices, contact.normals]
        return (*out, *(() if loose is None else loose.handles))


def shading_of(draft: Draft, who: int, mesh: PosedMesh, *more: Attributes, **program: Any) -> AvatarShading:
    """The program of one of the plan's avatars as it calls for it. more: further attributes of the vertices; program:
    as `Draft.program`."""
    light, contact, loose = light_of(draft, who), contact_of(draft, who), offsets_of(draft, who)

    def variant(touch: AvatarContact | None, moved: LooseOffsets | None) -> Variant:
        """The program with this contact and these loose parts, or without."""
        made = draft.program(
            "avatar.vert", "avatar.frag", SKINNING=int(draft.dual), LIT=0 if light is None else light.variant,
            CONTACT=int(touch is not None), LOOSE=int(moved is not None),
            FACE=int(mesh.face is not None), **program,
        )  # fmt: skip
        buffers = [*more, *([] if light is None else [light.buffer])]
        if touch is not None:
            # the light's vertices have normals
            buffers += touch.buffers[:1] if light is not None else touch.buffers
        buffers += [] if moved is None else [moved.buffer]
        return Variant(mesh.array(draft, made, *buffers), made, light, touch, moved)

    note = light_note(draft, who, light) + ("" if contact is None else ", darkened where limbs come near")
    ways = [(touch, moved) for touch in dict.fromkeys((contact, None)) for moved in dict.fromkeys((loose, None))]
    return AvatarShading(tuple(variant(*way) for way in ways), note)


@dataclass(frozen=True)
class AvatarPass(Pass):
    """One avatar, in the colors of its texture or with view dependence."""

    layer: Layer
    mesh: PosedMesh
    shading: AvatarShading
    # by unit: base color, features, more features
    textures: tuple[Handle[moderngl.Texture], ...]
    running: Decision
    # the pass that draws the avatar instead, where it can show; None: it is that pass, or there is none
    instead: "AvatarPass | None" = None
    min_height: int = 0  # pixels

    def decide(self, drawing: Drawing) -> Decision:
        if not drawing.visible[self.mesh.avatar]:
            return OUT_OF_VIEW
        if self.instead is not None and self.instead.decide(drawing).runs:
            return VIEW_DRAWS_IT
        return self.running if drawing.height(self.mesh.avatar) >= self.min_height else TOO_SMALL

    def draw(self, drawing: Drawing) -> None:
        drawing.enter(self.layer)
        self.mesh.pose(drawing)
        self._bind(drawing.resources)
        variant = self.shading.variant(drawing)
        variant.apply(drawing)
        drawing.resources[variant.array].render()

    def warm(self, warming: Warming) -> None:
        if warming.enter(self.layer):
            self.mesh.warm(warming.resources)
            self._bind(warming.resources)
            self.shading.warm(warming.resources)

    def _bind(self, resources: PlanResources) -> None:
        for unit, texture in enumerate(self.textures):
            resources[texture].use(unit)
