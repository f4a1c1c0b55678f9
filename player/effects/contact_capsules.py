"""A body as capsules along its bones, and how much of the sky above a surface they hide: contact darkening.

The part of the cosine-weighted hemisphere over a point with normal n that a ball of radius r at distance l hides, seen
whole, is (Quilez 2006, "Sphere ambient occlusion")

    o = max(n . d / l, 0) r^2 / l^2            d: towards its middle

A capsule counts as the ball at its point nearest to the surface. Several let (1 - o_1) (1 - o_2) ... through. What lies
in a texture already is how dark a surface is in the pose that it rests in, so a body's surface shows its own openness
divided by that of rest. A surface is never hidden by its own bone or those next to it. Mirrored by contact.glsl.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt32
from numpy import ndarray as Array

from avatar.baked_avatar import Avatar, Level
from avatar.skeleton import JOINTS, PARENTS, joint_transforms
from player.draw.posing import PosedBones

WITHIN = 20.0  # percent of the distances from surface to bone: thin enough to stay inside the body
CROWN = 0.12  # metres of a head above its joint
# less than this share of the hemisphere is left out, so that what a capsule darkens has an end
LEAST = 0.03


def _bones() -> tuple[tuple[int, int], ...]:
    """Joint that moves a capsule, and the joint at its other end; the head's has none."""
    names = [("spine1", "spine2"), ("spine3", "neck"), ("head", "head")]
    for side in ("left", "right"):
        chains = (("hip", "knee"), ("knee", "ankle"), ("ankle", "foot"), ("shoulder", "elbow"), ("elbow", "wrist"))
        names += [(f"{side}_{a}", f"{side}_{b}") for a, b in chains]
        names.append((f"{side}_wrist", f"{side}_middle1"))
    return tuple((JOINTS.index(a), JOINTS.index(b)) for a, b in names)


BONES = _bones()


def _owners() -> np.ndarray:
    """The capsule that stands for each joint: its own, or that of the nearest joint above it that has one."""
    own = {joint: k for k, (joint, _) in enumerate(BONES)}
    # pelvis and spine2 have none of their own
    own |= {0: own[JOINTS.index("spine1")], JOINTS.index("spine2"): own[JOINTS.index("spine3")]}
    out = np.zeros(52, int)
    for joint in range(52):
        out[joint] = own[joint] if joint in own else out[PARENTS[joint]]
    return out


OWNERS = _owners()


@dataclass(frozen=True)
class Capsules:
    """The capsules of one avatar at a level of detail, and what its surface needs of them."""

    starts: Float[Array, "capsules 3"]  # canonical, metres
    ends: Float[Array, "capsules 3"]
    radii: Float[Array, "capsules"]
    # bit k: capsule k does not darken the vertex
    spared: UInt32[Array, "vertices"]
    # openness of each vertex in the pose it rests in
    rest: Float[Array, "vertices"]

    def posed(self, bones: PosedBones) -> tuple[Float[Array, "capsules 3"], Float[Array, "capsules 3"]]:
        """Both ends in view space."""
        moved = bones.view_from_canonical[[joint for joint, _ in BONES], :3]
        return tuple(
            np.einsum("kij,kj->ki", moved[:, :, :3], points) + moved[:, :, 3] for points in (self.starts, self.ends)
        )


def capsules_of(avatar: Avatar, level: Level) -> Capsules:
    """Capsules fitted to a level's surface in its canonical pose."""
    joints = avatar.joint_positions.astype(np.float64)
    at = joint_transforms(avatar.canonical_pose.astype(np.float64), joints)[:, :3, 3]
    starts = np.array([at[a] for a, _ in BONES])
    ends = np.array([at[b] if b != a else at[a] + [0.0, CROWN, 0.0] for a, b in BONES])
    points, normals = level.positions.astype(np.float64), level.normals.astype(np.float64)
    owner, radii = OWNERS[level.skin.heaviest], np.zeros(len(BONES))
    for k in range(len(BONES)):
        mine = points[owner == k]
        if len(mine):
            radii[k] = np.percentile(np.linalg.norm(mine - _nearest(mine, starts[k], ends[k]), axis=1), WITHIN)
    spared = _spared(level)
    rest = openness(points, normals, starts, ends, radii, spared)
    return Capsules(starts, ends, radii, spared, rest)


