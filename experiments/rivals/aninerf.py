"""AniNeRF (Peng et al., "Animatable neural radiance fields for modeling dynamic human bodies", ICCV 2021).

A radiance field of a person in the canonical pose, and a field of blend weights for every frame and for that pose:

    x_can = (sum_k w_i(x)_k B_k)^-1 x                                   its Eq. 3, inverse skinning at every step
    w_i(x) = norm(F_dw(x, psi_i) + w_s(x, S_i))                         Eq. 4; w_s the template's weights
    sigma, z = F_sigma(x_can),  c = F_c(z, d, l_i)                      Eq. 5, 6
    L = L_rgb + sum |w_i(x) - w_can(x_can)|_1                           Eq. 8, 9: the weights agree in both poses

The weights are added in logarithms, as its code does (softmax(log w_s + F_dw)). A novel pose gets a network of weights
of its own, fitted by the second term alone (its section 3.4); the mesh is where the density reaches a threshold, posed
by w_can. Extended by hands, as TotalSelfScan did: 52 bones, four videos.

Beside the publication: the masks are a loss, as for everyone here; w_s at x_can is that of the template sample which x
follows; the canonical pose is the big pose. Size `demo` has tri-planes under F_sigma and F_c, as our demo preset has,
and small networks; its novel poses are fitted in fewer steps.
"""

import copy
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array
from torch import Tensor, nn

from avatar.camera import Camera
from avatar.skeleton import BIG_POSE
from avatar.skinning import strongest_four
from bench.field.posed_field import MaskedPicture, PosableSurface
from capture.folder import read_subject
from capture.template.parts import part_boxes
from experiments.rivals.density import (
    SOLID,
    DensityField,
    Frame,
    FrameCodes,
    NerfColor,
    Person,
    Scene,
    Sections,
    blended,
    density_of,
    draw,
    person_of,
    root_bones,
    solid_mesh,
)
from experiments.rivals.learning import load_field, read_facts_of_rival
from train.deform import positional_encoding
from train.networks.paper import SkipLayers, input_sizes
from train.networks.triplane import TriPlane
from train.preset import PRESETS

CELL = 0.005  # metres, of the mesh
JITTER = 0.01  # metres beside the template where a novel pose's weights are fitted


@dataclass(frozen=True)
class Size:
    """Sizes of the networks."""

    width: int
    layers: int
    color: int  # width of F_c
    frequencies: int
    code: int  # numbers in psi_i and in l_i
    planes: tuple[int, int] = (0, 0)  # texels of the sides of F_sigma's and F_c's planes; 0: none
    fitting: int = 60  # steps of a novel pose


SIZES = {"paper": Size(256, 8, 256, 10, 128, fitting=2000), "demo": Size(64, 3, 128, 6, 16, planes=(320, 500))}


def trunk(inputs: int, width: int, layers: int) -> SkipLayers:
    """ReLU layers, the input again in the middle."""
    return SkipLayers([nn.Linear(size, width) for size in input_sizes(inputs, width, layers)], torch.relu)


class BlendWeights(nn.Module):
    """w(x): the template's weights, changed by a network of the point and a pose's code."""

    def __init__(self, poses: int, size: Size):
        super().__init__()
        self.frequencies = size.frequencies
        self.code = nn.Embedding(poses, size.code)
        nn.init.normal_(self.code.weight, std=0.1)
        self.trunk = trunk(3 + 6 * size.frequencies + size.code, size.width, size.layers)
        self.change = nn.Linear(size.width, 52)
        # it begins with the template's
        nn.init.zeros_(self.change.weight)
        nn.init.zeros_(self.change.bias)

    def forward(self, points: Float[Tensor, "n 3"], pose: int, given: Float[Tensor, "n 52"]) -> Float[Tensor, "n 52"]:
        code = self.code.weight[pose].expand(len(points), -1)
        hidden = self.trunk(torch.cat([positional_encoding(points, self.frequencies), code], -1))
        return torch.softmax((given + 1e-9).log() + self.change(hidden), -1)


