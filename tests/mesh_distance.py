"""P2S and Chamfer between two whole meshes, as bench/score measures them region by region."""

import numpy as np
from jaxtyping import Float, Int

from bench.score.surface_distance import SurfaceDistance, check_same_unit, surface_distance
from geometry.closest import closest_points, triangle_index
from geometry.mesh import check_mesh
from geometry.sample import stratified_samples


def mesh_distance(
    truth: tuple[Float[np.ndarray, "vertices 3"], Int[np.ndarray, "faces 3"]],
    reconstruction: tuple[Float[np.ndarray, "w 3"], Int[np.ndarray, "g 3"]],
    *,
    count: int = 20_000,
    seed: int = 0,
) -> SurfaceDistance:
    """P2S and Chamfer between two whole meshes in metres."""
    check_mesh(*truth, "truth")
    check_mesh(*reconstruction, "reconstruction")
    check_same_unit(truth[0], reconstruction[0])
    on_truth = stratified_samples(*truth, count, seed=seed).on(*truth)
    on_reconstruction = stratified_samples(*reconstruction, count, seed=seed + 1).on(*reconstruction)
    return surface_distance(
        closest_points(on_reconstruction, triangle_index(*truth)).distance,
        closest_points(on_truth, triangle_index(*reconstruction)).distance,
    )
