"""A field made solid deep inside the person, so that its zero level is nothing but the skin, and the template's own
behind loose clothes, where no camera ever looked.
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from avatar.skeleton import PARTS
from capture.folder import CaptureSubject
from capture.template.grid import distance_grid
from capture.template.surface import air_beyond, occupied_cells, surface_cloud, visible_faces
from geometry.cells import nearest_marked
from geometry.isosurface import PointFunction
from geometry.mesh import vertex_normals

# metres, per part: so deep inside the template is no surface
INSIDE = np.array([0.02, 0.015, 0.004, 0.004])
# metres, under hair: a hull (capture/template/hull.py) spans hollows; the head's band ends at 2 cm
HAIR_INSIDE = 0.025
# metres between samples of the template at cloth, and between the nodes of its distance
SPACING, CELL = 0.004, 0.006
# metres: where what is seen is nearer than what cloth hides by less than this, less than cloth is thick, both count
BLEND = 0.008


def template_behind_cloth(distance: PointFunction, subject: CaptureSubject) -> PointFunction:
    """The distance, replaced by the template's where what loose clothes hide is nearer than what is seen.

    No ray goes behind cloth (clothes.py): a field drifts there, and its sheets show from below. Across a hem one
    fades into the other: where they met in a jump, and where the sign was that of the plane of a sheet's end, crumbs
    hung below it.
    """
    if subject.behind_cloth is None:
        return distance
    # with the hem itself, on which the camera looks down
    hidden = subject.behind_cloth[subject.faces].any(1)
    low, high = (edge(subject.vertices[subject.faces[hidden]].reshape(-1, 3), 0) for edge in (np.min, np.max))
    low, high = low - 0.02, high + 0.02
    corners = subject.vertices[subject.faces]
    visible = visible_faces(subject)
    near = visible & ((corners > low - 0.05) & (corners < high + 0.05)).all((1, 2))
    cloud = lambda chosen: surface_cloud(subject, PARTS.index("body"), chosen, SPACING, SPACING)
    template = distance_grid(cloud(visible), low, high, CELL)
    # how much farther off than what cloth hides lies what is seen, at the grid's nodes, as far as it matters
    reach = 3 * CELL
    close = np.abs(template.values) < reach
    places, farthest = template.low + CELL * np.argwhere(close), reach + BLEND
    behind, seen = (
        np.minimum(cloud(near & of).tree.query(places, distance_upper_bound=farthest, workers=-1)[0], farthest)
        for of in (hidden, ~hidden)
    )
    values = np.zeros(close.shape, np.float32)
    values[close] = seen - behind
    further = template._replace(values=values[nearest_marked(close)])

    def replaced(points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n"]:
        """Signed distance at canonical points, metres; behind cloth it fades into the template's."""
        value = distance(points)
        inside = np.flatnonzero(((points > low) & (points < high)).all(1))
        share = np.clip(1 + further.at(points[inside]) / BLEND, 0, 1)
        inside, share = inside[share > 0], share[share > 0]
        if len(inside):
            value[inside] += share * (template.at(points[inside]) - value[inside])
        return value

    return replaced


def outer_air(
    vertices: Float[np.ndarray, "vertices 3"], faces: Int[np.ndarray, "faces 3"], cell: float = 0.01
) -> Callable[[Float[np.ndarray, "n 3"]], Bool[np.ndarray, "n"]]:
    """Whether points lie in the air that surrounds a mesh, two cells (metres) and more off its surface.

    A flood fill from outside round walls two cells thicker, which no hole under four cells lets in; what is nearer
    to the surface, and so between fingers, is never said to be air.
    """
    occupied, low = occupied_cells(vertices, faces, cell)
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
    vertices, faces = subject.vertices, subject.faces
    in_air = outer_air(vertices, faces)
    seen = np.unique(faces[visible_faces(subject)])
    normals = vertex_normals(vertices, faces)[seen]
    places = vertices[seen]
    part = subject.part[seen]
    limit = np.where(subject.hair[seen], np.maximum(INSIDE[part], HAIR_INSIDE), INSIDE[part])
    tree = KDTree(places)
    hands = places[part >= PARTS.index("hand_left")]
    # the hands' fields have weights up to 10 cm beyond the wrist, where the part is body
    if len(hands):
        limit = np.where(KDTree(hands).query(places)[0] < 0.12, np.minimum(limit, 0.006), limit)

    def solid(points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n"]:
        """Signed distance at canonical points, metres; deep inside, minus the way to the outer surface."""
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
