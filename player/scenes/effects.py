"""What a scene asks of the renderer beyond the avatars themselves. Nothing here touches OpenGL.

player/plan.py turns it into passes; what is not asked for is in no plan and costs nothing. The notes on each field
are its documentation in docs/scenes.md and in the JSON schema.
"""

from dataclasses import dataclass
from typing import Annotated

from avatar.settings import Above, Color, OneOf, check

VIEWS = ("off", "vertex", "linear", "network")
SKINNINGS = ("lbs", "dual_quaternion")
ANTIALIASINGS = ("auto", "none", "fxaa", "msaa")
BACKGROUNDS = ("color", "image", "video", "hdr", "transparent")
FITS = ("cover", "contain", "stretch")

RGBA = tuple[float, float, float, float]


@dataclass(frozen=True)
class Effects:
    """How avatars are drawn.

    Raises:
        ValueError: a value that is not known.
    """

    view: Annotated[
        str, OneOf(("auto", *VIEWS)), "view dependence: off is the paper; auto picks by avatar and device"
    ] = "auto"
    skinning: Annotated[
        str, OneOf(SKINNINGS), "linear blend, or dual quaternions, which keep volume where joints twist"
    ] = "lbs"
    antialiasing: Annotated[
        str,
        OneOf(ANTIALIASINGS),
        "smooth outlines: fxaa filters them in the finished picture, msaa takes 4 samples a pixel; auto is msaa on a "
        "GPU and fxaa on a software rasteriser",
    ] = "auto"

    def __post_init__(self):
        check(self)


@dataclass(frozen=True)
class Background:
    """What is behind the avatars.

    Raises:
        ValueError: a value that is not known, a kind without the file it needs, or a file for a kind that has none.
    """

    kind: Annotated[str, OneOf(BACKGROUNDS), "what it is; image, video and hdr need a path"] = "color"
    color: Annotated[
        RGBA,
        Color(),
        "of kind color, and where an image or a video does not reach",
    ] = (0.0, 0.0, 0.0, 0.0)  # premultiplied sRGB
    path: Annotated[
        str | None, "picture; film or folder of frames; panorama (Radiance .hdr, twice as wide as high)"
    ] = None
    fit: Annotated[
        str, OneOf(FITS), "of image and video: cover crops, contain leaves bars of `color`, stretch distorts"
    ] = "cover"
    rate: Annotated[float, Above(0), "frames per second of a folder of frames; films know theirs"] = 30.0
    exposure: Annotated[float, "of hdr, stops: +1 is twice as bright"] = 0.0
    turn_deg: Annotated[float, "of hdr, about the vertical: at 0 a camera in front sees the middle of the panorama"] = (
        0.0
    )

    def __post_init__(self):
        check(self)
        needs_file = self.kind in ("image", "video", "hdr")
        if needs_file != (self.path is not None):
            need = "needs a path" if needs_file else f"takes no path, has {self.path!r}"
            raise ValueError(f"background {self.kind} {need}")

    @property
    def transparent(self) -> bool:
        """Whether pixels may be left that are not opaque, as far as can be said without reading files."""
        bars = self.kind in ("image", "video") and self.fit == "contain"
        return self.kind == "transparent" or ((self.kind == "color" or bars) and self.color[3] < 1)


# where a scene says nothing
USUAL = Effects()
# nothing beside the avatars: what is measured
PLAIN = Effects(antialiasing="none")
# where a scene says nothing
STUDIO = Background("color", (43 / 255, 45 / 255, 51 / 255, 1.0))
