"""Clothes: what is hung on the body's own surface (tops, trousers), and what hangs down from it (skirts, coats).

A region says how many metres inside a garment a point of the naked body lies; its zero lines are the hems. Frame: pose 0,
pelvis at the origin, metres.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import trimesh
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array
from scipy.sparse import csr_matrix, diags
from scipy.spatial import KDTree

from avatar.body import Body
from avatar.skinning import dense_weights
from geometry.mesh import compact, neighbour_matrix, vertex_normals
from synth.people.cloth import TILE, Picture, cloth_picture
from synth.people.looks import Cloth, Looks
from synth.people.mesh import Piece, loft, reach, shell, smoothstep, trimmed, unrolled, waves

Region = Callable[[Float[Array, "n 3"]], Float[Array, "n"]]

RINGS, AROUND = 44, 144  # of what hangs
THICK = 0.0025
# half steps of smoothing over which skin weights of what hangs are blended: about 15 cm
BLENDED = 220


@dataclass(frozen=True)
class Figure:
    """The naked body as cloth meets it: trunk and limbs, finer than the body."""

    joints: Float[Array, "52 3"]
    points: Float[Array, "points 3"]
    faces: Int[Array, "faces 3"]
    weights: Float[Array, "points 52"]
    normals: Float[Array, "points 3"]  # of the smoothed surface
    half_step: csr_matrix  # half of the way to the mean of the neighbours

    def smoothed(self, values: Float[Array, "points n"], steps: int) -> Float[Array, "points n"]:
        """So many half steps."""
        for _ in range(steps):
            values = self.half_step @ values
        return values


def dressing_figure(body: Body) -> Figure:
    """The figure of a body, without head, hands and feet, each face in four."""
    dense = dense_weights(body.skin)
    x = np.abs(body.vertices[:, 0])
    clad = (dense[:, 15] < 0.6) & (x < np.abs(body.joints[20:22, 0]).mean() + 0.03)
    clad &= body.vertices[:, 1] > body.joints[7, 1] - 0.03
    mesh, kept = compact(body.vertices, body.faces[clad[body.faces].all(1)])
    points, faces, values = trimesh.remesh.subdivide(mesh.vertices, mesh.faces, vertex_attributes={"w": dense[kept]})
    near = neighbour_matrix(faces, len(points))
    mean = diags(1 / np.maximum(np.asarray(near.sum(1)).ravel(), 1)) @ near
    half_step = csr_matrix(0.5 * mean + 0.5 * diags(np.ones(len(points))))
    figure = Figure(body.joints, np.asarray(points), np.asarray(faces), values["w"], np.asarray(points), half_step)
    calm = figure.smoothed(figure.points, 3)
    normals = vertex_normals(figure.smoothed(calm, 25), figure.faces)
    return replace(figure, points=calm, normals=normals)


def top_region(joints: Float[Array, "52 3"], sleeve: float, hem: float, slope: float) -> Region:
    """A top: below a collar in a plane that falls by `slope` to the front, to the end of its sleeves, down to the height `hem`."""
    shoulder, elbow, wrist = (np.abs(joints[[k, k + 1], 0]).mean() for k in (16, 18, 20))
    cuff = np.interp(sleeve, [0, 1, 2], [shoulder - 0.01, elbow, wrist + 0.01])
    neck, up = joints[13:15].mean(0) + [0, 0.012, 0], np.array([0, 1, slope]) / np.hypot(1, slope)

    def region(p: Float[Array, "n 3"]) -> Float[Array, "n"]:
        # high shoulders stay covered
        collar = np.maximum((neck - p) @ up, 0.6 * (np.hypot(p[:, 0], p[:, 2] - neck[2]) - 0.15))
        inside = np.minimum.reduce([collar, cuff - np.abs(p[:, 0]), p[:, 1] - hem])
        return np.where(p[:, 1] > neck[1] + 0.12, -1.0, inside)

    return region


def coat_region(joints: Float[Array, "52 3"], waist: float) -> Region:
    """A coat down to its belt: open in front in a V that ends there."""
    whole = top_region(joints, 1.92, waist - 0.05, 0.3)

    def region(p: Float[Array, "n 3"]) -> Float[Array, "n"]:
        lapel = np.where(p[:, 2] > joints[12, 2], np.abs(p[:, 0]) - 0.34 * (p[:, 1] - waist - 0.01), 1.0)
        return np.minimum(whole(p), lapel)

    return region


def trouser_region(joints: Float[Array, "52 3"], waist: float, hem: float) -> Region:
    """Trousers from the waist down to the height `hem`."""
    arm = np.abs(joints[16, 0]) + 0.02
    return lambda p: np.minimum.reduce([waist - p[:, 1], p[:, 1] - hem, arm + 0.2 - np.abs(p[:, 0])])


def leg_height(joints: Float[Array, "52 3"], share: float) -> float:
    """The height at a share of the way from the hip (0) over the knee (1) to just above the ankle (2)."""
    return float(np.interp(share, [0, 1, 2], [joints[1, 1], joints[4, 1], joints[7, 1] - 0.01]))


def hung(
    figure: Figure, region: Region, ease: Float[Array, "points"] | float, folds: float, picture: Picture, seed: int, *,
    flare: float = 0.0,
) -> Piece:
    """A garment on the body's surface, closed.

    The smoothest surface outside skin + ease: a membrane on an obstacle, relaxed, so that it rests on what is round and
    spans what is hollow. `ease` and `folds` (their height) in metres; `flare`: how far trouser legs stand off at the
    ankle.
    """
    base, normals, joints = figure.points, figure.normals, figure.joints
    inside, ease = region(base), np.broadcast_to(ease, len(base))
    free = (inside > -0.03)[:, None]
    obstacle = figure.smoothed(base, 10)
    rise = figure.smoothed(np.maximum(((base - obstacle) * normals).sum(1, keepdims=True), 0), 3)
    obstacle = np.where(free, obstacle + rise * normals, base)
    points = base + np.where(free, ease[:, None] * normals, 0)
    for _ in range(24):
        points = np.where(free, figure.smoothed(points, 3), points)
        off = ((points - obstacle) * normals).sum(1)
        points = points + np.where(free, (np.clip(off, ease, ease + 0.025) - off)[:, None] * normals, 0)
    rng = np.random.default_rng([seed, 31])
    ridge = 0.55 * waves(base, (16, 26, 16), rng) + 0.45 * waves(base, (34, 50, 34), rng)
    loose = 0.4 + np.exp(-(((base[:, 1] - joints[4, 1]) / 0.1) ** 2)) + np.exp(-(((base[:, 1] - joints[0, 1]) / 0.12) ** 2))
    points = points + np.where(free, (folds * loose * np.maximum(ridge, -0.8))[:, None] * normals, 0)
    faces, (points, base, weights, normals) = trimmed(inside, figure.faces, [points, base, figure.weights, normals])
    side, below = np.sign(base[:, 0]), base[:, 1] < joints[1, 1] - 0.08
    if flare:
        # straight legs, as wide all the way down as at the knee
        axis = np.stack([np.interp(base[:, 1], *joints[[7, 4, 1]][:, [1, k]].T) for k in (0, 2)], 1)
        away = points[:, [0, 2]] - axis * np.stack([side, np.ones(len(side))], 1)
        radius = np.linalg.norm(away, axis=1)
        knee = np.median(radius[np.abs(base[:, 1] - joints[4, 1]) < 0.03]) + flare
        wide = np.maximum(knee - radius, 0.3 * flare) * smoothstep(joints[1, 1] - 0.05, joints[4, 1] + 0.05, base[:, 1])
        points[:, [0, 2]] += away / np.maximum(radius, 1e-6)[:, None] * wide[:, None]
    # legs do not reach into each other
    points[:, 0] = np.where(below & (base[:, 1] > joints[7, 1] - 0.2), side * np.maximum(side * points[:, 0], 0.003), points[:, 0])
    piece = Piece("cloth", points, faces, _places(base, normals, faces, joints), weights, picture)
    return shell(piece, THICK)


def _places(base, normals, faces, joints) -> Float[Array, "faces 3 2"]:
    """Texture coordinates: round the trunk, round each arm from a seam below, round each leg from one behind."""
    shoulder = np.abs(joints[16, 0]) + 0.01
    middle = base[faces].mean(1)
    # over the shoulders cloth runs on outwards
    fall = -base[:, 1] + np.clip(normals[:, 1], 0, 1) ** 4 * np.abs(base[:, 0])
    uv = unrolled(np.arctan2(base[:, 0], base[:, 2] - joints[3, 2]), fall, faces, round(0.95 / TILE), TILE)
    arm = (np.abs(middle[:, 0]) > shoulder) & (middle[:, 1] > joints[0, 1] + 0.15)
    about = np.arctan2(base[:, 2] - joints[18, 2], base[:, 1] - joints[18, 1])
    uv[arm] = unrolled(about, np.abs(base[:, 0]), faces[arm], 0.36 / TILE, TILE)
    leg = middle[:, 1] < joints[1, 1] - 0.06
    side = np.where(base[:, 0] > 0, 1, -1)
    about = np.arctan2(side * (base[:, 0] - side * abs(joints[4, 0])), base[:, 2] - joints[4, 2])
    uv[leg] = unrolled(about, -base[:, 1], faces[leg], 0.5 / TILE, TILE)
    return uv


def hanging(
    figure: Figure, under: Float[Array, "n 3"], top: float, hem: float, flare: float, picture: Picture, seed: int, *,
    open_front: bool = False,
) -> Piece:
    """A skirt, or the skirts of a coat: one surface from the height `top` to `hem`, open below, off the legs; closed.

    A ring is the outline of what it hangs over (`under`), never narrower than those above, and flares with folds;
    `open_front`: its ends overlap in front.
    """
    rng = np.random.default_rng([seed, 32])
    ends = (0.0, 2 * np.pi) if not open_front else (-0.16, 2 * np.pi + 0.16)
    angle = np.linspace(*ends, AROUND + 1)[: AROUND + open_front]
    middle = np.array([0, figure.joints[1:3, 2].mean()])
    number, phase = int(rng.integers(7, 12)), rng.uniform(0, 6)
    least, rings = np.zeros(len(angle)), []
    shares = np.linspace(0, 1, RINGS)
    for share in shares:
        y = top + share * (hem - top)
        level = under[np.abs(under[:, 1] - y) < 0.014][:, [0, 2]] - middle
        least = np.maximum(least, reach(level[np.abs(level[:, 0]) < 0.35], angle) + 0.005)
        fold = np.cos(number * angle + phase + 1.2 * np.sin(2 * angle + phase)) + 0.5
        radius = least + flare * share + 0.14 * flare * smoothstep(0.05, 0.9, share) * fold
        radius = radius + 0.009 * open_front * (angle - ends[0]) / (ends[1] - ends[0])
        rings.append(np.stack([middle[0] + np.sin(angle) * radius, np.full(len(angle), y), middle[1] + np.cos(angle) * radius], 1))
    out = np.array(rings)
    for _ in range(3):
        out[1:-1, :, [0, 2]] = 0.5 * out[1:-1, :, [0, 2]] + 0.25 * (out[:-2] + out[2:])[:, :, [0, 2]]
    girth = round(1.1 / TILE)
    u = np.linspace(*ends, AROUND + 1) * girth / (2 * np.pi)
    points, faces, uv = loft(out, u, -(top + shares * (hem - top)) / TILE, closed=not open_front)
    weights = figure.weights[KDTree(figure.points).query(points)[1]]
    near = neighbour_matrix(faces, len(points))
    mean = diags(1 / np.asarray(near.sum(1)).ravel()) @ near
    waist = (points[:, 1] > top - 0.03)[:, None]
    for _ in range(BLENDED):
        weights = np.where(waist, weights, 0.5 * weights + 0.5 * (mean @ weights))
    return shell(Piece("cloth", points, faces, uv, weights, picture), THICK)


@dataclass(frozen=True)
class Clothes:
    """What a person wears, and which of the body's vertices it hides for good."""

    pieces: list[Piece]
    hidden: Bool[Array, "vertices"]


