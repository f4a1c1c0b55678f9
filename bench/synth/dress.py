"""Dressing the free body: garments, hair, shoes and eyes as surface that stands off the skin.

Shirt, trousers and hair are the body's own surface moved outwards: cut along hems, smoothed so that cloth spans
what it would span, pushed out by its ease plus folds, and kept between 5 mm and 3 cm off the skin. Feet are
replaced by shoes lofted round them. Frame: pose 0, pelvis at the origin, metres.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import ConvexHull, cKDTree

from avatar.body import Body
from avatar.skinning import dense_weights
from bench.synth.noise import noise
from bench.synth.refine import Mesh, cut_along, edges_of, refined, smoothed, vertex_normals

Array = np.ndarray

SKIN, SHIRT, TROUSERS, BELT, HAIR, SHOE, SOLE, LINING, EYE = range(9)  # what a face is made of
CLOSEST, FARTHEST = 0.005, 0.030  # cloth and hair off the skin, metres
BELT_WIDTH = 0.035
LIP = 0.003  # width of the band that closes a hem towards the skin


NAILS = (  # texture coordinates (v up) of the nails' middles
    (0.408, 0.0822), (0.4140, 0.0463), (0.4459, 0.0160), (0.5010, 0.0186), (0.5378, 0.0577),
    (0.7166, 0.0822), (0.7113, 0.0463), (0.6791, 0.0160), (0.6241, 0.0186), (0.5874, 0.0577),
)  # fmt: skip


LID_X = np.linspace(-0.0125, 0.0135, 11)  # towards the temple, from the eye's centre


@dataclass(frozen=True)
class Looks:
    """What one person wears; lengths in metres, colours sRGB 0-255."""

    sex: str
    seed: int
    tucked: bool  # shirt inside the trousers, with a belt; else its hem hangs over them
    sleeve: float  # hem of the sleeve, as a fraction of the way from shoulder to elbow (over 1: to the wrist)
    collar: float  # height of the collar over the collar bones' joints
    neckline: float  # slope of the collar towards the front
    shirt_ease: float
    trouser_ease: tuple[float, float, float]  # hip, knee, ankle
    hair_top: float
    hair_side: float
    bun: float
    pattern: str  # "stripes" or "plaid"
    skin: tuple[int, int, int]
    hair: tuple[int, int, int]
    iris: tuple[int, int, int]
    lips: tuple[int, int, int]
    shirt: tuple[tuple[int, int, int], tuple[int, int, int]]
    trousers: tuple[int, int, int]
    shoes: tuple[int, int, int]


@dataclass(frozen=True)
class Dressed:
    """The dressed person, still with the texture coordinates of the body (shoes and eyes: their own)."""

    mesh: Mesh  # as seen
    skin_positions: Float[Array, "V 3"]  # where each vertex lies on the naked body
    kind: Int[Array, " F"]
    face: "Face"
    hairline: Float[Array, " V"]  # metres inside the hairline, negative outside
    collar: Float[Array, " V"]  # metres from the edge of the collar, over the cloth


@dataclass(frozen=True)
class Face:
    """Landmarks found on the body by its texture coordinates, which both sexes share."""

    eyes: Float[Array, "2 3"]  # centres of the eyeballs, left then right
    eye_radius: float
    lids: Float[Array, "2 2 11"]  # of each eye the upper and the lower lid's edge: y over the centre at LID_X
    mouth: Float[Array, "3"]
    nose: Float[Array, "3"]
    chin: Float[Array, "3"]
    ears: Float[Array, "2 3"]
    nails: Float[Array, "10 3"]  # the middles of the finger nails


def smoothstep(low, high, x):
    """0 below `low`, 1 above `high`, smooth between."""
    t = np.clip((x - low) / (high - low), 0, 1)
    return t * t * (3 - 2 * t)


def at_uv(mesh: Mesh, u: float, v: float) -> Float[Array, "3"]:
    """The surface point at a texture coordinate (v down)."""
    a, b, c = (mesh.uv[mesh.uv_faces[:, i]] for i in range(3))
    p = np.array([u, v])

    def cross(x, y):
        return x[..., 0] * y[..., 1] - x[..., 1] * y[..., 0]

    area = cross(b - a, c - a)
    area = np.where(area == 0, np.inf, area)
    s, t = cross(p - a, c - a) / area, cross(b - a, p - a) / area
    inside = np.where(np.isfinite(area), np.minimum(np.minimum(s, t), 1 - s - t), -1.0)
    k = int(np.argmax(inside))
    return np.array([1 - s[k] - t[k], s[k], t[k]]) @ mesh.vertices[mesh.faces[k]]


def find_face(mesh: Mesh) -> Face:
    """Eyes from the sockets' own islands of the texture, the rest from fixed texture coordinates."""
    middle = mesh.uv[mesh.uv_faces].mean(1)
    island = (middle[:, 0] < 0.16) & (middle[:, 1] > 0.365) & (middle[:, 1] < 0.455)
    island &= mesh.weights[mesh.faces[:, 0]][:, 15] > 0.9
    socket = np.unique(mesh.faces[island])
    eyes, radii = [], []
    for side in (1, -1):
        points = mesh.vertices[socket][side * (mesh.vertices[socket][:, 0] - mesh.vertices[socket][:, 0].mean()) > 0]
        system = np.concatenate([2 * points, np.ones((len(points), 1))], 1)
        centre = np.linalg.lstsq(system, (points**2).sum(1), rcond=None)[0][:3]
        eyes.append(centre)
        radii.append(np.linalg.norm(points - centre, axis=1).min())
    on_socket, on_skin = np.zeros((2, len(mesh.vertices)), bool)
    on_socket[mesh.faces[island]] = True
    on_skin[mesh.faces[~island]] = True
    rim = mesh.vertices[on_socket & on_skin]
    lids = []
    for side, centre in zip((1, -1), eyes):
        d = rim - centre
        d = d[np.linalg.norm(d, axis=1) < 0.02] * [side, 1, 1]
        d = d[np.argsort(d[:, 0])]
        over = d[:, 1] >= np.interp(d[:, 0], d[[0, -1], 0], d[[0, -1], 1])
        lids.append([np.interp(LID_X, d[rows, 0], d[rows, 1]) for rows in (over, ~over)])
    return Face(
        np.array(eyes),
        float(min(radii)),
        np.array(lids),
        0.5 * (at_uv(mesh, 0.909, 1 - 0.502) + at_uv(mesh, 0.909, 1 - 0.466)),
        at_uv(mesh, 0.863, 1 - 0.4835),
        at_uv(mesh, 0.936, 1 - 0.4835),
        np.array([at_uv(mesh, 0.846, 1 - 0.626), at_uv(mesh, 0.846, 1 - 0.341)]),
        np.array([at_uv(mesh, u, 1 - v) for u, v in NAILS]),
    )