def openness(
    points: Float[Array, "n 3"], normals: Float[Array, "n 3"],
    starts: Float[Array, "capsules 3"], ends: Float[Array, "capsules 3"], radii: Float[Array, "capsules"],
    spared: UInt32[Array, "n"],
) -> Float[Array, "n"]:  # fmt: skip
    """What the capsules leave of the hemisphere over each point, 0 to 1."""
    out = np.ones(len(points))
    for k, (start, end, radius) in enumerate(zip(starts, ends, radii, strict=True)):
        towards = _nearest(points, start, end) - points
        l2 = (towards * towards).sum(1)
        facing = np.maximum((normals * towards).sum(1) / np.sqrt(np.maximum(l2, 1e-8)), 0)
        hidden = facing * radius**2 / np.maximum(l2, max(radius**2, 1e-8))
        hidden = np.maximum(hidden - LEAST, 0) / (1 - LEAST)
        out *= np.where(spared >> k & 1, 1.0, 1 - hidden)
    return out


def capsule_distances(
    points: Float[Array, "n 3"], starts: Float[Array, "capsules 3"], ends: Float[Array, "capsules 3"]
) -> Float[Array, "n capsules"]:
    """From each point to the line in the middle of each capsule."""
    return np.sqrt(np.maximum(squared_distances(points, starts, ends), 0)).T


def squared_distances(points: Array, starts: Array, ends: Array) -> Float[Array, "capsules n"]:
    """The distances' squares, to rounding.

    |p - s - t a|^2 = |p - s|^2 + t (t - 2 q) |a|^2        q = (p - s) a / |a|^2, t = q between 0 and 1

    |p - s|^2 and q are linear in (p, |p|^2, 1): one product of matrices, the rest in place.
    """
    count = len(starts)
    along = ends - starts
    length2 = np.maximum(np.einsum("ki,ki->k", along, along), 1e-18)[:, None]
    linear = np.empty((2 * count, 5))
    linear[:count, :3] = along
    linear[:count, 3] = 0
    linear[:count, 4] = -np.einsum("ki,ki->k", starts, along)
    linear[:count] /= length2
    linear[count:, :3] = -2 * starts
    linear[count:, 3] = 1
    linear[count:, 4] = np.einsum("ki,ki->k", starts, starts)
    lifted = np.empty((5, len(points)))
    lifted[:3] = points.T
    lifted[3] = np.einsum("ni,ni->n", points, points)
    lifted[4] = 1
    products = linear @ lifted
    q, out = products[:count], products[count:]
    share = np.minimum(np.maximum(q, 0), 1)
    q *= -2
    q += share
    q *= share
    q *= length2
    out += q
    return out


def _nearest(points: Array, start: Array, end: Array) -> Float[Array, "n 3"]:
    along = end - start
    share = np.clip((points - start) @ along / max(float(along @ along), 1e-12), 0, 1)
    return start + share[:, None] * along


def _spared(level: Level) -> UInt32[Array, "vertices"]:
    """The capsules of each vertex's own bones, and those next to them."""
    beside = np.eye(len(BONES), dtype=bool)
    for joint in range(1, 52):
        a, b = OWNERS[joint], OWNERS[PARENTS[joint]]
        beside[a, b] = beside[b, a] = True
    bits = np.array([sum(1 << int(k) for k in np.flatnonzero(row)) for row in beside], np.uint32)
    out = np.zeros(len(level.positions), np.uint32)
    for slot in range(level.joints.shape[1]):
        out |= np.where(level.weights[:, slot] > 0, bits[OWNERS[level.joints[:, slot]]], 0).astype(np.uint32)
    return out
