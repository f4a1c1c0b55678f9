"""How an avatar's program is varied by what a scene calls for: other light, contact darkening. The passes that draw
avatars ask for it here; what cannot show in a frame leaves them with the program that never heard of it."""

from typing import Any, NamedTuple

import moderngl

from player.drawing import Drawing
from player.passes.contact import Touched, touched
from player.passes.light import Lit, light_note, lit
from player.plan import Draft
from player.posed_mesh import PosedMesh
from player.resources import Handle, PlanResources
from player.shader import uniform


class Variant(NamedTuple):
    """A program with the vertices it reads."""

    array: Handle[moderngl.VertexArray]
    program: Handle[moderngl.Program]
    light: Lit | None
    contact: Touched | None

    def apply(self, drawing: Drawing) -> None:
        """Give the program what holds in this frame."""
        program = drawing.resources[self.program]
        if self.light is not None:
            self.light.apply(program, drawing.inputs.camera)
        if self.contact is not None:
            self.contact.bind(drawing)
            uniform(program, "darkening").value = self.contact.strength


class Shaded(NamedTuple):
    """The variants of one avatar: the darkened one where contact is asked for and can be seen."""

    plain: Variant
    darkened: Variant | None
    # for people: the end of a pass's reason
    note: str

    def variant(self, drawing: Drawing) -> Variant:
        contact = None if self.darkened is None else self.darkened.contact
        return self.plain if contact is None or not contact.shows(drawing) else self.darkened or self.plain

    def warm(self, resources: PlanResources) -> None:
        """Draw a triangle with each variant, to what is bound."""
        for variant in self.variants:
            if variant.contact is not None:
                variant.contact.warm(resources)
            resources[variant.array].render(vertices=3)

    @property
    def variants(self) -> tuple[Variant, ...]:
        return (self.plain,) if self.darkened is None else (self.plain, self.darkened)

    @property
    def handles(self) -> tuple[Handle[Any], ...]:
        out: list[Handle[Any]] = [variant.array for variant in self.variants]
        if self.plain.light is not None:
            out += [self.plain.light.vertices, self.plain.program]
        if self.darkened is not None and self.darkened.contact is not None:
            contact = self.darkened.contact
            out += [contact.block, contact.vertices, contact.normals, self.darkened.program]
        return tuple(out)


def shaded(draft: Draft, who: int, mesh: PosedMesh, *more: tuple[Any, ...], **program: Any) -> Shaded:
    """The program of one of the plan's avatars as it calls for it. more: further attributes of the vertices; program:
    as `Draft.program`."""
    light, contact = lit(draft, who), touched(draft, who)

    def variant(touch: Touched | None) -> Variant:
        made = draft.program(
            "avatar.vert", "avatar.frag", SKINNING=int(draft.dual), LIT=0 if light is None else light.variant,
            CONTACT=int(touch is not None), **program,
        )  # fmt: skip
        buffers = list(more)
        if light is not None:
            buffers.append(light.buffer)
        if touch is not None:
            # the light's vertices have normals
            buffers += touch.buffers[:1] if light is not None else touch.buffers
        return Variant(mesh.array(draft, made, *buffers), made, light, touch)

    note = light_note(draft, who, light) + ("" if contact is None else ", darkened where limbs come near")
    return Shaded(variant(None), None if contact is None else variant(contact), note)
