"""What small increments of a pose do to the posed template and to its picture, to first order.

Increments d turn the moving joints (R_j exp d_j) and shift the root; alignment (capture/repair/align.py) and learning
(train/pose_correction.py) solve for them.
"""

import numpy as np
from jaxtyping import Bool, Float, Int

from avatar.camera import Camera
from avatar.skeleton import PARENTS
from avatar.skinning import SkinWeights
from capture.folder import CaptureSubject, PartVideo

Array = np.ndarray


def descends() -> Bool[Array, "52 52"]:
    """[k, j]: joint k is j or hangs from it."""
    out = np.eye(52, dtype=bool)
    for k in range(1, 52):
        out[k] |= out[PARENTS[k]]
    return out


DESCENDS = descends()


def moving_joints(subject: CaptureSubject, part: int, video: PartVideo, *, least: float = 20.0) -> Int[Array, "m"]:
    """Joints whose turning shows in the video: some vertex of the part moves `least` pixels a radian or more."""
    assert video.axis_angle is not None and video.root is not None
    chosen = np.ones(len(subject.rest), bool) if part == 0 else subject.part == part
    skin = subject.skin.of(chosen)
    share = np.zeros((int(chosen.sum()), 52))
    np.put_along_axis(share, skin.joints, skin.weights, 1)
    # how much of a vertex follows joint j
    moves = share @ DESCENDS
    away = np.linalg.norm(subject.rest[chosen][:, None] - subject.joints, axis=2)
    camera = video.cameras[0]
    depth = max(float((camera.camera_from_world[:3] @ np.append(video.root[0], 1))[2]), 0.1)
    return np.flatnonzero((moves * away).max(0) * camera.K[0, 0] / depth >= least)


def increments_moved(
    points: Float[Array, "n 3"], skin: SkinWeights, G: Float[Array, "52 4 4"], B: Float[Array, "52 4 4"],
    g: Float[Array, "n 3"], moving: Int[Array, "m"],
) -> Float[Array, "n p"]:  # fmt: skip
    """Derivative of g . x, x skinned `points`, to the increments of the moving joints and of the root.

    dx / dd_j = sum_k w_k [k hangs from j] (G_j e) x (B_k x - position of j)
    """
    joints, weights = skin.joints, skin.weights
    placed = np.einsum("nkij,nj->nki", B[joints, :3, :3], points) + B[joints, :3, 3]
    hangs = DESCENDS[joints][:, :, moving] * weights[:, :, None]  # n 4 m
    arm = np.einsum("nkm,nki->nmi", hangs, placed) - hangs.sum(1)[:, :, None] * G[moving, :3, 3]
    # (w x a) . g = w . (a x g)
    turn = np.cross(arm, g[:, None])
    turned = np.einsum("nmi,mij->nmj", turn, G[moving, :3, :3])
    return np.concatenate([turned.reshape(len(points), 3 * len(moving)), g], 1)


def joints_moved(
    G: Float[Array, "52 4 4"], g: Float[Array, "52 3"], moving: Int[Array, "m"]
) -> Float[Array, "52 p"]:  # fmt: skip
    """Derivative of g . x, x the posed joints, to the increments of the moving joints and of the root."""
    place = G[:, :3, 3]
    arm = (place[:, None] - place[moving]) * DESCENDS[:, moving, None]
    turned = np.einsum("kmi,mij->kmj", np.cross(arm, g[:, None]), G[moving, :3, :3])
    return np.concatenate([turned.reshape(52, -1), g], 1)


def project_derivative(camera: Camera, points: Float[Array, "n 3"]) -> Float[Array, "n 2 3"]:
    """Derivative of the pixel position to the world point; lens distortion left out."""
    R = camera.camera_from_world[:3, :3]
    x, y, z = (points @ R.T + camera.camera_from_world[:3, 3]).T
    o = np.zeros_like(z)
    fx, fy, skew = camera.K[0, 0], camera.K[1, 1], camera.K[0, 1]
    rows = np.stack([np.stack([fx / z, skew / z, -(fx * x + skew * y) / z**2], 1),
                     np.stack([o, fy / z, -fy * y / z**2], 1)], 1)  # fmt: skip
    return rows @ R


def metres_of_a_pixel(video: PartVideo) -> float:
    """How large a pixel is at the person, middle frame."""
    assert video.root is not None
    sizes = [np.linalg.norm(root - camera.eye) / camera.K[0, 0] for root, camera in zip(video.root, video.cameras)]
    return float(np.median(sizes))
