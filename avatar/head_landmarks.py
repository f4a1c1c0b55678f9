"""landmarks.json of a head's video: places of the face in the frame of its cameras, and the template's vertices there.

{"points": {"nose_tip": [x, y, z], ...}, "vertices": {"nose_tip": 4711, ...}}
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from command.errors import AssetError
from files.input_file import read_json_object

FEWEST = 6
# in any unit
FARTHEST = 1e6


class HeadLandmarks(NamedTuple):
    """Landmarks in alphabetical order of their names."""

    points: Float[Array, "points 3"]  # head frame, its own unit
    vertices: Int[Array, "points"]  # the template's


def read_head_landmarks(path: Path, vertex_count: int) -> HeadLandmarks:
    """Read the landmarks of a template of `vertex_count` vertices.

    Raises:
        AssetError: too few, other names on the two sides, no vertex's number, or no finite point. File, field and name.
    """
    content = read_json_object(path, "landmarks")
    points, vertices = content.get("points"), content.get("vertices")
    if not isinstance(points, dict) or not isinstance(vertices, dict) or set(points) != set(vertices):
        raise AssetError(f"{path}: expected 'points' and 'vertices' with the same names")
    if len(points) < FEWEST:
        raise AssetError(f"{path}: expected at least {FEWEST} landmarks, found {len(points)}")
    names = sorted(points)
    for name in names:
        index, point = vertices[name], points[name]
        if type(index) is not int or not 0 <= index < vertex_count:
            expected = f"an index below {vertex_count}"
            raise AssetError(f"{path}: vertices.{name[:40]} should be {expected}, is {str(index)[:40]!r}")
        numbers = isinstance(point, list) and all(type(v) in (int, float) and abs(v) < FARTHEST for v in point)
        if not numbers or len(point) != 3:
            raise AssetError(f"{path}: points.{name[:40]} should be three finite numbers, is {str(point)[:60]!r}")
    return HeadLandmarks(np.array([points[name] for name in names], np.float64), np.array([vertices[n] for n in names]))
