"""Cuts in a baked level along a line on its surface, and vertices that are added to it.

A cut vertex lies on an edge between two others and takes the mean of all that they have, texture coordinates too: so
the finished atlas and its chart seams stay as they are.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Integer
from numpy import ndarray as Array

from avatar.baked_avatar import Level
from avatar.rotation import unit_or_zero
from geometry.mesh import half_edges

# what vertices have, but for joints and weights
MEANS = ("positions", "normals", "uv", "view_dir", "view_q", "view_seen", "light", "loose")
UNIT_LENGTH = ("normals", "view_dir")
# where it is asked whether an edge comes near: long ones fan out over flat skin from a chart's border beside the lips
ALONG = (0.125, 0.5, 0.875)


class Cut(NamedTuple):
    """A mesh divided along a line: new vertices come after the old ones."""

    edges: Integer[Array, "new 2"]  # the old vertices that each lies between
    share: Float[Array, "new"]  # share of the way from the first to the second
    faces: Integer[Array, "faces 3"]
    side: Integer[Array, "faces"]  # -1 or 1, as the function that was cut along


def cut_along(
    faces: Integer[Array, "old 3"],
    value: Float[Array, "vertices"],
    chosen: Callable[[Integer[Array, "n 2"], Float[Array, "n"]], Bool[Array, "n"]] = lambda edges, share: share >= 0,
) -> Cut:
    """Divide faces where `value` changes its sign along an edge, if that edge, so far along, is `chosen`.

    The side of a face that is not divided is that of most of its corners.
    """
    edge = np.unique(np.sort(half_edges(faces), axis=1), axis=0)
    edge = edge[(value[edge[:, 0]] > 0) != (value[edge[:, 1]] > 0)]
    a, b = value[edge].T
    kept = chosen(edge, a / (a - b))
    divided = divided_faces(faces, edge[kept], len(value))
    # a new vertex says nothing of the side
    signs = np.r_[np.where(value > 0, 1, -1), np.zeros(int(kept.sum()), np.int64)]
    return Cut(edge[kept], (a / (a - b))[kept], divided, np.where(signs[divided].sum(1) >= 0, 1, -1))


def divided_faces(
    faces: Integer[Array, "old 3"], edges: Integer[Array, "new 2"], count: int
) -> Integer[Array, "faces 3"]:
    """Faces with a new vertex on each of some edges, whose ends ascend; the first is number `count`."""
    key = lambda pairs: pairs[:, 0].astype(np.int64) * count + pairs[:, 1]
    names, own = key(edges), key(np.sort(half_edges(faces), axis=1))
    order = np.argsort(names)
    at = np.minimum(np.searchsorted(names, own, sorter=order), max(len(names) - 1, 0))
    new = np.where(names[order][at] == own, count + order[at], -1) if len(names) else np.full(len(own), -1)
    new = new.reshape(3, -1).T
    found = [faces[(new < 0).all(1)]]
    for corner in range(3):
        p, q, r = (faces[:, (corner + k) % 3] for k in range(3))
        pq, qr, rp = (new[:, (corner + k) % 3] for k in range(3))
        patterns = [
            ((pq >= 0) & (qr < 0) & (rp < 0), ((p, pq, r), (pq, q, r))),
            ((pq >= 0) & (qr < 0) & (rp >= 0), ((p, pq, rp), (pq, q, rp), (rp, q, r))),
        ]
        if corner == 0:
            patterns.append(((new >= 0).all(1), ((p, pq, rp), (pq, q, qr), (rp, qr, r), (pq, qr, rp))))
        for where, pieces in patterns:
            found += [np.stack([column[where] for column in piece], 1) for piece in pieces]
    return np.concatenate(found)


def refined(level: Level, near: Callable[[Float[Array, "n 3"]], Bool[Array, "n"]], longest: float) -> Level:
    """The level with edges halved until none that comes `near` is longer, metres: it looks the same, and bends in
    more places."""
    for _ in range(4):
        points, faces = level.positions.astype(np.float64), level.faces.astype(np.int64)
        edge = np.unique(np.sort(half_edges(faces), axis=1), axis=0)
        first, second = points[edge[:, 0]], points[edge[:, 1]]
        comes = np.any([near(first + share * (second - first)) for share in ALONG], axis=0)
        edge = edge[comes & (np.linalg.norm(first - second, axis=1) > longest)]
        if not len(edge):
            break
        level = extended(level, edge, np.full(len(edge), 0.5))
        level = replace(level, faces=divided_faces(faces, edge, len(points)).astype(np.uint32))
    return level


def extended(level: Level, edges: Integer[Array, "new 2"], share: Float[Array, "new"]) -> Level:
    """The level with vertices between others behind its own; they are skinned as the nearer one."""
    first, second = edges.T
    fields = {}
    for name, old in vars(level).items():
        if name in MEANS and old is not None:
            part = share.reshape(-1, *[1] * (old.ndim - 1)).astype(np.float64)
            new = (1 - part) * old[first] + part * old[second]
            fields[name] = unit_or_zero(new) if name in UNIT_LENGTH else new
    nearer = np.where(share < 0.5, first, second)
    return joined(level, fields | {"joints": level.joints[nearer], "weights": level.weights[nearer]})


def joined(level: Level, fields: dict[str, Array]) -> Level:
    """The level with vertices behind its own, whose `fields` are given."""
    own = vars(level)
    return replace(level, **{k: np.concatenate([own[k], new]).astype(own[k].dtype) for k, new in fields.items()})


def places(points: Float[Array, "n 3"]) -> Integer[Array, "n"]:
    """The number of each vertex's place, from 0: an atlas has a vertex in each chart that meets there."""
    return np.unique(np.round(points * 1e6).astype(np.int64), axis=0, return_inverse=True)[1].reshape(-1)


def chains(pairs: Integer[Array, "pairs 2"]) -> list[Integer[Array, "n"]]:
    """Pairs of neighbours in order, as lines, the longest first; a closed one begins and ends with one number.

    What hangs together otherwise than as a line is left at its first fork.
    """
    near: dict[int, list[int]] = {}
    for a, b in np.unique(np.sort(pairs[pairs[:, 0] != pairs[:, 1]], axis=1), axis=0).tolist():
        near.setdefault(a, []).append(b)
        near.setdefault(b, []).append(a)
    found, left = [], dict(near)
    for start in sorted(near, key=lambda at: len(near[at]) != 1):
        if start not in left:
            continue
        line = [start]
        while True:
            left.pop(line[-1], None)
            following = [at for at in near[line[-1]] if at in left]
            if not following:
                break
            line.append(following[0])
        if len(line) > 2 and start in near[line[-1]]:
            line.append(start)
        found.append(np.array(line))
    return sorted(found, key=len, reverse=True)
