"""What is behind the avatars: a color, a picture, a film, a panorama.

Pixels are made ready at the size of the picture when their content changes, and copied in each frame: a copy costs
1.04 of a bare frame in software, a textured triangle 1.4 to 1.8. Their first row is the top, as in the renderer's own
image; a window takes the copy upside down.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

import numpy as np

from command.errors import AssetError
from command.settings import Above, AtMost, Color, FilePlace, OneOf, settings
from player.draw.drawing import Drawing
from player.draw.plan import Absent, Decision, Draft, Pass, PassState, Stage
from player.draw.resources import Image
from player.effects.background_source import RGBA, PictureSequence, Placing, Source, Video, opened_folder
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
    exposure: Annotated[float, "of hdr, stops: +1 is twice as bright"] = 0.0
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
        # a file that cannot be read is said at once
        content = self.content(draft)
        # a window is planned with its first frame
        if draft.canvas.size is None:
            return ()
        image = draft.framebuffer("background", draft.canvas.size, depth=False, textures=True)
        draft.background = image
        if isinstance(content, Panorama):
            return (panorama_pass(draft, image, content), CopyPass("background", image.handles, image, None))
        upload = UploadPass("background: video", image.handles, image, content)
        if self.kind == "video":
            return (upload, CopyPass("background", image.handles, image, None))
        return (CopyPass("background", image.handles, image, upload),)

    def content(self, draft: Draft) -> "OpenBackground | Panorama":
        """What is drawn, opened once."""
        path = self.path
        assert path is not None
        if self.kind == "hdr":
            return draft.keep(self, lambda: Panorama(path, self.exposure, self.turn_deg))
        return draft.keep(self, lambda: OpenBackground(opened_source(self)))


class OpenBackground:
    """An open picture or film, and which of its frames the texture holds."""

    def __init__(self, source: Source):
        self.source = source
        self.holds: tuple[object, int] | None = None

    def close(self) -> None:
        self.source.close()


@dataclass(frozen=True)
class UploadPass(Pass):
    """The frame of a film that belongs to this moment, at the size of the picture."""

    image: Image
    behind: OpenBackground

    def decide(self, drawing: Drawing) -> Decision:
        return SAME_FRAME if self.behind.holds == self._wanted(drawing) else NEW_FRAME

    def draw(self, drawing: Drawing) -> None:
        texture = drawing.resources[self.image.color]
        pixels = self.behind.source.pixels(drawing.inputs.seconds, texture.size)
        texture.write(np.ascontiguousarray(pixels).tobytes())
        self.behind.holds = self._wanted(drawing)

    def _wanted(self, drawing: Drawing) -> tuple[object, int]:
        return drawing.resources[self.image.color], self.behind.source.number(drawing.inputs.seconds)


@dataclass(frozen=True)
class CopyPass(Pass):
    """The background into the picture."""

    image: Image
    # uploads a picture that changes with its size alone; None: a pass of its own uploads it
    upload: UploadPass | None

    def decide(self, drawing: Drawing) -> Decision:
        return ASKED

    def draw(self, drawing: Drawing) -> None:
        if self.upload is not None and self.upload.decide(drawing).runs:
            self.upload.draw(drawing)
        inputs, (width, height) = drawing.inputs, drawing.inputs.camera.size
        turned = None if inputs.flipped else height
        background = drawing.resources[self.image.framebuffer]
        drawing.blit(background, inputs.framebuffer, (0, 0, width, height), turned=turned)
        inputs.framebuffer.use()


def opened_source(background: Background) -> Source:
    """What an image or video background is drawn from.

    Raises:
        AssetError: the file is absent, or is not what its kind says.
    """
    assert background.path is not None
    path, placing = Path(background.path), Placing(background.fit, background.color)
    if background.kind == "image":
        return PictureSequence([path], placing)
    if not path.exists():
        raise AssetError(f"{path}: no such file")
    return opened_folder(path, placing, background.rate) if path.is_dir() else Video(path, placing)
