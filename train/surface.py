"""The zero level of the fused field as one mesh: coarse on the body, fine on head and hands, no seam."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from numpy import ndarray as Array

from avatar.skinning import SkinWeights
from capture.folder import CaptureSubject
from capture.template.layers import HAIR, LEAST_HAIR, hair_layers
from capture.template.parts import Part
from capture.template.solid import solid_inside, template_behind_cloth
from command.errors import AssetError
from geometry.isosurface import Detail, zero_set_mesh
from geometry.mesh import TriangleMesh, concatenated, largest_component, separate_pieces
from train.fused import FusedField


@dataclass(frozen=True)
class Surface:
    """Mesh of the fused field in the canonical frame, with Eq. 14's statistics (capture/template/views.py)."""

    vertices: Float[Array, "vertices 3"]
    faces: Int[Array, "faces 3"]
    normals: Float[Array, "vertices 3"]  # unit, gradient of the field
    # the part of the largest weight (Eq. 9)
    part: Int[Array, "vertices"]
    skin: SkinWeights
    view_count: Float[Array, "vertices"]  # directions seen
    # their mean, not normalised; unseen vertices have their neighbours'
    view_mean: Float[Array, "vertices 3"]
    # xx xy xz yy yz zz, across the mean direction
    view_covariance: Float[Array, "vertices 6"]
    # 0 the body, 1 hair that is a surface of its own (capture/template/layers.py)
    layer: Int[Array, "vertices"]


def grid_axes(parts: tuple[Part, ...], cells: Sequence[float], details: Sequence[Detail]) -> list[Array]:
    """Lines of a rectilinear grid that are close where a fine part or a detail lies and far elsewhere.

    One grid means one watertight mesh. Each axis takes the finest cell that anything asks for at that coordinate.
    """
    body_cell, head_cell, hand_cell = cells
    own_cell = {"head": head_cell, "hand_left": hand_cell, "hand_right": hand_cell}
    axes = []
    whole = parts[0].extent
    for axis in range(3):
        lines, at = [], float(whole.low[axis])
        while at < whole.high[axis]:
            lines.append(at)
            near = [p for p in parts[1:] if p.extent.low[axis] - 0.01 <= at <= p.extent.high[axis] + 0.01]
            own = [d.step for d in details if d.low[axis] - head_cell <= at <= d.high[axis]]
            at += min([body_cell, *(own_cell[p.name] for p in near), *own])
        axes.append(np.array([*lines, at]))
    return axes


def extract_surface(
    field: FusedField, parts: tuple[Part, ...], subject: CaptureSubject, cells: Sequence[float]
) -> tuple[TriangleMesh, Int[Array, "vertices"]]:
    """Marching cubes on a rectilinear grid, and the layer of each vertex (capture/template/layers.py); `cells` of body,
    head and hands, metres.

    The body is the largest connected piece, facing outwards; where hair is a layer of its own its pieces follow.
    The field is asked only at grid points within 2 cm of a coarse pass (every fourth line) that found the
    surface near; all others take the coarse value. Neither floaters nor a second person survive, nor sheets deep
    inside the subject's template, which may hang on the skin by a pinhole and be turned out by skinning.

    Raises:
        AssetError: the field has no zero crossing in the box.
    """
    to_field = lambda points: torch.as_tensor(points, dtype=torch.float32, device=field.device)
    asked = lambda points: field.distance(to_field(points)).cpu().numpy()
    distance = solid_inside(template_behind_cloth(asked, subject), subject)
    axes = grid_axes(parts, cells, field.details())
    thin = [np.unique(np.r_[axis[::4], axis[-1]]) for axis in axes]
    coarse = distance(np.stack(np.meshgrid(*thin, indexing="ij"), -1).reshape(-1, 3))
    coarse = coarse.reshape([len(axis) for axis in thin])
    # coarse values at the fine lines, by linear interpolation along each axis
    values = coarse.astype(np.float32)
    for axis in range(3):
        values = _interpolated(values, thin[axis], axes[axis], axis)
    band = np.abs(values) < 0.02 + 0.5 * max(np.diff(a).max() for a in thin)
    index = np.argwhere(band)
    points = np.stack([axes[i][index[:, i]] for i in range(3)], 1)
    values[tuple(index.T)] = distance(points)
    if not (values.min() < 0 < values.max()):
        side = "positive" if values.min() >= 0 else "negative"
        raise AssetError(
            f"what was learned is no surface, its distance is {side} everywhere; `selfscan check` shows whether the "
            "videos can be used"
        )
    layers = hair_layers(subject, distance)
    if layers is None:
        mesh = largest_component(zero_set_mesh(values, axes))[0]
        return mesh, np.zeros(len(mesh.vertices), np.int64)
    low, high = layers.box()
    inner = tuple(slice(*np.searchsorted(axis, [low[i], high[i]])) for i, axis in enumerate(axes))
    own_axes = [axis[part] for axis, part in zip(axes, inner)]
    points = np.stack(np.meshgrid(*own_axes, indexing="ij"), -1).reshape(-1, 3)
    body, hair = layers.divide(points, values[inner].reshape(-1))
    values[inner] = body.reshape(values[inner].shape)
    pieces = [largest_component(zero_set_mesh(values, axes))[0]]
    hair = np.pad(hair.reshape(values[inner].shape), 1, constant_values=1.0)
    if hair.min() < 0:
        around = [np.r_[2 * a[0] - a[1], a, 2 * a[-1] - a[-2]] for a in own_axes]
        pieces += separate_pieces(zero_set_mesh(hair, around), LEAST_HAIR)
    layer = np.concatenate([np.full(len(p.vertices), min(i, HAIR)) for i, p in enumerate(pieces)])
    return concatenated(pieces), layer


def _interpolated(values: Array, old: Array, new: Array, axis: int) -> Array:
    right = np.clip(np.searchsorted(old, new), 1, len(old) - 1)
    f = ((new - old[right - 1]) / (old[right] - old[right - 1])).astype(np.float32)
    f = f.reshape([-1 if i == axis else 1 for i in range(3)])
    return np.take(values, right - 1, axis) * (1 - f) + np.take(values, right, axis) * f
