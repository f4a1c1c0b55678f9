"""What is behind the avatars: a color, a picture, a film, a panorama.

Pixels are made ready at the size of the picture when their content changes, and copied in each frame: a copy costs
1.04 of a bare frame in software, a textured triangle 1.4 to 1.8. Their first row is the top, as in the renderer's own
image; a window takes the copy upside down.
"""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

import numpy as np

from command.errors import AssetError
from command.settings import Above, AtLeast, AtMost, Color, FilePlace, OneOf, settings
from player.draw.drawing import Drawing
from player.draw.plan import Absent, Decision, Draft, Pass, PassState, Stage
from player.draw.resources import Image
from player.effects.background_source import PICTURES, RGBA, PictureSequence, Placing, Source, Video, pictures_in
from player.effects.panorama import Panorama, panorama_pass

BACKGROUNDS = ("color", "image", "video", "hdr", "transparent")
FITS = ("cover", "contain", "stretch")
STUDIO_COLOR, NOTHING = (43 / 255, 45 / 255, 51 / 255, 1.0), (0.0, 0.0, 0.0, 0.0)
ASKED = Decision(PassState.RUNS, "asked for")
NEW_FRAME = Decision(PassState.RUNS, "a new frame")
SAME_FRAME = Decision(PassState.KEPT, "the same frame")


@settings
class Background:
    """What is behind the avatars.

    Raises:
        ValueError: a value that is not known, a kind without the file it needs, or a file for a kind that has none.
    """

    kind: Annotated[str, OneOf(BACKGROUNDS), "what it is; image, video and hdr need a path"] = "color"
    # premultiplied sRGB
    color: Annotated[RGBA, Color(), "of kind color, and where an image or a video does not reach"] = STUDIO_COLOR
    path: Annotated[str | None, FilePlace(),
        "picture; film or folder of frames; panorama (Radiance .hdr, twice as wide as high)"] = None
    fit: Annotated[str, OneOf(FITS),
        "of image and video: cover crops, contain leaves bars of `color`, stretch distorts"] = "cover"
    rate: Annotated[float, Above(0), AtMost(1e4), "frames per second of a folder of frames; a film has its own"] = 30.0
    exposure: Annotated[float, AtLeast(-30), AtMost(30), "of hdr, stops: +1 is twice as bright"] = 0.0
    turn_deg: Annotated[float, "of hdr, about the vertical: at 0 a camera in front sees the middle of the panorama"] = (
        0.0
    )

    def __post_init__(self):
        if self.kind == "transparent":
            if self.color not in (STUDIO_COLOR, NOTHING):
                raise ValueError("color: a transparent background takes no color")
            object.__setattr__(self, "color", NOTHING)
        needs_file = self.kind in ("image", "video", "hdr")
        if needs_file != (self.path is not None):
            need = "needs a path" if needs_file else f"takes no path, has {self.path!r}"
            raise ValueError(f"background {self.kind} {need}")

    @property
    def transparent(self) -> bool:
        """Whether pixels may be left that are not opaque, as far as can be said without reading files."""
        bars = self.kind in ("image", "video") and self.fit == "contain"
        return self.kind == "transparent" or ((self.kind == "color" or bars) and self.color[3] < 1)

    stage: ClassVar[Stage] = Stage.BACKGROUND

    def passes(self, draft: Draft) -> Sequence[Pass]:
        """What makes its pixels ready, and the copy into the picture."""
        if self.kind in ("color", "transparent"):
            return (Absent("background"),)
        # opened once; a file that cannot be read is said at once
        content = draft.keep(self, lambda: opened_source(self))
        # a window is planned with its first frame
        if draft.canvas.size is None:
            return ()
        image = draft.framebuffer("background", draft.canvas.size, depth=False, textures=True)
        draft.background = image
        if isinstance(content, Panorama):
            ready = panorama_pass(draft, image, content)
        else:
            ready = UploadPass(f"background: {self.kind}", image.handles, image, content)
        return (ready, CopyPass("background", image.handles, image))


@dataclass(frozen=True)
class UploadPass(Pass):
    """A picture, or the frame of a film that belongs to this moment, at the size of the image."""

    image: Image
    source: Source

    def decide(self, drawing: Drawing) -> Decision:
        return SAME_FRAME if drawing.resources.holds.get(self.image.color) == self._wanted(drawing) else NEW_FRAME

    def draw(self, drawing: Drawing) -> None:
        texture = drawing.resources[self.image.color]
        pixels = self.source.pixels(drawing.inputs.seconds, texture.size)
        texture.write(np.ascontiguousarray(pixels).tobytes())
        drawing.resources.holds[self.image.color] = self._wanted(drawing)

    def _wanted(self, drawing: Drawing) -> tuple[Source, int]:
        return self.source, self.source.number(drawing.inputs.seconds)


@dataclass(frozen=True)
class CopyPass(Pass):
    """The background into the picture."""

    image: Image

    def decide(self, drawing: Drawing) -> Decision:
        return ASKED

    def draw(self, drawing: Drawing) -> None:
        inputs, (width, height) = drawing.inputs, drawing.inputs.camera.size
        turned = None if inputs.flipped else height
        background = drawing.resources[self.image.framebuffer]
        drawing.blit(background, inputs.framebuffer, (0, 0, width, height), turned=turned)
        inputs.framebuffer.use()


def opened_source(background: Background) -> Source | Panorama:
    """What a background with a file is drawn from.

    Raises:
        AssetError: the file is absent, or is not what its kind says.
    """
    assert background.path is not None
    path, placing = Path(background.path), Placing(background.fit, background.color)
    if background.kind == "hdr":
        return Panorama(path, background.exposure, background.turn_deg)
    if background.kind == "image":
        return PictureSequence([path], placing)
    if not os.path.isdir(path):
        return Video(path, placing)
    files = pictures_in(path)
    if not files:
        raise AssetError(f"{path}: expected pictures ({', '.join(PICTURES)}), found none")
    return PictureSequence(files, placing, background.rate)
