"""The face of the built-in body: its shapes, what lies behind its lips, and where its mouth and lids open.

Both built-in bodies share it, and so does every template that was registered from one of them. Provenance:
THIRD_PARTY.md; made by experiments/derive_face.py.
"""

from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

import numpy as np
from jaxtyping import Float, Float32, Int
from numpy import ndarray as Array

from avatar.constant import constant
from avatar.face import SHAPES
from command.errors import AssetError
from files.npz import read_npz

# metres of a step in which the file counts displacements
UNIT = 2e-6
# vertices of the built-in bodies
BODY = 13380
HALVES = ("seam_upper", "seam_lower", "lid_left_upper", "lid_left_lower", "lid_right_upper", "lid_right_lower")
FIELDS = (
    "counts", "vertices", "steps", "inside", "inside_uv", "parts", "part_faces", "part_uv", "part_counts", *HALVES
)  # fmt: skip


@dataclass(frozen=True)
class FaceTemplate:
    """What is known of the built-in face. Edges of openings run from the least x to the most: from right to left."""

    # at a weight of 1, of the body's vertices and of those of `parts` behind them, metres
    offsets: Float32[Array, "52 all 3"]
    # the inside of the mouth, which meets the skin at the seam, by vertices of the body
    inside: Int[Array, "inside_faces 3"]
    # where its vertices are, ascending, in the mouth's picture, v down
    inside_uv: Float32[Array, "inside 2"]
    # upper teeth, lower teeth and tongue, as the built-in man has them, pose 0, metres
    parts: Float[Array, "parts 3"]
    part_faces: Int[Array, "part_faces 3"]
    part_uv: Float32[Array, "parts 2"]
    part_counts: tuple[int, int, int]  # vertices of each
    # upper and lower edge of the mouth's opening; both have the corners
    seam: tuple[Int[Array, "upper"], Int[Array, "lower"]]
    # the same of the left and of the right eye's opening
    lids: tuple[tuple[Int[Array, "a"], Int[Array, "b"]], tuple[Int[Array, "c"], Int[Array, "d"]]]


@constant
def builtin_face() -> FaceTemplate:
    """The face that ships with the project."""
    return read_face(Path(str(files("avatar") / "data" / "body" / "face.npz")))


def read_face(path: Path) -> FaceTemplate:
    """Read a face as experiments/derive_face.py writes it.

    Raises:
        AssetError: a field is absent, or the counts disagree.
    """
    found = read_npz(path, "a face template", FIELDS)
    counts, vertices = found["counts"].astype(np.int64), found["vertices"].astype(np.int64)
    every = BODY + len(found["parts"])
    if counts.shape != (len(SHAPES),) or counts.sum() != len(vertices) or len(found["steps"]) != len(vertices):
        rows = f"the rows of vertices and steps, {len(vertices)} and {len(found['steps'])}"
        are = f"{counts.shape} and sum to {int(counts.sum())}"
        raise AssetError(f"{path}: counts should be {len(SHAPES)} that sum to {rows}; are {are}")
    if vertices.max() >= every:
        raise AssetError(f"{path}: vertices should be below {every}, hold {int(vertices.max())}")
    offsets = np.zeros((len(SHAPES), every, 3), np.float32)
    offsets[np.repeat(np.arange(len(SHAPES)), counts), vertices] = found["steps"] * np.float32(UNIT)
    halves = [found[name].astype(np.int64) for name in HALVES]
    upper, lower, tongue = found["part_counts"].tolist()
    return FaceTemplate(
        offsets, found["inside"].astype(np.int64), found["inside_uv"], found["parts"].astype(np.float64),
        found["part_faces"].astype(np.int64), found["part_uv"], (upper, lower, tongue), (halves[0], halves[1]),
        ((halves[2], halves[3]), (halves[4], halves[5])),
    )  # fmt: skip
