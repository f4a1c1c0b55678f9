"""A face that moves: the 52 shapes that ARKit names, as offsets of a level's vertices, and eyes that turn.

A shape is what its vertices are moved by at a weight of 1; shapes add up. An eye is a ball of its own that turns about
its center; lids stay outside of it. Canonical frame of the avatar, metres; left is the person's left.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32, UInt8, UInt32
from numpy import ndarray as Array

SIDES = ("left", "right")
# in the order in which Apple's documentation lists them, which is that of most senders
SHAPES = (
    "eyeBlinkLeft", "eyeLookDownLeft", "eyeLookInLeft", "eyeLookOutLeft", "eyeLookUpLeft", "eyeSquintLeft",
    "eyeWideLeft",
    "eyeBlinkRight", "eyeLookDownRight", "eyeLookInRight", "eyeLookOutRight", "eyeLookUpRight", "eyeSquintRight",
    "eyeWideRight",
    "jawForward", "jawLeft", "jawRight", "jawOpen",
    "mouthClose", "mouthFunnel", "mouthPucker", "mouthLeft", "mouthRight", "mouthSmileLeft", "mouthSmileRight",
    "mouthFrownLeft", "mouthFrownRight", "mouthDimpleLeft", "mouthDimpleRight", "mouthStretchLeft", "mouthStretchRight",
    "mouthRollLower", "mouthRollUpper", "mouthShrugLower", "mouthShrugUpper", "mouthPressLeft", "mouthPressRight",
    "mouthLowerDownLeft", "mouthLowerDownRight", "mouthUpperUpLeft", "mouthUpperUpRight",
    "browDownLeft", "browDownRight", "browInnerUp", "browOuterUpLeft", "browOuterUpRight",
    "cheekPuff", "cheekSquintLeft", "cheekSquintRight", "noseSneerLeft", "noseSneerRight", "tongueOut",
)  # fmt: skip

# the number of each shape's on the other side; its own where it is its own mirror image
PARTNERS = tuple(
    SHAPES.index(name[: -len(side)] + other) if name.endswith(side) else number
    for number, name in enumerate(SHAPES)
    for side, other in (("Left", "Right") if name.endswith("Left") else ("Right", "Left"),)
)


@dataclass(frozen=True)
class Eye:
    """A ball that looks along its axis at rest."""

    center: Float[Array, "3"]
    axis: Float[Array, "3"]  # unit, from the center through the middle of the iris
    radius: float


@dataclass(frozen=True)
class Follow:
    """Vertices that move as a mean of vertices of the finest level does."""

    sources: UInt32[Array, "moving 4"]
    weights: UInt8[Array, "moving 4"]  # rows sum to 255


@dataclass(frozen=True)
class FaceShapes:
    """What of one level the face moves.

    The balls' vertices are skinned to the head alone and are in no shape: gaze turns them.
    """

    vertices: UInt32[Array, "moving"]  # ascending
    offsets: Float32[Array, "52 moving 3"]  # at a weight of 1
    # first vertex and count of the left and of the right ball
    balls: UInt32[Array, "2 2"]
    # below the finest level: the sources that offsets are interpolated from; None: the level has its own
    follow: Follow | None = None


def followed(finest: FaceShapes, follow: Follow) -> Float32[Array, "52 moving 3"]:
    """The offsets of vertices that follow those of the finest level."""
    at = np.minimum(np.searchsorted(finest.vertices, follow.sources), len(finest.vertices) - 1)
    # what no shape of the finest level moves counts as still
    weights = np.where(finest.vertices[at] == follow.sources, follow.weights, 0) / np.float32(255)
    offsets = np.zeros((len(SHAPES), len(at), 3), np.float32)
    for k in range(4):
        offsets += weights[:, k, None] * finest.offsets[:, at[:, k]]
    return offsets


@dataclass(frozen=True)
class FaceFrame:
    """What a face does in one frame."""

    weights: Float[Array, "52"]  # one for each of SHAPES, from 0 to 1
    # the left and the right eye's: yaw to the person's left and pitch upwards, radians, away from its axis
    gaze: Float[Array, "2 2"]

    @property
    def rests(self) -> bool:
        """Whether it leaves the face as it is."""
        return not (self.weights.any() or self.gaze.any())


REST = FaceFrame(np.zeros(len(SHAPES)), np.zeros((2, 2)))


def mirrored_face(frame: FaceFrame) -> FaceFrame:
    """The other side does what this one does."""
    return FaceFrame(frame.weights[list(PARTNERS)], frame.gaze[::-1] * [-1.0, 1.0])


def face_between(a: FaceFrame | None, b: FaceFrame | None, part: float) -> FaceFrame | None:
    """A share `part` of the way from one frame to another, straight; None is a face at rest."""
    if a is None and b is None:
        return None
    a, b = a or REST, b or REST
    return FaceFrame(a.weights + part * (b.weights - a.weights), a.gaze + part * (b.gaze - a.gaze))


def eye_turn(yaw: float, pitch: float) -> Float[Array, "3 3"]:
    """How an eye turns, radians: to the person's left, and upwards."""
    (cy, sy), (cp, sp) = ((math.cos(angle), math.sin(angle)) for angle in (yaw, pitch))
    return np.array([[cy, -sy * sp, sy * cp], [0.0, cp, sp], [-sy, -cy * sp, cy * cp]])
