"""A person of capsules: an analytic signed distance with 52 joints, a head and ten fingers, coloured by formula.

It stands in for a trained run, so that baking is tested without training: same interface, exact distance.
"""

from dataclasses import dataclass

import numpy as np
import torch
import trimesh

from avatar.body import builtin_body
from avatar.skeleton import BIG_POSE, LEFT_HAND, PARENTS, RIGHT_HAND, joint_transforms
from avatar.skinning import SkinWeights
from capture.folder import CaptureSubject
from geometry.isosurface import GridSteps, Hints, extract
from geometry.mesh import TriangleMesh
from train.fused import CanonicalField
from train.run import BakeSource
from train.surface import Surface

BODY, HEAD, LEFT, RIGHT = range(4)


def bone_radius(joint: int) -> float:
    if joint >= 22:
        return 0.011
    return {1: 0.10, 2: 0.10, 3: 0.11, 6: 0.12, 9: 0.12, 4: 0.08, 5: 0.08, 12: 0.07, 15: 0.06}.get(joint, 0.045)


@dataclass
class CapsuleField:
    """d(x) = smooth minimum over capsules of |x - nearest point of the bone| - radius."""

    starts: torch.Tensor
    ends: torch.Tensor
    radii: torch.Tensor
    sheen: float = 0.0

    def each(self, points):
        along = self.ends - self.starts
        t = ((points[:, None] - self.starts) * along).sum(-1) / along.square().sum(-1).clamp_min(1e-9)
        nearest = self.starts + t.clamp(0, 1)[..., None] * along
        return ((points[:, None] - nearest).square().sum(-1) + 1e-12).sqrt() - self.radii

    def distance(self, points):
        return -0.002 * torch.logsumexp(-self.each(points) / 0.002, 1)

    def normal(self, points):
        points = points.detach().requires_grad_()
        (gradient,) = torch.autograd.grad(self.distance(points).sum(), points)
        return torch.nn.functional.normalize(gradient, dim=1)

    def color(self, points, directions):
        waves = 0.5 + 0.2 * torch.sin(points * torch.tensor([9.0, 14.0, 11.0])) * torch.cos(points[:, [1, 2, 0]] * 17)
        if self.sheen:
            mirrored = (self.normal(points) * directions).sum(-1, keepdim=True).clamp(-1, 0).square()
            side = (directions * torch.tensor([0.6, 0.3, 0.74])).sum(-1, keepdim=True)
            waves = waves + self.sheen * (mirrored - 0.5) * (0.6 + 0.4 * side) * torch.tensor([1.0, 0.9, 0.7])
        return waves.clamp(0, 1)


def capsule_field(sheen: float = 0.0) -> tuple[CapsuleField, np.ndarray, np.ndarray]:
    """The field, its joints in pose 0, and the joint that drives each capsule."""
    joints = builtin_body("male").joints
    canonical = joint_transforms(BIG_POSE, joints, np.zeros(3))[:, :3, 3]
    bones = [(PARENTS[j], j) for j in range(1, 52) if PARENTS[j] not in (0,) or j == 3]
    bones += [(1, 4), (2, 5)]
    bones = sorted(set(bones))
    starts = np.array([canonical[a] for a, _ in bones] + [canonical[1], canonical[15]])
    ends = np.array([canonical[b] for _, b in bones] + [canonical[2], canonical[15] + [0, 0.13, 0.02]])
    owners = np.array([a for a, _ in bones] + [0, 15])
    radii = np.array([bone_radius(b) if b < 20 or b >= 22 else 0.035 for _, b in bones] + [0.1, 0.1])
    for tip in [j for j in range(22, 52) if j not in set(PARENTS.tolist())]:
        forward = canonical[tip] - canonical[PARENTS[tip]]
        starts = np.concatenate([starts, canonical[tip][None]])
        ends = np.concatenate([ends, (canonical[tip] + 0.8 * forward)[None]])
        owners, radii = np.append(owners, tip), np.append(radii, 0.010)
    as_torch = [torch.tensor(a, dtype=torch.float32) for a in (starts, ends, radii)]
    return CapsuleField(*as_torch, sheen=sheen), joints, owners


