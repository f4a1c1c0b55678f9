"""How flat the eyeballs are in front: the disc of the iris, where it looks alike in all frames of the head's video.

A template's eyeball is a sphere. A real iris is a disc in the plane of its rim, 1.5 to 2 mm behind the sphere's front
(the clear cornea before it is not seen), and so is a scanned one. Painted on the sphere it slides by as much when the
head turns: one to two pixels of a close-up. So each ball is cut by a plane square to where the face looks, at the
half-angle alpha from its middle, and alpha is what makes the colors of a place on the eye agree best:

    min over alpha of  mean over frames and places seen of  rho(I_f(project_f(x(alpha))) - c)

(rho: Geman and McClure 1985; c the place's mean color over the frames). Both eyes have one alpha.
"""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray as Array

from avatar.camera import Camera, project
from capture.fit.pixels import bilinear
from capture.folder import CaptureSubject, PartVideo
from capture.template.eyes import EyeSpheres, eye_spheres, face_forward, first_hits, uncovered
from capture.template.hull import head_cameras
from command.workers import on_all_cores
from geometry.least_squares import robust_cost, robust_weight

# half-angles that are tried: an iris of 3 to 9 mm radius; 0 is the sphere
ANGLES = np.radians([0.0, *range(12, 33)])
# places on the eye this far from where the face looks are asked: the widest iris and some white
ASKED = np.radians(42.0)
# cosine of the angle between the face's direction and a camera, at least
IN_FRONT = 0.5
FACING = 0.35  # cosine between a surface and a camera, at least
# a color's deviation: a highlight, a blink
OUTLIER = 0.1
# frames that see a place, at least, and places asked, at least
FRAMES, PLACES = 4, 60
# a disc must lower the residual to this share of the sphere's, or the ball stays round
BETTER = 0.95
# metres round an eyeball's middle in which the face may hide it: the nose
AROUND = 0.06
# metres before a place that still are the eye's own surface
THICK = 0.0005


class FlatIris(NamedTuple):
    """Eyeballs cut by planes square to `forward`."""

    forward: Float[Array, "3"]  # unit, canonical
    angle: float  # half-angle of the disc seen from the ball's middle, radians

    def distance(self, spheres: EyeSpheres, points: Float[Array, "n 3"]) -> Float[Array, "n"]:
        """Distance to the nearer cut ball, negative inside; exact beside the disc and the ball, a bound at its rim."""
        offset = points[:, None] - spheres.centres
        ball = np.linalg.norm(offset, axis=2) - spheres.radii
        plane = offset @ self.forward - spheres.radii * np.cos(self.angle)
        return np.maximum(ball, plane).min(1)


class IrisFit(NamedTuple):
    """What the head's video says of the eyes' front."""

    iris: FlatIris | None  # None: round
    residuals: Float[Array, "angles"]  # root of the mean rho at each of ANGLES
    depth: float  # metres from the sphere's front to the disc, mean of both eyes

    def facts(self) -> dict[str, Any]:
        """What run.json says of it."""
        return {
            "depth_mm": round(self.depth * 1000, 2),
            "half_angle_deg": 0.0 if self.iris is None else round(float(np.degrees(self.iris.angle)), 1),
            "residual_round": round(float(self.residuals[0]), 5),
            "residual_best": round(float(self.residuals.min()), 5),
        }


