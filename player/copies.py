"""Copies of one avatar in a scene: which they are, and their bones in a frame, worked out for all of them at once.

One by one 100 copies take 100 times what NumPy's calls cost, which at 52 joints is most of it. player/posing.py is the
plain version; tests/player/test_copies.py holds the two together.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float32

from avatar.baked_avatar import Avatar
from avatar.camera import Camera, view_from_world
from player.drawing import Pose
from player.kinematics import quaternions
from player.posing import PosedBones, Poser, ScreenBounds

# of a palette: three rows of view_from_canonical or one of dual parts, then the rotations (shaders/copies.glsl)
TURNS_SECTION, SECTIONS = 3, 4


def groups_of(
    avatars: Sequence[Avatar], *, loose: bool = False, detail: Sequence[int] | None = None
) -> tuple[tuple[int, ...], ...]:
    """Numbers of the avatars that are one and the same, in the order of the first of each. detail: and at the same
    level of detail, of which this is the number for each. Those with helper joints are
    posed and drawn one by one: palettes hold the 52 joints. So are those whose loose parts move (`loose`): each in its
    own way."""
    groups: dict[tuple[int, int, int], list[int]] = {}
    for index, avatar in enumerate(avatars):
        own_way = loose and any(level.loose is not None or level.springs is not None for level in avatar.levels)
        alone = 1 + index if own_way or avatar.levels[0].twist is not None else 0
        groups.setdefault((id(avatar), alone, 0 if detail is None else detail[index]), []).append(index)
    return tuple(tuple(group) for group in groups.values())


def posed_copies(poser: Poser, poses: Sequence[Pose], camera: Camera) -> list[PosedBones]:
    """`Poser.posed` of each pose.

    Raises:
        ValueError: a number of a pose is not finite.
    """
    axis_angle, root = np.stack([pose[0] for pose in poses]), np.stack([pose[1] for pose in poses])
    if not (np.isfinite(axis_angle).all() and np.isfinite(root).all()):
        raise ValueError("the pose holds a number that is not finite")
    view_from_joint = poser.chain.transforms_of_copies(axis_angle, root, view_from_world(camera))
    view_from_canonical = view_from_joint @ poser.joint_from_canonical
    centers = np.ascontiguousarray(view_from_joint[..., :3, 3])
    return [PosedBones(*one, poser.radii) for one in zip(view_from_canonical, centers, strict=True)]


def copies_bounds(bones: Sequence[PosedBones], camera: Camera) -> list[ScreenBounds]:
    """`screen_bounds` of each copy."""
    used = np.flatnonzero(bones[0].radii >= 0)
    centers, radii = np.stack([one.centers for one in bones])[:, used], bones[0].radii[used]
    # depth of each sphere's nearer and farther end
    ends = np.stack([-centers[..., 2] - radii, radii - centers[..., 2]], 1)
    nearest, farthest = ends[:, 0].min(1), ends[:, 1].max(1)
    behind = nearest <= 0
    ends[behind] = 1.0
    flat = centers[..., :2] * (1.0, -1.0)
    low = ((flat - radii[:, None])[:, None] / ends[..., None]).min((1, 2))
    high = ((flat + radii[:, None])[:, None] / ends[..., None]).max((1, 2))
    (fx, skew, cx), (_, fy, cy), _ = camera.K.tolist()
    slant = np.sort(skew * np.stack([low[:, 1], high[:, 1]]), axis=0)
    boxes = np.stack([fx * low[:, 0] + cx + slant[0], fy * low[:, 1] + cy,
                      fx * high[:, 0] + cx + slant[1], fy * high[:, 1] + cy], 1)  # fmt: skip
    boxes[behind] = [-np.inf, -np.inf, np.inf, np.inf]
    return [ScreenBounds(*one) for one in zip(np.stack([nearest, farthest], 1), boxes, strict=True)]


def palette(bones: Sequence[PosedBones], *, dual: bool, directions: bool) -> Float32[np.ndarray, "copies columns 4"]:
    """The texels that shaders/copies.glsl reads, a row a copy; the rotations where `dual` or `directions` need them."""
    out = np.zeros((len(bones), SECTIONS if dual or directions else TURNS_SECTION, 52, 4), np.float32)
    matrices = np.stack([one.view_from_canonical[:, :3] for one in bones])
    if not dual:
        out[:, :TURNS_SECTION] = matrices.transpose(0, 2, 1, 3)
    if dual or directions:
        turns = quaternions(matrices[..., :3].reshape(-1, 3, 3))
        out[:, TURNS_SECTION] = turns.reshape(-1, 52, 4)
        if dual:
            t, u, w = matrices[..., 3].reshape(-1, 3), turns[:, :3], turns[:, 3:]
            out[:, 0, :, :3] = (0.5 * (w * t + np.cross(t, u))).reshape(-1, 52, 3)
            out[:, 0, :, 3] = -0.5 * np.einsum("ni,ni->n", t, u).reshape(-1, 52)
    return out.reshape(len(bones), -1, 4)
