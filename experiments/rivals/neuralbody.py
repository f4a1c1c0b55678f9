"""NeuralBody (Peng et al., "Neural Body: implicit neural representations with structured latent codes", CVPR 2021).

    Z = {z_1 ... z_n}, one code a template vertex, posed (its section 3.1); voxels of 5 mm, whose codes are spread by
    sparse convolutions into four volumes of 1, 2, 4 and 8 cm (3.2)
    psi(x, Z, S_t) = the four volumes at x, trilinear
    sigma = M_sigma(psi)                                                      Eq. 2
    c = M_c(psi, gamma_d(d), gamma_x(x), l_t)                                 Eq. 3

There is no canonical surface: a mesh is where the density of one pose reaches a threshold. New poses pose the codes.

No library of sparse convolutions runs on a CPU here, so sites are gathered and scattered in torch: sites and their
neighbours as spconv's SubMConv3d and SparseConv3d (kernel 3, stride 2, padding 1) have them. Beside the publication:
vertices that share a voxel share the mean of their codes; batch normalisation over a frame's sites is layer
normalisation of each site, which does not depend on what else is in the picture; close-ups spread only the codes within
REACH of their rays; place and direction are in the root frame, not the camera's; the masks are a loss, as for everyone
here; 52 bones and four videos, as TotalSelfScan extended it; a template finer than SMPL has a code where SMPL's
vertices would lie. Size `demo` has fewer channels, one convolution a level for two or three, narrower networks, and
codes that learn ten times as fast.
"""

from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float, Int, Int64
from numpy import ndarray as Array
from scipy.spatial import KDTree
from torch import Tensor, nn

from avatar.camera import Camera
from avatar.skeleton import BIG_POSE
from avatar.skinning import skin_points, unskin_points
from bench.field.posed_field import MaskedPicture, PosableSurface
from capture.folder import read_subject
from experiments.rivals.density import (
    DensityField,
    Frame,
    FrameCodes,
    NerfColor,
    Person,
    Scene,
    Sections,
    begin_as_wide,
    blended,
    density_of,
    draw,
    person_of,
    root_bones,
    solid_mesh,
)
from experiments.rivals.learning import load_field, read_facts_of_rival
from train.deform import positional_encoding
from train.preset import PRESETS

VOXEL = 0.005  # metres
CODE = 16  # numbers of a vertex
APART = 0.016  # metres between vertices that have one; SMPL's 6,890 on a body
REACH = 0.3  # metres; the coarsest volume's convolutions reach about as far
CELL = 0.006  # metres, of a mesh


@dataclass(frozen=True)
class Size:
    """Channels of the five levels, convolutions of each, and widths."""

    channels: tuple[int, int, int, int, int]
    convolutions: tuple[int, int, int, int, int]
    width: int
    color: int
    frame_code: int
    # how much faster than everything else the codes learn
    code_rate: float


SIZES = {
    "paper": Size((16, 32, 64, 128, 128), (2, 2, 3, 3, 3), 256, 256, 128, 1.0),
    "demo": Size((16, 16, 16, 32, 32), (1, 1, 1, 1, 1), 64, 128, 16, 10.0),
}

_OFFSETS = torch.tensor(list(product((-1, 0, 1), repeat=3)))
_CORNERS = torch.tensor(list(product((0, 1), repeat=3)))


