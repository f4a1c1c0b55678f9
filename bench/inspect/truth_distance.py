"""How far the baked surface lies from the field it was cut from, and from the true surface."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from jaxtyping import Float

from avatar.baked_avatar import Avatar, Level
from avatar.errors import AssetError
from avatar.skeleton import skin_transforms
from avatar.skinning import skin_points
from bench.surface_distance import check_same_unit
from bench.true_mesh import read_true_mesh
from geometry.closest import closest_points, triangle_index


def from_run(level: Level, run: Path) -> Float[np.ndarray, "faces"]:
    """`from_field` with the field of a run folder."""
    # torch: imported before anything draws
    from bake.field import numpy_field
    from train.run import read_run

    return from_field(level, numpy_field(read_run(run).field).distance)


def from_field(level: Level, distance: Callable[[np.ndarray], np.ndarray]) -> Float[np.ndarray, "faces"]:
    """Signed distance of a field, millimetres, on each triangle: of centre and corners the farthest.

    Positive where the triangle lies outside of the field's surface.
    """
    points = level.positions.astype(np.float64)
    corners = np.asarray(distance(points), np.float64)[level.faces]
    middle = np.asarray(distance(points[level.faces].mean(1)), np.float64)
    every = np.concatenate([corners, middle[:, None]], axis=1)
    farthest = np.abs(every).argmax(1)
    return 1e3 * every[np.arange(len(every)), farthest]


def from_truth(avatar: Avatar, level: Level, capture: Path) -> Float[np.ndarray, "vertices"]:
    """P2S at each vertex, millimetres: to the visible surface of the subject, both in pose 0."""
    truth = read_true_mesh(capture)
    transforms = skin_transforms(
        np.zeros((52, 3)),
        avatar.joint_positions.astype(np.float64),
        truth.joints[0],
        rest=avatar.canonical_pose.astype(np.float64),
    )
    points = skin_points(level.positions.astype(np.float64), level.skin, transforms)
    try:
        check_same_unit(truth.vertices, points)
    except ValueError as error:
        raise AssetError(f"{capture}: {error}") from None
    index = triangle_index(truth.vertices, truth.faces[truth.visible])
    return 1e3 * closest_points(points, index).distance