# ---- where things end: signed distances, positive inside ----


def neckline(points, joints, looks: Looks):
    """A plane round the neck that drops to the front."""
    neck = np.array([joints[0, 0], joints[13:15, 1].mean(), joints[13:15, 2].mean()])
    up = np.array([0.0, 1.0, looks.neckline])
    up /= np.linalg.norm(up)
    centre = neck + np.array([0, looks.collar, 0.0])
    distance = (centre - points) @ up
    near = np.hypot(points[:, 0] - neck[0], points[:, 2] - neck[2])
    return np.where((points[:, 1] > neck[1] - 0.12) & (near < 0.20), distance, 0.3)


def sleeves(points, joints, looks: Looks):
    """Along the arms, to the hem."""
    out = np.full(len(points), 0.3)
    for shoulder, elbow, wrist in ((16, 18, 20), (17, 19, 21)):
        side = np.sign(joints[shoulder, 0])
        upper = abs(joints[elbow, 0] - joints[shoulder, 0])
        lower = abs(joints[wrist, 0] - joints[elbow, 0])
        reach = upper * min(looks.sleeve, 1.0) + lower * max(looks.sleeve - 1.0, 0.0)
        along = side * (points[:, 0] - joints[shoulder, 0])
        arm = points[:, 1] > joints[0, 1] + 0.25
        out = np.where(arm & (along > -0.02), np.minimum(out, reach - along), out)
    return out


def hem_height(joints, looks: Looks):
    """Where the shirt ends: at the belt when tucked in, else across the hips."""
    return joints[0, 1] + (0.085 if looks.tucked else -0.035)


def hairline(points: Float[Array, "N 3"], face: Face, looks: Looks) -> Float[Array, " N"]:
    """Metres inside the hairline, about: a curve in the side view, up the temples, round the ear, to the nape."""
    eye = face.eyes.mean(0)
    ear = face.ears.mean(0)
    y, z = points[:, 1] - eye[1], points[:, 2] - ear[2]
    x = np.abs(points[:, 0] - eye[0])
    front = eye[2] + 0.018 - ear[2]
    if looks.sex == "male":
        curve = [(-0.12, -0.075), (-0.07, -0.068), (-0.045, -0.055), (-0.022, -0.02), (-0.012, 0.018), (0.006, 0.022)]
        curve += [(0.012, -0.012), (0.022, -0.016), (0.030, 0.012), (0.036, 0.034), (0.052, 0.050), (0.075, 0.066)]
        curve += [(front, 0.066), (front + 0.05, 0.066)]
    else:
        curve = [(-0.12, -0.055), (-0.07, -0.05), (-0.045, -0.040), (-0.025, -0.012), (-0.012, 0.012), (0.006, 0.020)]
        curve += [(0.014, 0.006), (0.022, 0.002), (0.030, 0.022), (0.040, 0.040), (0.058, 0.055), (0.08, 0.070)]
        curve += [(front, 0.070), (front + 0.05, 0.070)]
    curve = np.array(curve)
    height = np.interp(z, curve[:, 0], curve[:, 1])
    slope = np.gradient(curve[:, 1], curve[:, 0])
    inside = (y - height) / np.sqrt(1 + np.interp(z, curve[:, 0], slope) ** 2)
    peak = 0.006 * np.exp(-((x / 0.012) ** 2)) - 0.005 * smoothstep(0.02, 0.045, x) * smoothstep(0.04, 0.06, z)
    inside = inside + (peak if looks.sex == "male" else 0.6 * peak)
    for centre in face.ears:  # the ear itself stays bare
        d = (points - centre - [0, -0.004, 0.002]) / [0.026, 0.043, 0.024]
        inside = np.minimum(inside, (np.linalg.norm(d, axis=1) - 1) * 0.022 + 0.004)
    return np.where(points[:, 1] > eye[1] - 0.10, inside, -0.1)