def fit_iris(
    subject: CaptureSubject, video: PartVideo, canonical_from_head: Float[Array, "4 4"]
) -> IrisFit | None:  # fmt: skip
    """The disc that the head's video asks for; None where there are no eyes or too few frames see them open."""
    spheres = eye_spheres(subject)
    if spheres is None:
        return None
    forward = face_forward(subject)
    views = []
    for camera, image in zip(head_cameras(video, canonical_from_head), video.images):
        away = camera.eye - spheres.centres.mean(0)
        if away @ forward > IN_FRONT * np.linalg.norm(away):
            views.append((camera, image))
    middles = subject.vertices[subject.faces].mean(1)
    sums = np.zeros((len(ANGLES), 2))
    for centre, radius, directions in zip(spheres.centres, spheres.radii, uncovered(subject, spheres)):
        asked = directions[directions @ forward > np.cos(ASKED)]
        near = np.linalg.norm(middles - centre, axis=1) < AROUND
        corners = subject.vertices[subject.faces[near]]
        fronts = (eye_front(asked, forward, float(angle)) for angle in ANGLES)
        sums += list(on_all_cores(lambda front: disagreement(centre, radius, front, corners, views), fronts))
    if sums[:, 1].min() < PLACES * FRAMES:
        return None
    residuals = np.sqrt(sums[:, 0] / sums[:, 1])
    best = int(residuals.argmin())
    if best == 0 or residuals[best] > BETTER * residuals[0]:
        return IrisFit(None, residuals, 0.0)
    depth = float((spheres.radii * (1 - np.cos(ANGLES[best]))).mean())
    return IrisFit(FlatIris(forward, float(ANGLES[best])), residuals, depth)


class EyeFront(NamedTuple):
    """Places on the front of a ball of radius 1 round the origin, cut or not."""

    points: Float[Array, "n 3"]
    normals: Float[Array, "n 3"]


def eye_front(directions: Float[Array, "n 3"], forward: Float[Array, "3"], angle: float) -> EyeFront:
    """Where rays from the ball's middle leave it; `angle` is the disc's half-angle, 0: round."""
    along = directions @ forward
    on_disc = along > np.cos(angle)
    length = np.where(on_disc, np.cos(angle) / np.where(on_disc, along, 1.0), 1.0)
    return EyeFront(length[:, None] * directions, np.where(on_disc[:, None], forward, directions))


def disagreement(
    centre: Float[Array, "3"],
    radius: float,
    surface: EyeFront,
    corners: Float[Array, "faces 3 3"],
    views: list[tuple[Camera, UInt8[Array, "h w 3"]]],
) -> Float[Array, "2"]:
    """Sum of rho over places and frames, weighted by how squarely they are seen, and the sum of these weights."""
    points = centre + radius * surface.points
    if not len(points) or not views:
        return np.zeros(2)
    color = np.zeros((len(views), len(points), 3))
    weight = np.zeros((len(views), len(points)))
    for row, (camera, image) in enumerate(views):
        color[row], seen, facing = _shown(camera, image, points, surface.normals, corners)
        weight[row] = np.where(seen, facing, 0.0)
    weight[:, (weight > 0).sum(0) < FRAMES] = 0
    trust = weight.copy()
    q = np.zeros_like(weight)
    for _ in range(4):
        mean = (trust[..., None] * color).sum(0) / np.maximum(trust.sum(0), 1e-9)[:, None]
        q = ((color - mean) ** 2).sum(2)
        trust = weight * robust_weight(q, OUTLIER)
    return np.array([(weight * robust_cost(q, OUTLIER)).sum(), weight.sum()])


def _shown(
    camera: Camera, image: UInt8[Array, "h w 3"], points: Float[Array, "n 3"], normals: Float[Array, "n 3"],
    corners: Float[Array, "faces 3 3"],
) -> tuple[Float[Array, "n 3"], Bool[Array, "n"], Float[Array, "n"]]:  # fmt: skip
    """What a frame shows at points, which of them it sees, and the cosine it sees them at."""
    back = camera.eye - points
    length = np.linalg.norm(back, axis=1)
    facing = (back * normals).sum(1) / length
    pixels, depth = project(camera, points)
    width, height = camera.size
    inside = (depth > 0) & ((pixels >= 1) & (pixels < np.array([width - 1, height - 1]))).all(1)
    hidden = first_hits(camera.eye, -back / length[:, None], corners) < length - THICK
    return bilinear(image, pixels) / 255, inside & ~hidden & (facing > FACING), facing
