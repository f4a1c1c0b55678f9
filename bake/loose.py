"""How loose each vertex of a baked surface is: skirts, hanging hair, wide sleeves stand far off the body under them.

With d the distance to the body's own template, without what was carved from the masks and joined to it (hull.py,
clothes.py), looseness is 0 up to NEAR and 1 from FAR on, smooth in between, so that cloth fades into what holds
it. Hands and feet hold nothing loose: gloves and heels are no skirts. Islets are none either.
"""

import numpy as np
from jaxtyping import Bool, Float, Float32, Integer
from numpy import ndarray as Array
from scipy.spatial import KDTree

from avatar.skeleton import JOINTS
from avatar.skinning import SkinWeights
from capture.folder import CaptureSubject
from geometry.mesh import component_labels, face_areas

# metres off the template's vertices, which are a centimetre or two apart
NEAR, FAR = 0.03, 0.09
# square metres: a smaller piece is a buckle or a fold
LEAST = 0.01
STIFF = np.array([name.endswith(("ankle", "foot", "wrist")) or name[-1].isdigit() for name in JOINTS])
STIFF &= np.array([not name.startswith("spine") for name in JOINTS])


def looseness(
    positions: Float[Array, "vertices 3"], faces: Integer[Array, "faces 3"], skin: SkinWeights, subject: CaptureSubject
) -> Float32[Array, "vertices"] | None:
    """0 to 1 of each vertex of a surface in the canonical pose; None: nothing of it is loose."""
    away = KDTree(bare_template(subject)).query(positions)[0]
    share = np.clip((away - NEAR) / (FAR - NEAR), 0, 1)
    stiff = (skin.weights * STIFF[skin.joints]).sum(1) > 0.5
    loose = np.where(stiff, 0.0, share * share * (3 - 2 * share))
    loose[~in_large_pieces(loose > 0, positions, faces)] = 0
    return loose.astype(np.float32) if loose.any() else None


def bare_template(subject: CaptureSubject) -> Float[Array, "vertices 3"]:
    """Vertices of the template without carved hair and clothes, which were joined behind the body's own: the body is
    the piece that the most joints move."""
    piece = component_labels(subject.faces, len(subject.vertices))
    moved = np.unique(np.stack([piece, subject.skin.heaviest], 1), axis=0)[:, 0]
    body = np.bincount(moved).argmax()
    return np.asarray(subject.vertices, np.float64)[: int(np.flatnonzero(piece == body)[-1]) + 1]


def in_large_pieces(
    chosen: Bool[Array, "vertices"], positions: Float[Array, "vertices 3"], faces: Integer[Array, "faces 3"]
) -> Bool[Array, "vertices"]:
    """Which of the chosen vertices lie in connected pieces of LEAST or more; an atlas's cuts do not divide them."""
    _, place = np.unique(np.asarray(positions, np.float32), axis=0, return_inverse=True)
    place = place.reshape(-1)
    whole = faces[chosen[faces].all(1)].astype(np.int64)
    piece = component_labels(place[whole], int(place.max()) + 1)[place]
    area = np.bincount(piece[whole[:, 0]], face_areas(positions, whole), minlength=int(piece.max()) + 1)
    return chosen & (area[piece] >= LEAST)
