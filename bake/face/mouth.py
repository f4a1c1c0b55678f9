"""What lies behind the lips: inside of the mouth, sewn to both edges of the cut, teeth and tongue, and their picture.

The inside is sewn to the lips, vertex by vertex, so that no shape can open a gap between them. Its colors are painted,
and tinted where a film of the face shows it. Light falls off with the depth behind the lips.
"""

from dataclasses import replace
from typing import NamedTuple

import fast_simplification
import numpy as np
from jaxtyping import Float, Float32, Integer
from numpy import ndarray as Array
from scipy import ndimage
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra

from avatar.face_template import BODY
from bake.face.template import MouthTint, PersonFace
from bake.texture.texels import barycentric, rasterise_charts, spread
from geometry.mesh import blended, half_edges

# metres that the inside's edge lies behind the cut
BEHIND = 0.0025
# metres behind that edge at which nothing moves with it
FADE = 0.03
# sRGB: flesh at the lips and deep inside, gums, tongue, teeth at edge and neck, between two teeth
FLESH, DEEP, GUM, TONGUE = (150, 78, 72), (30, 9, 10), (166, 88, 86), (172, 92, 92)
TOOTH, NECK, GAP = (236, 226, 210), (222, 204, 180), (140, 108, 94)
# metres behind the lips up to which it is light, and in which light then falls by a factor of e; the least light
LIT, DARK, NIGHT = 0.007, 0.014, 0.12
# u of the template's picture, and of this one: teeth have details, the walls are smooth
TEMPLATE_U, MOUTH_U = (0.0, 0.4, 0.8, 1.0), (0.0, 0.14, 0.86, 1.0)
# where a tooth ends on the way from the outer gum to the inner one; widths of teeth along half an arch, mm
CROWN, EDGE = 0.36, 2 / 3
UPPER_WIDTHS, LOWER_WIDTHS = (8.6, 6.8, 7.8, 7.0, 7.0, 10.0), (5.3, 5.9, 6.9, 7.0, 7.2, 11.0)


class Mouth(NamedTuple):
    """Geometry behind the lips, with vertices of its own; the first are copies of those along the cut."""

    points: Float[Array, "n 3"]
    offsets: Float32[Array, "52 n 3"]
    uv: Float[Array, "n 2"]  # its own picture's
    faces: Integer[Array, "faces 3"]


def mouth_behind(
    person: PersonFace, upper: Float[Array, "k 3"], moves: tuple[Float32[Array, "52 k 3"], Float32[Array, "52 k 3"]]
) -> Mouth:
    """The mouth behind a cut along `upper`, right to left, whose upper and lower edge move by `moves`."""
    face, inside, k = person.face, np.unique(person.face.inside), len(upper)
    where = np.full(BODY, -1)
    where[inside] = np.arange(len(inside))
    halves = (where[face.seam[0]], where[face.seam[1]])
    places, forwards = sewn_inside(person, where[face.inside], halves, [states(upper, move) for move in moves])
    parts = person.parts.copy()
    parts[:, 2] += forwards * np.clip(1 - (parts[:, 2].max() - parts[:, 2]) / FADE, 0, 1)
    faces, uv = [where[face.inside] + 2 * k], []
    for number, half in enumerate(halves):
        along, own = _along(upper), _along(person.inside[half])
        uv.append(face.inside_uv[half[np.abs(along[:, None] - own).argmin(1)]])
        strip = np.r_[number * k + np.arange(k), half + 2 * k][zipped(along, own)]
        # seen from both sides: where a lip turns its skin away from the eye, its back is all that is behind it
        faces += [strip, strip[:, ::-1]]
    faces.append(face.part_faces + 2 * k + len(inside))
    offsets = [*moves, (places[:, 1:] - places[:, :1]).transpose(1, 0, 2), face.offsets[:, BODY:]]
    places_uv = np.concatenate([*uv, face.inside_uv, face.part_uv]).astype(np.float64)
    return Mouth(
        np.concatenate([upper, upper, places[:, 0], parts]),
        np.concatenate(offsets, 1).astype(np.float32),
        np.c_[np.interp(places_uv[:, 0], TEMPLATE_U, MOUTH_U), places_uv[:, 1]],
        np.concatenate(faces),
    )


