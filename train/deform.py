"""Part deformation: observed points to canonical ones (TotalSelfScan, 3.2, Eq. 3 and 4)."""

from collections.abc import Callable
from math import pi

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array
from torch import Tensor, nn

from avatar.skinning import SINGULAR, SkinWeights, blended_transforms


def inverse_transforms(
    skin: SkinWeights, transforms: Float[Array, "52 4 4"]
) -> tuple[Float[Array, "n 3 4"], Bool[Array, "n"]]:
    """(sum_k w_k B_k)^-1 as rows [A^-1 | -A^-1 t] (supplement, Eq. 1), by the adjugate; ok where |det| is not tiny.

    Made once per template sample and frame, then gathered by every point that follows this sample.
    """
    M = blended_transforms(skin, transforms)
    a, b, c = M[:, :3, 0], M[:, :3, 1], M[:, :3, 2]
    bc, ca, ab = np.cross(b, c), np.cross(c, a), np.cross(a, b)
    det = (a * bc).sum(1)
    ok = np.abs(det) > SINGULAR
    A = np.stack([bc, ca, ab], 1) / np.where(ok, det, 1.0)[:, None, None]
    A[~ok] = np.eye(3)
    out = np.empty((len(M), 3, 4), np.float32)
    out[:, :, :3] = A
    out[:, :, 3] = -(A @ M[:, :3, 3:])[:, :, 0]
    return out, ok


def apply_rows(rows: Float[Array, "s 3 4"], index: Int[Array, "n"], points: Float[Array, "n 3"]) -> Float[Array, "n 3"]:
    """rows[index] @ [points, 1]."""
    chosen = rows[index]
    return np.einsum("nij,nj->ni", chosen[:, :, :3], points) + chosen[:, :, 3]


def canonical_from_posed(
    points: Float[Array, "n 3"], start: Int[Array, "n"], inverse: Float[Array, "samples 3 4"],
    nearest: Callable[[Float[Array, "k 3"]], Int[Array, "k"]], settled: float = 1e-4,
) -> tuple[Int[Array, "n"], Float[Array, "n 3"], Bool[Array, "n"]]:  # fmt: skip
    """Which template sample each posed point follows, where that puts it, and whether the answer settled.

    Starts at the closest posed sample (`start`), maps the point with its weights, looks the weights up again at
    the canonical point found (`nearest`, -1 where it does not know), at most three times, until the point
    moves less than `settled` metres. One that still moves has two answers (fingers that touch, legs that cross)
    and is flagged; training leaves it out.
    """
    row, here = start.copy(), apply_rows(inverse, start, points)
    ok = np.zeros(len(points), bool)
    open_ = np.arange(len(points))
    for _ in range(3):
        again = nearest(here[open_])
        again = np.where(again < 0, row[open_], again)
        moved = apply_rows(inverse, again, points[open_])
        same = np.linalg.norm(moved - here[open_], axis=1) < settled
        row[open_], here[open_], ok[open_] = again, moved, same
        open_ = open_[~same]
        if len(open_) == 0:
            break
    return row, here, ok


def canonical_directions(
    directions: Float[Tensor, "n 3"], weights: Float[Tensor, "n 4"], bones: Float[Tensor, "n 4 4"]
) -> Float[Tensor, "n 3"]:
    """R^T d with R the hemisphere-aligned quaternion blend: avatar.skinning.blended_rotations, in torch,
    a bone set per point.

    `bones` are the unit quaternions (xyzw) of the four bones of each point, heaviest first.
    """
    return posed_directions(directions, weights, bones, -1.0)


def posed_directions(
    directions: Float[Tensor, "n 3"], weights: Float[Tensor, "n 4"], bones: Float[Tensor, "n 4 4"], sign: float = 1.0
) -> Float[Tensor, "n 3"]:
    """R d, or R^T d where the sign is -1."""
    q = bones
    side = torch.where((q * q[:, :1]).sum(-1) < 0, -1.0, 1.0)
    q = ((weights * side)[..., None] * q).sum(1)
    q = q / q.norm(dim=-1, keepdim=True).clamp_min(1e-12)
    v, w = sign * q[:, :3], q[:, 3:]  # the conjugate turns back
    t = 2 * torch.linalg.cross(v, directions)
    return directions + w * t + torch.linalg.cross(v, t)


def positional_encoding(x: Float[Tensor, "n c"], frequencies: int) -> Float[Tensor, "n d"]:
    """x, sin(2^k pi x), cos(2^k pi x) for k < frequencies (Mildenhall et al. 2020).

    c (1 + 2 frequencies) numbers; x is of order one.
    """
    scales = pi * 2.0 ** torch.arange(frequencies, device=x.device, dtype=x.dtype)
    angles = (x[:, None, :] * scales[:, None]).flatten(1)
    return torch.cat([x, angles.sin(), angles.cos()], -1)


def trilinear(grid: Float[Tensor, "c x y z"], unit: Float[Tensor, "n 3"]) -> Float[Tensor, "n c"]:
    """Values between the nodes of a grid over the box [-1, 1]; beyond it the border repeats."""
    # grid_sample counts its last axis first
    at = unit.flip(-1)[None, :, None, None]
    sampled = nn.functional.grid_sample(grid[None], at, padding_mode="border", align_corners=True)
    return sampled[0, :, :, 0, 0].T


class Displacement(nn.Module):
    """T_nr(x, code): what skinning or the rigid motion leaves over, at most `reach` metres (Eq. 3, 4).

    The trunk turns the encoded point and the code, side by side, into `width` numbers; the last layer starts at zero.
    `code` is one row per frame; the mean over the frames is what the fused query adds at rendering time.
    """

    code: nn.Embedding
    # axes x, y, z of the unit box; zero until `settle`
    mean_grid: Float[Tensor, "3 side side side"]

    def __init__(self, code: nn.Embedding, trunk: nn.Module, *, width: int, frequencies: int, reach: float):
        super().__init__()
        self.reach, self.frequencies = reach, frequencies
        self.code = code
        self.trunk = trunk
        self.out = nn.Linear(width, 3)
        nn.init.zeros_(self.out.weight)
        nn.init.zeros_(self.out.bias)
        self.register_buffer("mean_grid", torch.zeros(3, 40, 40, 40))

    def forward(self, unit: Float[Tensor, "n 3"], frame: Int[Tensor, "n"]) -> Float[Tensor, "n 3"]:
        """Displacement in metres of points given in the part's unit box."""
        encoded = positional_encoding(unit, self.frequencies)
        return self.reach * torch.tanh(self.out(self.trunk(torch.cat([encoded, self.code(frame)], -1))))

    def exact_mean(self, unit: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3"]:
        """Mean over all frames' codes."""
        total = torch.zeros_like(unit)
        for frame in range(len(self.code.weight)):
            total = total + self(unit, torch.full((len(unit),), frame, device=unit.device))
        return total / len(self.code.weight)

    @torch.no_grad()
    def settle(self) -> None:
        """Store the mean on a grid of the unit box. Asked exactly it costs one network call per frame and point."""
        side = self.mean_grid.shape[-1]
        axis = torch.linspace(-1, 1, side, device=self.mean_grid.device)
        points = torch.stack(torch.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)
        values = torch.cat([self.exact_mean(piece) for piece in points.split(16384)])
        self.mean_grid.copy_(values.T.view(3, side, side, side))

    def mean(self, unit: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3"]:
        """Mean over all frames' codes, from the grid that `settle` stored; zero before."""
        return trilinear(self.mean_grid, unit)
