"""How far each shape of a sender goes: trackers leave some of them near 0 on many faces, wide eyes above all.

For GRIMACE seconds from the first face on the person pulls faces, as wide as they can; from then on the largest value
of each shape is 1. Shapes that hardly moved stay as they are, and none is made more than MOST times larger. A take
keeps what came, without it.
"""

import numpy as np

from avatar.face import FaceFrame
from avatar.gaze import gaze_of

GRIMACE = 5.0  # seconds
# the least that counts as a movement, and the largest gain
LEAST, MOST = 0.08, 4.0


class Gains:
    """Learns while the person grimaces, then applies what it has learned."""

    def __init__(self):
        self.began: float | None = None
        self.largest = np.zeros(52)

    def left(self, now: float | int) -> float:
        """Seconds of grimacing that are left, 0 when it is over; all of them before the first face."""
        return GRIMACE if self.began is None else max(self.began + GRIMACE - now, 0.0)

    def __call__(self, face: FaceFrame, now: float | int) -> FaceFrame:
        """The face with what has been learned by `now`, seconds; while it is learned, as it came."""
        if self.began is None:
            self.began = now
        if self.left(now) > 0:
            self.largest = np.maximum(self.largest, face.weights)
            return face
        gains = np.where(self.largest < LEAST, 1.0, 1.0 / np.clip(self.largest, 1.0 / MOST, 1.0))
        weights = np.minimum(gains * face.weights, 1.0)
        # a gaze that the shapes said is theirs still; angles of their own stay
        said = np.allclose(face.gaze, gaze_of(face.weights), atol=1e-6)
        return FaceFrame(weights, gaze_of(weights) if said else face.gaze)
