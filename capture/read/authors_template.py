"""lbs/ of the authors' folders: joints and the surface in the big pose, taken to pose 0;
weights of a model or a grid.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.ndimage import map_coordinates

from avatar.body import Body
from avatar.skeleton import BIG_POSE, PARENTS, skin_transforms
from avatar.skinning import SkinWeights, strongest_four, unskin_points
from capture.read.authors_files import numbers
from capture.read.template import LICENSED, TemplateMesh, check_height
from command.errors import AssetError

# metres: bigpose_bw reaches this far round the vertices, in such cells
GRID_MARGIN, GRID_CELL = 0.05, 0.025


@dataclass(frozen=True)
class AuthorsSkeleton:
    """lbs/ of one folder: the surface in the big pose, and the joints, both with the pelvis at `origin`."""

    vertices: Float[Array, "vertices 3"]
    joints: Float[Array, "52 3"]  # minus origin
    origin: Float[Array, "3"]


def read_skeleton(folder: Path) -> AuthorsSkeleton:
    """The big pose and its joints, metres, the pelvis at the origin; AssetError where the tree is not SMPL+H's."""
    joints = numbers(folder / "joints.npy", "joints", (52, 3))
    vertices = numbers(folder / "bigpose_vertices.npy", "vertices in the big pose", (None, 3))
    parents = numbers(folder / "parents.npy", "parents", (52,)).astype(np.int64)
    if (parents[1:] != PARENTS[1:]).any():
        joint = int(np.argmax(parents[1:] != PARENTS[1:])) + 1
        raise AssetError(
            f"{folder / 'parents.npy'}: expected SMPL+H's 52 joints, parent of {joint} is {parents[joint]}, expected "
            f"{PARENTS[joint]}"
        )
    return AuthorsSkeleton(vertices - joints[0], joints - joints[0], joints[0])


def authors_template(folder: Path, skeleton: AuthorsSkeleton, body: Body | None, notes: list[str]) -> TemplateMesh:
    """The body folder's vertices, taken from the big pose to pose 0."""
    place = folder / "bigpose_vertices.npy"
    check_height(f"{place}: the body", skeleton.vertices)
    count = len(skeleton.vertices)
    if body is not None and len(body.vertices) != count:
        raise AssetError(f"{place}: expected {len(body.vertices)} vertices as {body.name}, found {count}")
    faces = numbers(folder / "faces.npy", "faces", (None, 3)).astype(np.int64)
    if len(faces) == 0 or faces.min() < 0 or faces.max() >= count:
        raise AssetError(f"{folder / 'faces.npy'}: faces should index {count} vertices")
    if body is None:
        skin = _weights_of_grid(folder / "bigpose_bw.npy", skeleton.vertices)
        grid = "from the 25 mm grid lbs/bigpose_bw.npy, blurred between fingers; --body MODEL has them exactly"
        notes.append(f"skin weights: {grid}")
    else:
        skin = body.skin
        notes.append(f"skin weights: of {body.name}")
    B = skin_transforms(BIG_POSE, skeleton.joints, rest=np.zeros((52, 3)))
    rest, ok = unskin_points(skeleton.vertices, skin, B)
    assert ok.all(), "thirty degrees never flatten a blend"
    name = "SMPL+H, TotalSelfScan's folder" if body is None else body.name
    return TemplateMesh(rest, faces, skin, skeleton.joints, LICENSED.format(name))


def _weights_of_grid(path: Path, vertices: Float[Array, "vertices 3"]) -> SkinWeights:
    """Weights at the vertices from the grid (x, y, z, 52 weights and a distance) round them, trilinear.

    Grid point i lies at low + i * 25 mm, low = the vertices' least coordinates - 50 mm: the grid's shape says
    whether that margin is the one it was made with.
    """
    grid = numbers(path, "grid of skin weights", (None, None, None, 53))[..., :52]
    low = vertices.min(0) - GRID_MARGIN
    expected = np.ceil((np.ptp(vertices, axis=0) + 2 * GRID_MARGIN) / GRID_CELL).astype(np.int64) + 1
    if (np.abs(np.array(grid.shape[:3]) - expected) > 1).any():
        raise AssetError(
            f"{path}: expected about {tuple(expected.tolist())} points of {GRID_CELL * 1000:.0f} mm round the "
            f"vertices, found {grid.shape[:3]}"
        )
    at = ((vertices - low) / GRID_CELL).T
    weights = np.stack([map_coordinates(grid[..., bone], at, order=1, mode="nearest") for bone in range(52)], 1)
    try:
        return strongest_four(weights)
    except ValueError as error:
        raise AssetError(f"{path}: {error}") from None
