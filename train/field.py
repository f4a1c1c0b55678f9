"""One part of the person: signed distance and colour in the canonical frame (TotalSelfScan, Eq. 1 and 2)."""

from typing import NamedTuple

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor, nn

from train.deform import Displacement
from train.encoding import positional_encoding
from train.template import TemplateGrid


class FieldSample(NamedTuple):
    """F_s at a point."""

    distance: Float[Tensor, "n"]  # metres, negative inside
    feature: Float[Tensor, "n z"]  # geometry feature, read by the colour network


class TriPlane(nn.Module):
    """Features of a point: bilinear look-ups on three axis-aligned planes, side by side."""

    def __init__(self, channels: int, size: int, *, start: float = 1e-2):
        super().__init__()
        self.planes = nn.Parameter(start * torch.randn(3, channels, size, size))

    def forward(self, unit: Float[Tensor, "n 3"]) -> Float[Tensor, "n d"]:
        """`unit` is the part's box scaled to [-1, 1]; beyond it the border repeats."""
        at = torch.stack([unit[:, [0, 1]], unit[:, [0, 2]], unit[:, [1, 2]]])[:, :, None]
        sampled = F.grid_sample(self.planes, at, mode="bilinear", padding_mode="border", align_corners=True)
        return sampled[..., 0].permute(2, 0, 1).flatten(1)


class PartField(nn.Module):
    """F_s = template distance + reach tanh(mlp), F_c = sigmoid(mlp), T_nr: the three networks of one part.

    The template distance is the registered body's, so an untrained part is that body and the first rendered
    frame already shows a person; the correction's last layer starts at zero and reaches at most `reach` metres.

    Frame: canonical, metres. The head's is canonical too: its video is moved there by Eq. 6 before training.
    """

    reach = 0.06

    low: Float[Tensor, "3"]  # the part's box, metres
    high: Float[Tensor, "3"]
    appearance: nn.Embedding  # l_i, one row per frame
    reference: Float[Tensor, "l"]  # the code that the fused person is shown with

    def __init__(
        self,
        template: TemplateGrid,
        low: Float[Tensor, "3"],
        high: Float[Tensor, "3"],
        frames: int,
        *,
        plane_channels: int = 8,
        plane_size: int = 160,
        color_channels: int = 8,
        color_size: int = 256,
        width: int = 64,
        feature: int = 15,
        appearance: int = 8,
        displacement: int = 8,
        displacement_reach: float = 0.03,
    ):
        super().__init__()
        self.template = template
        self.register_buffer("low", low)
        self.register_buffer("high", high)
        self.planes = TriPlane(plane_channels, plane_size)
        inputs = 3 * plane_channels + 27
        self.trunk = nn.Sequential(
            nn.Linear(inputs, width), nn.Softplus(beta=100), nn.Linear(width, width), nn.Softplus(beta=100)
        )
        self.correction = nn.Linear(width, 1)
        self.feature = nn.Linear(width, feature)
        nn.init.zeros_(self.correction.weight)
        nn.init.zeros_(self.correction.bias)
        self.color_planes = TriPlane(color_channels, color_size)
        self.appearance = nn.Embedding(frames, appearance)
        nn.init.normal_(self.appearance.weight, std=0.1)
        inputs = 39 + feature + 3 + 9 + appearance + 3 * color_channels
        self.color_network = nn.Sequential(
            nn.Linear(inputs, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU(), nn.Linear(width, 3)
        )
        self.displacement = Displacement(
            frames, code=displacement, width=width, frequencies=4, reach=displacement_reach
        )
        self.register_buffer("reference", torch.zeros(appearance))

    def unit(self, points: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3"]:
        """The part's box scaled to [-1, 1]."""
        return (points - self.low) / (self.high - self.low) * 2 - 1

    def forward(self, points: Float[Tensor, "n 3"]) -> FieldSample:
        """F_s, Eq. 1."""
        correction, feature = self._correction(points)
        return FieldSample(self.template(points) + correction, feature)

    def _correction(self, points: Float[Tensor, "n 3"]) -> tuple[Float[Tensor, "n"], Float[Tensor, "n z"]]:
        unit = self.unit(points)
        hidden = self.trunk(torch.cat([self.planes(unit), positional_encoding(unit, 4)], -1))
        return self.reach * torch.tanh(self.correction(hidden)[:, 0]), self.feature(hidden)

    def with_gradient(
        self, points: Float[Tensor, "n 3"], *, create_graph: bool
    ) -> tuple[FieldSample, Float[Tensor, "n 3"]]:
        """F_s and its spatial gradient at fixed points; the gradient carries a graph to the weights if asked.

        The template's part of the gradient is its interpolant's, a constant: Eikonal cannot change it.
        """
        with torch.enable_grad():
            points = points.detach().requires_grad_()
            correction, feature = self._correction(points)
            (residual,) = torch.autograd.grad(correction.sum(), points, create_graph=create_graph)
        distance, gradient = self.template.sample(points.detach())
        return FieldSample(distance + correction, feature), gradient + residual

    def color(
        self,
        points: Float[Tensor, "n 3"],
        feature: Float[Tensor, "n z"],
        normals: Float[Tensor, "n 3"],
        directions: Float[Tensor, "n 3"],
        code: Float[Tensor, "n l"],
    ) -> Float[Tensor, "n 3"]:
        """F_c, Eq. 2: sRGB in [0, 1] seen along unit `directions` (away from the camera), all canonical."""
        unit = self.unit(points)
        inputs = [
            positional_encoding(unit, 6),
            feature,
            normals,
            positional_encoding(directions, 1),
            code,
            self.color_planes(unit),
        ]
        return torch.sigmoid(self.color_network(torch.cat(inputs, -1)))

    def codes(self, frame: Int[Tensor, "n"]) -> Float[Tensor, "n l"]:
        """Appearance codes of frames; frame -1 is the reference."""
        return torch.where(frame[:, None] < 0, self.reference, self.appearance(frame.clamp_min(0)))


def unit_normals(gradient: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3"]:
    """Gradient scaled to length one; a vanishing gradient gives a short vector, not NaN, and a finite gradient."""
    return gradient / (gradient.square().sum(-1, keepdim=True) + 1e-12).sqrt()