def coarser(person: PersonFace) -> PersonFace:
    """The face with half of the vertices behind the lips; the seam keeps its own."""
    face, inside = person.face, np.unique(person.face.inside)
    where = np.full(BODY, -1)
    where[inside] = np.arange(len(inside))
    left, faces = fewer(person.inside, where[face.inside], where[np.unique(np.concatenate(face.seam))])
    parts, part_faces = fewer(person.parts, face.part_faces, np.zeros(0, np.int64))
    upper, lower, tongue = np.histogram(parts, np.r_[0, np.cumsum(face.part_counts)])[0].tolist()
    own = replace(
        face, inside=inside[left[faces]], inside_uv=face.inside_uv[left], parts=face.parts[parts],
        part_faces=part_faces, part_uv=face.part_uv[parts], part_counts=(upper, lower, tongue),
        offsets=np.concatenate([face.offsets[:, :BODY], face.offsets[:, BODY + parts]], 1),
    )  # fmt: skip
    return person._replace(face=own, inside=person.inside[left], parts=person.parts[parts])


def fewer(
    points: Float[Array, "n 3"], faces: Integer[Array, "faces 3"], pinned: Integer[Array, "k"]
) -> tuple[Integer[Array, "left"], Integer[Array, "less 3"]]:
    """Half of the vertices of a mesh, the pinned among them, ascending, and the triangles between these.

    Each stands for those that quadric collapse (geometry/decimate.py) draws together: the one nearest to their place.
    """
    flat, small = points.astype(np.float64), faces.astype(np.int32)
    *_, collapses = fast_simplification.simplify(flat, small, target_reduction=0.5, return_collapses=True)
    places, _, place = fast_simplification.replay_simplification(flat, small, collapses)
    away = np.linalg.norm(points - places[place], axis=1)
    away[pinned] = -1
    order = np.lexsort([away, place])
    first = order[np.unique(place[order], return_index=True)[1]]
    stands_for = first[place]
    stands_for[pinned] = pinned
    faces = stands_for[faces]
    faces = faces[(np.roll(faces, 1, 1) != faces).all(1)]
    left, numbers = np.unique(faces, return_inverse=True)
    return left, numbers.reshape(-1, 3)


def states(points: Float[Array, "n 3"], offsets: Float32[Array, "52 n 3"]) -> Float[Array, "n 53 3"]:
    """Where points lie at rest and at each shape."""
    return np.concatenate([points[:, None], points[:, None] + offsets.transpose(1, 0, 2)], 1)


def sewn_inside(
    person: PersonFace, faces: Integer[Array, "faces 3"], halves: tuple[Integer[Array, "a"], Integer[Array, "b"]],
    edges: list[Float[Array, "k 53 3"]],
) -> tuple[Float[Array, "inside 53 3"], float]:  # fmt: skip
    """The inside of the mouth at rest and at each shape, moved so that the halves of its edge lie behind the upper and
    the lower one of the cut; what is deeper moves less. And how far that edge was moved to the front.
    """
    inside = np.unique(person.face.inside)
    places = states(person.inside, person.face.offsets[:, inside])
    rows, moved = np.concatenate(halves), []
    for half, edge in zip(halves, edges):
        along, own = _along(edge[:, 0]), _along(person.inside[half])
        flat = edge.reshape(len(edge), -1)
        behind = np.stack([np.interp(own, along, column) for column in flat.T], 1).reshape(len(half), -1, 3)
        moved.append(behind - np.array([0, 0, BEHIND]) - places[half])
    move = np.concatenate(moved)
    pairs = half_edges(faces)
    length = np.linalg.norm(person.inside[pairs[:, 0]] - person.inside[pairs[:, 1]], axis=1)
    # along the surface, for at rest upper and lower wall touch
    away = dijkstra(coo_matrix((length, pairs.T), shape=(len(places),) * 2).tocsr(), False, rows)
    weight = 1 / np.maximum(away, 1e-6) ** 2
    spread_out = np.tensordot(weight.T / weight.sum(0)[:, None], move, 1)
    return places + np.clip(1 - away.min(0) / FADE, 0, 1)[:, None, None] * spread_out, float(np.median(move[:, 0, 2]))


def _along(points: Float[Array, "n 3"]) -> Float[Array, "n"]:
    """How far along a line each of its points lies, from 0 to 1."""
    length = np.r_[0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))]
    return length / length[-1]


