"""Hair: a cap that grows inside the hairline, and what hangs or is tied from it; every piece is a closed volume.

Long hair is a curtain of strands that leave the head where it is widest, fall, and slide over shoulders and
collar; open below and in front. Frame: pose 0, pelvis at the origin, metres.
"""

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array
from scipy.spatial import KDTree

from avatar.body import Body
from avatar.skeleton import JOINTS
from geometry.mesh import TriangleMesh, compact, concatenated, vertex_normals
from synth.people.body import HAIRLINE, HEAD, chart, inside_line
from synth.people.cloth import Picture, strands
from synth.people.looks import Looks
from synth.people.mesh import (
    PersonPiece,
    ended,
    in_four,
    loft,
    reach,
    shell,
    smoothstep,
    trimmed,
    tube,
    unrolled,
    waves,
)

SKULL, NECK, CHEST = (JOINTS.index(name) for name in ("head", "neck", "spine3"))
TILE = 0.16  # metres of a picture
STEP = 0.008  # metres that a strand falls at a time
# thickness on the crown, metres
CAP = {
    "short": 0.014,
    "curly": 0.034,
    "bob": 0.016,
    "bun": 0.008,
    "ponytail": 0.008,
    "long": 0.014,
    "long front": 0.014,
}
# where hair hangs: directions round the head in radians, 0 and 2 pi before the face
SPANS = {"long": [(1.5, 4.78)], "long front": [(0.85, 1.75), (1.6, 4.68), (4.53, 5.43)], "bob": [(0.9, 5.38)]}


