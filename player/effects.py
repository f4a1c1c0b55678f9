"""What a scene asks of the renderer beyond the avatars themselves. Nothing here touches OpenGL.

player/plan.py turns it into passes; what is not asked for is in no plan and costs nothing.
"""

from dataclasses import dataclass

VIEWS = ("off", "vertex", "linear", "network")
SKINNINGS = ("lbs", "dual_quaternion")
ANTIALIASINGS = ("none", "fxaa", "msaa")
BACKGROUNDS = ("color", "image", "video", "hdr", "transparent")
FITS = ("cover", "contain", "stretch")

RGBA = tuple[float, float, float, float]


def _one_of(what: str, value: str, known: tuple[str, ...]) -> None:
    if value not in known:
        raise ValueError(f"{what} should be one of {', '.join(known)}, is {value!r}")


@dataclass(frozen=True)
class Effects:
    """How avatars are drawn.

    Raises:
        ValueError: a value that is not known.
    """

    view: str = "auto"  # view dependence: off is the paper; auto picks by avatar and device
    skinning: str = "lbs"  # linear blend, or dual quaternions, which keep volume where joints twist
    antialiasing: str = "none"  # fxaa: a filter on the avatars' part of the finished picture; msaa: 4 samples

    def __post_init__(self):
        _one_of("view", self.view, ("auto", *VIEWS))
        _one_of("skinning", self.skinning, SKINNINGS)
        _one_of("antialiasing", self.antialiasing, ANTIALIASINGS)


@dataclass(frozen=True)
class Background:
    """What is behind the avatars.

    Raises:
        ValueError: a value that is not known, a kind without the file it needs, or a file for a kind that has none.
    """

    kind: str = "color"
    color: RGBA = (0.0, 0.0, 0.0, 0.0)  # premultiplied, sRGB; also where an image does not reach
    path: str | None = (
        None  # of image, video (a film, or a folder of frames), hdr (Radiance .hdr, equirectangular)
    )
    fit: str = "cover"  # image, video: cover crops, contain leaves bars of `color`, stretch distorts
    rate: float = 30.0  # frames per second, for a folder of frames; films know theirs
    exposure: float = 0.0  # hdr: stops; +1 is twice as bright
    turn_deg: float = 0.0  # hdr: about the vertical; at 0 the front camera sees the middle of the picture

    def __post_init__(self):
        _one_of("background", self.kind, BACKGROUNDS)
        _one_of("fit", self.fit, FITS)
        needs_file = self.kind in ("image", "video", "hdr")
        if needs_file != (self.path is not None):
            need = "needs a path" if needs_file else f"takes no path, has {self.path!r}"
            raise ValueError(f"background {self.kind} {need}")
        if not self.rate > 0:
            raise ValueError(f"background rate should be positive frames per second, is {self.rate}")

    @property
    def transparent(self) -> bool:
        """Whether a picture may have pixels that are not opaque, so that its file should hold alpha."""
        return self.kind == "transparent" or (self.kind == "color" and self.color[3] < 1)


PLAIN = Effects()
