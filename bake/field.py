"""The field that is baked: asked with NumPy arrays, in pieces, and solid deep inside the body."""

from collections.abc import Callable
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float
from scipy.spatial import KDTree

from bake.surface import PointFunction
from train.capture import PARTS, Subject
from train.mesh import vertex_normals
from train.template import visible_faces


@runtime_checkable
class Field(Protocol):
    """What is baked: the fused field of a run, canonical frame, torch float32."""

    def distance(self, points: torch.Tensor) -> torch.Tensor: ...
    def normal(self, points: torch.Tensor) -> torch.Tensor: ...
    def color(self, points: torch.Tensor, directions: torch.Tensor) -> torch.Tensor: ...


class NumpyField(NamedTuple):
    """The field behind NumPy functions, asked in pieces so that memory stays bounded."""

    distance: Callable[[Float[np.ndarray, "n 3"]], Float[np.ndarray, "n"]]
    normal: Callable[[Float[np.ndarray, "n 3"]], Float[np.ndarray, "n 3"]]
    color: Callable[[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]], Float[np.ndarray, "n 3"]]


def numpy_field(field: Field, *, piece: int = 1 << 16) -> NumpyField:
    """The field behind functions that take and give float64, `piece` points at a time."""

    def ask(function: Callable[..., torch.Tensor], *arrays: np.ndarray) -> np.ndarray:
        pieces = []
        for start in range(0, len(arrays[0]), piece):
            tensors = [
                torch.from_numpy(np.ascontiguousarray(a[start : start + piece], np.float32)) for a in arrays
            ]
            pieces.append(function(*tensors).detach().cpu().numpy().astype(np.float64))
        return np.concatenate(pieces) if pieces else np.zeros((0, 3))

    return NumpyField(
        lambda points: ask(field.distance, points).reshape(-1),
        lambda points: ask(field.normal, points),
        lambda points, directions: ask(field.color, points, directions),
    )


INSIDE = np.array([0.02, 0.015, 0.004, 0.004])  # metres, per part: so deep inside the template is no surface


def solid_inside(distance: PointFunction, subject: Subject) -> PointFunction:
    """The distance, made negative deep inside the subject's template (INSIDE, per part).

    Training samples a band around the template; deeper in, the field is whatever its network makes up, and its
    zero sets there are sheets inside the body, some of them joined to the skin through a pinhole. Only the
    faces that can be seen from outside count: mouth and eye sockets would turn the sign.
    """
    faces = np.asarray(subject.faces, np.int64)
    vertices = np.asarray(subject.vertices, np.float64)
    seen = np.unique(faces[visible_faces(subject)])
    normals = vertex_normals(vertices, faces)[seen]
    places = vertices[seen]
    part = np.asarray(subject.part, np.int64)[seen]
    tree, limit = KDTree(places), INSIDE[part]
    hands = places[part >= PARTS.index("hand_left")]
    if len(hands):  # the hands' fields speak up to 10 cm beyond the wrist, where the part is body
        limit = np.where(KDTree(hands).query(places)[0] < 0.12, np.minimum(limit, 0.006), limit)

    def solid(points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n"]:
        value = distance(points)
        # only what is positive, or nearly, can be wrong; an island deeper in is dropped as one
        doubtful = np.flatnonzero((value > -0.005) & (value < 0.06))
        away, near = tree.query(points[doubtful], k=4, distance_upper_bound=0.1, workers=-1)
        found = np.isfinite(away).all(1)
        doubtful, away, near = doubtful[found], np.asarray(away)[found], np.asarray(near)[found]
        # four vertices must agree: beside a sharp edge one normal alone can be wrong
        offset = points[doubtful][:, None] - places[near]
        behind = ((offset * normals[near]).sum(2) < -0.3 * away).all(1)
        deep = behind & (away[:, 0] > limit[near[:, 0]])
        value[doubtful[deep]] = -away[deep, 0]
        return value

    return solid
