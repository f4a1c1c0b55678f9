"""AniSDF (Peng et al., "Animatable neural implicit surfaces for creating avatars from videos", arXiv 2203.08133, 2022).

One canonical signed distance and color field, and a displacement that depends on the pose:

    x_can = T_ilbs(x, p_i) + dx(T_ilbs(x, p_i), p_i)       inverse skinning by the template, then the displacement
    s, z = F_s(x_can),  c = F_c(x_can, z, n, d, l_i)        F_c sees a code per frame, as its code has it
    sigma = Psi_beta(-s) / beta                             VolSDF's density, beta learned
    L = L_rgb + L_mask + L_E + L_dx

dx is given the pose vector itself: 21 joints of the body and 30 of the fingers, 153 numbers; in a novel pose that
pose's own, so its surface changes with the pose. Directions are the rays' own: there is no Eq. 14, nor fusion, as there
is one field. Its neural feature field for colors is left out, as TotalSelfScan left it out.

So it is the single network of single.py with another code in T_nr (frozen: the pose), another density, and other
directions, and its run folder is one that `selfscan bake` takes (with the mean displacement of its frames). Size
`demo` has tri-planes over the template, as our demo preset has; `paper` begins with F_s fitted to it. All four videos;
a head's frames are given the big pose.
"""

import copy
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float
from numpy import ndarray as Array
from torch import Tensor, nn

from avatar.camera import Camera
from avatar.skeleton import BIG_POSE, PARTS
from bench.field.posed_field import MaskedPicture, PosableSurface, PosedField
from capture.folder import Capture
from experiments.rivals.single import single_preset, single_untrained
from files.whole import whole_file
from player.draw.raster import Rasteriser
from train.deform import Displacement, positional_encoding
from train.networks.paper import PaperNetworks
from train.networks.triplane import TriPlaneGeometry, TriPlaneNetworks
from train.part_job import PartJob, Untrained
from train.preset import Preset
from train.run import Run, read_run
from train.weight_file import read_weights

POSE = 153  # numbers: all joints but the root
# width of the density at first and at least, metres
BETA, LEAST_BETA = 0.002, 5e-4


def anisdf_preset(preset: Preset) -> Preset:
    """The preset that stands against the four parts of `preset`: the single network's, with VolSDF's density."""
    single = single_preset(preset)
    part = single.parts[0]
    networks = part.networks
    assert isinstance(networks, TriPlaneNetworks | PaperNetworks), "size demo or paper"
    part = replace(part, networks=replace(networks, displacement=POSE), displacement_reach=0.05)
    return replace(single, parts=(part,), density="volsdf")


class LearnedWidth(TriPlaneGeometry):
    """The demo's geometry with a width of the density that is learned."""

    def __init__(self, networks: TriPlaneNetworks):
        super().__init__(networks)
        self.beta = nn.Parameter(torch.tensor(0.0))

    def density_width(self) -> Float[Tensor, ""]:
        """beta, metres: of order one in its logarithm, whatever the rate that networks learn at."""
        return BETA * (10 * self.beta).exp() + LEAST_BETA


def untrained(preset: Preset, job: PartJob, capture: Capture) -> Untrained:
    """The field, untrained, and the rays of all videos; `preset` is the four parts'."""
    made = single_untrained(preset, job, capture)
    field, networks = made.field, job.settings.networks
    if isinstance(networks, TriPlaneNetworks):
        field.geometry = LearnedWidth(networks).to(job.device)
    code = field.displacement.code
    code.weight.data.copy_(torch.as_tensor(frame_poses(capture), dtype=torch.float32))
    code.requires_grad_(False)
    return made


def frame_poses(capture: Capture) -> Float[Array, "frames 153"]:
    """The pose vector of every frame of every video, in the order of PARTS."""
    poses = []
    for name in PARTS:
        video = capture.videos[name]
        angles = np.tile(BIG_POSE, (len(video.images), 1, 1)) if video.axis_angle is None else video.axis_angle
        poses.append(angles[:, 1:].reshape(-1, POSE))
    return np.concatenate(poses)


def without_width(part: Path) -> None:
    """The weights as the single network has them: who draws a surface asks for no density."""
    content = read_weights(part, "a trained part")
    if content["state"].pop("geometry.beta", None) is not None:
        with whole_file(part) as file:
            torch.save(content, file)


class PoseDisplacement(nn.Module):
    """The displacement of one pose, in the place of a field's mean one."""

    def __init__(self, of_frames: Displacement, axis_angle: Float[Array, "52 3"]):
        super().__init__()
        self.of_frames = of_frames
        self.pose = torch.as_tensor(axis_angle[1:].reshape(1, POSE), dtype=torch.float32)

    def mean(self, unit: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3"]:
        """Metres, at points of the unit box."""
        own = self.of_frames
        inputs = torch.cat([positional_encoding(unit, own.frequencies), self.pose.expand(len(unit), -1)], -1)
        return own.reach * torch.tanh(own.out(own.trunk(inputs)))


class Shown:
    """A trained person as the eval asks for it."""

    def __init__(self, run: Path):
        self.run: Run = read_run(run)
        field = self.run.field.field(0)
        self.displacement = field.displacement
        points = torch.as_tensor(self.run.surface.vertices, dtype=torch.float32)
        with torch.no_grad():
            # where the surface is for F_s, whatever the pose
            self.place = points + field.displacement.mean(field.unit(points))
        self.last: tuple[bytes, PosedField] | None = None

    def in_pose(self, axis_angle: Float[Array, "52 3"]) -> PosedField:
        """The field whose displacement is that of a pose."""
        key = axis_angle[1:].tobytes()
        if self.last is None or self.last[0] != key:
            fused = copy.copy(self.run.field)
            field = fused.field(0)
            own = PoseDisplacement(self.displacement, axis_angle)
            field.displacement = own  # pyright: ignore[reportAttributeAccessIssue]
            # x + dx(x) = place, by iteration: dx changes slowly
            with torch.no_grad():
                points = self.place
                for _ in range(4):
                    points = self.place - own.mean(field.unit(points))
            vertices = points.numpy().astype(np.float64)
            surface = replace(self.run.surface, vertices=vertices)
            self.last = key, PosedField(replace(self.run, surface=surface))
        return self.last[1]

    def draw(
        self, axis_angle: Float[Array, "52 3"], root: Float[Array, "3"], camera: Camera, samples: int = 1,
        where: Bool[Array, "height width"] | None = None, *, raster: Rasteriser,
    ) -> MaskedPicture:  # fmt: skip
        """A picture of its surface in the colors that its own rays see."""
        field = self.in_pose(axis_angle)
        return field.draw(raster, axis_angle, root, camera, samples=samples, directions="own", where=where)

    def surface(self, axis_angle: Float[Array, "52 3"], root: Float[Array, "3"]) -> PosableSurface:
        """The canonical surface as this pose displaces it."""
        return self.in_pose(axis_angle).surface