# ---- the surface ----


def dress(body: Body, looks: Looks) -> Dressed:
    """The person in clothes."""
    joints = body.joints.astype(np.float64)
    mesh = Mesh(
        body.vertices.astype(np.float64),
        body.faces.astype(np.int64),
        body.uv.astype(np.float64),
        body.uv_faces.astype(np.int64),
        dense_weights(body.skin),
    )
    face = find_face(mesh)
    wrist = np.abs(joints[20:22, 0]).min()
    mesh = refined(
        mesh,
        lambda points: np.where(
            np.abs(points[:, 0]) > wrist - 0.01,
            0.05,  # hands stay as they are
            np.where(hairline(points, face, looks) > -0.006, 0.0085, 0.016),
        ),
    )
    mesh = _without_feet(mesh, joints)
    hem_y = hem_height(joints, looks)

    def over_hem(points):
        return np.where(sleeves(points, joints, looks) < 0.29, 1.0, points[:, 1] - hem_y)

    waist = [(0.0, 0.2), (-LIP, 0.0)] if not looks.tucked else [(0.0, 0.2), (BELT_WIDTH, 0.2), (LIP, 0.0), (BELT_WIDTH + LIP, 0.0)]
    cuts = [(lambda p: neckline(p, joints, looks), 0.0, 0.2), (lambda p: sleeves(p, joints, looks), 0.0, 0.2)]
    cuts += [(lambda p: neckline(p, joints, looks), -LIP, 0.0), (lambda p: sleeves(p, joints, looks), -LIP, 0.0)]
    cuts += [(over_hem, level, snap) for level, snap in waist]
    cuts += [(lambda p: hairline(p, face, looks), 0.0, 0.2)]
    for values, level, snap in cuts:
        mesh = cut_along(mesh, values(mesh.vertices), level, snap=snap)

    skin = mesh.vertices
    neck, arm = neckline(skin, joints, looks), sleeves(skin, joints, looks)
    above = over_hem(skin)
    tiny = 1e-7
    shirt = (neck > -tiny) & (arm > -tiny) & (above > -tiny)
    trousers = ~shirt & (above <= tiny) & (skin[:, 1] < joints[0, 1] + 0.2)
    belt = (above > LIP - tiny) & (above < 0.035 + tiny) & shirt if looks.tucked else np.zeros(len(skin), bool)
    corner = skin[mesh.faces].mean(1)
    f_neck, f_arm = neckline(corner, joints, looks), sleeves(corner, joints, looks)
    f_above = over_hem(corner)
    kind = np.full(len(mesh.faces), SKIN)
    kind[(f_above < 0) & (corner[:, 1] < joints[0, 1] + 0.2)] = TROUSERS
    kind[(f_neck > 0) & (f_arm > 0) & (f_above > 0)] = SHIRT
    lip = (f_neck > -LIP) & (f_neck < 0) | (f_arm > -LIP) & (f_arm < 0) & (f_neck > 0)
    kind[lip] = LINING
    if looks.tucked:
        kind[(f_above > 0) & (f_above < 0.035 + LIP) & (f_arm > 0)] = BELT
    else:
        kind[(f_above < 0) & (f_above > -LIP)] = LINING

    line = hairline(skin, face, looks)
    cavity = _inner(mesh, face)
    line = np.where(cavity, -0.1, line)
    hair = line > 0
    kind[(line[mesh.faces].mean(1) > 0) & (corner[:, 1] > joints[12, 1])] = HAIR

    cloth = shirt | trousers
    normals = vertex_normals(smoothed(skin, mesh.faces, np.ones(len(skin), bool), 30), mesh.faces)
    ease = np.where(cloth, _ease(skin, joints, looks, shirt, belt, above), 0.0)
    under = smoothed(skin, mesh.faces, _breast_tips(mesh) & cloth, 200)
    ease = ease + np.where(_breast_tips(mesh) & shirt, 0.006, 0.0)  # the tips stand out of `under`
    posed = _hang(under, mesh.faces, cloth, ease, normals)
    folds = _folds(skin, joints, looks, shirt, above)
    posed += np.where(cloth & ~belt, folds, 0)[:, None] * vertex_normals(posed, mesh.faces)
    for _ in range(2):
        off = ((posed - 0.5 * (skin + under)) * normals).sum(1)
        posed += np.where(cloth, np.maximum(CLOSEST + 0.0030 - off, 0), 0)[:, None] * normals
        posed = smoothed(posed, mesh.faces, cloth, 1)
    nearest = cKDTree(skin)
    for _ in range(3):  # what still comes too close, the tips
        short = np.maximum(CLOSEST + 0.001 - nearest.query(posed)[0], 0)
        posed += np.where(cloth, short, 0)[:, None] * normals
    posed = _apart(posed, skin, joints, trousers)
    for values, level in ((neck, 0.0), (arm, 0.0), *((above, level) for level, _ in waist), (skin[:, 1], ankle_level(joints))):
        posed = _straight(posed, mesh.faces, (np.abs(values - level) < tiny) & cloth)
    # nothing near a hem hangs over it, and hems lie in their planes
    for sign, near in ((1, (above > 0) & (above < 0.04) & shirt), (-1, (above < 0) & (above > -0.04) & trousers)):
        kept = hem_y + 0.4 * above
        posed[:, 1] = np.where(near, sign * np.maximum(sign * posed[:, 1], sign * kept), posed[:, 1])
    near = (arm > 0) & (arm < 0.04)
    over = np.where(near, np.minimum(sleeves(posed, joints, looks) - 0.4 * arm, 0), 0)
    posed[:, 0] += np.sign(skin[:, 0]) * over
    edge = np.zeros(len(skin), bool)
    for level, _ in waist:
        edge |= np.abs(above - level) < tiny
    edge |= np.abs(skin[:, 1] - ankle_level(joints)) < tiny
    posed[edge, 1] = skin[edge, 1]
    edge = np.abs(arm) < tiny
    posed[edge, 0] = skin[edge, 0]
    edge = np.abs(neck) < tiny
    up = np.array([0.0, 1.0, looks.neckline]) / np.hypot(1.0, looks.neckline)
    posed[edge] += (neckline(posed[edge], joints, looks) - neck[edge])[:, None] * up

    rise = vertex_normals(smoothed(skin, mesh.faces, line > -0.01, 40), mesh.faces)
    thick = np.clip(_hair_thickness(skin, face, looks, line), 0, FARTHEST - 0.001)
    posed = np.where(hair[:, None], skin + rise * thick[:, None], posed)
    posed = smoothed(posed, mesh.faces, hair & (line > 0.002), 2)

    dressed = replace(mesh, vertices=posed)
    on_collar = np.flatnonzero((np.abs(neck) < tiny) & cloth)
    collar, _ = cKDTree(posed[on_collar]).query(posed)
    result = Dressed(dressed, skin, kind, face, line, collar)
    for side in (0, 1):
        result = _with_shoe(result, body, joints, side)
    for centre in face.eyes:
        result = _with_eye(result, centre, face.eye_radius - 0.0004)
    return result


