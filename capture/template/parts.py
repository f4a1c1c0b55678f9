"""The four parts: their canonical boxes, and where two of them overlap (TotalSelfScan, 3.3, Eq. 9)."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from avatar.skeleton import JOINTS, PARTS
from avatar.skinning import SkinWeights, dense_weights, strongest_four
from capture.folder import CaptureSubject

HEAD = JOINTS.index("head")


@dataclass(frozen=True)
class Box:
    """An axis-aligned box of the canonical frame, metres."""

    low: Float[Array, "3"]
    high: Float[Array, "3"]

    def contains(self, points: Float[Array, "n 3"]) -> Bool[Array, "n"]:
        """Which points lie in the box or on its border."""
        return np.all((points >= self.low) & (points <= self.high), axis=-1)

    def padded(self, margin: float) -> "Box":
        """The box grown by `margin` metres on every side."""
        return Box(self.low - margin, self.high + margin)


@dataclass(frozen=True)
class Part:
    """Where a part's field lives and where it takes over from the body.

    `extent` is the box its networks are scaled to; nothing outside it is learned. `blend_box` is the box of Eq. 9:
    at its border the part's weight is 0 and the body's 1, `overlap` metres inside it the other way round.
    """

    name: str
    extent: Box
    # None: the body, which covers everyone
    blend_box: Box | None
    overlap: float  # d_s, metres

    def weight(self, points: Float[Array, "n 3"]) -> Float[Array, "n"]:
        """Eq. 9's share of the part: d / d_s with d the depth inside its box, 0 outside, 1 from d_s on."""
        assert self.blend_box is not None
        depth = np.minimum(points - self.blend_box.low, self.blend_box.high - points).min(-1)
        return np.clip(depth / self.overlap, 0, 1)


def part_boxes(subject: CaptureSubject) -> tuple[Part, ...]:
    """The boxes of the four parts, from the template's labelled vertices.

    Hands begin 10 cm up the forearm, the head 3 cm under its lowest labelled skin, or lower by the subject's
    `head_reach`; there the overlap lies. The other faces of `blend_box` stand off by d_s more than the surface
    needs, so that Eq. 9's weight is 1 at the fingertips and continuous everywhere.
    """
    everyone = Box(subject.vertices.min(0), subject.vertices.max(0))
    parts = [Part("body", everyone.padded(0.08), None, 0.0)]
    for index, name in enumerate(PARTS[1:], start=1):
        vertices = subject.vertices[(subject.part == index) & ~subject.hair]
        covered = subject.vertices[subject.part == index]
        overlap = 0.05 if name == "head" else 0.10
        low, high = covered.min(0).copy(), covered.max(0).copy()
        # the networks' box of the head reaches as far: no part has a weight where it learned nothing
        stand_off = overlap + (0.02 if name == "head" else 0.03)
        if name == "head":
            # the neck below: Eq. 9 starts under the lowest skin of the head, hair hanging deeper or not
            low[1] = max(low[1], vertices[:, 1].min()) - subject.head_reach
        blend_low, blend_high = low - stand_off, high + stand_off
        if name == "head":
            blend_low[1] = low[1] - overlap + 0.02
            low[1] = blend_low[1] - 0.02
            extent = Box(low - [stand_off, 0.0, stand_off], high + stand_off)
        else:
            extent = Box(low - 0.03, high + 0.03)
            # the left hand's wrist is its low x
            if name == "hand_left":
                blend_low[0] = low[0] - overlap
                extent.low[0] = blend_low[0] - 0.02
            else:
                blend_high[0] = high[0] + overlap
                extent.high[0] = blend_high[0] + 0.02
        parts.append(Part(name, extent, Box(blend_low, blend_high), overlap))
    return tuple(parts)


def rigid_weights(count: int) -> SkinWeights:
    """Weights of what follows the head's bone alone."""
    weights = np.zeros((count, 4), np.float32)
    weights[:, 0] = 1
    return SkinWeights(np.full((count, 4), HEAD), weights)


def with_rigid_head(subject: CaptureSubject) -> CaptureSubject:
    """The template whose vertices follow only the head bone where only the head's field has a weight (Eq. 9).

    The head is rigid: its field is learned from a video under one rigid motion a frame (TotalSelfScan, Eq. 4). A
    body model's weights bend the jaw and the back of the head with the neck by a tenth or more; the head's video,
    seen as rigid, contradicts that. Over the upper half of the overlap (Eq. 9) the weights blend.
    """
    head = part_boxes(subject)[PARTS.index("head")]
    share = head.weight(subject.vertices)
    follows = np.clip(2 * share - 1, 0, 1)[:, None]
    weights = dense_weights(subject.skin)
    weights = weights * (1 - follows)
    weights[:, HEAD] += follows[:, 0]
    return replace(subject, skin=strongest_four(weights))
