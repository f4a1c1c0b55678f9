"""The built-in subject: the free body, dressed and painted by our own code. Everything about it is CC0."""

from functools import cache

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from avatar.body import builtin_body
from avatar.skinning import strongest_four
from bench.synth.dress import EYE, FEMALE, HAIR, MALE, Dressed, Looks, dress, hairline
from bench.synth.occlusion import sky_light, surface_points
from bench.synth.paint import Canvas, covered_texels, eye_picture, paint, spread
from bench.synth.refine import smoothed, vertex_normals
from bench.synth.subject import PARTS, Subject

Array = np.ndarray
TEXTURE = 2048
BODY, HEAD, EYEBALL = range(3)  # materials


@cache
def builtin_subject(sex: str, texture: int = TEXTURE) -> Subject:
    """The built-in person, "male" or "female"; takes some seconds once, the same on every machine.

    Materials: 0 body, clothes and shoes, 1 head, 2 eyes.

    Raises:
        ValueError: another word.
    """
    if sex not in ("male", "female"):
        raise ValueError(f"sex should be 'male' or 'female', is {sex!r}")
    body, looks = builtin_body(sex), {"male": MALE, "female": FEMALE}[sex]
    dressed = dress(body, looks)
    mesh = dressed.mesh
    material, atlas = layout(dressed)
    light, opened = baked_light(dressed)
    normals = vertex_normals(mesh.vertices, mesh.faces)
    cavity = crease(mesh.vertices, mesh.faces, normals)

    textures = []
    for number in (BODY, HEAD):
        faces = np.flatnonzero(material == number)
        textures.append(painted(dressed, faces, atlas[faces], (normals, light, opened, cavity), body.joints, looks, texture))
    textures.append(eye_picture(looks, dressed.face.eye_radius))

    # one vertex for each pair of a point and a texture coordinate
    corner = np.concatenate([mesh.faces.reshape(-1, 1), np.round(atlas.reshape(-1, 2) * 2**22).astype(np.int64)], 1)
    corner = np.concatenate([corner, np.repeat(material, 3)[:, None]], 1)
    _, first, index = np.unique(corner, axis=0, return_index=True, return_inverse=True)
    point = mesh.faces.reshape(-1)[first]
    hair_points = np.zeros(len(mesh.vertices), bool)
    hair_points[mesh.faces[dressed.kind == HAIR]] = True
    skin = strongest_four(mesh.weights[point])
    return Subject(
        name=f"builtin:{sex}",
        vertices=mesh.vertices[point].astype(np.float32),
        faces=index.reshape(-1, 3),
        uv=atlas.reshape(-1, 2)[first].astype(np.float32),
        material=material,
        textures=tuple(textures),
        alpha=(None,) * len(textures),
        skin=skin,
        joints=np.asarray(body.joints, np.float64),
        part=parts_of(mesh.weights)[point],
        hair=hair_points[point],
        licence="CC0-1.0 (body: MakeHuman base mesh; clothes, hair and colours: this project)",
    )


def parts_of(weights: Float[Array, "V 52"]):
    """Which part each vertex belongs to, by its strongest bone: hands with their wrists, head, body."""
    strongest = weights.argmax(1)
    part = np.full(len(weights), PARTS.index("body"), np.uint8)
    part[strongest == 15] = PARTS.index("head")
    part[(strongest == 20) | (strongest >= 22) & (strongest < 37)] = PARTS.index("hand_left")
    part[(strongest == 21) | (strongest >= 37)] = PARTS.index("hand_right")
    return part


