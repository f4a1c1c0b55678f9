"""How far the face's features stand from the true ones: lids, brows, nose and lips of iBUG's 68 points.

A point of ours is the vertex of the template that the fit takes for the landmark, moved to the nearest point of
what is judged. The jaw's points are left out: they slide along the outline as the head turns.
"""

import numpy as np

from bench.score.posed_geometry import GeometryCase, PosedPair, alignment
from capture.fit.points import body_points
from capture.folder import CaptureSubject
from geometry.closest import closest_on_triangles, closest_points, triangle_index

INNER = range(17, 68)
MILLIMETRES = 1000.0  # per metre


def face_landmarks_mm(template: CaptureSubject, case: GeometryCase, pair: PosedPair) -> float | None:
    """Their mean in pose 0, the head aligned by itself; None: the truth or the template names none."""
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
    return MILLIMETRES * float(np.linalg.norm(ours @ T[:3, :3].T + T[:3, 3] - truth[INNER], axis=1).mean())
