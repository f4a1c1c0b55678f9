"""The subject's template: the free body registered to the subject's surface, with the subject's own 52 joints.

Registration in three steps (FRAMES.md, "Subject template"; notes on what each is worth: docs/decisions.md):

1. shape coefficients, scale and place of the free body from the limb joints and the visible surface;
2. its limbs and fingers carried bone by bone onto the subject's own joints;
3. smooth offsets to robust closest points, against a Laplacian whose stiffness falls.

Frame: pose 0, pelvis joint at the origin, metres.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from scipy.sparse import csr_matrix, diags
from scipy.spatial import KDTree

from avatar.body import Body, builtin_body, shaped
from avatar.rotation import nearest_rotation, rotation_between
from avatar.skeleton import JOINTS, LEFT_HAND, PARENTS, PARTS, RIGHT_HAND
from avatar.skinning import skin_points
from capture.read.template import TemplateMesh, body_template
from capture.template.eyes import RADIUS, body_sockets, fit_sphere
from geometry.closest import closest_points, triangle_index
from geometry.least_squares import factorised
from geometry.mesh import component_labels, face_normals, half_edges, neighbour_matrix, vertex_normals
from geometry.sample import stratified_samples
from player.draw.raster import Rasteriser
from synth.subject import SynthSubject
from synth.visibility import view_counts

SAMPLES = 200_000  # points on the subject's visible surface
# metres: hair nearer than this, straight out from a template vertex, stands over it
HAIR_REACH = 0.08
# stiffness, farthest correspondence (metres), repetitions
STEPS = ((60.0, 0.08, 6), (40.0, 0.06, 5), (28.0, 0.04, 5), (20.0, 0.04, 8))

# metres: vertices so near the edge of a lid are drawn to nothing farther than LID_LIMIT, or lids fold over each other
LIDS = 0.006
LID_LIMIT = 0.004

LIMB_ENDS = ("hip", "knee", "ankle", "foot", "shoulder", "elbow", "wrist")
_LIMBS = [i for i, name in enumerate(JOINTS) if name.split("_")[-1] in LIMB_ENDS]
_LIMBS += list(range(LEFT_HAND.start, RIGHT_HAND.stop))


@dataclass(frozen=True)
class RegisteredTemplate:
    """The registered body: what a real self-scan would have as its fitted body model."""

    mesh: TemplateMesh
    # name of the free body
    body: str
    hair: Bool[np.ndarray, "vertices"]  # the subject's hair stands over this vertex
    # centimetres, mean distance from the subject's visible surface
    residual: dict[str, float]
    # centre and radius of the eyeballs, left then right; None: the subject's mesh does not separate them
    eyes: Float[np.ndarray, "2 4"] | None = None
    # the template's pelvis joint from the subject's, pose 0
    pelvis: tuple[float, float, float] = (0.0, 0.0, 0.0)


def register(subject: SynthSubject, visible: Bool[np.ndarray, "faces"], rasteriser: Rasteriser) -> RegisteredTemplate:
    """The template of a subject, with the free body's skin and the subject's own joints; `visible` are the faces that
    can be seen from outside.

    Both free bodies are tried; the one whose first fit is closer goes on.
    """
    surface = _subject_surface(subject, visible)
    body = _closest_body(subject.joints, surface)
    carried = _carry_limbs(body, subject.joints.astype(np.float64))
    placed = _place_head(body, carried, surface)
    outside = _outer_vertices(rasteriser, placed, body.faces)
    vertices = _smooth_offsets(body, placed, surface, outside)
    mesh = replace(body_template(body), vertices=vertices.astype(np.float32), joints=subject.joints)
    hair = _under_hair(subject, vertices, body.faces)
    residual = _residual(vertices, body.faces, surface)
    return RegisteredTemplate(mesh, body.name, hair, residual, _eyes(subject, visible))


def shape_only(subject: SynthSubject, visible: Bool[np.ndarray, "faces"]) -> RegisteredTemplate:
    """A free body's ten shape coefficients, size and place fitted to the surface as it is seen, hair and clothes
    included; its joints are where its shape has them. What a person's scan in a T-pose would give without offsets,
    a rig or labels.
    """
    surface = _subject_surface(subject, visible, hair=True)
    body = _closest_body(None, surface)
    pelvis = body.joints[0]
    vertices, joints = ((places - pelvis).astype(np.float32) for places in (body.vertices, body.joints))
    mesh = replace(body_template(body), vertices=vertices, joints=joints)
    residual = _residual(body.vertices, body.faces, surface)
    place = float(pelvis[0]), float(pelvis[1]), float(pelvis[2])
    return RegisteredTemplate(mesh, body.name, np.zeros(len(vertices), bool), residual, pelvis=place)


def _closest_body(joints: Float[np.ndarray, "52 3"] | None, surface: "_Surface") -> Body:
    """Of the two free bodies, fitted, the one that comes closer to the surface."""
    fits = [_fit_shape(builtin_body(sex), joints, surface) for sex in ("male", "female")]
    return min(fits, key=lambda fit: fit[1])[0]


def _eyes(subject: SynthSubject, visible: Bool[np.ndarray, "faces"]) -> Float[np.ndarray, "2 4"] | None:
    """Spheres through what can be seen of the subject's own eyeballs, left then right."""
    if subject.eye is None:
        return None
    seen = np.unique(subject.faces[visible & subject.eye[subject.faces].all(1)])
    points = subject.vertices[seen].astype(np.float64)
    if not len(points):
        return None
    middle = 0.5 * (points[:, 0].min() + points[:, 0].max())
    sides = [points[points[:, 0] > middle], points[points[:, 0] <= middle]]
    try:
        fitted = [fit_sphere(side) for side in sides]
    except ValueError:  # eyes drawn on a plane
        return None
    if not all(RADIUS[0] < radius < RADIUS[1] for _, radius in fitted):
        return None
    return np.array([[*centre, radius] for centre, radius in fitted])


