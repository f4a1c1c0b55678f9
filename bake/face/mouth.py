"""What lies behind the lips: inside of the mouth, sewn to both edges of the cut, teeth and tongue, and their picture.

The inside is sewn to the lips, vertex by vertex, so that no shape can open a gap between them. Its colors are painted:
no video shows it. Light falls off with the depth behind the lips.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float32, Integer
from numpy import ndarray as Array
from scipy import ndimage
from scipy.spatial import KDTree

from avatar.face_template import BODY
from bake.face.template import PersonFace
from bake.texture.texels import barycentric, rasterise_charts, spread
from geometry.mesh import blended

# metres that the inside's edge lies behind the cut
BEHIND = 0.0025
# sRGB: flesh at the lips and deep inside, gums, tongue, teeth at edge and neck, between two teeth
FLESH, DEEP, GUM, TONGUE = (150, 78, 72), (30, 9, 10), (166, 88, 86), (172, 92, 92)
TOOTH, NECK, GAP = (236, 226, 210), (222, 204, 180), (140, 108, 94)
# metres behind the lips at which light has fallen by a factor of e
DARK = 0.022
# where a tooth ends on the way from the outer gum to the inner one; widths of teeth along half an arch, mm
CROWN, EDGE = 0.36, 2 / 3
UPPER_WIDTHS, LOWER_WIDTHS = (8.6, 6.8, 7.8, 7.0, 7.0, 10.0), (5.3, 5.9, 6.9, 7.0, 7.2, 11.0)


class Mouth(NamedTuple):
    """Geometry behind the lips, with vertices of its own; the first are copies of those along the cut."""

    points: Float[Array, "n 3"]
    offsets: Float32[Array, "52 n 3"]
    uv: Float[Array, "n 2"]  # of its own picture
    faces: Integer[Array, "faces 3"]


def mouth_behind(
    person: PersonFace, upper: Float[Array, "k 3"], moves: tuple[Float32[Array, "52 k 3"], Float32[Array, "52 k 3"]]
) -> Mouth:
    """The mouth behind a cut along `upper`, right to left, whose upper and lower edge move by `moves`."""
    face, inside = person.face, np.unique(person.face.inside)
    where = np.full(BODY, -1)
    where[inside] = np.arange(len(inside))
    points, parts = sewn_inside(person, upper, where)
    k, uv = len(upper), face.inside_uv.astype(np.float64)
    faces, start = [where[face.inside] + 2 * k], np.array([0, k])
    sewn_uv = []
    for number, half in enumerate(face.seam):
        row = where[half]
        along, own = _along(upper), _along(points[row])
        nearest = row[np.abs(along[:, None] - own).argmin(1)]
        sewn_uv.append(uv[nearest])
        strip = zipped(along, own)
        names = np.r_[start[number] + np.arange(k), row + 2 * k]
        faces.append(names[strip if number == 0 else strip[:, ::-1]])
    faces.append(face.part_faces + 2 * k + len(inside))
    offsets = [*moves, face.offsets[:, inside], face.offsets[:, BODY:]]
    return Mouth(
        np.concatenate([upper, upper, points, parts]),
        np.concatenate(offsets, 1),
        np.concatenate([*sewn_uv, uv, face.part_uv]).astype(np.float64),
        np.concatenate(faces),
    )


def sewn_inside(
    person: PersonFace, upper: Float[Array, "k 3"], where: Integer[Array, "body"]
) -> tuple[Float[Array, "inside 3"], Float[Array, "parts 3"]]:
    """The inside of the mouth, moved so that its edge lies behind the cut, and teeth and tongue as far to the front;
    what is deeper moves less."""
    points, face = person.inside.copy(), person.face
    rows = np.unique(where[np.concatenate(face.seam)])
    edge, target = points[rows], upper - [0.0, 0.0, BEHIND]
    along = np.interp(edge[:, 0], edge[[edge[:, 0].argmin(), edge[:, 0].argmax()], 0], upper[[0, -1], 0])
    move = np.stack([np.interp(along, upper[:, 0], target[:, axis]) for axis in range(3)], 1) - edge
    away, near = KDTree(edge).query(points, k=4)
    weight = 1 / np.maximum(away, 1e-6) ** 2
    forwards = float(np.median(move[:, 2]))
    move = (weight[..., None] * move[near]).sum(1) / weight.sum(1, keepdims=True)
    points += np.clip(1 - away[:, :1] / 0.03, 0, 1) * move
    parts = person.parts.copy()
    parts[:, 2] += forwards * np.clip(1 - (parts[:, 2].max() - parts[:, 2]) / 0.03, 0, 1)
    return points, parts


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
    light = np.exp(-depth / DARK)[:, None]
    color = np.empty((len(points), 3))
    own = part < 0
    color[own] = mixed(DEEP, FLESH, np.exp(-depth[own] / 0.012))
    uv = blended(mouth.uv, corners, weight)
    for number, widths in enumerate((UPPER_WIDTHS, LOWER_WIDTHS)):
        own = part == number
        low, high = (f(uv[own], axis=0) for f in (np.min, np.max))
        color[own] = teeth_colors((uv[own] - low) / (high - low), widths) * (0.3 + 0.7 * light[own])
    own = part == 2
    groove = np.exp(-np.square((points[own, 0] - np.median(points[own, 0])) / 0.0015))[:, None]
    color[own] = np.array(TONGUE) * (1 - 0.15 * groove) * (0.3 + 0.7 * light[own])
    image = spread(color / 255, texels)[:height]
    return ndimage.gaussian_filter(image, (0.4, 0.4, 0))


def mixed(low: tuple[int, int, int], high: tuple[int, int, int], share: Float[Array, "n"]) -> Float[Array, "n 3"]:
    """Between two colors."""
    return (1 - share[:, None]) * np.array(low) + share[:, None] * np.array(high)


def teeth_colors(uv: Float[Array, "n 2"], widths: tuple[float, ...]) -> Float[Array, "n 3"]:
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
    return (1 - of_tooth[:, None]) * np.array(GUM) + of_tooth[:, None] * color