def _inner(mesh: Mesh, face: Face):
    """Vertices of the mouth's and the sockets' inside."""
    middle = mesh.uv[mesh.uv_faces].mean(1)
    inside = (middle[:, 0] < 0.16) & (middle[:, 1] > 0.365) & (middle[:, 1] < 0.455) | (
        (middle[:, 0] > 0.755) & (middle[:, 1] > 0.86)
    )
    out = np.zeros(len(mesh.vertices), bool)
    out[mesh.faces[inside]] = True
    return out & (mesh.vertices[:, 1] > face.chin[1] - 0.1)


def _breast_tips(mesh: Mesh):
    """Vertices around the two points that cloth does not follow."""
    tip = np.zeros(len(mesh.vertices), bool)
    for u in (0.3235, 0.4375):
        tip[mesh.faces[np.hypot(*(mesh.uv[mesh.uv_faces].mean(1) - [u, 0.302]).T) < 0.022]] = True
    return tip


def _ease(skin, joints, looks: Looks, shirt, belt, above):
    """How far cloth stands off the skin at least, metres."""
    hip, knee, ankle = looks.trouser_ease
    y_hip, y_knee, y_ankle = joints[1, 1], joints[4, 1], joints[7, 1]
    heights = [y_ankle + 0.01, y_knee - 0.12, y_knee, y_hip, y_hip + 0.1]
    leg = np.interp(skin[:, 1], heights, [ankle, 0.5 * ankle + 0.5 * knee, knee, hip, 0.007])
    front = smoothstep(-0.02, 0.05, skin[:, 2] - joints[7, 2])
    leg = leg + front * 0.007 * smoothstep(y_ankle + 0.10, y_ankle + 0.01, skin[:, 1])  # breaks over the shoe
    leg = leg + 0.006 * np.exp(-(((skin[:, 1] - y_hip + 0.06) / 0.06) ** 2)) * smoothstep(0.02, 0.06, skin[:, 2])
    torso = looks.shirt_ease * np.interp(above, [0, 0.1, 0.3, 0.45], [1.5, 1.1, 0.8, 0.6])
    if looks.tucked:
        torso = torso + 0.006 * np.exp(-(((above - 0.075) / 0.03) ** 2))
        torso = np.where(above < 0.05, np.interp(above, [0, 0.036, 0.05], [0.0065, 0.0065, 0.009]), torso)
    upper = smoothstep(-0.02, 0.05, np.abs(skin[:, 0]) - abs(joints[16, 0]))
    sleeve = 0.006 + 0.7 * looks.shirt_ease
    return np.where(belt, 0.011, np.where(shirt, (1 - upper) * torso + upper * sleeve, leg))


