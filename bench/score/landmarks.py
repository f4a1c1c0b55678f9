"""How far the face's features stand from the true ones: lids, brows, nose and lips of iBUG's 68 points.

Once laid on the true ones by the rigid motion that fits them best (the face's shape), and once with the whole head
aligned (where the face sits in it: a centimetre of hair moves that by as much).

A point of ours is the vertex of the template that the fit takes for the landmark, moved to the nearest point of
what is judged. The jaw's points are left out: they slide along the outline as the head turns.
"""

from typing import NamedTuple

import numpy as np

from avatar.similarity import similarity_from_landmarks
from bench.score.posed_geometry import GeometryCase, PosedPair, alignment
from capture.fit.points import body_points
from capture.folder import CaptureSubject
from geometry.closest import closest_on_triangles, closest_points, triangle_index

INNER = range(17, 68)
MILLIMETRES = 1000.0  # per metre


class FaceError(NamedTuple):
    """Mean distance of the features in pose 0, millimetres."""

    shape: float  # the features aligned by themselves
    on_head: float  # the head aligned


def face_landmarks_mm(template: CaptureSubject, case: GeometryCase, pair: PosedPair) -> FaceError | None:
    """The features' errors; None: the truth or the template names none."""
    truth = case.truth.face
    if truth is None or not template.on_free_body:
        return None
    points = body_points()
    places = np.stack([points[f"face_{number:02d}"].place(template.vertices, template.joints) for number in INNER])
    found = closest_points(places, triangle_index(case.surface.vertices, case.faces))
    corners = case.faces[found.face]
    weights = closest_on_triangles(found.point, case.surface.vertices[corners])[1]
    ours = np.einsum("nk,nkc->nc", weights, pair.surface[corners])
    T = alignment(case, pair, "head")
    own = similarity_from_landmarks(ours, truth[INNER]).transform[:3, :3]
    own /= np.cbrt(np.linalg.det(own))
    off = (ours - ours.mean(0)) @ own.T - (truth[INNER] - truth[INNER].mean(0))
    on_head = ours @ T[:3, :3].T + T[:3, 3] - truth[INNER]
    return FaceError(*(MILLIMETRES * float(np.linalg.norm(x, axis=1).mean()) for x in (off, on_head)))