def hair_pieces(body: Body, looks: Looks, clothes: list[PersonPiece]) -> list[PersonPiece]:
    """All hair of a person; it falls over the clothes."""
    if looks.hair == "bald":
        return []
    picture = strands(looks.hair_color, looks.seed, looks.hair == "curly")
    cap, solid = _cap(body, looks, picture), _Solid(body, clothes)
    outside = cap.points[: len(cap.points) // 2]
    if looks.hair in ("bun", "ponytail"):
        return [cap, _tied(outside, solid, looks, picture)]
    end = body.joints[NECK, 1] + (0.025 if looks.hair == "bob" else -looks.hair_length)
    return [cap, *(_curtain(outside, solid, looks.seed, span, end, picture) for span in SPANS.get(looks.hair, []))]


def _cap(body: Body, looks: Looks, picture: Picture) -> PersonPiece:
    number, uv = chart(body)
    rows, inside = np.flatnonzero(number == HEAD), np.full(len(body.vertices), -1.0)
    inside[body.faces[rows]] = inside_line(HAIRLINE, uv[rows])
    mesh, kept = compact(body.vertices, body.faces[rows[(inside[body.faces[rows]] > -0.05).all(1)]])
    faces, edges = in_four(mesh.faces, len(mesh.vertices))
    points, grown = (np.r_[values, values[edges].mean(1)] for values in (mesh.vertices, inside[kept, None]))
    rng = np.random.default_rng([looks.seed, 51])
    ragged = grown + 0.0018 * waves(points, (220.0, 60.0, 160.0), rng)[:, None]
    faces, (points, normals, ragged) = trimmed(ragged[:, 0], faces, [points, vertex_normals(points, faces), ragged])
    curly, short = looks.hair == "curly", looks.hair == "short"
    low = 0.3 if short else 0.55
    high = smoothstep(-0.02, 0.07, points[:, 1] - body.joints[SKULL, 1] - 0.09)
    scale = (150.0, 150.0, 150.0) if curly else (110.0, 60.0, 60.0) if short else (60.0, 20.0, 20.0)
    rough = 1 + (0.1 if not (curly or short) else 0.24) * waves(points, scale, rng)
    thick = 0.002 + CAP[looks.hair] * (low + (1 - low) * high) * rough * smoothstep(-0.012, 0.045, ragged[:, 0])
    out = points - points.mean(0)
    crown = np.arccos(np.clip(out @ [0, 0.9, -0.43] / np.linalg.norm(out, axis=1), -1, 1))
    uv = unrolled(np.arctan2(out[:, 0], out[:, 2]), 0.1 / TILE * crown, faces, 4.0)
    weights = np.tile(np.eye(52)[SKULL], (len(points), 1))
    return shell(PersonPiece("hair", points + thick[:, None] * normals, faces, uv, weights, picture), thick + 0.002)


class _Solid:
    def __init__(self, body: Body, clothes: list[PersonPiece]):
        # ears and face do not hold hair up
        below = compact(body.vertices, body.faces[(body.skin.heaviest[body.faces] != SKULL).all(1)])[0]
        mesh = concatenated([below, *(TriangleMesh(piece.points, piece.faces) for piece in clothes)])
        self.normals, self.tree = vertex_normals(*mesh), KDTree(mesh.vertices)
        self.neck, head = body.joints[NECK, 1], body.vertices[body.skin.heaviest == SKULL]
        self.ears = head[np.abs(head[:, 0]) > np.abs(head[:, 0]).max() - 0.012]

    def pushed(self, points: Float[Array, "n 3"], clearance: float) -> tuple[Float[Array, "n 3"], Bool[Array, "n"]]:
        """Points at least `clearance` metres outside, and which ones had to move."""
        distance, nearest = self.tree.query(points)
        off = ((points - self.tree.data[nearest]) * self.normals[nearest]).sum(1)
        close = (off < clearance) & (distance < 0.045)
        return points + (close * (clearance - off))[:, None] * self.normals[nearest], close

    def fall(self, start: Float[Array, "n 3"], end: float, lean: float, clearance: float) -> Float[Array, "44 n 3"]:
        """Strands from `start` down to the height `end`; where they touch they slide by `lean` along z."""
        path, touching = [start], np.zeros(len(start), bool)
        for _ in range(160):
            step = np.outer(touching, [0, 0, STEP * lean]) - [0, STEP, 0]
            moved, touching = self.pushed(path[-1] + step, clearance)
            path.append(moved)
        way = np.array(path)
        # strands that rub against a shoulder do not zigzag
        for _ in range(20):
            way[1:-1] = 0.5 * way[1:-1] + 0.25 * (way[:-2] + way[2:])
        length = np.linalg.norm(np.diff(way, axis=0, prepend=way[:1]), axis=2).cumsum(0)
        out = np.empty((44, *start.shape))
        for k, at in enumerate(length.T):
            depth = np.maximum.accumulate(-way[:, k, 1]) + 1e-9 * np.arange(len(way))
            places = np.linspace(0, np.interp(-end, depth, at), len(out))
            out[:, k] = np.stack([np.interp(places, at, values) for values in way[:, k].T], 1)
        return out

    def weights(self, points: Float[Array, "n 3"]) -> Float[Array, "n 52"]:
        """Hair follows the head down to the chin, the chest below the shoulders, and both between."""
        head = smoothstep(self.neck - 0.01, self.neck + 0.11, points[:, 1:2])
        return head * np.eye(52)[SKULL] + (1 - head) * np.eye(52)[CHEST]


def _curtain(
    cap: Float[Array, "n 3"], solid: _Solid, seed: int, span: tuple[float, float], end: float, picture: Picture
) -> PersonPiece:
    """Hair that hangs from the cap between two directions round the head to the height `end`."""
    angle = np.linspace(*span, 8 + int(11 * (span[1] - span[0])))
    middle = np.array([0, cap[:, 1].max(), 0.5 * (cap[:, 2].min() + cap[:, 2].max())])
    rings, least, held = [], np.zeros(len(angle)), np.concatenate([cap, solid.ears])
    for drop in np.linspace(0.015, 0.15, 14):
        above = held[held[:, 1] > middle[1] - drop][:, [0, 2]] - middle[[0, 2]]
        least = np.maximum(least, reach(above, angle) + 0.002)
        rings.append(middle + np.stack([np.sin(angle) * least, np.full(len(angle), -drop), np.cos(angle) * least], 1))
    front = np.cos(0.5 * (span[0] + span[1])) > -0.2
    clearance = 0.016 if front else 0.02
    sheet = np.concatenate([rings[:-1], solid.fall(rings[-1], end, 0.8 if front else -0.8, clearance)])
    rng, share = np.random.default_rng([seed, 52]), np.linspace(0, 1, len(sheet))[:, None]
    sheet[..., 0] += 0.007 * rng.uniform() * share * np.sin(70 * sheet[..., 1] + 2 * angle)
    for again in range(9):
        sheet[1:-1] = 0.5 * sheet[1:-1] + 0.25 * (sheet[:-2] + sheet[2:])
        sheet[:, 1:-1] = 0.5 * sheet[:, 1:-1] + 0.25 * (sheet[:, :-2] + sheet[:, 2:])
        if again == 5:
            sheet[14:] = solid.pushed(sheet[14:].reshape(-1, 3), 0.7 * clearance)[0].reshape(sheet[14:].shape)
    points, faces, uv = loft(sheet, 0.1 * angle / TILE, share[:, 0] * (middle[1] - end) / TILE)
    # thin at its beginning, its tips and its sides; in locks
    aside = np.minimum(angle - span[0], span[1] - angle) / (span[1] - span[0])
    half = 0.002 + 0.0105 * smoothstep(0.0, 0.3, share) * smoothstep(1.02, 0.8, share) * smoothstep(0.0, 0.14, aside)
    half = half.ravel() * (1 + 0.25 * waves(np.c_[np.tile(angle, len(sheet)), points[:, 1]], (14.0, 6.0), rng))
    outer = points + half[:, None] * vertex_normals(points, faces)
    return shell(PersonPiece("hair", outer, faces, uv, solid.weights(points), picture), 2 * half)


def _tied(cap: Float[Array, "n 3"], solid: _Solid, looks: Looks, picture: Picture) -> PersonPiece:
    """A bun behind the head, or a ponytail that falls down from there."""
    towards, turn = np.array([0, 0.42, -0.91]), 2 * np.pi * np.arange(28) / 28
    root = cap[(cap @ towards - 0.3 * np.abs(cap[:, 0])).argmax()] * [0, 1, 1]
    if looks.hair == "ponytail":
        out = root + np.linspace(-0.01, 0.045, 6)[:, None] * towards
        path = np.concatenate([out[:-1], solid.fall(out[-1:], root[1] - looks.hair_length - 0.1, -0.5, 0.026)[:, 0]])
        for _ in range(8):
            path[1:-1] = 0.5 * path[1:-1] + 0.25 * (path[:-2] + path[2:])
        size = 0.026 * np.interp(
            np.linspace(0, 1, len(path)), [0, 0.1, 0.2, 0.45, 0.8, 1], [0.7, 0.6, 0.85, 1, 0.8, 0.15]
        )
    else:
        along = np.linspace(-1, 1, 22)
        path, size = root + (0.019 + 0.027 * along[:, None]) * towards, 0.037 * np.sqrt(np.maximum(1 - along**2, 0.003))
    run = np.linspace(0, 1, len(path) + 2)
    rings = ended(tube(path, size[:, None] * (1 + 0.07 * np.cos(7 * turn + 9 * run[1:-1, None]))))
    points, faces, uv = loft(rings, np.linspace(0, 1.5, 29), run * np.linalg.norm(path[0] - path[-1]) / TILE)
    return PersonPiece("hair", points, faces, uv, solid.weights(points), picture)