def _folds(skin, joints, looks: Looks, shirt, above):
    """Wrinkles: rings stacked at ankle, knee and elbow, drapes down the chest, bunches at the waist; metres."""
    seed, side = looks.seed, np.sign(skin[:, 0])
    x, y, z = skin.T
    y_hip, y_knee, y_ankle = joints[1, 1], joints[4, 1], joints[7, 1]
    warp = noise(skin * 9 + side[:, None] * 5, seed + 1)

    def ridges(scale_x, scale_y, scale_z, extra, number):
        n = noise(np.stack([x * scale_x + 3.1 * side, y * scale_y + extra, z * scale_z], -1), seed + number)
        return 1 - 2 * np.abs(n) ** 0.8 - 0.3  # sharp crests, wide valleys

    stack = np.exp(-(((y - y_ankle - 0.085) / 0.07) ** 2)) + 0.7 * np.exp(-(((y - y_knee + 0.01) / 0.07) ** 2))
    crotch = np.exp(-(((y - y_hip + 0.06) / 0.06) ** 2)) * smoothstep(-0.02, 0.06, z)
    leg = 0.0040 * stack * ridges(6, 17, 6, 0.8 * warp + 5 * z * side, 2)
    leg = leg + 0.0028 * crotch * ridges(16, 5, 4, 6 * np.abs(x), 3) + 0.0012 * ridges(12, 4, 12, warp, 7)
    drape = ridges(11, 3.5, 9, 7 * np.abs(x), 4)
    bunch = ridges(5, 17, 5, 0.8 * warp, 5)
    belly = np.exp(-(((above - 0.09) / 0.07) ** 2))
    chest = 0.0030 * drape * smoothstep(0.0, 0.1, above) + 0.0030 * belly * bunch
    chest = np.where(above < 0.045, 0, chest) if looks.tucked else chest + 0.002 * drape
    upper = smoothstep(-0.02, 0.05, np.abs(x) - abs(joints[16, 0]))
    across = np.abs(x) * 17 + 10 * (y - joints[16, 1]) * side
    n = noise(np.stack([across + 0.7 * warp, y * 7 + 3.1 * side, z * 7], -1), seed + 6)
    elbow = np.exp(-(((np.abs(x) - abs(joints[18, 0])) / 0.09) ** 2))
    sleeve = (0.0018 + 0.0024 * elbow) * (0.7 - 2 * np.abs(n) ** 0.8)
    return np.where(shirt, (1 - upper) * chest + upper * sleeve, leg)


def _hang(skin, faces, cloth, ease, normals):
    """The smoothest surface outside skin + ease and within 3 cm: a membrane on an obstacle, relaxed.

    It rests on what is round and spans what is hollow, as cloth does; what is small (12 smoothing steps remove
    it) does not show through.
    """
    obstacle = smoothed(skin, faces, cloth, 12)
    points = skin + ease[:, None] * normals
    for _ in range(28):
        points = smoothed(points, faces, cloth, 4)
        off = ((points - obstacle) * normals).sum(1)
        held = np.clip(off, ease, np.maximum(FARTHEST - 0.003, ease))
        points += np.where(cloth, held - off, 0)[:, None] * normals
    return smoothed(points, faces, cloth, 1)


def _straight(points, faces, on):
    """Take the waves out of a hem: a Laplacian along the edges between its own vertices."""
    ends, _ = edges_of(faces)
    ends = ends[on[ends].all(1)]
    rows, columns = np.concatenate([ends[:, 0], ends[:, 1]]), np.concatenate([ends[:, 1], ends[:, 0]])
    degree = np.bincount(rows, minlength=len(points))
    points = points.copy()
    for _ in range(12):
        for k in range(3):
            mean = np.bincount(rows, points[columns, k], len(points)) / np.maximum(degree, 1)
            points[:, k] = np.where(degree > 1, 0.5 * (points[:, k] + mean), points[:, k])
    return points


