"""Spring bones of an avatar: chains of joints that hang on the 52 and swing, as a .vrm tells them.

A bone has a head, which its parent bone or a joint of the body carries, and a tail, which swings about it at a fixed
distance. The numbers mean what VRMC_springBone 1.0 says, whose step of each frame is

    tail += (1 - drag) (tail - tail of the frame before) + seconds (stiffness rest direction + gravity)

player/spring_chains.py says what they are in seconds instead of frames. Canonical frame, metres.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

# bones and colliders of an avatar, at most; player/loose_parts.py, PARTICLES
MOST_BONES, MOST_COLLIDERS = 300, 200
# metres a second, each frame: stiffness and gravity of a file stay far below
STRONGEST = 1e4


@dataclass(frozen=True)
class Springs:
    """The spring bones of a level of detail, parents before their children."""

    heads: Float[np.ndarray, "bones 3"]
    tails: Float[np.ndarray, "bones 3"]
    # of the 52, that carries it while nothing swings
    joints: Int[np.ndarray, "bones"]
    # bone that carries its head; -1: the joint does
    parents: Int[np.ndarray, "bones"]
    # metres a second that are added each frame of 1/60 s, towards where the parent bone has it at rest
    stiffness: Float[np.ndarray, "bones"]
    # the same, of gravity; world
    gravity: Float[np.ndarray, "bones 3"]
    # part of the velocity that a frame takes
    drag: Float[np.ndarray, "bones"]
    # joint whose motion is no motion for it; -1: velocities are the world's
    centers: Int[np.ndarray, "bones"]
    # of the tail, metres
    radii: Float[np.ndarray, "bones"]
    # capsules that tails keep out of: joint that carries each, both ends of the line in its middle, metres
    collider_joints: Int[np.ndarray, "colliders"]
    collider_ends: Float[np.ndarray, "2 colliders 3"]
    collider_radii: Float[np.ndarray, "colliders"]
    # whether a tail heeds a collider
    heeds: Bool[np.ndarray, "bones colliders"]
    # of each vertex: four tails and how far it follows each
    near: Int[np.ndarray, "vertices 4"]
    follows: Float[np.ndarray, "vertices 4"]

    def __len__(self) -> int:
        return len(self.heads)

    def with_followers(
        self, near: Int[np.ndarray, "vertices 4"], follows: Float[np.ndarray, "vertices 4"]
    ) -> "Springs":
        """The same bones of another level of detail."""
        return replace(self, near=near, follows=follows)


def check_springs(springs: Springs, vertices: int, where: str) -> None:
    """Refuse springs that break a promise of `Springs`, with a ValueError that says which."""
    count, fields = len(springs), vars(springs)
    if not 0 < count <= MOST_BONES:
        raise ValueError(f"{where} should be 1 to {MOST_BONES} bones, are {count}")
    for name, values in fields.items():
        if values.dtype.kind == "f" and not (np.abs(values) <= STRONGEST).all():
            raise ValueError(f"{where}.{name} should be finite and at most {STRONGEST:g}, is not")
    _within(fields, "joints", 0, 52, where)
    _within(fields, "centers", -1, 52, where)
    _within(fields, "collider_joints", 0, 52, where)
    _within(fields, "near", 0, count, where)
    if not ((springs.parents >= -1) & (springs.parents < np.arange(count))).all():
        raise ValueError(f"{where}.parents should stand before their children, do not")
    for name in ("stiffness", "radii", "collider_radii"):
        if (fields[name] < 0).any():
            raise ValueError(f"{where}.{name} should be from 0, is {fields[name].min()}")
    if not ((springs.drag >= 0) & (springs.drag <= 1)).all():
        raise ValueError(f"{where}.drag should be from 0 to 1, is not")
    if not (np.linalg.norm(springs.tails - springs.heads, axis=1) > 0).all():
        raise ValueError(f"{where}.tails should lie off their heads, do not")
    if len(springs.near) != vertices or len(springs.follows) != vertices:
        raise ValueError(f"{where}.near should have {vertices} rows, has {len(springs.near)}")


def _within(fields: Mapping[str, Any], name: str, low: int, end: int, where: str) -> None:
    values = fields[name]
    if len(values) and not ((values >= low) & (values < end)).all():
        raise ValueError(f"{where}.{name} should be from {low} to {end - 1}, is not")