def make_run(sheen: float = 0.0, step: float = 0.010, fine: float = 0.005) -> BakeSource:
    field, joints, owners = capsule_field(sheen)

    def distance(points):
        return field.distance(torch.tensor(points, dtype=torch.float32)).numpy().astype(float)

    def normal(points):
        return field.normal(torch.tensor(points, dtype=torch.float32)).numpy().astype(float)

    canonical = joint_transforms(BIG_POSE, joints, np.zeros(3))[:, :3, 3]
    hints = np.concatenate([canonical, field.starts.numpy() + field.radii.numpy()[:, None], field.ends.numpy()])
    box = np.array([canonical.min(0) - 0.2, canonical.max(0) + [0.2, 0.35, 0.2]])
    hand = np.r_[LEFT_HAND, RIGHT_HAND]
    grid = np.concatenate([hints, box])
    fine_mask = np.isin(np.arange(len(grid)), hand)
    found = extract(distance, normal, Hints(grid, fine_mask), GridSteps(step, fine), margin=0.05)
    vertices, faces = found.mesh

    each = field.each(torch.tensor(vertices, dtype=torch.float32)).numpy()
    soft = np.exp(-(each - each.min(1, keepdims=True)) / 0.01)
    dense = np.zeros((len(vertices), 52))
    np.add.at(dense.T, owners, soft.T)
    order = np.argsort(-dense, 1, kind="stable")[:, :4]
    weights = np.take_along_axis(dense, order, 1)
    part = np.zeros(len(vertices), np.uint8)
    part[vertices[:, 1] > canonical[15, 1] + 0.01] = HEAD
    part[vertices[:, 0] > canonical[20, 0]] = LEFT
    part[vertices[:, 0] < canonical[21, 0]] = RIGHT

    # seen by a camera going round: against the normal, in the horizontal plane; soles and crown never
    flat = -found.normals * [1, 0.2, 1]
    seen = np.abs(found.normals[:, 1]) < 0.95
    mean = np.where(seen[:, None], 0.9 * flat / np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-9), 0)
    across = np.cross(mean, [0, 1.0, 0])
    variance = 0.15 * across[:, :, None] * across[:, None, :] + 0.01 * np.diag([0, 1.0, 0])
    surface = Surface(
        vertices=vertices,
        faces=faces,
        normals=found.normals,
        part=part.astype(np.int64),
        skin=SkinWeights(order, (weights / weights.sum(1, keepdims=True)).astype(np.float32)),
        view_count=np.where(seen, 40.0, 0.0),
        view_mean=mean,
        view_covariance=variance.reshape(-1, 9)[:, [0, 1, 2, 4, 5, 8]],
        layer=np.zeros(len(part), np.int64),
    )
    nobody = np.zeros(len(vertices), bool)
    subject = CaptureSubject("capsules", vertices, vertices, faces, surface.skin, joints, surface.part, nobody)
    functions = CanonicalField(field.distance, field.normal, field.color)
    return BakeSource(functions, surface, subject, {"subject": "capsules", "preset": "analytic"})


def sphere(radius: float, centre=(0.0, 0.0, 0.0)):
    """Exact distance and normal of a ball, as NumPy functions."""
    centre = np.asarray(centre)

    def distance(points):
        return np.linalg.norm(points - centre, axis=1) - radius

    def normal(points):
        return (points - centre) / np.maximum(np.linalg.norm(points - centre, axis=1, keepdims=True), 1e-12)

    return distance, normal


def ball_mesh(radius: float = 0.1, step: float = 0.01) -> TriangleMesh:
    distance, normal = sphere(radius)
    corners = radius * np.array([[-1.0, -1, -1], [1, 1, 1]])
    return extract(distance, normal, Hints(corners, np.zeros(2, bool)), GridSteps(step, step)).mesh


def icosphere(radius, centre=(0.0, 0.0, 0.0), subdivisions=3):
    """Vertices and faces of a sphere."""
    mesh = trimesh.creation.icosphere(subdivisions, radius)
    return np.asarray(mesh.vertices) + centre, np.asarray(mesh.faces)


EGG = np.array([0.07, 0.11, 0.09])


def egg(count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Points and normals of an ellipsoid of a head's size with three different axes, metres."""
    d = np.random.default_rng(seed).normal(size=(count, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    normals = d / EGG
    return d * EGG, normals / np.linalg.norm(normals, axis=1, keepdims=True)
