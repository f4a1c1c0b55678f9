"""Clothes: what is hung on the body's own surface (tops, trousers), and what hangs down from it (skirts, coats).

A region says how many metres inside a garment a point of the naked body lies; its zero lines are the hems. Frame:
pose 0, pelvis at the origin, metres.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array
from scipy.sparse import csr_matrix
from scipy.spatial import KDTree

from avatar.body import Body
from avatar.skinning import dense_weights
from geometry.mesh import compact, vertex_normals
from synth.people.cloth import TILE, Picture, cloth_picture
from synth.people.looks import Fabric, Looks
from synth.people.mesh import (
    PersonPiece,
    half_step,
    hemmed,
    in_four,
    loft,
    reach,
    shell,
    smoothstep,
    trimmed,
    unrolled,
    waves,
)

Region = Callable[[Float[Array, "n 3"]], Float[Array, "n"]]

# rings of what hangs, and their points
RINGS, AROUND = 44, 144
THICK = 0.0025
# half steps of smoothing over which skin weights of what hangs are blended: about 10 cm
BLENDED = 100


@dataclass(frozen=True)
class Figure:
    """The naked body as cloth meets it: trunk and limbs without head, hands and feet, each face of the body in four."""

    joints: Float[Array, "52 3"]
    points: Float[Array, "points 3"]
    faces: Int[Array, "faces 3"]
    weights: Float[Array, "points 52"]
    normals: Float[Array, "points 3"]  # those of the smoothed surface
    step: csr_matrix

    def smoothed(self, values: Float[Array, "points n"], steps: int) -> Float[Array, "points n"]:
        for _ in range(steps):
            values = self.step @ values
        return values


def dressing_figure(body: Body) -> Figure:
    """The figure of a body."""
    dense, (x, y, _) = dense_weights(body.skin), body.vertices.T
    clad = (dense[:, 15] < 0.6) & (np.abs(x) < np.abs(body.joints[20:22, 0]).mean() + 0.03)
    clad &= y > body.joints[7, 1] - 0.03
    mesh, kept = compact(body.vertices, body.faces[clad[body.faces].all(1)])
    faces, edges = in_four(mesh.faces, len(mesh.vertices))
    points, weights = (np.r_[values, values[edges].mean(1)] for values in (mesh.vertices, dense[kept]))
    figure = Figure(body.joints, points, faces, weights, points, half_step(faces, len(points)))
    calm = figure.smoothed(points, 3)
    return replace(figure, points=calm, normals=vertex_normals(figure.smoothed(calm, 25), faces))


def top_region(joints: Float[Array, "52 3"], sleeve: float, hem: float, slope: float) -> Region:
    """A top: below a collar in a plane that falls by `slope` to the front, with sleeves, down to the height `hem`."""
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


def leg_height(joints: Float[Array, "52 3"], share: float) -> float:
    """The height at a share of the way from the hip (0) over the knee (1) to the ankle (2)."""
    return float(np.interp(share, [0, 1, 2], [joints[1, 1], joints[4, 1], joints[7, 1] - 0.01]))


def hung(
    figure: Figure, region: Region, ease: Float[Array, "points"] | float, folds: float, picture: Picture, seed: int,
    flare: float = 0.0,
) -> PersonPiece:  # fmt: skip
    """A garment on the body's surface, closed.

    The smoothest surface outside skin + ease: a membrane on an obstacle, relaxed, so that it rests on what is round and
    spans what is hollow. `ease` and `folds` (their height) in metres; `flare`: how far trouser legs stand off.
    """
    base, normals, joints = figure.points, figure.normals, figure.joints
    inside, ease = region(base), np.broadcast_to(ease, len(base))[:, None]
    free = (inside > -0.03)[:, None]

    def lift(points: Float[Array, "points 3"], over: Float[Array, "points 3"]) -> Float[Array, "points 1"]:
        return ((points - over) * normals).sum(1, keepdims=True)

    obstacle = figure.smoothed(base, 10)
    obstacle = obstacle + figure.smoothed(np.maximum(lift(base, obstacle), 0), 3) * normals
    points = np.where(free, base + ease * normals, base)
    for _ in range(24):
        points = np.where(free, figure.smoothed(points, 3), points)
        off = lift(points, obstacle)
        points = np.where(free, points + (np.clip(off, ease, ease + 0.025) - off) * normals, points)
    rng, y = np.random.default_rng([seed, 31]), base[:, 1]
    ridge = 0.55 * waves(base, (16.0, 26.0, 16.0), rng) + 0.45 * waves(base, (34.0, 50.0, 34.0), rng)
    slack = 0.4 + np.exp(-(((y - joints[4, 1]) / 0.1) ** 2)) + np.exp(-(((y - joints[0, 1]) / 0.12) ** 2))
    points = np.where(free, points + (folds * slack * np.maximum(ridge, -0.8))[:, None] * normals, points)
    faces, (points, base, normals, weights) = trimmed(inside, figure.faces, [points, base, normals, figure.weights])
    _hang_legs(points, base, joints, flare)
    points = hemmed(points, faces)
    return shell(PersonPiece("cloth", points, faces, _places(base, normals, faces, joints), weights, picture), THICK)


def _hang_legs(
    points: Float[Array, "n 3"], base: Float[Array, "n 3"], joints: Float[Array, "52 3"], flare: float
) -> None:
    """Trouser legs, in place: as wide all the way down as `flare` at the knee, and not reaching into each other."""
    side, y = np.sign(base[:, 0]), base[:, 1]
    if flare:
        axis = np.stack([np.interp(y, *joints[[7, 4, 1]][:, [1, k]].T) for k in (0, 2)], 1)
        away = points[:, [0, 2]] - axis * np.stack([side, np.ones(len(side))], 1)
        radius = np.linalg.norm(away, axis=1)
        knee = np.median(radius[np.abs(y - joints[4, 1]) < 0.03]) + flare
        wide = np.maximum(knee - radius, 0.3 * flare) * smoothstep(joints[1, 1] - 0.05, joints[4, 1] + 0.05, y)
        points[:, [0, 2]] += away * (wide / np.maximum(radius, 1e-6))[:, None]
    apart = side * np.maximum(side * points[:, 0], 0.003)
    points[:, 0] = np.where(y < joints[1, 1] - 0.08, apart, points[:, 0])


def _places(
    base: Float[Array, "n 3"], normals: Float[Array, "n 3"], faces: Int[Array, "faces 3"], joints: Float[Array, "52 3"]
) -> Float[Array, "faces 3 2"]:
    """Texture coordinates: round the trunk, round each arm from a seam below, round each leg from one behind."""
    (x, y, z), middle = base.T, base[faces].mean(1)
    # over the shoulders cloth runs on outwards
    fall = np.clip(normals[:, 1], 0, 1) ** 4 * np.abs(x) - y
    uv = unrolled(np.arctan2(x, z - joints[3, 2]), fall / TILE, faces, 4.0)
    arm = (np.abs(middle[:, 0]) > np.abs(joints[16, 0]) + 0.01) & (middle[:, 1] > joints[0, 1] + 0.15)
    about = np.arctan2(z - joints[18, 2], y - joints[18, 1])
    uv[arm] = unrolled(about, np.abs(x) / TILE, faces[arm], 0.36 / TILE)
    leg = middle[:, 1] < joints[1, 1] - 0.06
    about = np.arctan2(np.abs(x) - joints[4, 0], z - joints[4, 2])
    uv[leg] = unrolled(about, -y / TILE, faces[leg], 0.5 / TILE)
    return uv


def hanging(
    figure: Figure, under: Float[Array, "n 3"], span: tuple[float, float], flare: float, picture: Picture, seed: int,
    open_front: bool = False,
) -> PersonPiece:  # fmt: skip
    """A skirt, or the skirts of a coat: one surface from one height down to another (`span`), open below; closed.

    A ring is the outline of what it hangs over (`under`), never narrower than those above, and flares with folds;
    `open_front`: its ends overlap in front.
    """
    rng, (top, hem) = np.random.default_rng([seed, 32]), span
    start, turn = (-0.16, 2 * np.pi + 0.32) if open_front else (0.0, 2 * np.pi)
    angle = start + turn * np.arange(AROUND + open_front) / AROUND
    middle, least, rings = np.array([0, 0, figure.joints[1:3, 2].mean()]), np.zeros(len(angle)), []
    fold = np.cos(int(rng.integers(7, 12)) * angle + rng.uniform(0, 6) + 1.2 * np.sin(2 * angle)) + 0.5
    shares = np.linspace(0, 1, RINGS)
    heights, bent = top + shares * (hem - top), smoothstep(0.05, 0.9, shares)
    for y, share, depth in zip(heights, shares, bent, strict=True):
        level = (under[np.abs(under[:, 1] - y) < 0.014] - middle)[:, [0, 2]]
        least = np.maximum(least, reach(level[np.abs(level[:, 0]) < 0.35], angle) + 0.005)
        radius = least + flare * (share + 0.14 * depth * fold)
        radius = radius + 0.009 * open_front * (angle - start) / turn
        rings.append(middle + np.stack([np.sin(angle) * radius, np.full(len(angle), y), np.cos(angle) * radius], 1))
    out = np.array(rings)
    for _ in range(3):
        out[1:-1] = 0.5 * out[1:-1] + 0.25 * (out[:-2] + out[2:])
    u = (start + turn * np.arange(AROUND + 1) / AROUND) * 5 / (2 * np.pi)
    points, faces, uv = loft(out, u, -heights / TILE)
    weights, step = figure.weights[KDTree(figure.points).query(points)[1]], half_step(faces, len(points))
    for _ in range(BLENDED):
        # the waist stays where it is
        weights = np.where(points[:, 1:2] > top - 0.03, weights, step @ weights)
    return shell(PersonPiece("cloth", points, faces, uv, weights, picture), THICK)


def dress(body: Body, looks: Looks) -> tuple[list[PersonPiece], Bool[Array, "vertices"]]:
    """Everything but shoes, and the vertices of the body that it hides for good."""
    figure, joints, seed = dressing_figure(body), body.joints, looks.seed
    x, y, _ = figure.points.T
    hip, waist, woman = float(joints[1, 1]), float(joints[3, 1] + 0.01), looks.sex == "female"
    tucked, coat = looks.wear in ("dress", "skirt"), looks.wear == "coat"
    top, bottom = cloth_picture(looks.top, seed), cloth_picture(looks.bottom, seed + 1)
    second = cloth_picture(Fabric("plain", looks.top.colors[1:] + looks.top.colors[:1]), seed)
    pieces, regions = [], [top_region(joints, looks.sleeve, hip + (0.02 if tucked else -0.03), 0.8 if woman else 0.5)]
    legs = {"wide": (2.0, 0.008, 0.02 + 0.35 * looks.flare), "shorts": (looks.hem, 0.009, 0.0)}
    legs |= dict.fromkeys(("tight", "coat"), (1.93, 0.003, 0.0) if woman else (1.97, 0.009, 0.004))
    if looks.wear in legs:
        share, ease, flare = legs[looks.wear]
        end = leg_height(joints, share)
        regions.append(lambda p: np.minimum(waist - 0.02 - p[:, 1], p[:, 1] - end))
        pieces.append(hung(figure, regions[1], ease, 0.002, bottom, seed + 2, flare))
    loose = 0.008 + 0.008 * smoothstep(waist + 0.1, hip, y) + 0.005 * smoothstep(0.0, 0.1, np.abs(x) - joints[16, 0])
    if coat:
        over = coat_region(joints, waist)
        shirt = regions[0]
        pieces.append(hung(figure, lambda p: np.minimum(shirt(p), 0.04 - over(p)), 0.006, 0.0, second, seed + 3))
        loose = 0.004 + 1.3 * loose + 0.022 * np.exp(-(((y - waist - 0.04) / 0.08) ** 2))
        pieces.append(hung(figure, over, loose, 0.003, top, seed + 3))
    else:
        pieces.append(hung(figure, regions[0], 0.006 if tucked else loose, 0.0025, top, seed + 3))
    if tucked or coat:
        under = np.concatenate([figure.points, *(piece.points for piece in pieces)])
        cloth, flare = bottom if looks.wear == "skirt" else top, (0.6 if coat else 1) * looks.flare
        skirt = hanging(figure, under, (waist, leg_height(joints, looks.hem)), flare, cloth, seed + 4, coat)
        under = np.concatenate([under, skirt.points])
        pieces += [skirt, hanging(figure, under, (waist + 0.022, waist - 0.02), 0.0, second, seed + 4)]
    return pieces, np.any([region(body.vertices) > 0.03 for region in regions], axis=0)