def _apart(points, skin, joints, trousers):
    """The two trouser legs do not cross the middle below the crotch."""
    middle = joints[0, 0]
    below = trousers & (skin[:, 1] < joints[1, 1] - 0.115)
    side = np.sign(skin[:, 0] - middle)
    x = side * np.maximum(side * (points[:, 0] - middle), 0.0015) + middle
    return np.stack([np.where(below, x, points[:, 0]), points[:, 1], points[:, 2]], -1)


def _hair_thickness(skin, face: Face, looks: Looks, line):
    eye, ear = face.eyes.mean(0), face.ears.mean(0)
    y, z, x = skin[:, 1] - eye[1], skin[:, 2] - ear[2], skin[:, 0] - eye[0]
    top = smoothstep(0.035, 0.095, y)
    thick = looks.hair_side + (looks.hair_top - looks.hair_side) * top
    seed = looks.seed + 40
    if looks.sex == "male":
        thick = thick + 0.009 * top * smoothstep(0.02, 0.08, z)  # lifted over the forehead
        thick = thick * (1 - 0.35 * smoothstep(-0.02, -0.07, y) * smoothstep(0.0, -0.04, z))
        flow = np.stack([x * 60 + z * 25, y * 18, z * 24 - x * 20], -1)
        thick = thick + top * (0.0045 * noise(flow, seed) + 0.002 * noise(flow * 2.1, seed + 1)) + 0.001 * noise(skin * 90, seed + 2)
        edge = 0.012
    else:
        part = np.exp(-(((x - 0.022) / 0.006) ** 2)) * smoothstep(0.03, 0.07, y) * smoothstep(-0.03, 0.02, z)
        flow = np.stack([x * 70, y * 20 + z * 12, z * 10], -1)
        thick = thick - 0.0055 * part + 0.0018 * noise(flow, seed)
        centre = np.array([eye[0], eye[1] + 0.015, ear[2] - 0.098])
        away = np.linalg.norm((skin - centre) / [1.0, 0.95, 1.3], axis=1)
        thick = thick + looks.bun * smoothstep(0.052, 0.022, away)
        edge = 0.014
    return np.maximum(thick, CLOSEST + 0.0006) * smoothstep(-0.001, edge, line) ** 0.7


def _without_feet(mesh: Mesh, joints) -> Mesh:
    """Trouser legs end level above the ankle joint and are closed there; what lies below is dropped."""
    level = ankle_level(joints)
    mesh = cut_along(mesh, mesh.vertices[:, 1] - level, 0.0)
    keep = (mesh.vertices[mesh.faces][:, :, 1] > level - 1e-7).all(1)
    faces, uv_faces = mesh.faces[keep], mesh.uv_faces[keep]
    open_edges = {}
    for face, uv in zip(faces, uv_faces):
        for i in range(3):
            open_edges[(face[i], face[(i + 1) % 3])] = uv[i], uv[(i + 1) % 3]
    rim = [(a, b, *uv) for (a, b), uv in open_edges.items() if (b, a) not in open_edges]
    vertices, weights, uvs = list(mesh.vertices), list(mesh.weights), list(mesh.uv)
    caps, uv_caps = [], []
    for side in (1, -1):
        loop = [edge for edge in rim if side * mesh.vertices[edge[0], 0] > 0]
        ids = [edge[0] for edge in loop]
        vertices.append(mesh.vertices[ids].mean(0) + [0, 0.01, 0])
        weights.append(mesh.weights[ids].mean(0))
        uvs.append(np.mean([mesh.uv[edge[2]] for edge in loop], 0))
        for a, b, _, _ in loop:
            caps.append([b, a, len(vertices) - 1])
            uv_caps.append([len(uvs) - 1] * 3)
    faces, uv_faces = np.concatenate([faces, caps]), np.concatenate([uv_faces, uv_caps])
    used, index = np.unique(faces, return_inverse=True)
    return Mesh(
        np.array(vertices)[used], index.reshape(-1, 3), np.array(uvs), uv_faces, np.array(weights)[used]
    )


def ankle_level(joints) -> float:
    """The height of the trouser hem."""
    return float(joints[7:9, 1].mean() + 0.004)


RINGS, AROUND = 26, 56


