"""The line between the lips on a baked surface, and the cut along it."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Float32, Integer
from numpy import ndarray as Array

from avatar.baked_avatar import Level
from bake.face.cut import chains, cut_along, extended, places, refined
from bake.face.template import FaceRefused, PersonFace
from geometry.mesh import area_normals, half_edges

# metres: the line is smoothed over so much of its length; no vertex farther off it is of a lip
KERNEL, LIPS = 0.002, 0.015
# metres before or behind the line that the surface of the mouth may lie: lips are thick
DEEP = 0.018
# metres that the cut ends before the corners of the mouth
SHORT = 0.0005
# metres from the line within which edges are made no longer than this
FINE, LONGEST = 0.003, 0.002
# metres: a shape that parts the lips nowhere by more leaves them closed
PARTED = 0.0008
# vertices of a cut: fewer open as a wedge; metres between two of them below which one will do
LEAST, STEP = 12, 0.0009
STEPS = 200


class LipLine(NamedTuple):
    """Where the lips meet, from the right corner to the left one."""

    x: Float[Array, "steps"]
    y: Float[Array, "steps"]
    z: Float[Array, "steps"]

    def above(self, points: Float[Array, "n 3"]) -> Float[Array, "n"]:
        """Metres above the line; beside the corners above its straight way on."""
        ends = [(self.y[k] - self.y[j]) / (self.x[k] - self.x[j]) for j, k in ((0, 10), (-11, -1))]
        x = points[:, 0]
        y = np.interp(x, self.x, self.y)
        y += np.minimum(x - self.x[0], 0) * ends[0] + np.maximum(x - self.x[-1], 0) * ends[1]
        return points[:, 1] - y

    def away(self, points: Float[Array, "n 3"]) -> Float[Array, "n"]:
        """Metres from the line as the face is seen from the front; inf for what is not of the mouth."""
        x = np.clip(points[:, 0], self.x[0], self.x[-1])
        off = np.hypot(points[:, 0] - x, points[:, 1] - np.interp(x, self.x, self.y))
        return np.where(np.abs(points[:, 2] - np.interp(x, self.x, self.z)) < DEEP, off, np.inf)


def lip_line(person: PersonFace) -> LipLine:
    """The middle of the template's seam."""
    upper, lower = (person.vertices[half] for half in person.face.seam)
    x = np.linspace(upper[0, 0], upper[-1, 0], STEPS)
    ways = [by_x(half) for half in (upper, lower)]
    place = [np.mean([np.interp(x, way[:, 0], way[:, axis]) for way in ways], axis=0) for axis in (1, 2)]
    width = max(1, int(KERNEL / (x[1] - x[0])))
    weight = np.hanning(2 * width + 3)[1:-1]
    smooth = [np.convolve(np.pad(one, width, mode="edge"), weight / weight.sum(), mode="valid") for one in place]
    return LipLine(x, *smooth)


def by_x(points: Float[Array, "n 3"]) -> Float[Array, "n 3"]:
    """From right to left."""
    return points[np.argsort(points[:, 0], kind="stable")]


class CutLips(NamedTuple):
    """A level whose lips are two."""

    level: Level
    # 1 of the upper lip and -1 of the lower one, each with its edge of the cut; 0 elsewhere and at the corners
    lip: Integer[Array, "vertices"]
    # vertices along the cut, right to left; both lips have the corners
    upper: Integer[Array, "n"]
    lower: Integer[Array, "n"]


