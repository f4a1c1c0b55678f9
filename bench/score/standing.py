"""The standing person beside the true one: outlines from eight sides, and the features of the face.

A bag over a head or a hem that is missing shows in outlines, whatever a mean distance forgives. Features are lids,
brows, nose and lips of iBUG's 68 points: the vertex of the template that the fit takes for the landmark, moved to the
nearest point of what is judged. The jaw's points are left out: they slide along the outline as the head turns. They are
laid on the true ones once by the rigid motion that fits them best (the face's shape), and once with the whole head
aligned (where the face sits in it: a centimetre of hair moves that by as much).
"""

import numpy as np
from jaxtyping import Float

from avatar.camera import orbit_camera
from avatar.similarity import similarity_from_landmarks
from bench.score.picture_scores import REGION_PART
from bench.score.posed_geometry import GeometryCase, PosedPair, alignment
from capture.fit.points import body_points
from capture.folder import CaptureSubject
from geometry.closest import closest_on_triangles, closest_points, triangle_index
from player.draw.raster import Rasteriser

SIDES = 8
SIZE = (192, 192)
FOV = 0.61  # radians
INNER = range(17, 68)
MILLIMETRES = 1000.0  # per metre


def outline_scores(
    raster: Rasteriser, case: GeometryCase, pair: PosedPair, truth_from_surface: Float[np.ndarray, "4 4"] | None = None
) -> dict[str, dict[str, float]]:
    """Intersection over union of the true outline and ours, [0, 1], mean and worst: of the whole person and, within
    the ball that their true surface fills, of head and hands (a trunk behind it would do for any hand); of both hands
    the mean, and the worst."""
    ours = pair.surface
    if truth_from_surface is not None:
        ours = ours @ truth_from_surface[:3, :3].T + truth_from_surface[:3, 3]
    part, faces = case.truth.part[case.truth_faces[:, 0]], case.truth_faces
    regions = {"total": faces} | {region: faces[part == number] for region, number in REGION_PART.items()}
    scores = {}
    for region, own in regions.items():
        if not len(own):
            continue
        # the whole of both is in the picture
        framed = np.concatenate([pair.truth, ours]) if region == "total" else pair.truth[own].reshape(-1, 3)
        middle = 0.5 * (framed.min(0) + framed.max(0))
        radius = 1.1 * float(np.linalg.norm(framed - middle, axis=1).max())
        meshes = [(points, whole[(np.linalg.norm(points - middle, axis=1) < radius)[whole].any(1)])
                  for points, whole in ((pair.truth, faces), (ours, case.faces))]  # fmt: skip
        ratios = []
        for side in range(SIDES):
            # at the height of the middle; the ball fills the picture
            camera = orbit_camera(middle, radius / np.tan(FOV / 2), 2 * np.pi * side / SIDES, 0.0, SIZE, FOV)
            true, drawn = (raster.draw(*mesh, camera).face >= 0 for mesh in meshes)
            ratios.append((true & drawn).sum() / max((true | drawn).sum(), 1))
        scores[region] = {"outline_iou": float(np.mean(ratios)), "outline_worst": float(np.min(ratios))}
    if {"left_hand", "right_hand"} <= scores.keys():
        left, right = scores["left_hand"], scores["right_hand"]
        worst = min(left["outline_worst"], right["outline_worst"])
        scores["hands"] = {"outline_iou": 0.5 * (left["outline_iou"] + right["outline_iou"]), "outline_worst": worst}
    return scores


def face_landmarks_mm(template: CaptureSubject | None, case: GeometryCase, pair: PosedPair) -> dict[str, float]:
    """Mean distance of the features in pose 0, millimetres, aligned by themselves and with the head; empty: the truth
    or the template names none."""
    truth = case.truth.face
    if truth is None or template is None or not template.on_free_body:
        return {}
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
    shape, placed = (MILLIMETRES * float(np.linalg.norm(x, axis=1).mean()) for x in (off, on_head))
    return {"face_mm": shape, "face_on_head_mm": placed}
