"""How cloth hangs: the body's surface moved outwards by ease and folds, spanning what is hollow.

Frame: pose 0, pelvis at the origin, metres.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from experiments.builtin.hems import (
    BELT_WIDTH,
    LIP,
    Hems,
    ankle_level,
    hem_height,
    neckline,
    sleeves,
    waist_levels,
)
from experiments.builtin.looks import Looks
from experiments.builtin.noise import noise
from experiments.builtin.refine import TexturedMesh, edges_of, smoothed
from geometry.mesh import vertex_normals
from synth.people.mesh import smoothstep

Array = np.ndarray

CLOSEST, FARTHEST = 0.005, 0.030  # cloth and hair off the skin, metres
# metres: a vertex this near to a hem was cut onto it
TINY = 1e-7


class Garments(NamedTuple):
    """Which vertices wear what."""

    # the belt is part of it
    shirt: Bool[Array, "vertices"]
    trousers: Bool[Array, "vertices"]
    belt: Bool[Array, "vertices"]

    @property
    def cloth(self) -> Bool[Array, "vertices"]:
        """Every vertex that wears something."""
        return self.shirt | self.trousers


def garments(skin: Float[Array, "vertices 3"], hems: Hems, joints: Float[Array, "52 3"], looks: Looks) -> Garments:
    """Who wears what, hems included."""
    shirt = (hems.neck > -TINY) & (hems.arm > -TINY) & (hems.waist > -TINY)
    trousers = ~shirt & (hems.waist <= TINY) & (skin[:, 1] < joints[0, 1] + 0.2)
    belt = (hems.waist > LIP - TINY) & (hems.waist < BELT_WIDTH + TINY) & shirt
    return Garments(shirt, trousers, belt if looks.tucked else np.zeros_like(belt))


def hung(
    mesh: TexturedMesh, hems: Hems, worn: Garments, joints: Float[Array, "52 3"], looks: Looks
) -> Float[Array, "vertices 3"]:
    """The vertices of the naked `mesh` (cut along the hems) with the cloth hung on it; bare ones stay."""
    skin, cloth = mesh.vertices, worn.cloth
    normals = vertex_normals(smoothed(skin, mesh.faces, np.ones(len(skin), bool), 30), mesh.faces)
    ease = np.where(cloth, _ease(skin, joints, looks, worn, hems.waist), 0.0)
    tips = _breast_tips(mesh)
    under = smoothed(skin, mesh.faces, tips & cloth, 200)
    # the tips stand out of `under`
    ease = ease + np.where(tips & worn.shirt, 0.006, 0.0)
    posed = _hang(under, mesh.faces, cloth, ease, normals)
    folds = _folds(skin, joints, looks, worn.shirt, hems.waist)
    posed += np.where(cloth & ~worn.belt, folds, 0)[:, None] * vertex_normals(posed, mesh.faces)
    for _ in range(2):
        off = ((posed - 0.5 * (skin + under)) * normals).sum(1)
        posed += np.where(cloth, np.maximum(CLOSEST + 0.0030 - off, 0), 0)[:, None] * normals
        posed = smoothed(posed, mesh.faces, cloth, 1)
    nearest = KDTree(skin)
    # what still comes too close, the tips
    for _ in range(3):
        short = np.maximum(CLOSEST + 0.001 - nearest.query(posed)[0], 0)
        posed += np.where(cloth, short, 0)[:, None] * normals
    posed = _apart(posed, skin, joints, worn.trousers)
    return _hemmed(posed, mesh, hems, worn, joints, looks)


def _hemmed(
    posed: Float[Array, "vertices 3"],
    mesh: TexturedMesh,
    hems: Hems,
    worn: Garments,
    joints: Float[Array, "52 3"],
    looks: Looks,
) -> Float[Array, "vertices 3"]:
    """Hems without waves and in their planes, and nothing near a hem hangs over it."""
    skin, cloth = mesh.vertices, worn.cloth
    neck, arm, above = hems
    levels = [level for level, _ in waist_levels(looks)]
    for values, level in (
        (neck, 0.0),
        (arm, 0.0),
        *((above, level) for level in levels),
        (skin[:, 1], ankle_level(joints)),
    ):
        posed = _straight(posed, mesh.faces, (np.abs(values - level) < TINY) & cloth)
    for sign, near in (
        (1, (above > 0) & (above < 0.04) & worn.shirt),
        (-1, (above < 0) & (above > -0.04) & worn.trousers),
    ):
        kept = hem_height(joints, looks) + 0.4 * above
        posed[:, 1] = np.where(near, sign * np.maximum(sign * posed[:, 1], sign * kept), posed[:, 1])
    near = (arm > 0) & (arm < 0.04)
    over = np.where(near, np.minimum(sleeves(posed, joints, looks) - 0.4 * arm, 0), 0)
    posed[:, 0] += np.sign(skin[:, 0]) * over
    edge = np.abs(skin[:, 1] - ankle_level(joints)) < TINY
    for level in levels:
        edge |= np.abs(above - level) < TINY
    posed[edge, 1] = skin[edge, 1]
    edge = np.abs(arm) < TINY
    posed[edge, 0] = skin[edge, 0]
    edge = np.abs(neck) < TINY
    up = np.array([0.0, 1.0, looks.neckline]) / np.hypot(1.0, looks.neckline)
    posed[edge] += (neckline(posed[edge], joints, looks) - neck[edge])[:, None] * up
    return posed


def _ease(
    skin: Float[Array, "vertices 3"],
    joints: Float[Array, "52 3"],
    looks: Looks,
    worn: Garments,
    above: Float[Array, "vertices"],
) -> Float[Array, "vertices"]:
    """How far cloth stands off the skin at least, metres."""
    hip, knee, ankle = looks.trouser_ease
    y_hip, y_knee, y_ankle = joints[1, 1], joints[4, 1], joints[7, 1]
    heights = [y_ankle + 0.01, y_knee - 0.12, y_knee, y_hip, y_hip + 0.1]
    leg = np.interp(skin[:, 1], heights, [ankle, 0.5 * ankle + 0.5 * knee, knee, hip, 0.007])
    front = smoothstep(-0.02, 0.05, skin[:, 2] - joints[7, 2])
    if looks.skirt is not None:
        front = 0 * front
    leg = leg + front * 0.007 * smoothstep(y_ankle + 0.10, y_ankle + 0.01, skin[:, 1])  # breaks over the shoe
    leg = leg + 0.006 * np.exp(-(((skin[:, 1] - y_hip + 0.06) / 0.06) ** 2)) * smoothstep(0.02, 0.06, skin[:, 2])
    torso = looks.shirt_ease * np.interp(above, [0, 0.1, 0.3, 0.45], [1.5, 1.1, 0.8, 0.6])
    if looks.tucked:
        torso = torso + 0.006 * np.exp(-(((above - 0.075) / 0.03) ** 2))
        torso = np.where(above < 0.05, np.interp(above, [0, 0.036, 0.05], [0.0065, 0.0065, 0.009]), torso)
    upper = smoothstep(-0.02, 0.05, np.abs(skin[:, 0]) - abs(joints[16, 0]))
    sleeve = 0.006 + 0.7 * looks.shirt_ease
    return np.where(worn.belt, 0.011, np.where(worn.shirt, (1 - upper) * torso + upper * sleeve, leg))


def _folds(
    skin: Float[Array, "vertices 3"],
    joints: Float[Array, "52 3"],
    looks: Looks,
    shirt: Bool[Array, "vertices"],
    above: Float[Array, "vertices"],
) -> Float[Array, "vertices"]:
    """Wrinkles: rings stacked at ankle, knee and elbow, drapes down the chest, bunches at the waist; metres."""
    seed, side = looks.seed, np.sign(skin[:, 0])
    x, y, z = skin.T
    y_hip, y_knee, y_ankle = joints[1, 1], joints[4, 1], joints[7, 1]
    warp = noise(skin * 9 + side[:, None] * 5, seed + 1)

    def ridges(scale_x, scale_y, scale_z, extra, number):
        n = noise(np.stack([x * scale_x + 3.1 * side, y * scale_y + extra, z * scale_z], -1), seed + number)
        return 1 - 2 * np.abs(n) ** 0.8 - 0.3  # sharp crests, wide valleys

    stack = np.exp(-(((y - y_ankle - 0.085) / 0.07) ** 2)) + 0.7 * np.exp(-(((y - y_knee + 0.01) / 0.07) ** 2))
    crotch = np.exp(-(((y - y_hip + 0.06) / 0.06) ** 2)) * smoothstep(-0.02, 0.06, z)
    leg = 0.0040 * stack * ridges(6, 17, 6, 0.8 * warp + 5 * z * side, 2)
    leg = leg + 0.0028 * crotch * ridges(16, 5, 4, 6 * np.abs(x), 3) + 0.0012 * ridges(12, 4, 12, warp, 7)
    drape = ridges(11, 3.5, 9, 7 * np.abs(x), 4)
    bunch = ridges(5, 17, 5, 0.8 * warp, 5)
    belly = np.exp(-(((above - 0.09) / 0.07) ** 2))
    chest = 0.0030 * drape * smoothstep(0.0, 0.1, above) + 0.0030 * belly * bunch
    chest = np.where(above < 0.045, 0, chest) if looks.tucked else chest + 0.002 * drape
    upper = smoothstep(-0.02, 0.05, np.abs(x) - abs(joints[16, 0]))
    across = np.abs(x) * 17 + 10 * (y - joints[16, 1]) * side
    n = noise(np.stack([across + 0.7 * warp, y * 7 + 3.1 * side, z * 7], -1), seed + 6)
    elbow = np.exp(-(((np.abs(x) - abs(joints[18, 0])) / 0.09) ** 2))
    sleeve = (0.0018 + 0.0024 * elbow) * (0.7 - 2 * np.abs(n) ** 0.8)
    if looks.skirt is not None:
        # tights
        leg = np.zeros_like(leg)
    return np.where(shirt, (1 - upper) * chest + upper * sleeve, leg)


def _hang(
    skin: Float[Array, "vertices 3"],
    faces: Int[Array, "faces 3"],
    cloth: Bool[Array, "vertices"],
    ease: Float[Array, "vertices"],
    normals: Float[Array, "vertices 3"],
) -> Float[Array, "vertices 3"]:
    """The smoothest surface outside skin + ease and within 3 cm: a membrane on an obstacle, relaxed.

    It rests on what is round and spans what is hollow, as cloth does; what is small (12 smoothing steps remove
    it) does not show through.
    """
    obstacle = smoothed(skin, faces, cloth, 12)
    points = skin + ease[:, None] * normals
    for _ in range(28):
        points = smoothed(points, faces, cloth, 4)
        off = ((points - obstacle) * normals).sum(1)
        held = np.clip(off, ease, np.maximum(FARTHEST - 0.003, ease))
        points += np.where(cloth, held - off, 0)[:, None] * normals
    return smoothed(points, faces, cloth, 1)


def _straight(
    points: Float[Array, "vertices 3"], faces: Int[Array, "faces 3"], on: Bool[Array, "vertices"]
) -> Float[Array, "vertices 3"]:
    """Take the waves out of a hem: a Laplacian along the edges between its own vertices."""
    ends, _ = edges_of(faces)
    ends = ends[on[ends].all(1)]
    rows, columns = np.concatenate([ends[:, 0], ends[:, 1]]), np.concatenate([ends[:, 1], ends[:, 0]])
    degree = np.bincount(rows, minlength=len(points))
    points = points.copy()
    for _ in range(12):
        for k in range(3):
            mean = np.bincount(rows, points[columns, k], len(points)) / np.maximum(degree, 1)
            points[:, k] = np.where(degree > 1, 0.5 * (points[:, k] + mean), points[:, k])
    return points


def _apart(
    points: Float[Array, "vertices 3"],
    skin: Float[Array, "vertices 3"],
    joints: Float[Array, "52 3"],
    trousers: Bool[Array, "vertices"],
) -> Float[Array, "vertices 3"]:
    """The two trouser legs do not cross the middle below the crotch."""
    middle = joints[0, 0]
    below = trousers & (skin[:, 1] < joints[1, 1] - 0.115)
    side = np.sign(skin[:, 0] - middle)
    x = side * np.maximum(side * (points[:, 0] - middle), 0.0015) + middle
    return np.stack([np.where(below, x, points[:, 0]), points[:, 1], points[:, 2]], -1)


def _breast_tips(mesh: TexturedMesh) -> Bool[Array, "vertices"]:
    """Vertices around the two points that cloth does not follow."""
    tip = np.zeros(len(mesh.vertices), bool)
    for u in (0.3235, 0.4375):
        tip[mesh.faces[np.hypot(*(mesh.uv[mesh.uv_faces].mean(1) - [u, 0.302]).T) < 0.022]] = True
    return tip