class _Surface(NamedTuple):
    """The visible surface of a subject without eyeballs, with the joint that moves each point most."""

    points: Float[np.ndarray, "n 3"]
    normals: Float[np.ndarray, "n 3"]
    joint: Int[np.ndarray, "n"]
    part: UInt8[np.ndarray, "n"]


def _subject_surface(subject: SynthSubject, visible: Bool[np.ndarray, "faces"], *, hair: bool = False) -> _Surface:
    """The surface to fit to; `hair`: as it is seen, else what is labelled hair is left out."""
    shown = visible if hair else visible & ~subject.hair[subject.faces].any(1)
    if subject.eye is not None:
        # the body has no eyeballs: its lids would be drawn onto them
        shown &= ~subject.eye[subject.faces].any(1)
    faces = subject.faces[shown]
    samples = stratified_samples(subject.vertices, faces, SAMPLES, seed=0)
    # hands are 3 % of the area and a third of what is looked at
    hand_faces = faces[subject.part[faces[:, 0]] >= PARTS.index("hand_left")]
    hands = stratified_samples(subject.vertices, hand_faces, SAMPLES // 5, seed=1)
    vertex = np.concatenate([faces[samples.face, 0], hand_faces[hands.face, 0]])
    vertices = subject.vertices.astype(np.float64)
    normals = [face_normals(vertices, f)[spread.face] for f, spread in ((faces, samples), (hand_faces, hands))]
    return _Surface(
        np.concatenate([samples.on(vertices, faces), hands.on(vertices, hand_faces)]),
        np.concatenate(normals),
        subject.skin.heaviest[vertex],
        subject.part[vertex],
    )


def _fit_shape(body: Body, joints: Float[np.ndarray, "52 3"] | None, surface: _Surface) -> tuple[Body, float]:
    """The free body with its ten shapes, its scale and its place fitted to limb joints and surface.

        min |s V + S b + t - c|^2 along the normals of c, + 30 |s J + D b + t - J_subject|^2 over limb joints

    Linear in (s, b, t); closest points and the fit alternate. Without `joints` the surface alone is fitted. Returns the
    body and its mean residual in metres.
    """
    wanted = (body.joints if joints is None else joints)[_LIMBS].astype(np.float64)
    shapes = body.shape_directions.shape[2]
    every = np.arange(0, len(body.vertices), 2)
    basis_v = np.concatenate([body.vertices[every, :, None], body.shape_directions[every]], 2)  # (n, 3, 1 + S)
    basis_j = np.concatenate([body.joints[_LIMBS, :, None], body.joint_directions[_LIMBS]], 2)
    eye_v, eye_j = (np.broadcast_to(np.eye(3), (len(b), 3, 3)) for b in (basis_v, basis_j))
    A_v, A_j = np.concatenate([basis_v, eye_v], 2), np.concatenate([basis_j, eye_j], 2)
    solution = np.zeros(1 + shapes + 3)
    solution[0] = np.ptp(surface.points[:, 1]) / np.ptp(body.vertices[:, 1])
    solution[-3:] = [0, surface.points[:, 1].min() - solution[0] * body.vertices[:, 1].min(), 0]
    # a beta of 1 costs what 2 cm cost a vertex
    prior = np.diag([0.0, *[0.02**2] * shapes, 0, 0, 0])
    tree = KDTree(surface.points[::8])
    normals = surface.normals[::8]
    faces_normals = vertex_normals(body.vertices, body.faces)[every]
    error = np.inf
    for step in range(12):
        found = A_v @ solution
        distance, nearest = tree.query(found)
        n = normals[nearest]
        keep = ((n * faces_normals).sum(1) > 0.5) & (distance < (0.15 if step < 4 else 0.08))
        error = float(np.abs(((found - tree.data[nearest]) * n).sum(1))[keep].mean())
        rows = np.einsum("nc,ncs->ns", n, A_v)[keep]
        targets = (n * tree.data[nearest]).sum(1)[keep]
        limb = A_j.reshape(-1, A_j.shape[2])
        weight = 0.0 if joints is None else 30.0 * len(rows) / len(every)
        lhs = rows.T @ rows + weight * limb.T @ limb + len(rows) * prior
        rhs = rows.T @ targets + weight * limb.T @ wanted.ravel()
        solution = np.linalg.solve(lhs, rhs)
    scale, betas, place = solution[0], solution[1:-3], solution[-3:]
    fitted = shaped(replace(body, vertices=scale * body.vertices, joints=scale * body.joints), betas)
    shift = place + np.einsum("cs,s->c", body.joint_directions[0], betas) + scale * body.joints[0]
    return replace(fitted, vertices=fitted.vertices + shift, joints=fitted.joints + shift), error


def _carry_limbs(body: Body, joints: Float[np.ndarray, "52 3"]) -> Float[np.ndarray, "vertices 3"]:
    """The fitted body with limbs and fingers carried onto the subject's joints, bone by bone.

    Trunk, hips and shoulders stay where the surface put them: rigs agree on where an elbow is, not on where a
    spine is (measured: up to 14 cm apart). Each bone is turned the shortest way, on top of its parent's turn, and
    stretched along itself; a palm follows its five knuckles (Kabsch 1976).
    """
    goal = body.joints.copy()
    carried = [i for i in _LIMBS if not JOINTS[i].endswith(("hip", "shoulder"))]
    goal[carried] = joints[carried]
    children = {i: [int(c) for c in np.flatnonzero(i == PARENTS)] for i in range(len(JOINTS))}
    turn = np.tile(np.eye(3), (len(JOINTS), 1, 1))
    stretch = np.tile(np.eye(3), (len(JOINTS), 1, 1))  # in the rest frame, before the turn
    for k in range(1, len(JOINTS)):
        moved = [c for c in children[k] if c in carried]
        above = turn[PARENTS[k]] if k in carried else np.eye(3)
        turn[k] = above
        if k in carried and not moved:
            stretch[k] = stretch[PARENTS[k]] if k >= LEFT_HAND.start else np.eye(3)
        elif len(moved) == 1:
            old, new = body.joints[moved[0]] - body.joints[k], goal[moved[0]] - goal[k]
            length = np.linalg.norm(old)
            turn[k] = rotation_between(above @ old / length, new / np.linalg.norm(new)) @ above
            axis = old / length
            stretch[k] = np.eye(3) + (np.linalg.norm(new) / length - 1) * np.outer(axis, axis)
        elif len(moved) > 1:
            old, new = body.joints[moved] - body.joints[k], goal[moved] - goal[k]
            turn[k] = nearest_rotation(new.T @ old)
            stretch[k] = np.eye(3) * np.sqrt((new**2).sum() / (old**2).sum())
    transforms = np.tile(np.eye(4), (len(JOINTS), 1, 1))
    transforms[:, :3, :3] = turn @ stretch
    transforms[:, :3, 3] = goal - np.einsum("kij,kj->ki", transforms[:, :3, :3], body.joints)
    return skin_points(body.vertices, body.skin, transforms)


def _place_head(body: Body, x: Float[np.ndarray, "vertices 3"], surface: _Surface) -> Float[np.ndarray, "vertices 3"]:
    """The head moved nose on nose, then fitted by affine point-to-plane steps kept near a similarity.

    Smooth offsets cannot slide an ear along a head: features have to meet before them. The neck follows by the
    head joint's skin weight. Without a face to see (all hair) the head stays where it is.
    """
    head = JOINTS.index("head")
    share = ((body.skin.joints == head) * body.skin.weights).sum(1)
    members = np.flatnonzero(share > 0.7)
    seen = np.flatnonzero(surface.part == PARTS.index("head"))
    if len(seen) < 500:
        return x
    points, normals = surface.points[seen], surface.normals[seen]
    nose, goal = (p[np.abs(p[:, 0] - np.median(p[:, 0])) < 0.015] for p in (x[members], points))
    nose, goal = nose[nose[:, 2].argmax()], goal[goal[:, 2].argmax()]
    tree = KDTree(np.concatenate([points, 0.03 * normals], 1))
    affine, shift = np.eye(3), goal - nose
    for step in range(30):
        moved = nose + (x - nose) @ affine.T + shift
        own = vertex_normals(moved, body.faces)[members]
        at = moved[members]
        _, found = tree.query(np.concatenate([at, 0.03 * own], 1))
        apart = points[found] - at
        n = normals[found]
        limit = 0.03 if step < 10 else 0.015
        keep = ((n * own).sum(1) > 0.6) & (np.linalg.norm(apart, axis=1) < limit)
        if keep.sum() < 200:
            return x
        arm = (at - nose)[keep]
        rows = np.concatenate([np.einsum("ni,nj->nij", n[keep], arm).reshape(-1, 9), n[keep]], 1)
        # shears and unequal scales cost; turning and growing as a whole cost nothing
        shear = np.zeros((7, 12))
        for row, (i, j) in enumerate(((0, 1), (0, 2), (1, 2))):
            shear[row, 3 * i + j] = shear[row, 3 * j + i] = 1
            shear[3 + row, 4 * i], shear[3 + row, 4 * j] = 1, -1
        penalty = 1e-4 * shear.T @ shear + 1e-7 * np.eye(12)
        right = rows.T @ (n[keep] * apart[keep]).sum(1) / len(rows)
        delta = np.linalg.solve(rows.T @ rows / len(rows) + penalty, right)
        affine = affine + delta[:9].reshape(3, 3) @ affine
        shift = shift + delta[9:] + delta[:9].reshape(3, 3) @ shift
    moved = nose + (x - nose) @ affine.T + shift
    return x + share[:, None] * (moved - x)


def _outer_vertices(
    rasteriser: Rasteriser, x: Float[np.ndarray, "vertices 3"], faces: Int[np.ndarray, "faces 3"]
) -> Bool[np.ndarray, "vertices"]:
    """Vertices of the outer skin: mouth, nostrils and eye sockets have no surface to go to.

    A face is outside when it is seen from six views or more (the back of a mouth is seen from one or two,
    between the lips); the outer skin is the largest piece of such faces.
    """
    kept = faces[view_counts(rasteriser, x, faces, enough=6) >= 6]
    piece = component_labels(kept, len(x))
    return piece == np.bincount(piece[kept[:, 0]]).argmax()


def _fingers(joint: Int[np.ndarray, "n"]) -> Int[np.ndarray, "n"]:
    """0-9: the finger of a joint; -2, -1: the palms (left, right); -3: elsewhere."""
    finger = np.full(len(joint), -3)
    finger[joint == JOINTS.index("left_wrist")] = -2
    finger[joint == JOINTS.index("right_wrist")] = -1
    on_finger = joint >= LEFT_HAND.start
    finger[on_finger] = (joint[on_finger] - LEFT_HAND.start) // 3
    return finger


def _smooth_offsets(
    body: Body, start: Float[np.ndarray, "vertices 3"], surface: _Surface, outside: Bool[np.ndarray, "vertices"]
) -> Float[np.ndarray, "vertices 3"]:
    """Non-rigid fit: each step solves for offsets o from `start`

        min sum_i w_i |start_i + o_i - c_i|^2 + (k / 1000)^2 / mean_edge^2 sum_edges |o_i - o_j|^2 ...

    c_i is the foot of the vertex on the plane of its closest point (position and normal agree; fingers are
    matched with their own finger or the palm), w_i is Tukey's weight of the distance.
    """
    V = len(start)
    faces = body.faces
    adjacency = neighbour_matrix(faces, V)
    degree = np.asarray(adjacency.sum(1)).ravel()
    laplacian = csr_matrix(diags(degree) - adjacency)
    # bending carries a slope on past the last vertex that is held, and would blow the mouth's inside up into the
    # cheeks: inside, offsets are harmonic, so no larger than at the lips
    bent = adjacency @ (~outside).astype(float) == 0
    bending = laplacian.T @ diags((bent & outside) / degree) @ laplacian

    # closest points in position and normal together: a normal turned by 60 degrees costs 3 cm
    reach = 0.03
    finger = _fingers(body.skin.heaviest)
    sample_finger = _fingers(surface.joint)
    groups = []
    for f in np.unique(finger):
        # a finger meets itself and its palm, all else what is no finger, and a palm its own fingers too
        allowed = (sample_finger == f) | (sample_finger == f // 5 - 2) if f >= 0 else sample_finger < 0
        if f in (-2, -1):
            allowed |= sample_finger // 5 == f + 2
        rows = np.flatnonzero(allowed)
        tree = KDTree(np.concatenate([surface.points[rows], reach * surface.normals[rows]], 1))
        groups.append((np.flatnonzero(finger == f), rows, tree))

    rims = np.concatenate([socket.rim for socket in body_sockets()])
    on_lids = KDTree(start[rims]).query(start)[0] < LIDS
    x = start.copy()
    for stiffness, farthest, repetitions in STEPS:
        limit = np.where(on_lids, LID_LIMIT, farthest)
        for _ in range(repetitions):
            normals = vertex_normals(x, faces)
            target, weight = x.copy(), np.zeros(V)
            for members, rows, tree in groups:
                _, found = tree.query(np.concatenate([x[members], reach * normals[members]], 1))
                p, n = surface.points[rows[found]], surface.normals[rows[found]]
                apart = x[members] - p
                distance = np.linalg.norm(apart, axis=1)
                agree = (n * normals[members]).sum(1) > 0.5
                tukey = np.maximum(1 - (distance / limit[members]) ** 2, 0) ** 2
                along = (apart * n).sum(1, keepdims=True)
                # mostly the foot on the plane; a tenth of the way to the point itself keeps rims from drifting
                target[members] = x[members] - along * n
                weight[members] = np.where(agree & outside[members], tukey, 0)
            A = diags(weight) + (stiffness / 20) * (0.02 * laplacian + 0.15 * bending)
            x = start + factorised(A).solve(weight[:, None] * (target - start))
    return x


def _under_hair(
    subject: SynthSubject, vertices: Float[np.ndarray, "vertices 3"], faces: Int[np.ndarray, "faces 3"]
) -> Bool[np.ndarray, "vertices"]:
    """Template vertices over which the subject's hair stands: on the outer side and within HAIR_REACH."""
    if not subject.hair.any():
        return np.zeros(len(vertices), bool)
    strands = subject.faces[subject.hair[subject.faces].all(1)]
    hair = stratified_samples(subject.vertices, strands, SAMPLES // 4, seed=2)
    places = hair.on(subject.vertices.astype(np.float64), strands)
    normals = vertex_normals(vertices, faces)
    distance, nearest = KDTree(places).query(vertices)
    outside = ((places[nearest] - vertices) * normals).sum(1)
    straight_out = outside > np.minimum(0.85 * distance, distance - 0.005)  # within half a centimetre any side will do
    covered = (distance < HAIR_REACH) & straight_out
    # close small gaps (where the nape turns away from the hair): grow by four edges, shrink by four
    edges = half_edges(faces)
    for value in (True, False):
        for _ in range(4):
            reached = edges[(covered[edges] == value).any(1)]
            covered[reached] = value
    return covered


def _residual(
    vertices: Float[np.ndarray, "vertices 3"], faces: Int[np.ndarray, "faces 3"], surface: _Surface
) -> dict[str, float]:
    some = slice(0, SAMPLES, 10)
    distance = 100 * closest_points(surface.points[some], triangle_index(vertices, faces)).distance
    part = surface.part[some]
    return {
        "surface_cm": float(distance.mean()),
        "head_cm": float(distance[part == PARTS.index("head")].mean()),
        "hands_cm": float(distance[part >= PARTS.index("hand_left")].mean()),
    }
