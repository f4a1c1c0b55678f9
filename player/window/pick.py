"""What is under the pointer: a ray against the posed triangles, as they are drawn."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from avatar.baked_avatar import Avatar, Level
from avatar.camera import Camera, pixel_rays
from avatar.skinning import SkinWeights, dense_weights
from player.draw.posing import posed_vertices
from player.scene.renderer import Pose


class Picked(NamedTuple):
    """A place on an avatar's skin."""

    avatar: int
    # the bone that moves the place most
    joint: int
    face: int
    point: Float[np.ndarray, "3"]  # world, metres
    distance: float  # metres from the eye


def pick(
    avatars: Sequence[Avatar],
    levels: Sequence[Level],
    poses: Sequence[Pose],
    camera: Camera,
    pixel: tuple[float, float],
) -> Picked | None:
    """The nearest triangle that faces the camera on the ray through a pixel (left, top; centres at .5).

    Moeller and Trumbore 1997, in double precision; triangles that turn their back are not drawn and not hit.
    """
    origins, directions = pixel_rays(camera, np.array([pixel], np.float64))
    origin, direction = origins[0], directions[0]
    best: Picked | None = None
    for number, (avatar, level, pose) in enumerate(zip(avatars, levels, poses, strict=True)):
        faces = level.faces.astype(np.int64)
        a, b, c = posed_vertices(avatar, level, pose)[faces.T] - origin
        # (1 - u - v) a + u b + v c = t direction; the volumes are those of Cramer's rule
        p = np.cross(direction, c - a)
        determinant = (p * (b - a)).sum(1)
        q = np.cross(-a, b - a)
        with np.errstate(divide="ignore", invalid="ignore"):
            u = -(a * p).sum(1) / determinant
            v = (q @ direction) / determinant
            t = (q * (c - a)).sum(1) / determinant
        hit = (determinant > 0) & (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0)
        if not hit.any():
            continue
        face = int(np.argmin(np.where(hit, t, np.inf)))
        if best is None or t[face] < best.distance:
            corners = np.array([1 - u[face] - v[face], u[face], v[face]])
            skin = SkinWeights(*(part[faces[face]] for part in level.skin))
            joint = int(np.argmax(corners @ dense_weights(skin)))
            best = Picked(number, joint, face, origin + t[face] * direction, float(t[face]))
    return best