def _with_shoe(dressed: Dressed, body: Body, joints, side: int) -> Dressed:
    """A shoe round one foot: rings stacked from the sole to the inside of the trouser leg, closed at both ends.

    Ring k is the outline of what of the foot lies above it, so that the instep rises as the ring's front recedes.
    """
    ankle = joints[7 + side]
    foot = body.vertices[(np.sign(body.vertices[:, 0]) == (1, -1)[side]) & (body.vertices[:, 1] < ankle[1] + 0.075)]
    foot = foot.astype(np.float64)
    ground, top = foot[:, 1].min(), ankle[1] + 0.045
    levels = np.concatenate([[-0.014, -0.013, -0.004, 0.006, 0.0075], np.linspace(0.009, top - ground, RINGS - 5)])
    angle = 2 * np.pi * np.arange(AROUND) / AROUND
    rings = []
    for k, level in enumerate(levels):
        y = ground + level
        part = foot[foot[:, 1] > y - 0.0115][:, [0, 2]]
        outline = part[ConvexHull(part).vertices]
        centre = np.array([part[:, 0].mean(), 0.5 * (part[:, 1].min() + part[:, 1].max())])
        length = 0.5 * (part[:, 1].max() - part[:, 1].min())
        width = 0.5 * (part[:, 0].max() - part[:, 0].min())
        direction = np.stack([np.sin(angle) * width, np.cos(angle) * length], -1)
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        radius = np.full(AROUND, np.inf)  # where the ray from the centre leaves the outline
        for p, q in zip(outline, np.roll(outline, -1, axis=0)):
            e = q - p
            n = np.array([e[1], -e[0]]) / max(np.hypot(*e), 1e-12)
            if n @ (p - centre) < 0:
                n = -n
            facing = direction @ n
            radius = np.where(facing > 1e-6, np.minimum(radius, (n @ (p - centre)) / np.maximum(facing, 1e-6)), radius)
        sole = 0.0120 if k in (1, 2, 3) else 0.0110 if k == 0 else 0.0115
        sole = sole - 0.0062 * smoothstep(ankle[1] - 0.035, ankle[1] - 0.005, y)  # slim inside the trouser leg
        xz = centre + direction * (radius + sole)[:, None]
        rings.append(np.stack([xz[:, 0], np.full(AROUND, y), xz[:, 1]], -1))
    rings = np.array(rings)
    upper = rings[5:]
    for _ in range(6):  # soften the outline's corners, round the ring and up the shoe
        upper = 0.5 * upper + 0.25 * (np.roll(upper, 1, axis=1) + np.roll(upper, -1, axis=1))
        middle = 0.5 * upper[1:-1] + 0.25 * (upper[:-2] + upper[2:])
        upper[1:-1, :, [0, 2]] = middle[:, :, [0, 2]]
    grow = upper - upper.mean(1, keepdims=True)
    slim = 1 - smoothstep(ankle[1] - 0.035, ankle[1] - 0.005, upper[:, :, 1:2])
    upper += 0.0025 * slim * grow / np.maximum(np.linalg.norm(grow, axis=2, keepdims=True), 1e-9)
    for k in range(5):
        for _ in range(3):
            rings[k] = 0.5 * rings[k] + 0.25 * (np.roll(rings[k], 1, axis=0) + np.roll(rings[k], -1, axis=0))
    rings[5:] = upper
    grid = rings.reshape(-1, 3)
    bottom, lid = rings[0].mean(0), rings[-1].mean(0)
    points = np.concatenate([grid, [bottom, lid]])
    count = len(rings)

    # texture: unrolled, one column more than there are vertices; the closing fans use a point each
    u = 0.02 + 0.155 * (np.arange(AROUND + 1) / AROUND) + (0.19 if side else 0.0)
    v = 0.99 - 0.13 * np.linspace(0, 1, count)
    uv = np.stack(np.meshgrid(u, v), -1).reshape(-1, 2)
    disc = np.stack([np.sin(angle), np.cos(angle)], -1) * 0.018
    centres = np.array([[0.05, 0.30], [0.05, 0.30]]) + [0, 0.06 * side]
    uv = np.concatenate([uv, centres[:1] + disc, centres])
    k, i = np.meshgrid(np.arange(count - 1), np.arange(AROUND), indexing="ij")
    j = (i + 1) % AROUND
    a, b, c, d = k * AROUND + i, k * AROUND + j, (k + 1) * AROUND + j, (k + 1) * AROUND + i
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    w = AROUND + 1
    a, b, c, d = k * w + i, k * w + i + 1, (k + 1) * w + i + 1, (k + 1) * w + i
    uv_faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    ring = np.arange(AROUND)
    n, m = len(grid), count * w
    fans = np.concatenate(
        [np.stack([(ring + 1) % AROUND, ring, 0 * ring + n], -1), np.stack([n - AROUND + ring, n - AROUND + (ring + 1) % AROUND, 0 * ring + n + 1], -1)]
    )
    uv_fans = np.concatenate(
        [
            np.stack([m + (ring + 1) % AROUND, m + ring, 0 * ring + m + AROUND], -1),
            np.stack([(count - 1) * w + ring, (count - 1) * w + ring + 1, (count - 1) * w + ring], -1),
        ]
    )
    faces, uv_faces = np.concatenate([faces, fans]), np.concatenate([uv_faces, uv_fans])
    if np.einsum("fi,fi->", points[faces[:, 0]], np.cross(points[faces[:, 1]], points[faces[:, 2]])) < 0:
        faces, uv_faces = faces[:, ::-1], uv_faces[:, ::-1]
    kind = np.full(len(faces), SHOE)
    height = points[faces].mean(1)[:, 1] - ground
    kind[height < 0.0075] = SOLE
    # a shoe bends at the ball of the foot and at the ankle, not toe by toe
    weights = np.zeros((len(points), 52))
    ball = smoothstep(-0.03, 0.03, points[:, 2] - joints[10 + side, 2] + 0.01)
    shin = smoothstep(ankle[1] - 0.01, ankle[1] + 0.045, points[:, 1]) * (1 - ball)
    weights[:, 10 + side] = ball
    weights[:, 4 + side] = shin
    weights[:, 7 + side] = 1 - ball - shin
    _, nearest = cKDTree(body.vertices).query(points)
    return _joined(dressed, points, faces, uv, uv_faces, weights, kind, body.vertices[nearest].astype(np.float64))


