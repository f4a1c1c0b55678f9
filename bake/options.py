"""What a bake may be told."""

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class BakeOptions:
    """Settings of a bake; `selfscan bake` offers the first three."""

    # triangles of the finest level
    faces: int = 30_000
    texture: int = 2048  # its atlas, texels per side
    # view network: 4 features, 8-16-3; 8 features, 12-16-16-3
    quality: Literal["normal", "high"] = "normal"
    body_step: float = 0.005  # grid step of the extraction, metres
    # the same along the spans of head and hands
    fine_step: float = 0.0025
    head_density: float = 2.5  # texels per metre, relative to the body's
    hand_density: float = 2.5
    # blown up so much while triangles are collapsed
    head_scale: float = 1.8
    hand_scale: float = 2.4
    # surface points for the network
    samples: int = 160_000
    steps: int = 1200  # of its training
    # pixels per side of the pictures that are compared
    image: int = 512
    seed: int = 0
    # of each held-out set, to choose the default view by
    truth_poses: int = 5

    def __post_init__(self):
        if self.faces < 200:
            raise ValueError(f"--faces should be at least 200, is {self.faces}")
        if self.quality not in ("normal", "high"):
            raise ValueError(f"--quality should be normal or high, is {self.quality!r}")
        if self.texture < 64 or self.texture > 8192 or self.texture & (self.texture - 1):
            raise ValueError(f"--texture should be a power of two from 64 to 8192, is {self.texture}")
