"""What one video gives to the fit, and what the fit makes of it."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int, UInt8
from numpy import ndarray as Array

from avatar.camera import Camera
from avatar.kinematics import ShapedSkeleton, SkinnedPoints
from capture.fit.person import Person
from capture.fit.points import BodyPoint, body_points
from capture.keypoints.record import Keypoints

# pixels of a picture 1080 high: standard deviation of a detector's sure point
SIGMA = 4.0
# confidence under which a point is not used, and from which on it is sure
LEAST, SURE = 0.1, 0.8
# standard deviations that a point of no confidence has more
UNSURE = 2.5


@dataclass(frozen=True)
class Footage:
    """Points and masks of the frames of one video."""

    names: tuple[str, ...]
    pixels: Float[Array, "frames points 2"]  # 0 where not seen
    # one over the standard deviation, 1 / pixels; 0: not seen
    sure: Float[Array, "frames points"]
    masks: UInt8[Array, "frames height width"]
    focal: float  # pixels, the first guess
    # relative standard deviation of the guess
    focal_sigma: float
    moving: Int[Array, "m"]  # joints that turn, the pelvis left out

    @property
    def size(self) -> tuple[int, int]:
        return self.masks.shape[2], self.masks.shape[1]

    @property
    def turning(self) -> Int[Array, "m"]:
        return np.r_[0, self.moving]

    @property
    def centre(self) -> Float[Array, "2"]:
        return 0.5 * np.array(self.size)

    @property
    def points(self) -> list[BodyPoint]:
        table = body_points()
        return [table[name] for name in self.names]

    def rows(self, chosen: Int[Array, "n"]) -> "Footage":
        return replace(self, pixels=self.pixels[chosen], sure=self.sure[chosen], masks=self.masks[chosen])


def footage_of(
    keypoints: Keypoints, masks: UInt8[Array, "frames height width"], names: tuple[str, ...], moving: Int[Array, "m"],
    *, focal: float, focal_sigma: float,
) -> Footage:  # fmt: skip
    """The points of `names` that the detector has, and how sure they are."""
    table = body_points()
    chosen = [k for k, name in enumerate(keypoints.names) if name in names and name in table]
    confidence = keypoints.confidence[:, chosen]
    pixels = np.nan_to_num(keypoints.pixels[:, chosen])
    sigma = SIGMA * min(masks.shape[1:]) / 1080
    widening = 1 + (UNSURE - 1) * np.clip((SURE - confidence) / (SURE - LEAST), 0, 1)
    sure = np.where(confidence >= LEAST, 1 / (sigma * widening), 0.0)
    named = tuple(keypoints.names[k] for k in chosen)
    return Footage(named, pixels, sure, masks, focal, focal_sigma, moving)


@dataclass(frozen=True)
class Estimate:
    """Shape and poses as they stand. World: the camera at the origin, looking along -z, +y up, metres."""

    person: Person
    g: Float[Array, "g"]
    # offset of each point from its place on the body, in the frame of its bone: what the detector does differently
    bias: Float[Array, "points 3"]
    log_focal: float  # the focal length over the guess
    mean: Float[Array, "52 3"]  # joint angles
    root: Float[Array, "frames 3"]
    heading: Float[Array, "frames 3 3"]  # the pelvis'
    angles: Float[Array, "frames 52 3"]  # the joints' (avatar/limits.py)

    def skeleton(self) -> ShapedSkeleton:
        return ShapedSkeleton(self.person.joints(self.g), self.person.joint_directions)

    def camera(self, footage: Footage) -> Camera:
        """Square pixels, the axis through the middle of the picture."""
        focal, (x, y) = footage.focal * float(np.exp(self.log_focal)), footage.centre
        return Camera(np.array([[focal, 0, x], [0, focal, y], [0, 0, 1.0]]), np.diag([1.0, -1, -1, 1]), footage.size)

    def markers(self, footage: Footage) -> SkinnedPoints:
        """The named points, moved by their bias."""
        person, points = self.person, footage.points
        vertices, joints = person.vertices(self.g), person.joints(self.g)
        rest = np.stack([p.place(vertices, joints) for p in points]) + self.bias
        directions = np.stack([p.place(person.vertex_directions, person.joint_directions) for p in points])
        bones = np.array([[p.joint] for p in points])
        return SkinnedPoints(rest, directions, bones, np.ones((len(points), 1)))

    def skin(self, vertices: Int[Array, "n"] | slice = slice(None)) -> SkinnedPoints:
        person, skin = self.person, self.person.body.skin
        rest = person.vertices(self.g, vertices)
        return SkinnedPoints(rest, person.vertex_directions[vertices], skin.joints[vertices], skin.weights[vertices])


def unplaced(person: Person, g: Float[Array, "g"], footage: Footage, angles: Float[Array, "52 3"] | None = None
             ) -> Estimate:  # fmt: skip
    """One frame of a person of shape g at the origin; without angles in pose 0."""
    angles = np.zeros((52, 3)) if angles is None else angles
    return Estimate(person, g, np.zeros((len(footage.names), 3)), 0.0, angles, np.zeros((1, 3)), np.eye(3)[None],
                    angles[None])  # fmt: skip