def dress(body: Body, looks: Looks) -> Clothes:
    """Everything but shoes."""
    figure, joints, seed = dressing_figure(body), body.joints, looks.seed
    hip, waist = float(joints[1, 1]), float(joints[3, 1] + 0.01)
    top, bottom = cloth_picture(looks.top, seed), cloth_picture(looks.bottom, seed + 1)
    shirt_picture = cloth_picture(Cloth("plain", looks.top.colors[1:] + looks.top.colors[:1]), seed)
    over = figure.points[:, 1]
    loose = 0.008 + 0.008 * smoothstep(waist + 0.1, hip, over) + 0.005 * smoothstep(0.0, 0.1, np.abs(figure.points[:, 0]) - abs(joints[16, 0]))
    legs = {"tight": (1.93, 0.003 if looks.sex == "female" else 0.009, 0.0), "wide": (2.0, 0.008, 0.02 + 0.35 * looks.flare), "coat": (1.95, 0.005, 0.0),
            "shorts": (looks.hem, 0.009, 0.0)}.get(looks.wear)  # fmt: skip
    pieces, regions, slope = [], [], 0.5 + 0.3 * (looks.sex == "female")
    if legs:
        share, ease, flare = legs
        region = trouser_region(joints, waist - 0.02, leg_height(joints, share))
        pieces.append(hung(figure, region, ease, 0.002, bottom, seed + 2, flare=flare))
        regions.append(region)
    tucked = looks.wear in ("dress", "skirt")
    region = top_region(joints, looks.sleeve, hip + 0.02 if tucked else hip - 0.03, slope)
    if looks.wear == "coat":
        over = coat_region(joints, waist)
        shirt = lambda p: np.minimum(region(p), 0.04 - over(p))
        pieces.append(hung(figure, shirt, 0.006, 0.0, shirt_picture, seed + 3))
        pieces.append(hung(figure, over, 0.004 + 1.3 * loose + 0.022 * np.exp(-(((figure.points[:, 1] - waist - 0.04) / 0.08) ** 2)), 0.003, top, seed + 3))
    else:
        pieces.append(hung(figure, region, 0.006 if tucked else loose, 0.0025, top, seed + 3))
    regions.append(region)
    if tucked or looks.wear == "coat":
        under = np.concatenate([piece.points for piece in pieces] + [figure.points])
        cloth = bottom if looks.wear == "skirt" else top
        hem, coat = leg_height(joints, looks.hem), looks.wear == "coat"
        pieces.append(hanging(figure, under, waist, hem, looks.flare * (0.6 if coat else 1), cloth, seed + 4, open_front=coat))
        belt = cloth_picture(Cloth("plain", looks.top.colors[1:] + looks.top.colors[:1]), seed)
        under = np.concatenate([under, pieces[-1].points])
        pieces.append(hanging(figure, under, waist + 0.022, waist - 0.02, 0.0, belt, seed + 4))
    hidden = np.any([region(body.vertices) > 0.03 for region in regions], axis=0)
    return Clothes(pieces, hidden)
