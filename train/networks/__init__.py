"""The networks of a part, Eq. 1-4: a geometry, a color and a displacement network for each preset.

Every file here has a frozen record of sizes with its `kind`, as run.json names it, and `build`, which makes the three
networks and the appearance codes; a line in train/preset.py (Networks) makes it known.
All take points in the part's unit box, [-1, 1] in each axis (`PartField.unit`):

    geometry(unit)                                        -> signed distance in metres (n,), feature (n, z)
    color(ColorInputs)                                    -> sRGB in [0, 1]
    displacement(unit, frame)                             -> T_nr in metres
"""

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Annotated, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn

from command.settings import AtLeast, AtMost
from train.deform import Displacement, positional_encoding

# each is an object of its own
Layers = Annotated[int, AtLeast(1), AtMost(64)]


class FeatureGrid(nn.Module):
    """Features of points on a grid; its own parameters learn at the preset's `grid_rate`."""

    def open_for(self, share: float) -> None:
        """Open the detail that counts once `share` of the training is done; nothing, if all counts from the start."""


def layers(sizes: Sequence[int], activation: Callable[[], nn.Module] = nn.ReLU) -> nn.Sequential:
    """Fully connected layers, an activation behind each."""
    return nn.Sequential(*(one for size in pairwise(sizes) for one in (nn.Linear(*size), activation())))


class Geometry(nn.Module):
    """F_s of a part."""

    # whether it gives the distance's correction of the template's, not the distance itself
    over_template = True
    # width of VolSDF's density, metres, where the geometry learns it
    density_width: Callable[[], Tensor] | None = None


class TemplateCorrection(Geometry):
    """reach tanh(mlp): the last layer starts at zero, so an untrained part is its template.

    A kind of network says by `encoded` what its trunk is given.
    """

    def add_layers(self, trunk: nn.Sequential, *, width: int, feature: int, reach: float) -> None:
        """The layers, behind those of `encoded`; the trunk gives `width` numbers, `reach` is in metres."""
        self.reach = reach
        self.trunk = trunk
        self.correction = nn.Linear(width, 1)
        self.feature = nn.Linear(width, feature)
        nn.init.zeros_(self.correction.weight)
        nn.init.zeros_(self.correction.bias)

    def encoded(self, unit: Float[Tensor, "n 3"]) -> Float[Tensor, "n d"]:
        """What the trunk is given at points of the unit box."""
        raise NotImplementedError

    def forward(self, unit: Float[Tensor, "n 3"]) -> tuple[Float[Tensor, "n"], Float[Tensor, "n z"]]:
        hidden = self.trunk(self.encoded(unit))
        return self.reach * torch.tanh(self.correction(hidden)[:, 0]), self.feature(hidden)


class ColorInputs(NamedTuple):
    """What F_c is asked at."""

    unit: Float[Tensor, "n 3"]
    feature: Float[Tensor, "n z"]
    normals: Float[Tensor, "n 3"]
    directions: Float[Tensor, "n 3"]
    code: Float[Tensor, "n l"]


class SmallColor(nn.Module):
    """F_c of three layers, with a grid of its own where one is given: texture is finer than shape."""

    def __init__(self, planes: FeatureGrid | None, *, width: int, feature: int, appearance: int, planes_give: int = 0):
        super().__init__()
        self.planes = planes
        inputs = 39 + feature + 3 + 9 + appearance + planes_give
        self.network = nn.Sequential(*layers([inputs, width, width]), nn.Linear(width, 3))

    def forward(self, at: ColorInputs) -> Float[Tensor, "n 3"]:
        """sRGB in [0, 1]."""
        directions = positional_encoding(at.directions, 1)
        inputs = [positional_encoding(at.unit, 6), at.feature, at.normals, directions, at.code]
        if self.planes is not None:
            inputs.append(self.planes(at.unit))
        return torch.sigmoid(self.network(torch.cat(inputs, -1)))


class PartNetworks(NamedTuple):
    """What a part is composed of."""

    geometry: Geometry  # F_s, Eq. 1
    appearance: nn.Embedding  # l_i, one row per frame
    color: nn.Module  # F_c, Eq. 2
    # T_nr, Eq. 3 and 4
    displacement: Displacement


def frame_codes(frames: int, size: int) -> nn.Embedding:
    """Codes l_i or phi_i, one row per frame, near zero."""
    return nn.Embedding.from_pretrained(drawn(frames, size, by=lambda values: values.normal_(std=0.1)), freeze=False)


def drawn(*shape: int, by: Callable[[Tensor], Tensor]) -> Tensor:
    """Random numbers; on the meta device, which has no memory, none: torch would import sympy to draw them there, which
    takes seconds."""
    values = torch.empty(shape)
    return values if values.is_meta else by(values)
