"""The built-in person's texture layout: the free body's islands, with face and hands enlarged."""

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from experiments.builtin.dressed import EYE, SKIRT, Dressed

Array = np.ndarray

BODY, HEAD, EYEBALL, CLOTH = range(4)  # materials


def layout(dressed: Dressed) -> tuple[Int[Array, "faces"], Float[Array, "faces 3 2"]]:
    """Material and texture coordinates (v down) of each face: the body's islands, with face and hands enlarged.

    The maps are monotone in u and in v, so islands that did not overlap still do not.
    """
    mesh = dressed.mesh
    uv = mesh.uv[mesh.uv_faces]
    ends = np.concatenate([mesh.uv_faces[:, [0, 1]], mesh.uv_faces[:, [1, 2]]])
    graph = coo_matrix((np.ones(len(ends)), ends.T), (len(mesh.uv),) * 2)
    island = connected_components(graph, directed=False)[1][mesh.uv_faces[:, 0]]
    middle = uv.mean(1)
    nose = np.argmin(np.where(~np.isin(dressed.kind, (EYE, SKIRT)), np.hypot(*(middle - [0.863, 0.5165]).T), 9))
    head = (island == island[nose]) & (dressed.kind != EYE)
    # the insides of mouth and eye sockets; the tip of the left middle finger lies beside one of them
    inner = (middle[:, 0] < 0.16) & (middle[:, 1] > 0.365) & (middle[:, 1] < 0.455)
    inner |= (middle[:, 0] > 0.755) & (middle[:, 1] > 0.86) & ~head
    inner &= (mesh.weights[mesh.faces[:, 0], 15] > 0.9) & (dressed.kind != EYE)
    own = np.isin(dressed.kind, (EYE, SKIRT))
    material = np.where(dressed.kind == EYE, EYEBALL, np.where(head | inner, HEAD, BODY))
    material = np.where(dressed.kind == SKIRT, CLOTH, material)

    u, v = uv[..., 0], uv[..., 1]
    on_body = np.stack([u / 0.765, np.interp(v, [0, 0.79, 1], [0.003, 0.56, 0.997])], -1)
    on_head = np.stack(
        [
            np.interp(u, [0.635, 0.80, 0.96, 1.0], [0, 0.25, 0.93, 1]),
            np.interp(v, [0.17, 0.415, 0.615, 0.86], [0.01, 0.17, 0.83, 0.99]),
        ],
        -1,
    )
    tucked = 0.003 + 0.026 * np.stack([u, v], -1)
    chosen = (material == HEAD)[:, None, None]
    atlas = np.where(chosen, np.where(inner[:, None, None], tucked, on_head), on_body)
    return material, np.where(own[:, None, None], uv, atlas)