def _with_eye(dressed: Dressed, centre, radius: float) -> Dressed:
    """An eyeball: a closed sphere with the pole in front, texture by angle from the pole (its own picture)."""
    stacks, slices = 22, 32
    theta = np.pi * (np.arange(1, stacks) / stacks) ** 1.6  # finer in front
    phi = 2 * np.pi * np.arange(slices) / slices
    t, p = np.meshgrid(theta, phi, indexing="ij")
    direction = np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)], -1).reshape(-1, 3)
    direction = np.concatenate([direction, [[0, 0, 1], [0, 0, -1]]])
    k, i = np.meshgrid(np.arange(stacks - 2), np.arange(slices), indexing="ij")
    j = (i + 1) % slices
    a, b, c, d = k * slices + i, (k + 1) * slices + i, (k + 1) * slices + j, k * slices + j
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    ring, last, n = np.arange(slices), (stacks - 2) * slices, len(direction)
    turn = (ring + 1) % slices
    faces = np.concatenate(
        [faces, np.stack([0 * ring + n - 2, ring, turn], -1), np.stack([0 * ring + n - 1, last + turn, last + ring], -1)]
    )
    weights = np.zeros((n, 52))
    weights[:, 15] = 1
    angle = np.arccos(np.clip(direction[:, 2], -1, 1))
    across = np.hypot(direction[:, 0], direction[:, 1])
    flat = direction[:, :2] / np.maximum(across, 1e-9)[:, None] * (0.49 * np.sqrt(angle / np.pi))[:, None]
    uv = 0.5 + flat * [1, -1]
    points = centre + radius * direction
    return _joined(dressed, points, faces, uv, faces, weights, np.full(len(faces), EYE), points)


def _joined(dressed: Dressed, points, faces, uv, uv_faces, weights, kind, skin) -> Dressed:
    mesh, n = dressed.mesh, len(dressed.mesh.vertices)
    return replace(
        dressed,
        mesh=Mesh(
            np.concatenate([mesh.vertices, points]),
            np.concatenate([mesh.faces, faces + n]),
            np.concatenate([mesh.uv, uv]),
            np.concatenate([mesh.uv_faces, uv_faces + len(mesh.uv)]),
            np.concatenate([mesh.weights, weights]),
        ),
        skin_positions=np.concatenate([dressed.skin_positions, skin]),
        kind=np.concatenate([dressed.kind, kind]),
        hairline=np.concatenate([dressed.hairline, np.full(len(points), -0.1)]),
        collar=np.concatenate([dressed.collar, np.full(len(points), 1.0)]),
    )


MALE = Looks(
    sex="male", seed=11, tucked=False, sleeve=0.62, collar=0.012, neckline=0.55, shirt_ease=0.010, trouser_ease=(0.010, 0.014, 0.0235),
    hair_top=0.016, hair_side=0.0075, bun=0.0, pattern="stripes", skin=(222, 172, 143), hair=(62, 42, 28), iris=(92, 122, 140),
    lips=(186, 112, 102), shirt=((238, 234, 224), (38, 62, 104)), trousers=(52, 66, 96), shoes=(232, 230, 226),
)  # fmt: skip
FEMALE = Looks(
    sex="female", seed=23, tucked=True, sleeve=1.45, collar=0.004, neckline=0.5, shirt_ease=0.011, trouser_ease=(0.009, 0.010, 0.019),
    hair_top=0.012, hair_side=0.008, bun=0.019, pattern="plaid", skin=(232, 188, 164), hair=(110, 62, 34), iris=(96, 108, 62),
    lips=(196, 98, 98), shirt=((150, 42, 44), (34, 40, 60)), trousers=(70, 68, 74), shoes=(60, 44, 38),
)  # fmt: skip
