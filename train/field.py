"""One part of the person: signed distance and color in the canonical frame (TotalSelfScan, Eq. 1 and 2)."""

from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from train.light import LightTensors
from train.networks import ColorInputs, PartNetworks
from train.pose_correction import PoseCorrection
from train.template_grid import TemplateGrid

# share of the template's normal in the normals that light falls on
TEMPLATE_SHARE = 0.7


class FieldSample(NamedTuple):
    """F_s at a point."""

    distance: Float[Tensor, "n"]  # metres, negative inside
    # geometry feature, read by the color network
    feature: Float[Tensor, "n z"]


class PartField(nn.Module):
    """F_s, F_c and T_nr of one part: three networks (train/networks) in the part's box.

    Where the geometry network works `over_template`, F_s is the registered body's distance plus the network's, so
    an untrained part is that body and the first rendered frame already shows a person.

    Frame: canonical, metres. The head's is canonical too: its video is moved there by Eq. 6 before training.
    """

    low: Float[Tensor, "3"]  # the part's box, metres
    high: Float[Tensor, "3"]
    appearance: nn.Embedding  # l_i, one row per frame
    # the code that the fused person is shown with
    reference: Float[Tensor, "l"]
    # learned with the field where poses are refined; None once they are known
    poses: PoseCorrection | None
    # the video's, while the part is trained: F_c is albedo then; None: F_c is the color as it is shown
    light: LightTensors | None

    def __init__(
        self, template: TemplateGrid, low: Float[Tensor, "3"], high: Float[Tensor, "3"], networks: PartNetworks
    ):
        super().__init__()
        self.template = template
        self.register_buffer("low", low)
        self.register_buffer("high", high)
        self.geometry, self.appearance, self.color_network, self.displacement = networks
        self.poses = None
        self.light = None
        # the surface is the template's, whatever was learned
        self.keeps_template = False
        self.register_buffer("reference", torch.zeros(self.appearance.weight.shape[1]))

    def unit(self, points: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3"]:
        """The part's box scaled to [-1, 1]."""
        return (points - self.low) / (self.high - self.low) * 2 - 1

    def forward(self, points: Float[Tensor, "n 3"]) -> FieldSample:
        """F_s, Eq. 1."""
        distance, feature = self.geometry(self.unit(points))
        if self.keeps_template:
            distance = self.template(points)
        elif self.geometry.over_template:
            distance = self.template(points) + distance
        return FieldSample(distance, feature)

    def with_gradient(
        self, points: Float[Tensor, "n 3"], *, create_graph: bool, attached: bool = False
    ) -> tuple[FieldSample, Float[Tensor, "n 3"]]:
        """F_s and its spatial gradient; the gradient carries a graph to the weights if asked.

        The points are fixed; `attached`, F_s keeps the graph that the points carry (to T_nr) as well.

        The template's part of the gradient is its interpolant's, a constant: Eikonal cannot change it.
        """
        with torch.enable_grad():
            if not (attached and points.requires_grad):
                points = points.detach().requires_grad_()
            distance, feature = self.geometry(self.unit(points))
            (gradient,) = torch.autograd.grad(distance.sum(), points, create_graph=create_graph)
        if self.keeps_template:
            distance, gradient = self.template.sample(points.detach())
        elif self.geometry.over_template:
            template, slope = self.template.sample(points.detach())
            distance, gradient = template + distance, slope + gradient
        return FieldSample(distance, feature), gradient

    def light_normal(self, points: Float[Tensor, "n 3"], gradient: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3"]:
        """Unit normals that light falls on, where F_s has this gradient; no graph.

        F_s follows the colors and wrinkles by 5 to 7 degrees; on such normals a lamp's shading and highlight show
        wrinkles that are not there. The template is smoother than a person and about as right: both are taken together.
        """
        facing = unit_normals(self.template.smooth_gradient(points))
        return unit_normals(TEMPLATE_SHARE * facing + (1 - TEMPLATE_SHARE) * unit_normals(gradient.detach()))

    def color(
        self, points: Float[Tensor, "n 3"], feature: Float[Tensor, "n z"], normals: Float[Tensor, "n 3"],
        directions: Float[Tensor, "n 3"], code: Float[Tensor, "n l"],
    ) -> Float[Tensor, "n 3"]:  # fmt: skip
        """F_c, Eq. 2: sRGB in [0, 1] seen along unit `directions` (away from the camera), all canonical."""
        return self.color_network(ColorInputs(self.unit(points), feature, normals, directions, code))

    def codes(self, frame: Int[Tensor, "n"]) -> Float[Tensor, "n l"]:
        """Appearance codes of frames; frame -1 is the reference."""
        return torch.where(frame[:, None] < 0, self.reference, self.appearance(frame.clamp_min(0)))


def unit_normals(gradient: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3"]:
    """Gradient scaled to length one; a vanishing gradient gives a short vector, not NaN, and a finite gradient."""
    return gradient / (gradient.square().sum(-1, keepdim=True) + 1e-12).sqrt()