def cut_lips(level: Level, line: LipLine, coarse: float = 1.0) -> CutLips:
    """Divide the triangles along the line between the lips; the vertices of the lower lip along it are those of the
    upper one over again. Edges at the line may be `coarse` times as long.

    Raises:
        FaceRefused: the line does not cut the surface in one go.
    """
    level = refined(level, lambda points: line.away(points) < FINE, coarse * LONGEST)
    points, faces = level.positions.astype(np.float64), level.faces.astype(np.int64)
    above, near = line.above(points), line.away(points) < LIPS
    # one on the line would leave triangles without area
    above = np.where(np.abs(above) < 2e-5, 2e-5, above)

    def between(edges: Integer[Array, "n 2"], share: Float[Array, "n"]) -> Bool[Array, "n"]:
        at = (1 - share[:, None]) * points[edges[:, 0]] + share[:, None] * points[edges[:, 1]]
        return near[edges].all(1) & (at[:, 0] > line.x[0] + SHORT) & (at[:, 0] < line.x[-1] - SHORT)

    cut = cut_along(faces, above, between)
    grown, count = extended(level, cut.edges, cut.share), len(points)
    place = places(grown.positions[count:])
    edges = half_edges(cut.faces)
    found = chains(place[edges[(edges >= count).all(1)] - count])
    if len(found) != 1 or len(found[0]) < LEAST or found[0][0] == found[0][-1]:
        pieces = ", ".join(str(len(piece)) for piece in found[:4])
        raise FaceRefused(f"its lips should be cut along one line of {LEAST} vertices or more, are along {pieces or 0}")
    chain = found[0]
    thin = thinned(grown.positions.astype(np.float64), cut.faces, chain, np.r_[np.full(count, -1), place])
    cut, chain = cut._replace(faces=thin[cut.faces]), chain[np.isin(chain, place[thin[count:] - count])]
    flat = (np.roll(cut.faces, 1, 1) == cut.faces).any(1)
    cut = cut._replace(faces=cut.faces[~flat], side=cut.side[~flat])
    upper = count + np.array([int(np.argmax(place == at)) for at in chain])
    if grown.positions[upper[0], 0] > grown.positions[upper[-1], 0]:
        upper, chain = upper[::-1], chain[::-1]
    # corners stay whole
    twice = np.flatnonzero(~np.isin(place, chain[[0, -1]]))
    twin = np.arange(count + len(place))
    twin[count + twice] = len(twin) + np.arange(len(twice))
    grown = extended(grown, np.stack([count + twice] * 2, 1), np.zeros(len(twice)))
    faces = np.where((cut.side < 0)[:, None], twin[cut.faces], cut.faces)
    lip = np.zeros(len(grown.positions), np.int64)
    between_corners = (points[:, 0] > line.x[0]) & (points[:, 0] < line.x[-1])
    lip[:count] = np.where(near & between_corners, np.sign(above), 0)
    lip[count + twice], lip[count + len(place) :] = 1, -1
    return CutLips(replace(grown, faces=faces.astype(np.uint32)), lip, upper, twin[upper])


def kept_closed(cut: CutLips, offsets: Float32[Array, "52 n 3"]) -> Float32[Array, "52 n 3"]:
    """The offsets with lips that stay closed in shapes that hardly part them: through a gap of some tenths of a
    millimetre teeth would shine, which are dark behind real lips. Vertices behind those of `cut` stay as they are."""
    apart = np.maximum(offsets[:, cut.upper, 1] - offsets[:, cut.lower, 1], 0)
    apart[apart.max(1) > PARTED] = 0
    # each chart has a vertex of its own in a place
    place = places(cut.level.positions)
    half = np.zeros((len(offsets), len(place)), np.float32)
    half[:, place[cut.upper]] = apart / 2
    out = offsets.copy()
    out[:, : len(place), 1] -= half[:, place] * cut.lip
    return out


def thinned(
    points: Float[Array, "n 3"], faces: Integer[Array, "faces 3"], chain: Integer[Array, "k"],
    place: Integer[Array, "n"],
) -> Integer[Array, "n"]:  # fmt: skip
    """For each vertex the one that stands for it: of those along a cut, whose places are `chain`, one that lies within
    STEP of the last one that was kept is drawn onto it, if in each chart an edge leads there and no face turns over.

    `place`: of each vertex along the cut, -1 elsewhere.
    """
    stands_for, kept = np.arange(len(points)), int(chain[0])
    at = {int(number): np.flatnonzero(place == number) for number in chain}
    for number in chain[1:-1].tolist():
        own, onto = at[number], at[kept]
        trial = stands_for.copy()
        near = np.linalg.norm(points[own[0]] - points[onto[0]]) < STEP
        now = stands_for[faces[np.isin(stands_for[faces], own).any(1)]]
        pairs = {tuple(sorted(pair)) for pair in half_edges(now).tolist()}
        leads = [[to for to in onto.tolist() if (min(one, to), max(one, to)) in pairs] for one in own.tolist()]
        if near and all(len(to) == 1 for to in leads):
            trial[own] = [to[0] for to in leads]
            after = trial[now]
            whole = (np.roll(after, 1, 1) != after).all(1)
            before, turned = area_normals(points, now[whole]), area_normals(points, after[whole])
            lengths = np.linalg.norm(before, axis=1) * np.linalg.norm(turned, axis=1)
            if ((before * turned).sum(1) > 0.5 * lengths).all():
                stands_for = trial
                continue
        kept = number
    return stands_for