class Sites(NamedTuple):
    """Occupied voxels of one level: their coordinates, and the number of each in a dense grid, -1 where none is."""

    at: Int[Tensor, "n 3"]
    number: Int[Tensor, "x y z"]

    def numbers(self, at: Int[Tensor, "*m 3"]) -> Int[Tensor, "*m"]:
        """The sites at these coordinates; those that are none get the number behind the last."""
        shape = torch.tensor(self.number.shape)
        inside = ((at >= 0) & (at < shape)).all(-1)
        x, y, z = at.clamp_min(0).minimum(shape - 1).unbind(-1)
        found = self.number[x, y, z]
        return torch.where(inside & (found >= 0), found, len(self.at))

    def coarser(self) -> "Sites":
        """Those of half the resolution that a kernel of 3 with stride 2 reaches from here."""
        shape = [side // 2 + 2 for side in self.number.shape]
        reached = torch.zeros(shape, dtype=torch.bool)
        for up in _CORNERS:
            x, y, z = torch.div(self.at + up, 2, rounding_mode="floor").unbind(-1)
            reached[x, y, z] = True
        return sites_at(reached)


def sites_at(occupied: Bool[Tensor, "x y z"]) -> Sites:
    at = occupied.nonzero()
    number = torch.full(occupied.shape, -1)
    number[occupied] = torch.arange(len(at))
    return Sites(at, number)


def one_of_each_cell(points: Float[Array, "n 3"], cell: float) -> Int64[Array, "m"]:
    """Points, by their numbers, of which no two are in one cell of a grid."""
    return np.sort(np.unique(np.floor(points / cell).astype(np.int64), axis=0, return_index=True)[1])


class SparseConvolution(nn.Module):
    """Kernel 3 on sites: each output site gathers the 27 input sites round it; then normalisation and ReLU."""

    def __init__(self, channels: int, out: int):
        super().__init__()
        self.weight, self.norm = nn.Linear(27 * channels, out, bias=False), nn.LayerNorm(out)
        nn.init.kaiming_normal_(self.weight.weight)

    def forward(self, values: Float[Tensor, "n c"], table: Int[Tensor, "m 27"]) -> Float[Tensor, "m o"]:
        padded = torch.cat([values, values.new_zeros(1, values.shape[1])])
        return torch.relu(self.norm(self.weight(padded[table].flatten(1))))


class Volume(NamedTuple):
    """Features of one level's sites."""

    sites: Sites
    values: Float[Tensor, "n c"]
    cell: float  # metres

    def at(self, points: Float[Tensor, "m 3"]) -> Float[Tensor, "m c"]:
        """Trilinear; nothing is where no site is. Points are metres from site 0, 0, 0."""
        place = points / self.cell
        corner = place.floor().long()
        f = place - corner
        rows = self.sites.numbers(corner[:, None] + _CORNERS)
        weights = torch.where(_CORNERS.bool(), f[:, None], 1 - f[:, None]).prod(-1)
        padded = torch.cat([self.values, self.values.new_zeros(1, self.values.shape[1])])
        return (weights[..., None] * padded[rows]).sum(1)


class NeuralBody(DensityField):
    """Codes of the template's vertices, what spreads them, and what reads them."""

    vertices: Float[Tensor, "v 3"]  # canonical
    skin: Float[Tensor, "v 52"]

    def __init__(self, person: Person, frames: int, size: Size):
        super().__init__()
        subject = person.subject
        kept = one_of_each_cell(subject.vertices, APART)
        self.register_buffer("vertices", torch.tensor(subject.vertices[kept], dtype=torch.float32), persistent=False)
        joints, weights = torch.tensor(subject.skin.joints[kept]).long(), torch.tensor(subject.skin.weights[kept])
        self.register_buffer("skin", torch.zeros(len(joints), 52).scatter_add_(1, joints, weights), persistent=False)
        # Adam's steps are as long whatever a number's size is: what is multiplied afterwards learns faster
        self.code, self.code_rate = nn.Embedding(len(self.vertices), CODE), size.code_rate
        nn.init.normal_(self.code.weight, std=1 / size.code_rate)
        levels, before = [], CODE
        for count, channels in zip(size.convolutions, size.channels, strict=True):
            # the first of a level but the finest halves the resolution
            first = [] if not levels else [SparseConvolution(before, channels)]
            same = [SparseConvolution(before if not levels and i == 0 else channels, channels) for i in range(count)]
            levels.append(nn.ModuleList(first + same))
            before = channels
        self.levels, self.codes = nn.ModuleList(levels), FrameCodes(frames, size.frame_code)
        inputs, width = sum(size.channels[1:]), size.width
        self.trunk = nn.Sequential(nn.Linear(inputs, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU(),
                                   nn.Linear(width, width), nn.ReLU())  # fmt: skip
        self.density = nn.Linear(width, 1)
        self.color = NerfColor(width, size.frame_code, size.color, beside=63)
        begin_as_wide(self.trunk, 2.0)
        # the volumes of the pose that was asked last, where nothing is learned
        self.last: tuple[Tensor | None, tuple[Tensor, list[Volume]] | None] = None, None

    def volumes(
        self, bones: Float[Tensor, "52 3 4"], box: tuple[Tensor, Tensor] | None
    ) -> tuple[Float[Tensor, "3"], list[Volume]]:
        """Place of site 0, 0, 0 and the four volumes of a pose; `box`: of the codes in it alone."""
        M = blended(self.skin, bones)
        posed = (M[:, :, :3] @ self.vertices[:, :, None])[..., 0] + M[:, :, 3]
        code = self.code_rate * self.code.weight
        if box is not None:
            near = ((posed > box[0] - REACH) & (posed < box[1] + REACH)).all(1)
            posed, code = posed[near], code[near]
        # a multiple of the coarsest voxel, so that a pose has the same voxels in every crop
        coarsest = 16 * VOXEL
        low = coarsest * (posed.amin(0) / coarsest - 2).floor()
        at = ((posed - low) / VOXEL).round().long()
        occupied = torch.zeros((at.amax(0) + 3).tolist(), dtype=torch.bool)
        occupied[at[:, 0], at[:, 1], at[:, 2]] = True
        sites = sites_at(occupied)
        number = sites.numbers(at)
        values = code.new_zeros(len(sites.at), CODE).index_add(0, number, code)
        values = values / torch.bincount(number, minlength=len(sites.at))[:, None]
        out, cell = [], VOXEL
        for index, level in enumerate(self.levels):
            assert isinstance(level, nn.ModuleList)
            convolutions = list(level)
            if index:
                finer, sites, cell = sites, sites.coarser(), 2 * cell
                values = convolutions.pop(0)(values, finer.numbers(2 * sites.at[:, None] + _OFFSETS))
            table = sites.numbers(sites.at[:, None] + _OFFSETS)
            for convolution in convolutions:
                values = convolution(values, table)
            out.append(Volume(sites, values, cell))
        return low, out[1:]

    def asked(self, points: Float[Tensor, "n 3"], bones: Float[Tensor, "52 3 4"]) -> Float[Tensor, "n w"]:
        """Hidden features at points of the root frame."""
        if torch.is_grad_enabled():
            found, self.last = self.volumes(bones, (points.amin(0), points.amax(0))), (None, None)
        else:
            if self.last[0] is not bones or self.last[1] is None:
                self.last = bones, self.volumes(bones, None)
            found = self.last[1]
            assert found is not None
        low, volumes = found
        return self.trunk(torch.cat([volume.at(points - low) for volume in volumes], -1))

    def sections(self, points: Float[Tensor, "b k 3"], frame: Frame) -> Sections:
        b, k, _ = points.shape
        flat = points.reshape(-1, 3)
        hidden = self.asked(flat, frame.bones)
        direction, place = frame.direction.repeat_interleave(k, 0), positional_encoding(flat, 10)
        color = self.color(hidden, self.codes(frame.number, b * k), direction, place)
        return Sections(density_of(self.density(hidden)[:, 0]).view(b, k), color.view(b, k, 3))

    def settle(self, body_frames: int) -> None:
        self.codes.settle(body_frames)


def untrained(scene: Scene, size: str) -> NeuralBody:
    """The field before its first step."""
    return NeuralBody(scene.person, len(scene.frames), SIZES[size])


class Shown:
    """A trained person as the eval asks for it."""

    def __init__(self, run: Path):
        facts = read_facts_of_rival(run)
        subject = read_subject(run / "subject.npz")
        self.person = person_of(subject, PRESETS["paper" if facts["size"] == "paper" else "demo"])
        self.field = NeuralBody(self.person, int(facts["frames"]), SIZES[facts["size"]])
        load_field(run, self.field)

    def draw(
        self, axis_angle: Float[Array, "52 3"], root: Float[Array, "3"], camera: Camera, samples: int = 1,
        where: Bool[Array, "height width"] | None = None,
    ) -> MaskedPicture:  # fmt: skip
        """A picture by volume rendering; one ray a pixel, whatever `samples` says."""
        return draw(self.field, self.person, (axis_angle, root), camera, where)

    def surface(self, axis_angle: Float[Array, "52 3"], root: Float[Array, "3"]) -> PosableSurface:
        """The mesh of this pose, unskinned by the nearest posed samples so that the pose gives it back."""
        cloud, joints = self.person.cloud, self.person.subject.joints
        bones = root_bones(axis_angle, joints)
        matrix = torch.as_tensor(bones[:, :3], dtype=torch.float32)
        density = lambda points, row: density_of(self.field.density(self.field.asked(points, matrix))[:, 0])
        vertices, faces = solid_mesh(cloud, bones, self.person.bands, CELL, density)
        nearest = np.asarray(KDTree(skin_points(cloud.points, cloud.skin, bones)).query(vertices)[1])
        skin = cloud.skin.of(nearest)
        canonical, ok = unskin_points(vertices, skin, bones)
        return PosableSurface(np.where(ok[:, None], canonical, vertices), faces, skin, joints, BIG_POSE)
