"""Pictures of the trained field by volume rendering: the truth of the model, which all that is baked stands for.

Each pixel's ray is cut into sections in a band round the posed surface; their ends are taken back into the canonical
frame by the inverse of the one blended matrix of the surface point that the ray hits (the band is thinner than what
that changes over), and weighted as in training (train/render.py). With one section it is the surface again, as NeuS
sees it. Pixels that miss the posed surface are left black: outside of it, training's band ends.
"""

import numpy as np
from jaxtyping import Float

from avatar.camera import Camera, pixel_rays
from avatar.skinning import blended_rotations, blended_transforms
from bake.cone import ViewCone, interpolated
from bench.posed_field import MaskedPicture, PosedField, faces_in_picture
from player.raster import Rasteriser

# of the surface's width beta, on either side: Phi has then passed by 1 - 1e-6
REACH = 8.0
# of the picture; what weighs less cannot be seen, and is not asked for its color
LEAST = 2e-3
# rays at once
CHUNK = 8192
# as train/render.py, LOGISTIC_PER_BETA
LOGISTIC_PER_BETA = 0.6


def draw_volume(
    field: PosedField,
    raster: Rasteriser,
    axis_angle: Float[np.ndarray, "52 3"],
    root: Float[np.ndarray, "3"],
    camera: Camera,
    *,
    beta: float,
    sections: int,
) -> MaskedPicture:
    """One picture on black, colors inside the cone that training saw. `beta` is the surface's width, metres."""
    surface = field.surface
    posed = field.posed(axis_angle, root)
    faces = faces_in_picture(posed, surface.faces, camera)
    fragments = raster.draw(posed, faces, camera)
    rows, columns = np.nonzero(fragments.face >= 0)
    width, height = camera.size
    image, opacity = np.zeros((height, width, 3), np.float32), np.zeros((height, width), np.float32)
    transforms = surface.transforms(axis_angle, root)
    matrices = blended_transforms(surface.skin, transforms)
    turns = blended_rotations(surface.skin, transforms)
    origins, directions = pixel_rays(camera, np.stack([columns, rows], -1) + 0.5)
    for start in range(0, len(rows), CHUNK):
        own = slice(start, start + CHUNK)
        corners = faces[fragments.face[rows[own], columns[own]]]
        weight = fragments.barycentric[rows[own], columns[own]].astype(np.float64)
        hit = (weight[:, :, None] * posed[corners]).sum(1)
        back = np.linalg.inv((weight[:, :, None, None] * matrices[corners]).sum(1))
        rays, eyes = directions[own], origins[own]
        far = ((hit - eyes) * rays).sum(1)
        steps = np.linspace(-REACH * beta, REACH * beta, sections + 1)
        points = eyes[:, None] + (far[:, None] + steps)[:, :, None] * rays[:, None]
        ends = np.einsum("nij,nsj->nsi", back[:, :3, :3], points) + back[:, None, :3, 3]
        distance = field.distance(ends.reshape(-1, 3)).reshape(ends.shape[:2])
        shares = section_weights(distance, beta)
        ray, section = np.nonzero(shares > LEAST)
        at = crossing(distance, ends)[ray, section]
        turn = turns[corners[np.arange(len(corners)), weight.argmax(1)]][ray]
        seen: ViewCone = interpolated(field.cone, corners[ray], weight[ray])
        color = field.shown(at, seen, turn, rays[ray], "cone")
        part = shares[ray, section].astype(np.float32)
        total, sums = np.zeros((len(corners), 3), np.float32), np.zeros(len(corners), np.float32)
        np.add.at(total, ray, part[:, None] * color.astype(np.float32))
        np.add.at(sums, ray, part)
        image[rows[own], columns[own]], opacity[rows[own], columns[own]] = total, sums
    return MaskedPicture(np.clip(image, 0, 1), opacity >= 0.5)


def section_weights(distance: Float[np.ndarray, "rays ends"], beta: float) -> Float[np.ndarray, "rays sections"]:
    """NeuS weights of the sections between consecutive ends, as train/render.py."""
    scaled = np.clip(np.asarray(distance, np.float64) / (LOGISTIC_PER_BETA * beta), -1e6, 1e6)
    log_phi = -np.logaddexp(0, -scaled)
    passed = np.minimum(np.diff(log_phi, axis=1), 0)
    before = np.cumsum(passed, 1) - passed
    return np.exp(before) * -np.expm1(passed)


def crossing(
    distance: Float[np.ndarray, "rays ends"], ends: Float[np.ndarray, "rays ends 3"]
) -> Float[np.ndarray, "rays sections 3"]:
    """The point of each section that is shaded: its zero crossing, else its middle, as train/render.py."""
    s0, s1 = distance[:, :-1], distance[:, 1:]
    enters = (s0 > 0) & (s1 <= 0)
    at = np.where(enters, s0 / np.where(enters, s0 - s1, 1.0), 0.5)[..., None]
    return ends[:, :-1] + at * (ends[:, 1:] - ends[:, :-1])
