"""A field made solid deep inside the person, so that its zero level is nothing but the skin, and the template's own
behind loose clothes, where no camera ever looked.
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from avatar.skeleton import PARTS
from capture.folder import CaptureSubject
from capture.template import air_beyond, surface_cloud, visible_faces
from geometry.mesh import vertex_normals
from geometry.sample import lattice_samples

PointFunction = Callable[[Float[np.ndarray, "n 3"]], np.ndarray]

# metres, per part: so deep inside the template is no surface
INSIDE = np.array([0.02, 0.015, 0.004, 0.004])
# metres, under hair: a hull (train/hull.py) spans hollows; the head's band ends at 2 cm
HAIR_INSIDE = 0.025


# metres between samples of the template behind cloth
SPACING = 0.008


def template_behind_cloth(distance: PointFunction, subject: CaptureSubject) -> PointFunction:
    """The distance, replaced by the template's where what loose clothes hide is nearer than what is seen.

    No ray goes behind cloth (train/clothes.py): a field drifts there, and its sheets show from below.
    """
    if subject.behind_cloth is None:
        return distance
    body, hidden = PARTS.index("body"), subject.behind_cloth[subject.faces].all(1)
    visible = visible_faces(subject)
    behind, seen = (surface_cloud(subject, body, visible & chosen, SPACING, SPACING) for chosen in (hidden, ~hidden))
    low, high = behind.points.min(0) - 0.02, behind.points.max(0) + 0.02

    def replaced(points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n"]:
        value = distance(points)
        near = np.flatnonzero(((points > low) & (points < high)).all(1))
        if len(near):
            own, row = behind.distance(points[near])
            # not by |own|, which is that to a plane: under a hem it goes on
            away = np.linalg.norm(points[near] - behind.points[row], axis=1)
            nearer = away < seen.tree.query(points[near])[0]
            value[near[nearer]] = own[nearer]
        return value

    return replaced


def outer_air(
    vertices: Float[np.ndarray, "vertices 3"], faces: Int[np.ndarray, "faces 3"], cell: float = 0.01
) -> Callable[[Float[np.ndarray, "n 3"]], Bool[np.ndarray, "n"]]:
    """Whether points lie in the air that surrounds a mesh, two cells (metres) and more off its surface.

    A flood fill from outside round walls two cells thicker, which no hole under four cells lets in; what is nearer
    to the surface, and so between fingers, is never said to be air.
    """
    corners = vertices[faces]
    face, barycentric = lattice_samples(vertices, faces, np.full(len(faces), 0.5 * cell))
    samples = np.einsum("sk,skc->sc", barycentric, corners[face])
    low = samples.min(0) - 6 * cell
    index = ((samples - low) / cell).astype(int)
    occupied = np.zeros(tuple(index.max(0) + 7), bool)
    occupied[tuple(index.T)] = True
    air = air_beyond(occupied, (0, 0, 0))

    def inside(points: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, "n"]:
        at = np.floor((points - low) / cell).astype(int)
        # beyond the grid there is nothing but air
        return air[tuple(np.clip(at, 0, np.array(air.shape) - 1).T)]

    return inside


def solid_inside(distance: PointFunction, subject: CaptureSubject) -> PointFunction:
    """The distance, made negative deep inside the subject's template (INSIDE, per part).

    Training samples a band around the template; deeper in, the field is whatever its network makes up, and its
    zero sets there are sheets inside the body, some of them joined to the skin through a pinhole. Only the
    faces that can be seen from outside count: mouth and eye sockets would turn the sign.
    """
    faces = np.asarray(subject.faces, np.int64)
    vertices = np.asarray(subject.vertices, np.float64)
    in_air = outer_air(vertices, faces)
    seen = np.unique(faces[visible_faces(subject)])
    normals = vertex_normals(vertices, faces)[seen]
    places = vertices[seen]
    part = np.asarray(subject.part, np.int64)[seen]
    limit = np.where(np.asarray(subject.hair, bool)[seen], np.maximum(INSIDE[part], HAIR_INSIDE), INSIDE[part])
    tree = KDTree(places)
    hands = places[part >= PARTS.index("hand_left")]
    # the hands' fields have weights up to 10 cm beyond the wrist, where the part is body
    if len(hands):
        limit = np.where(KDTree(hands).query(places)[0] < 0.12, np.minimum(limit, 0.006), limit)

    distance = template_behind_cloth(distance, subject)

    def solid(points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n"]:
        value = distance(points)
        # only what is positive, or nearly, can be wrong; an island deeper in is dropped as one
        doubtful = np.flatnonzero((value > -0.005) & (value < 0.06))
        away, near = tree.query(points[doubtful], k=4, distance_upper_bound=0.1, workers=-1)
        found = np.isfinite(away).all(1)
        doubtful, away, near = doubtful[found], np.asarray(away)[found], np.asarray(near)[found]
        # four vertices must agree: beside a sharp edge a single normal can be wrong
        offset = points[doubtful][:, None] - places[near]
        behind = ((offset * normals[near]).sum(2) < -0.3 * away).all(1)
        deep = behind & (away[:, 0] > limit[near[:, 0]])
        # the nearest vertices may all be of a shoe's lining, which faces inwards
        deep[deep] = ~in_air(points[doubtful[deep]])
        value[doubtful[deep]] = -away[deep, 0]
        return value

    return solid
