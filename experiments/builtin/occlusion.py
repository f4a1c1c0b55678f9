"""How much of a cloudy sky each vertex sees: soft light baked into a painted texture.

Occluders are points on the surface, splatted into a depth grid for each direction; no ray is traced and no GPU
is asked, so every machine gets the same numbers.
"""

import numpy as np
from jaxtyping import Float, Int, UInt8

from avatar.rotation import fibonacci_sphere
from experiments.builtin.refine import TexturedMesh, smoothed
from geometry.mesh import vertex_normals

Array = np.ndarray


def surface_points(
    vertices: Float[Array, "vertices 3"], faces: Int[Array, "faces 3"], density: Float[Array, "faces"], seed: int
) -> Float[Array, "n 3"]:
    """Random points on the surface, `density` of them per square metre of each face."""
    generator = np.random.default_rng(seed)
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    count = np.floor(area * density + generator.random(len(faces))).astype(np.int64)
    face = np.repeat(np.arange(len(faces)), count)
    s, t = generator.random((2, len(face)))
    over = s + t > 1
    s, t = np.where(over, 1 - s, s)[:, None], np.where(over, 1 - t, t)[:, None]
    return a[face] + s * (b - a)[face] + t * (c - a)[face]


def sky_light(
    points: Float[Array, "vertices 3"],
    normals: Float[Array, "vertices 3"],
    occluders: Float[Array, "n 3"],
    *,
    cell: float,
    bias: float,
    count: int = 56,
    ground: float = 0.45,
) -> tuple[Float[Array, "vertices"], Float[Array, "vertices"]]:
    """Light from a sky, `ground` as bright below as above, and the openness to an even one; both about 0 to 1.

    A point is hidden from a direction when an occluder in its grid cell lies more than `bias` metres in front.
    """
    light, full, opened, total = (np.zeros(len(points)) for _ in range(4))
    lifted = (points + 0.6 * bias * normals).astype(np.float32)
    occluders = occluders.astype(np.float32)
    normals = normals.astype(np.float32)
    for d in fibonacci_sphere(count):
        across = np.cross(d, [0.0, 0.0, 1.0] if abs(d[2]) < 0.9 else [1.0, 0.0, 0.0])
        across /= np.linalg.norm(across)
        axes = np.stack([across, np.cross(d, across)], -1).astype(np.float32)
        d = d.astype(np.float32)
        low = occluders @ axes
        origin = low.min(0)
        i = ((low - origin) / cell).astype(np.int64)
        shape = i.max(0) + 1
        depth = np.full(int(shape[0] * shape[1]), -np.inf, np.float32)
        np.maximum.at(depth, i[:, 0] * shape[1] + i[:, 1], occluders @ d)
        j = np.clip(((lifted @ axes - origin) / cell).astype(np.int64), 0, shape - 1)
        hidden = depth[j[:, 0] * shape[1] + j[:, 1]] > lifted @ d + bias
        facing = np.maximum(normals @ d, 0)
        sky = ground + (1 - ground) * 0.5 * (1 + d[1])
        light += np.where(hidden, 0, facing * sky)
        opened += np.where(hidden, 0, facing)
        full += facing
        total += facing
    return light / np.maximum(full, 1e-9), opened / np.maximum(total, 1e-9)


def baked_light(
    mesh: TexturedMesh, part: UInt8[Array, "vertices"]
) -> tuple[Float[Array, "vertices"], Float[Array, "vertices"]]:
    """Sky light and openness of every vertex, 0 to 1: coarse for the body (part 0), fine for the other parts."""
    normals = vertex_normals(mesh.vertices, mesh.faces)
    of_face = part[mesh.faces[:, 0]]
    coarse = surface_points(mesh.vertices, mesh.faces, np.full(len(mesh.faces), 110_000.0), 1)
    light, opened = sky_light(mesh.vertices, normals, coarse, cell=0.006, bias=0.010)
    for number in range(1, int(part.max()) + 1):
        density = np.where(of_face == number, 700_000.0, 0.0)
        rows = np.flatnonzero(part == number)
        centre = mesh.vertices[rows].mean(0)
        around = coarse[np.linalg.norm(coarse - centre, axis=1) < 0.45]
        fine = surface_points(mesh.vertices, mesh.faces, density, 1 + number)
        near = sky_light(mesh.vertices[rows], normals[rows], np.concatenate([fine, around]), cell=0.0026, bias=0.0048)
        light[rows], opened[rows] = near
    everywhere = np.ones(len(light), bool)
    values = smoothed(np.stack([light, opened], -1), mesh.faces, everywhere, 7)
    return values[:, 0], values[:, 1]


def crease(
    vertices: Float[Array, "vertices 3"], faces: Int[Array, "faces 3"], normals: Float[Array, "vertices 3"]
) -> Float[Array, "vertices"]:
    """Signed mean curvature, squashed to about -1 (crease) to 1 (ridge), over some 4 mm."""
    calm = smoothed(vertices, faces, np.ones(len(vertices), bool), 2)
    height = ((vertices - calm) * normals).sum(1)
    return np.tanh(height / 0.0010)