def zipped(first: Float[Array, "n"], second: Float[Array, "m"]) -> Integer[Array, "faces 3"]:
    """Triangles between two lines whose vertices lie at rising places; those of the second line count on."""
    faces, i, j = [], 0, 0
    while i + 1 < len(first) or j + 1 < len(second):
        if j + 1 == len(second) or (i + 1 < len(first) and first[i + 1] <= second[j + 1]):
            faces.append([i, i + 1, len(first) + j])
            i += 1
        else:
            faces.append([i, len(first) + j + 1, len(first) + j])
            j += 1
    return np.array(faces)


def mouth_picture(person: PersonFace, mouth: Mouth, size: tuple[int, int]) -> Float[Array, "height width 3"]:
    """The picture of a mouth, `size` texels wide and high, [0, 1] sRGB."""
    width, height = size
    # charts are rasterised in squares
    texels = rasterise_charts(mouth.uv * [1, height / width], mouth.faces, width)
    weight = np.clip(barycentric(mouth.uv * [1, height / width], mouth.faces, texels, np.zeros(2)), 0, 1)
    corners = mouth.faces[texels.face]
    points = blended(mouth.points, corners, weight / weight.sum(1, keepdims=True))
    first = len(mouth.points) - len(person.parts)
    part = np.searchsorted(first + np.cumsum(person.face.part_counts), corners[:, 0], side="right")
    part = np.where(corners[:, 0] < first, -1, part)
    lips = mouth.points[: (first - len(person.inside)) // 2]
    depth = np.maximum(np.interp(points[:, 0], lips[:, 0], lips[:, 2]) - points[:, 2], 0)
    light = (NIGHT + (1 - NIGHT) * np.exp(-np.maximum(depth - LIT, 0) / DARK))[:, None]
    color = np.empty((len(points), 3))
    own = part < 0
    color[own] = person.tint.red * mixed(DEEP, FLESH, np.exp(-depth[own] / 0.012))
    uv = blended(mouth.uv, corners, weight)
    for number, widths in enumerate((UPPER_WIDTHS, LOWER_WIDTHS)):
        own = part == number
        low, high = (f(uv[own], axis=0) for f in (np.min, np.max))
        color[own] = teeth_colors((uv[own] - low) / (high - low), widths, person.tint) * light[own]
    own = part == 2
    groove = np.exp(-np.square((points[own, 0] - np.median(points[own, 0])) / 0.0015))[:, None]
    color[own] = person.tint.red * np.array(TONGUE) * (1 - 0.15 * groove) * np.sqrt(light[own])
    image = spread(color / 255, texels)[:height]
    return ndimage.gaussian_filter(image, (0.4, 0.4, 0))


def mixed(low: tuple[int, int, int], high: tuple[int, int, int], share: Float[Array, "n"]) -> Float[Array, "n 3"]:
    """Between two colors."""
    return (1 - share[:, None]) * np.array(low) + share[:, None] * np.array(high)


def teeth_colors(uv: Float[Array, "n 2"], widths: tuple[float, ...], tint: MouthTint) -> Float[Array, "n 3"]:
    """Teeth in their gum: u along the arch, v from the outer gum over the edge to the inner one."""
    ends = np.cumsum(widths)
    along = np.abs(2 * uv[:, 0] - 1) * ends[-1]
    tooth = np.minimum(np.searchsorted(ends, along), len(widths) - 1)
    half = 0.5 * np.array(widths)[tooth]
    # from -1 to 1 across each tooth
    across = (along - (ends[tooth] - half)) / half
    v = np.where(uv[:, 1] <= EDGE, uv[:, 1] / EDGE, (1 - uv[:, 1]) / (1 - EDGE))  # 0 gum, 1 edge
    crown = CROWN + 0.14 * np.square(across)  # the gum's arches
    of_tooth = np.clip((v - crown) / 0.05, 0, 1)
    height = np.clip((v - crown) / (1 - crown), 0, 1)
    color = mixed(NECK, TOOTH, np.sqrt(height)) * (1 - 0.10 * np.square(across))[:, None]
    # dark between them, wider at the edge, where their corners are round
    gap = np.clip((np.abs(across) - (0.96 - 0.10 * np.clip(height - 0.8, 0, 1) * 5)) / 0.05, 0, 1)
    color = (1 - gap[:, None]) * color + gap[:, None] * np.array(GAP)
    return (1 - of_tooth[:, None]) * (tint.red * np.array(GUM)) + of_tooth[:, None] * (tint.teeth * color)
