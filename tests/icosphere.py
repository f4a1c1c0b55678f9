"""A ball of triangles."""

import numpy as np
import trimesh


def icosphere(radius, centre=(0.0, 0.0, 0.0), subdivisions=3):
    """Vertices and faces of a sphere."""
    mesh = trimesh.creation.icosphere(subdivisions, radius)
    return np.asarray(mesh.vertices) + centre, np.asarray(mesh.faces)


EGG = np.array([0.07, 0.11, 0.09])


def egg(count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Points and normals of an ellipsoid of a head's size with three different axes, metres."""
    d = np.random.default_rng(seed).normal(size=(count, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    normals = d / EGG
    return d * EGG, normals / np.linalg.norm(normals, axis=1, keepdims=True)
