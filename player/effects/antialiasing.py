"""Smooth outlines: FXAA filters them in the finished picture, MSAA takes several samples a pixel."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar

import moderngl
import numpy as np

from player.draw.drawing import Drawing, Layer, Warming
from player.draw.plan import NONE_IN_VIEW, SAMPLES, Absent, Decision, Draft, Pass, PassState, Stage
from player.draw.resources import Handle, Image, PlanResources
from player.gl.shader import set_uniforms
from player.gl.tiles import TILE, Patches, covered, rectangles

FILTERED = Decision(PassState.RUNS, "on the tiles that avatars reach")
RESOLVED = Decision(PassState.RUNS, f"{SAMPLES} samples, resolved on the avatars' box")


@dataclass(frozen=True)
class Fxaa:
    """FXAA: filters the avatars' outlines in the finished picture; thresholds are in shaders/fxaa.frag.

    Avatars are drawn over nothing on a layer of their own, which is filtered over the background: it stays as it is. In
    software a filter costs what it covers: it runs on the tiles that avatars can reach.
    """

    stage: ClassVar[Stage] = Stage.PICTURE

    def passes(self, draft: Draft) -> Sequence[Pass]:
        """The filter; avatars before it are drawn on a layer of their own."""
        size = draft.canvas.size
        # a window: planned with its first frame
        if size is None:
            return ()
        output = draft.own_image(depth=False).handles if draft.canvas.own_image else ()
        image = draft.framebuffer("layer", size, depth=True, textures=True)
        draft.layer = Layer(image, lambda drawing: drawing.resources[image.framebuffer].clear())
        tiles = draft.buffer("fxaa tiles", 8 * -(-size[0] // TILE) * -(-size[1] // TILE), *size)
        program = draft.program("tiles.vert", "fxaa.frag", samplers=("picture", "depth"))
        array = draft.array(program, (tiles, "4u2 /i", "tile"))
        uses = (*output, *image.handles, tiles, array)
        return (FxaaPass("antialiasing: fxaa", uses, image, tiles, array, draft.patches(), draft.dual),)


@dataclass(frozen=True)
class FxaaPass(Pass):
    """The layer of avatars, filtered over the picture."""

    image: Image
    tiles: Handle[moderngl.Buffer]
    array: Handle[moderngl.VertexArray]
    patches: Callable[[], list[Patches]]
    dual: bool

    def decide(self, drawing: Drawing) -> Decision:
        return FILTERED if any(drawing.visible) else NONE_IN_VIEW

    def draw(self, drawing: Drawing) -> None:
        """The tiles that avatars reach, filtered."""
        camera, flipped = drawing.inputs.camera, drawing.inputs.flipped
        avatars = zip(self.patches(), drawing.bones, drawing.visible, drawing.reaches, strict=True)
        boxes = [
            patches.boxes(bones.view_from_canonical, camera, dual=self.dual, reach=reach)
            for patches, bones, seen, reach in avatars
            if seen
        ]
        reached = covered(np.concatenate(boxes), camera.size, drawing.look.margin)
        tiles = rectangles(reached, camera.size, flipped=flipped)
        drawing.inputs.framebuffer.use()
        if len(tiles):
            drawing.resources[self.tiles].write(np.ascontiguousarray(tiles))
            drawing.gl.enable_only(moderngl.BLEND)
            drawing.gl.blend_func = (moderngl.ONE, moderngl.ONE_MINUS_SRC_ALPHA)
            self._filter(drawing.resources, len(tiles))

    def warm(self, warming: Warming) -> None:
        resources = warming.resources
        if warming.enter_picture():
            resources[warming.look.frame].bind_to_uniform_block(0)
            resources[self.tiles].write(np.array([0, 0, 1, 1], np.uint16))
            self._filter(resources, 1)

    def _filter(self, resources: PlanResources, count: int) -> None:
        set_uniforms(resources[self.array].program, image_size=self.image.size)
        for unit, texture in enumerate(self.image.attachments):
            resources[texture].use(unit)
        resources[self.array].render(moderngl.TRIANGLE_STRIP, vertices=4, instances=count)


@dataclass(frozen=True)
class Msaa:
    """MSAA: avatars are drawn with SAMPLES samples a pixel, over the background; their mean goes into the picture."""

    stage: ClassVar[Stage] = Stage.PICTURE

    def passes(self, draft: Draft) -> Sequence[Pass]:
        """The mean of the samples; avatars before it are drawn on an image that has several."""
        canvas = draft.canvas
        if canvas.max_samples < SAMPLES:
            why = f"the device has {canvas.max_samples} samples a pixel, {SAMPLES} are needed"
            return (Absent("antialiasing", why),)
        # a window: planned with its first frame
        if canvas.size is None:
            return ()
        resolved = draft.own_image(depth=False)
        samples = draft.framebuffer("samples", canvas.size, depth=True, samples=SAMPLES)
        # a pixel's samples lie differently upside down: for a window the finished picture is turned instead
        draft.layer = Layer(
            samples, lambda drawing: _over_background(drawing, samples), always_flipped=True, begins_with_picture=True
        )
        uses = (*resolved.handles, *samples.handles)
        return (MsaaPass("antialiasing: msaa", uses, samples, resolved),)


@dataclass(frozen=True)
class BestAntialiasing:
    """MSAA on a GPU; on a software rasteriser, where MSAA costs more than twice as much, FXAA."""

    stage: ClassVar[Stage] = Stage.PICTURE

    def passes(self, draft: Draft) -> Sequence[Pass]:
        canvas = draft.canvas
        return (Fxaa() if canvas.software or canvas.max_samples < SAMPLES else Msaa()).passes(draft)


@dataclass(frozen=True)
class MsaaPass(Pass):
    """The samples on their way into the picture."""

    samples: Image
    resolved: Image

    def decide(self, drawing: Drawing) -> Decision:
        return RESOLVED if any(drawing.visible) else NONE_IN_VIEW

    def draw(self, drawing: Drawing) -> None:
        """The mean of the samples, where avatars are."""
        inputs, image, box = drawing.inputs, drawing.resources[self.resolved.framebuffer], drawing.box()
        drawing.blit(drawing.resources[self.samples.framebuffer], image, box)
        # a window may have another format, which only a plain copy allows
        if inputs.framebuffer is not image:
            drawing.blit(image, inputs.framebuffer, box, turned=None if inputs.flipped else inputs.camera.size[1])
        inputs.framebuffer.use()


def _over_background(drawing: Drawing, samples: Image) -> None:
    framebuffer = drawing.resources[samples.framebuffer]
    framebuffer.clear(color=drawing.look.color)
    if drawing.look.background is not None:
        drawing.blit(drawing.resources[drawing.look.background], framebuffer, drawing.box())
        framebuffer.use()