def unposed(points: Float[Tensor, "n 3"], M: Float[Tensor, "n 3 4"]) -> tuple[Tensor, Float[Tensor, "n 3 3"]]:
    """Points under the inverses of the transforms, and the inverses' linear parts, by the adjugate."""
    a, b, c = M[:, :, 0], M[:, :, 1], M[:, :, 2]
    bc = torch.linalg.cross(b, c)
    det = (a * bc).sum(-1)
    det = torch.where(det.abs() > 0.02, det, 1.0)
    inverse = torch.stack([bc, torch.linalg.cross(c, a), torch.linalg.cross(a, b)], 1) / det[:, None, None]
    return (inverse @ (points - M[:, :, 3])[:, :, None])[..., 0], inverse


class AniNerf(DensityField):
    """The canonical field and the blend weights of every frame; pose 0 of the weights is the canonical one."""

    low: Float[Tensor, "3"]
    high: Float[Tensor, "3"]

    def __init__(self, person: Person, frames: int, size: Size):
        super().__init__()
        extent = part_boxes(person.subject)[0].extent
        self.register_buffer("low", torch.tensor(extent.low, dtype=torch.float32))
        self.register_buffer("high", torch.tensor(extent.high, dtype=torch.float32))
        self.skin, self.frequencies = person.skin, size.frequencies
        self.weights, self.codes = BlendWeights(frames + 1, size), FrameCodes(frames, size.code)
        self.planes, self.color_planes = (TriPlane(8, side) if side else None for side in size.planes)
        given = 24 if self.planes is not None else 0
        self.trunk = trunk(3 + 6 * size.frequencies + given, size.width, size.layers)
        self.density = nn.Linear(size.width, 1)
        self.color = NerfColor(size.width + given, size.code, size.color)

    def canonical(self, points: Float[Tensor, "n 3"]) -> tuple[Float[Tensor, "n"], Float[Tensor, "n z"]]:
        """Density per metre, and features, at canonical points."""
        unit = (points - self.low) / (self.high - self.low) * 2 - 1
        inputs = [positional_encoding(points, self.frequencies)]
        inputs += [] if self.planes is None else [self.planes(unit)]
        hidden = self.trunk(torch.cat(inputs, -1))
        feature = hidden if self.color_planes is None else torch.cat([hidden, self.color_planes(unit)], -1)
        return density_of(self.density(hidden)[:, 0]), feature

    def sections(self, points: Float[Tensor, "b k 3"], frame: Frame) -> Sections:
        return self.sections_by(self.weights, frame.number + 1, points, frame)

    def sections_by(self, weights: BlendWeights, pose: int, points: Float[Tensor, "b k 3"], frame: Frame) -> Sections:
        """As `sections`, by the blend weights of one pose."""
        b, k, _ = points.shape
        flat, row = points.reshape(-1, 3), frame.row[:, :k].reshape(-1)
        given = self.skin.dense(row)
        w = weights(flat, pose, given)
        canonical, inverse = unposed(flat, blended(w, frame.bones))
        density, feature = self.canonical(canonical)
        direction = (inverse @ frame.direction.repeat_interleave(k, 0)[:, :, None])[..., 0]
        direction = nn.functional.normalize(direction, dim=-1)
        color = self.color(feature, self.codes(frame.number, b * k), direction)
        extra = None
        if torch.is_grad_enabled():
            solid = (density.detach() > SOLID).nonzero()[:, 0]
            agreed = self.weights(canonical[solid], 0, given[solid])
            extra = (w[solid] - agreed).abs().sum(-1).sum() / max(len(solid), 1)
        return Sections(density.view(b, k), color.view(b, k, 3), extra)

    def settle(self, body_frames: int) -> None:
        self.codes.settle(body_frames)