def layout(dressed: Dressed) -> tuple[Int[Array, " F"], Float[Array, "F 3 2"]]:
    """Material and texture coordinates (v down) of each face: the body's islands, with face and hands enlarged.

    The maps are monotone in u and in v, so islands that did not overlap still do not.
    """
    mesh = dressed.mesh
    uv = mesh.uv[mesh.uv_faces]
    ends = np.concatenate([mesh.uv_faces[:, [0, 1]], mesh.uv_faces[:, [1, 2]]])
    graph = coo_matrix((np.ones(len(ends)), ends.T), (len(mesh.uv),) * 2)
    island = connected_components(graph, directed=False)[1][mesh.uv_faces[:, 0]]
    middle = uv.mean(1)
    nose = np.argmin(np.where(dressed.kind != EYE, np.hypot(*(middle - [0.863, 0.5165]).T), 9))
    head = (island == island[nose]) & (dressed.kind != EYE)
    inner = (middle[:, 0] < 0.16) & (middle[:, 1] > 0.365) & (middle[:, 1] < 0.455) & (mesh.weights[mesh.faces[:, 0], 15] > 0.9)
    inner |= (middle[:, 0] > 0.755) & (middle[:, 1] > 0.86) & ~head
    inner &= dressed.kind != EYE
    material = np.where(dressed.kind == EYE, EYEBALL, np.where(head | inner, HEAD, BODY))

    u, v = uv[..., 0], uv[..., 1]
    on_body = np.stack([u / 0.765, np.interp(v, [0, 0.79, 1], [0.003, 0.56, 0.997])], -1)
    on_head = np.stack([np.interp(u, [0.635, 0.80, 0.96, 1.0], [0, 0.25, 0.93, 1]), np.interp(v, [0.17, 0.415, 0.615, 0.86], [0.01, 0.17, 0.83, 0.99])], -1)
    tucked = 0.003 + 0.026 * np.stack([u, v], -1)
    chosen = (material == HEAD)[:, None, None]
    atlas = np.where(chosen, np.where(inner[:, None, None], tucked, on_head), on_body)
    return material, np.where((material == EYEBALL)[:, None, None], uv, atlas)


def crease(vertices, faces, normals):
    """Signed mean curvature, squashed to about -1 (crease) to 1 (ridge), over some 4 mm."""
    calm = smoothed(vertices, faces, np.ones(len(vertices), bool), 2)
    height = ((vertices - calm) * normals).sum(1)
    return np.tanh(height / 0.0010)


def baked_light(dressed: Dressed):
    """Sky light and openness of every vertex: coarse for the body, fine for the head and each hand."""
    mesh = dressed.mesh
    normals = vertex_normals(mesh.vertices, mesh.faces)
    part = parts_of(mesh.weights)
    of_face = part[mesh.faces[:, 0]]
    coarse = surface_points(mesh.vertices, mesh.faces, np.full(len(mesh.faces), 110_000.0), 1)
    light, opened = sky_light(mesh.vertices, normals, coarse, cell=0.006, bias=0.010)
    for number in range(1, len(PARTS)):
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


def painted(dressed: Dressed, faces, atlas, per_vertex, joints, looks: Looks, size: int):
    """One texture."""
    mesh = dressed.mesh
    texels = covered_texels(atlas, size)
    corners = mesh.faces[faces[texels.face]]
    uv_corners = mesh.uv_faces[faces[texels.face]]
    b = texels.barycentric

    def across(values, ids=corners):
        values = np.asarray(values, np.float32)
        if values.ndim == 1:
            return sum(values[ids[:, i]] * b[:, i] for i in range(3))
        return sum(values[ids[:, i]] * b[:, i, None] for i in range(3))

    normals, light, opened, cavity = per_vertex
    p = across(dressed.skin_positions)
    n = across(normals)
    n = n / np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-9)
    line = hairline(p, dressed.face, looks).astype(np.float32)
    canvas = Canvas(p, across(mesh.vertices), n, across(mesh.uv, uv_corners), line, across(dressed.collar), across(light), across(opened), across(cavity))
    image = np.zeros((size * size, 3), np.float32)
    image[texels.index] = paint(canvas, dressed.kind[faces[texels.face]], dressed, joints, looks)
    covered = np.zeros(size * size, bool)
    covered[texels.index] = True
    return spread(image.reshape(size, size, 3), covered.reshape(size, size))
