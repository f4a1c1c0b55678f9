"""Dressing the free body: garments, hair, shoes and eyes as surface that stands off the skin.

Shirt, trousers and hair are the body's own surface moved outwards: cut along hems, smoothed so that cloth spans
what it would span, pushed out by its ease plus folds, and kept between 5 mm and 3 cm off the skin. Feet are
replaced by shoes lofted round them; a skirt is a shell of its own. Frame: pose 0, pelvis at the origin, metres.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from avatar.body import Body
from avatar.skinning import dense_weights
from experiments.builtin.cloth import FARTHEST, TINY, garments, hung
from experiments.builtin.dressed import BELT, HAIR, LINING, SHIRT, SKIN, TROUSERS, Dressed
from experiments.builtin.eyes import with_eye
from experiments.builtin.face import Face, find_face
from experiments.builtin.hair import hair_thickness, hairline
from experiments.builtin.hems import BELT_WIDTH, LIP, hems_at, neckline, sleeves, waist, waist_levels
from experiments.builtin.looks import Looks
from experiments.builtin.refine import TexturedMesh, cut_along, refined, smoothed
from experiments.builtin.shoes import with_shoe, without_feet
from experiments.builtin.skirt import with_skirt
from geometry.mesh import vertex_normals

Array = np.ndarray


def dress(body: Body, looks: Looks) -> Dressed:
    """The person in clothes.

    Raises:
        ValueError: a body without texture coordinates.
    """
    joints = body.joints.astype(np.float64)
    mesh = _body_mesh(body)
    face = find_face(mesh)
    mesh = without_feet(_fine(mesh, joints, face, looks), joints)
    mesh = _cut(mesh, joints, face, looks)

    skin = mesh.vertices
    hems = hems_at(skin, joints, looks)
    line = np.where(_inner(mesh, face), -0.1, hairline(skin, face, looks))
    worn = garments(skin, hems, joints, looks)
    posed = hung(mesh, hems, worn, joints, looks)

    rise = vertex_normals(smoothed(skin, mesh.faces, line > -0.01, 40), mesh.faces)
    thick = np.clip(hair_thickness(skin, face, looks, line), 0, FARTHEST - 0.001)
    posed = np.where((line > 0)[:, None], skin + rise * thick[:, None], posed)
    posed = smoothed(posed, mesh.faces, line > 0.002, 2)

    on_collar = np.flatnonzero((np.abs(hems.neck) < TINY) & worn.cloth)
    collar, _ = KDTree(posed[on_collar]).query(posed)
    dressed = Dressed(
        replace(mesh, vertices=posed),
        skin,
        _made_of(mesh, line, joints, looks),
        face,
        line,
        np.asarray(collar),
    )
    for side in (0, 1):
        dressed = with_shoe(dressed, body, joints, side)
    if looks.skirt is not None:
        dressed = with_skirt(dressed, joints, looks)
    for centre in face.eyes:
        dressed = with_eye(dressed, centre, face.eye_radius - 0.0004)
    return dressed


def _body_mesh(body: Body) -> TexturedMesh:
    if body.uv is None or body.uv_faces is None:
        raise ValueError(f"body {body.name} should have texture coordinates, has none")
    return TexturedMesh(
        body.vertices.astype(np.float64),
        body.faces.astype(np.int64),
        body.uv.astype(np.float64),
        body.uv_faces.astype(np.int64),
        dense_weights(body.skin),
    )


def _fine(mesh: TexturedMesh, joints: Float[Array, "52 3"], face: Face, looks: Looks) -> TexturedMesh:
    """Fine enough to hang folds on, finer under the hair; hands stay as they are."""
    wrist = np.abs(joints[20:22, 0]).min()

    def longest(points):
        elsewhere = np.where(hairline(points, face, looks) > -0.006, 0.0085, 0.016)
        return np.where(np.abs(points[:, 0]) > wrist - 0.01, 0.05, elsewhere)

    return refined(mesh, longest)


def _cut(mesh: TexturedMesh, joints: Float[Array, "52 3"], face: Face, looks: Looks) -> TexturedMesh:
    """Edges along every hem, along the bands that close the hems, and along the hairline."""

    def neck(points):
        return neckline(points, joints, looks)

    def arm(points):
        return sleeves(points, joints, looks)

    def above(points):
        return waist(points, arm(points), joints, looks)

    cuts = [(neck, 0.0, 0.2), (arm, 0.0, 0.2), (neck, -LIP, 0.0), (arm, -LIP, 0.0)]
    cuts += [(above, level, snap) for level, snap in waist_levels(looks)]
    cuts += [(lambda points: hairline(points, face, looks), 0.0, 0.2)]
    for values, level, snap in cuts:
        mesh = cut_along(mesh, values(mesh.vertices), level, snap=snap)
    return mesh


def _made_of(
    mesh: TexturedMesh, line: Float[Array, "vertices"], joints: Float[Array, "52 3"], looks: Looks
) -> Int[Array, "faces"]:
    """What each face is made of, by its middle on the naked body; shoes and eyes are no part of it yet."""
    middle = mesh.vertices[mesh.faces].mean(1)
    hems = hems_at(middle, joints, looks)
    kind = np.full(len(middle), SKIN)
    kind[(hems.waist < 0) & (middle[:, 1] < joints[0, 1] + 0.2)] = TROUSERS
    kind[(hems.neck > 0) & (hems.arm > 0) & (hems.waist > 0)] = SHIRT
    lip = (hems.neck > -LIP) & (hems.neck < 0) | (hems.arm > -LIP) & (hems.arm < 0) & (hems.neck > 0)
    kind[lip] = LINING
    if looks.tucked:
        kind[(hems.waist > 0) & (hems.waist < BELT_WIDTH + LIP) & (hems.arm > 0)] = BELT
    else:
        kind[(hems.waist < 0) & (hems.waist > -LIP)] = LINING
    kind[(line[mesh.faces].mean(1) > 0) & (middle[:, 1] > joints[12, 1])] = HAIR
    return kind


def _inner(mesh: TexturedMesh, face: Face) -> Bool[Array, "vertices"]:
    """Vertices of the mouth's and the sockets' inside."""
    middle = mesh.uv[mesh.uv_faces].mean(1)
    inside = (middle[:, 0] < 0.16) & (middle[:, 1] > 0.365) & (middle[:, 1] < 0.455) | (
        (middle[:, 0] > 0.755) & (middle[:, 1] > 0.86)
    )
    out = np.zeros(len(mesh.vertices), bool)
    out[mesh.faces[inside]] = True
    return out & (mesh.vertices[:, 1] > face.chin[1] - 0.1)