class OnePose(DensityField):
    """The person in a pose that no video has, with blend weights fitted to it."""

    def __init__(self, field: AniNerf, weights: BlendWeights):
        super().__init__()
        self.field, self.weights = field, weights

    def sections(self, points: Float[Tensor, "b k 3"], frame: Frame) -> Sections:
        return self.field.sections_by(self.weights, 0, points, frame)


def fitted_weights(field: AniNerf, person: Person, bones: Float[Tensor, "52 3 4"], steps: int) -> BlendWeights:
    """Blend weights of a novel pose: those under which points near its template go where w_can agrees (section 3.4)."""
    weights = copy.deepcopy(field.weights).requires_grad_(True)
    optimiser = torch.optim.Adam(weights.parameters(), lr=5e-4)
    generator = torch.Generator().manual_seed(0)
    at = torch.as_tensor(person.cloud.points, dtype=torch.float32)
    for _ in range(steps):
        row = torch.randint(len(at), (2048,), generator=generator)
        given = field.skin.dense(row)
        M = blended(given, bones)
        place = (M[:, :, :3] @ at[row][:, :, None])[..., 0] + M[:, :, 3]
        place = place + JITTER * torch.randn(place.shape, generator=generator)
        w = weights(place, 0, given)
        canonical, _ = unposed(place, blended(w, bones))
        loss = (w - field.weights(canonical, 0, given)).abs().sum(-1).mean()
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        optimiser.step()
    return weights.eval().requires_grad_(False)


def untrained(scene: Scene, size: str) -> AniNerf:
    """The field before its first step."""
    return AniNerf(scene.person, len(scene.frames), SIZES[size])


class Shown:
    """A trained person as the eval asks for it."""

    def __init__(self, run: Path):
        facts = read_facts_of_rival(run)
        self.size = SIZES[facts["size"]]
        subject = read_subject(run / "subject.npz")
        self.person = person_of(subject, PRESETS["paper" if facts["size"] == "paper" else "demo"])
        self.field = AniNerf(self.person, int(facts["frames"]), self.size)
        load_field(run, self.field)
        self.in_pose = cache(self._in_pose)
        self.canonical: PosableSurface | None = None

    def _in_pose(self, angles: bytes) -> OnePose:
        bones = root_bones(np.frombuffer(angles).reshape(52, 3), self.person.subject.joints)
        matrix = torch.as_tensor(bones[:, :3], dtype=torch.float32)
        return OnePose(self.field, fitted_weights(self.field, self.person, matrix, self.size.fitting))

    def draw(
        self, axis_angle: Float[Array, "52 3"], root: Float[Array, "3"], camera: Camera, samples: int = 1,
        where: Bool[Array, "height width"] | None = None,
    ) -> MaskedPicture:  # fmt: skip
        """A picture by volume rendering; one ray a pixel, whatever `samples` says."""
        pose = np.concatenate([np.zeros((1, 3)), axis_angle[1:]])
        return draw(self.in_pose(pose.tobytes()), self.person, (axis_angle, root), camera, where)

    def surface(self, axis_angle: Float[Array, "52 3"], root: Float[Array, "3"]) -> PosableSurface:
        """The canonical mesh with the canonical weights."""
        if self.canonical is None:
            field = self.field
            density = lambda points, row: field.canonical(points)[0]
            cloud = self.person.cloud
            vertices, faces = solid_mesh(cloud, np.tile(np.eye(4), (52, 1, 1)), self.person.bands, CELL, density)
            row: Int[Array, "n"] = cloud.tree.query(vertices)[1]
            with torch.no_grad():
                given = field.skin.dense(torch.as_tensor(row))
                weights = field.weights(torch.as_tensor(vertices, dtype=torch.float32), 0, given).numpy()
            skin = strongest_four(weights)
            self.canonical = PosableSurface(vertices, faces, skin, self.person.subject.joints, BIG_POSE)
        return self.canonical
