"""Shoes: lofted round the feet they replace. `footwear` paints them.

Frame: pose 0, pelvis at the origin, metres.
"""

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import ConvexHull, KDTree

from avatar.body import Body
from experiments.builtin.dressed import SHOE, SOLE, Dressed, joined
from experiments.builtin.hems import ankle_level
from experiments.builtin.refine import TexturedMesh, cut_along
from synth.people.mesh import smoothstep

Array = np.ndarray

RINGS, AROUND = 26, 56  # of a shoe's grid of vertices


def without_feet(mesh: TexturedMesh, joints: Float[Array, "52 3"]) -> TexturedMesh:
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
    return TexturedMesh(
        np.array(vertices)[used], index.reshape(-1, 3), np.array(uvs), uv_faces, np.array(weights)[used]
    )


def with_shoe(dressed: Dressed, body: Body, joints: Float[Array, "52 3"], side: int) -> Dressed:
    """The dressed person and a shoe round one foot (side 0 left, 1 right), closed at both ends."""
    ankle = joints[7 + side]
    foot = body.vertices[(np.sign(body.vertices[:, 0]) == (1, -1)[side]) & (body.vertices[:, 1] < ankle[1] + 0.075)]
    foot = foot.astype(np.float64)
    ground = foot[:, 1].min()
    rings = _rings(foot, float(ankle[1]))
    points = np.concatenate([rings.reshape(-1, 3), [rings[0].mean(0), rings[-1].mean(0)]])
    faces, uv, uv_faces = _grid(len(rings), side)
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
    _, nearest = KDTree(body.vertices).query(points)
    skin = body.vertices[nearest].astype(np.float64)
    return joined(dressed, points, faces, uv, uv_faces, weights, kind, skin)


def _rings(foot: Float[Array, "n 3"], ankle: float) -> Float[Array, "rings around 3"]:
    """Rings stacked from the sole to the inside of the trouser leg; `ankle` is the height of its joint.

    Ring k is the outline of what of the foot lies above it, so that the instep rises as the ring's front recedes.
    """
    ground, top = foot[:, 1].min(), ankle + 0.045
    levels = np.concatenate([[-0.014, -0.013, -0.004, 0.006, 0.0075], np.linspace(0.009, top - ground, RINGS - 5)])
    angle = 2 * np.pi * np.arange(AROUND) / AROUND
    # the trouser leg: slim there
    inside = smoothstep(ankle - 0.035, ankle - 0.005, ground + levels)
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
        # where the ray from the centre leaves the outline
        radius = np.full(AROUND, np.inf)
        for p, q in zip(outline, np.roll(outline, -1, axis=0)):
            e = q - p
            n = np.array([e[1], -e[0]]) / max(np.hypot(*e), 1e-12)
            if n @ (p - centre) < 0:
                n = -n
            facing = direction @ n
            radius = np.where(facing > 1e-6, np.minimum(radius, (n @ (p - centre)) / np.maximum(facing, 1e-6)), radius)
        sole = 0.0120 if k in (1, 2, 3) else 0.0110 if k == 0 else 0.0115
        sole = sole - 0.0062 * inside[k]
        xz = centre + direction * (radius + sole)[:, None]
        rings.append(np.stack([xz[:, 0], np.full(AROUND, y), xz[:, 1]], -1))
    rings = np.array(rings)
    upper = rings[5:]
    # soften the outline's corners, round the ring and up the shoe
    for _ in range(6):
        upper = 0.5 * upper + 0.25 * (np.roll(upper, 1, axis=1) + np.roll(upper, -1, axis=1))
        middle = 0.5 * upper[1:-1] + 0.25 * (upper[:-2] + upper[2:])
        upper[1:-1, :, [0, 2]] = middle[:, :, [0, 2]]
    grow = upper - upper.mean(1, keepdims=True)
    slim = 1 - smoothstep(ankle - 0.035, ankle - 0.005, upper[:, :, 1:2])
    upper += 0.0025 * slim * grow / np.maximum(np.linalg.norm(grow, axis=2, keepdims=True), 1e-9)
    for k in range(5):
        for _ in range(3):
            rings[k] = 0.5 * rings[k] + 0.25 * (np.roll(rings[k], 1, axis=0) + np.roll(rings[k], -1, axis=0))
    rings[5:] = upper
    return rings


def _grid(count: int, side: int) -> tuple[Int[Array, "faces 3"], Float[Array, "T 2"], Int[Array, "faces 3"]]:
    """Faces, texture coordinates (v down) and their faces of `count` closed rings, then a point at each end."""
    angle = 2 * np.pi * np.arange(AROUND) / AROUND
    # texture: unrolled, one column more than there are vertices; the closing fans use a point each
    u = 0.02 + 0.155 * (np.arange(AROUND + 1) / AROUND) + (0.19 if side else 0.0)
    # below the trouser legs, which end at .8932, and the tip of the right middle finger
    v = 0.9985 - 0.103 * np.linspace(0, 1, count)
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
    n, m = count * AROUND, count * w
    fans = np.concatenate(
        [
            np.stack([(ring + 1) % AROUND, ring, 0 * ring + n], -1),
            np.stack([n - AROUND + ring, n - AROUND + (ring + 1) % AROUND, 0 * ring + n + 1], -1),
        ]
    )
    uv_fans = np.concatenate(
        [
            np.stack([m + (ring + 1) % AROUND, m + ring, 0 * ring + m + AROUND], -1),
            np.stack([(count - 1) * w + ring, (count - 1) * w + ring + 1, (count - 1) * w + ring], -1),
        ]
    )
    faces, uv_faces = np.concatenate([faces, fans]), np.concatenate([uv_faces, uv_fans])
    return faces, uv, uv_faces
