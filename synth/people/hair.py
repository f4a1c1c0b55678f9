"""Hair: a cap that grows inside the hairline, and what hangs or is tied from it; every piece is a closed volume.

Long hair is a curtain of strands that leave the head where it is widest, fall, and slide over what they meet (shoulders,
collar) to its outside; it is open below and in front. Frame: pose 0, pelvis at the origin, metres.
"""

import numpy as np
import trimesh
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.spatial import KDTree

from avatar.body import Body
from avatar.skeleton import JOINTS
from geometry.mesh import compact, vertex_normals
from synth.people.body import head_chart, inside_hairline
from synth.people.cloth import Picture, strands
from synth.people.looks import Looks
from synth.people.mesh import Piece, loft, reach, shell, smoothstep, trimmed, tube, unrolled, waves

HEAD, NECK, CHEST = JOINTS.index("head"), JOINTS.index("neck"), JOINTS.index("spine3")
TILE = 0.16
STEP = 0.008  # metres that a strand falls at a time
CAP = {"short": 0.014, "curly": 0.034, "bob": 0.016, "bun": 0.008, "ponytail": 0.008, "long": 0.014, "long front": 0.014}


def hair_pieces(body: Body, looks: Looks, obstacles: list[Piece]) -> list[Piece]:
    """All hair of a person; `obstacles` are the clothes that it falls over."""
    if looks.hair == "bald":
        return []
    picture = strands(looks.hair_color, looks.seed, looks.hair == "curly")
    cap = _cap(body, looks, picture)
    outside = cap.points[: len(cap.points) // 2]
    solid = _Solid(body, obstacles)
    if looks.hair == "bun":
        return [cap, _tied(outside, solid, looks, picture, 0.034, 0.0)]
    if looks.hair == "ponytail":
        return [cap, _tied(outside, solid, looks, picture, 0.026, looks.hair_length + 0.1)]
    if looks.hair in ("long", "long front"):
        end = body.joints[NECK, 1] - looks.hair_length
        spans = [(1.5, 2 * np.pi - 1.5)] if looks.hair == "long" else [(0.85, 1.75), (1.6, 4.68), (4.53, 5.43)]
        return [cap, *(_curtain(outside, solid, looks, span, end, picture) for span in spans)]
    if looks.hair == "bob":
        return [cap, _curtain(outside, solid, looks, (0.9, 2 * np.pi - 0.9), body.joints[NECK, 1] + 0.025, picture)]
    return [cap]


def _cap(body: Body, looks: Looks, picture: Picture) -> Piece:
    """The hair on the scalp."""
    rows, places = head_chart(body)
    rows, places = rows[(places > 0.035).any(2).all(1)], places[(places > 0.035).any(2).all(1)]  # no sockets, no mouth
    inside = np.full(len(body.vertices), -1.0)
    inside[body.faces[rows]] = inside_hairline(places[..., 0], places[..., 1])
    mesh, kept = compact(body.vertices, body.faces[rows])
    points, faces, grown = trimesh.remesh.subdivide(mesh.vertices, mesh.faces, vertex_attributes={"i": inside[kept, None]})
    normals = vertex_normals(np.asarray(points), faces)
    rng = np.random.default_rng([looks.seed, 51])
    ragged = grown["i"] + 0.0018 * waves(points, (220, 60, 160), rng)[:, None]
    faces, (points, normals, grown) = trimmed(ragged[:, 0], faces, [np.asarray(points), normals, ragged])
    high = smoothstep(-0.02, 0.07, points[:, 1] - body.joints[HEAD, 1] - 0.09)
    rough = waves(points, (150, 150, 150), rng) if looks.hair == "curly" else waves(points, (60, 20, 20), rng)
    thick = CAP[looks.hair] * ((0.3 + 0.7 * high) if looks.hair == "short" else (0.55 + 0.45 * high)) * (1 + (0.22 if looks.hair == "curly" else 0.1) * rough)
    thick = 0.002 + thick * smoothstep(-0.012, 0.045, grown[:, 0])
    centre = points.mean(0)
    polar = np.arccos(np.clip(((points - centre) @ [0, 0.9, -0.43]) / np.linalg.norm(points - centre, axis=1), -1, 1))
    uv = unrolled(np.arctan2(points[:, 0], points[:, 2] - centre[2]), 0.1 * polar, faces, 4, TILE)
    weights = np.zeros((len(points), len(JOINTS)))
    weights[:, HEAD] = 1
    return shell(Piece("hair", points + thick[:, None] * normals, faces, uv, weights, picture), thick + 0.002)


class _Solid:
    """The surface that hair falls on."""

    def __init__(self, body: Body, clothes: list[Piece]):
        # ears and face do not hold hair up
        below = body.faces[(body.skin.heaviest[body.faces] != HEAD).all(1)]
        parts = [compact(body.vertices, below)[0], *((piece.points, piece.faces) for piece in clothes)]
        self.neck = body.joints[NECK, 1]
        head = body.vertices[body.skin.heaviest == HEAD]
        self.ears = head[np.abs(head[:, 0]) > np.abs(head[:, 0]).max() - 0.012]
        self.normals = np.concatenate([vertex_normals(*part) for part in parts])
        self.tree = KDTree(np.concatenate([points for points, _ in parts]))

    def pushed(self, points: Float[Array, "n 3"], clearance: float) -> tuple[Float[Array, "n 3"], Array]:
        """Points at least `clearance` metres outside, and which ones had to move."""
        distance, nearest = self.tree.query(points)
        normal = self.normals[nearest]
        off = ((points - self.tree.data[nearest]) * normal).sum(1)
        close = (off < clearance) & (distance < 0.045)
        return points + (close * (clearance - off))[:, None] * normal, close

    def fall(
        self, start: Float[Array, "n 3"], end: float, lean: float, clearance: float, rows: int
    ) -> Float[Array, "rows n 3"]:
        """Strands from `start` down to the height `end`; where they touch they slide by `lean` along z."""
        path, touching = [start], np.zeros(len(start), bool)
        for _ in range(160):
            step = path[-1] + STEP * np.stack([0 * start[:, 0], -np.ones(len(start)), lean * touching], 1)
            moved, touching = self.pushed(step, clearance)
            path.append(moved)
        way = np.array(path)
        # strands that rub against a shoulder do not zigzag
        for _ in range(20):
            way[1:-1] = 0.5 * way[1:-1] + 0.25 * (way[:-2] + way[2:])
        length = np.r_[np.zeros((1, len(start))), np.linalg.norm(np.diff(way, axis=0), axis=2).cumsum(0)]
        out = np.empty((rows, len(start), 3))
        for k in range(len(start)):
            low = np.maximum.accumulate(-way[:, k, 1])
            at = np.linspace(0, np.interp(-end, low + 1e-9 * np.arange(len(low)), length[:, k]), rows)
            out[:, k] = np.stack([np.interp(at, length[:, k], way[:, k, c]) for c in range(3)], 1)
        return out


def _curtain(
    cap: Float[Array, "n 3"], solid: _Solid, looks: Looks, span: tuple[float, float], end: float, picture: Picture
) -> Piece:
    """Hair that hangs from the cap between two directions round the head (0: the face) to the height `end`."""
    angle = np.linspace(*span, 8 + int(11 * (span[1] - span[0])))
    middle = np.array([0, cap[:, 1].max(), 0.5 * (cap[:, 2].min() + cap[:, 2].max())])
    rings, least = [], np.zeros(len(angle))
    for drop in np.linspace(0.015, 0.15, 14):
        above = np.concatenate([cap, solid.ears])
        above = above[above[:, 1] > middle[1] - drop][:, [0, 2]] - middle[[0, 2]]
        least = np.maximum(least, reach(above, angle) + 0.002)
        rings.append(middle + np.stack([np.sin(angle) * least, np.full(len(angle), -drop), np.cos(angle) * least], 1))
    front = np.cos(angle.mean()) > -0.2
    clearance = 0.016 if front else 0.02
    sheet = np.concatenate([rings[:-1], solid.fall(rings[-1], end, 0.8 if front else -0.8, clearance, 44)])
    curl = 0.007 * np.random.default_rng([looks.seed, 52]).uniform(0, 1)
    share = np.linspace(0, 1, len(sheet))
    sheet[..., 0] += curl * share[:, None] * np.sin(70 * sheet[..., 1] + 2 * angle)
    for _ in range(6):
        sheet[1:-1] = 0.5 * sheet[1:-1] + 0.25 * (sheet[:-2] + sheet[2:])
        sheet[:, 1:-1] = 0.5 * sheet[:, 1:-1] + 0.25 * (sheet[:, :-2] + sheet[:, 2:])
    sheet[14:] = solid.pushed(sheet[14:].reshape(-1, 3), 0.7 * clearance)[0].reshape(-1, len(angle), 3)
    points, faces, uv = loft(sheet, 0.1 * angle / TILE, share * (middle[1] - end) / TILE, closed=False)
    across = np.linspace(0, 1, len(angle))
    edge = smoothstep(0, 0.14, np.minimum(across, 1 - across))
    half = 0.002 + 0.0105 * np.outer(smoothstep(0, 0.3, share) * smoothstep(1.02, 0.8, share), edge).ravel()
    locks = 1 + 0.25 * waves(np.c_[np.tile(angle, len(sheet)), points[:, 1], 0 * half], (14, 6, 1), np.random.default_rng(looks.seed))
    half = half * locks
    outer = points + half[:, None] * vertex_normals(points, faces)
    return shell(Piece("hair", outer, faces, uv, _weights(points, solid), picture), 2 * half)


def _tied(
    cap: Float[Array, "n 3"], solid: _Solid, looks: Looks, picture: Picture, radius: float, length: float
) -> Piece:
    """A bun behind the head, or a ponytail that falls by `length`."""
    towards = np.array([0, 0.42, -0.91])
    root = cap[((cap - [0, 0, 0]) @ towards - 0.3 * np.abs(cap[:, 0])).argmax()] * [0, 1, 1]
    if length:
        out = root + np.linspace(-0.01, 0.045, 6)[:, None] * towards
        path = np.concatenate([out[:-1], solid.fall(out[-1:], root[1] - length, -0.5, radius, 30)[:, 0]])
        share = np.linspace(0, 1, len(path))
        for _ in range(8):
            path[1:-1] = 0.5 * path[1:-1] + 0.25 * (path[:-2] + path[2:])
        size = radius * np.interp(share, [0, 0.1, 0.2, 0.45, 0.8, 1], [0.7, 0.6, 0.85, 1, 0.8, 0.15])
    else:
        along = np.linspace(-1, 1, 22)
        path = root + radius * (0.55 + 0.8 * along[:, None]) * towards
        size = radius * 1.1 * np.sqrt(np.maximum(1 - along**2, 0.003))
    rings = tube(path, size, 28)
    turn = 2 * np.pi * np.arange(28) / 28
    groove = 1 + 0.07 * np.cos(7 * turn + 9 * np.linspace(0, 1, len(path))[:, None])
    rings = path[:, None] + groove[..., None] * (rings - path[:, None])
    points, faces, uv = loft(rings, np.linspace(0, 1.5, 29), np.linspace(0, 1, len(path)) * (length + 0.1) / TILE, capped=True)
    return Piece("hair", points, faces, uv, _weights(points, solid), picture)


def _weights(points: Float[Array, "n 3"], solid: _Solid) -> Float[Array, "n 52"]:
    """Hair follows the head down to the chin, the chest below the shoulders, and both between."""
    weights = np.zeros((len(points), len(JOINTS)))
    weights[:, HEAD] = smoothstep(solid.neck - 0.01, solid.neck + 0.11, points[:, 1])
    weights[:, CHEST] = 1 - weights[:, HEAD]
    return weights
