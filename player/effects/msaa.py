"""MSAA: avatars are drawn with several samples a pixel, over the background; their mean goes into the picture."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from player.draw.drawing import Drawing, Layer
from player.draw.plan import SAMPLES, Absent, Decision, Draft, Pass, PassState, Stage
from player.draw.resources import Image
from player.effects.fxaa import OUT_OF_VIEW, Fxaa

RUNS = Decision(PassState.RUNS, f"{SAMPLES} samples, resolved on the avatars' box")


@dataclass(frozen=True)
class Msaa:
    """No settings: the number of samples is the same on every machine."""

    stage: ClassVar[Stage] = Stage.PICTURE

    def passes(self, draft: Draft) -> Sequence[Pass]:
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
    samples: Image
    resolved: Image

    def decide(self, drawing: Drawing) -> Decision:
        return RUNS if any(drawing.visible) else OUT_OF_VIEW

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
