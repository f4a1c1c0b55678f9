"""A ball of triangles."""

import numpy as np
import trimesh


def icosphere(radius, centre=(0.0, 0.0, 0.0), subdivisions=3):
    """Vertices and faces of a sphere."""
    mesh = trimesh.creation.icosphere(subdivisions, radius)
    return np.asarray(mesh.vertices) + centre, np.asarray(mesh.faces)
