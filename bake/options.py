"""Settings of a bake, and of its command line."""

from typing import Annotated, Literal

from command.command_line import Hidden, Option
from command.settings import AtLeast, AtMost, OneOf, settings

# the unwrapper takes 200 000 (bake/atlas.py), and collapsing leaves up to a fifth more than was asked for
MOST_FACES = 150_000


@settings
class BakeOptions:
    """Settings of a bake; `selfscan bake` offers those that are not hidden."""

    faces: Annotated[int, AtLeast(200), AtMost(MOST_FACES), "triangles of the finest level"] = 30_000
    texture: Annotated[int, AtLeast(64), AtMost(8192), "its atlas, texels per side, a power of two"] = 2048
    texture_from: Annotated[
        Literal["videos", "field"],
        "videos: solved against the frames of the run's capture; field: as trained, the paper's own colors",
    ] = "videos"
    twist: Annotated[
        bool, "52 more bones, twist and bend joints: limbs that turn or bend keep their volume in every viewer"
    ] = False
    without: Annotated[
        tuple[str, ...], OneOf(("face",)), Option(several=True),
        "leave out what is made, not filmed: face (shapes, lips that part, lids that close, eyes that turn)",
    ] = ()  # fmt: skip
    body_step: Annotated[float, Hidden(), "grid step of the extraction, metres"] = 0.005
    fine_step: Annotated[float, Hidden(), "the same along the spans of head and hands, metres"] = 0.0025
    head_density: Annotated[float, Hidden(), "texels per metre, relative to the body's"] = 2.5
    hand_density: Annotated[float, Hidden(), "texels per metre, relative to the body's"] = 2.5
    collar_density: Annotated[float, Hidden(), "of neck and collar; the head's where its video shows them"] = 1.0
    head_scale: Annotated[float, Hidden(), "blown up so much while triangles are collapsed"] = 1.8
    hand_scale: Annotated[float, Hidden(), "blown up so much while triangles are collapsed"] = 2.4
    eye_scale: Annotated[float, Hidden(), "the same, and texels per metre relative to the head's"] = 2.2
    samples: Annotated[int, Hidden(), "surface points for the network"] = 160_000
    steps: Annotated[int, Hidden(), "steps of the network's training"] = 1200
    texel_samples: Annotated[
        int, AtLeast(1), AtMost(4), Hidden(), "of the field's color, where a texel differs from its neighbours"
    ] = 4
    image: Annotated[int, Hidden(), "pixels per side of the pictures that are compared"] = 512
    seed: Annotated[int, Hidden(), "of all random numbers"] = 0

    def __post_init__(self):
        if self.texture & (self.texture - 1):
            raise ValueError(f"texture: expected a power of two from 64 to 8192, found {self.texture}")
