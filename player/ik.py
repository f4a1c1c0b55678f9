"""Two-bone inverse kinematics: hands and feet go to a point, elbow or knee bends as it did.

The middle joint lies on the circle that the two bones' lengths leave (law of cosines); the pole says where on it.
With a the upper bone, b the lower one and d the distance from first joint to target, kept in [|a - b|, a + b],

    cos(alpha) = (a^2 + d^2 - b^2) / (2 a d)        alpha between upper bone and the line to the target

A limb that is bent keeps the side it bends to. One that is nearly straight has no side worth keeping (rest poses
bend knees sideways by some degrees): the more it is bent, the more it bends as anatomy does.

Each bone is turned by the rotation that takes its old direction and the old bending plane to the new ones, so
the twists of both bones along themselves stay relative to that plane, and a target at the present place changes
nothing. Out of reach, the end comes as near as it can: on the line to the target, stretched or folded.
"""

from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from avatar.rotation import axis_angle_from_matrix, rotation_between
from avatar.skeleton import JOINTS, PARENTS, joint_transforms

Array = np.ndarray

# a rest pose bends its knees and elbows up to 8 degrees, any way
STRAIGHT, BENT = np.radians([8.0, 20.0])
TINY = 1e-9  # metres


class Limb(NamedTuple):
    """First, middle and end joint, and where the middle one points when the limb is straight."""

    first: int
    middle: int
    end: int
    # in the first joint's frame: knees forwards, elbows backwards
    pole: tuple[float, float, float]


def _limb(side: str, chain: tuple[str, str, str], pole: tuple[float, float, float]) -> Limb:
    first, middle, end = (JOINTS.index(f"{side}_{joint}") for joint in chain)
    return Limb(first, middle, end, pole)


LIMBS = {
    f"{side}_{name}": _limb(side, chain, pole)
    for side in ("left", "right")
    for name, chain, pole in (
        ("hand", ("shoulder", "elbow", "wrist"), (0.0, 0.0, -1.0)),
        ("foot", ("hip", "knee", "ankle"), (0.0, 0.0, 1.0)),
    )
}


def reach_for(
    axis_angle: Float[Array, "52 3"],
    root: Float[Array, "3"],
    joints: Float[Array, "52 3"],
    limb: str,
    target: Float[Array, "3"],
    *,
    pole: Float[Array, "3"] | None = None,
    end: Literal["world", "follow"] = "world",
) -> Float[Array, "52 3"]:
    """The pose whose wrist or ankle joint is at `target` (world, metres), or as near as the limb reaches.

    pole: world direction, seen from the first joint, that the elbow or knee points to; None: where it points now,
    carried along with the limb. end: "world" keeps the hand or foot turned as it is in the world, "follow" lets it
    turn with the forearm or shin.

    A target at the shoulder itself has no direction: the limb folds along the one it has. The same start gives a
    continuous answer for a moving target, so a drag is solved from its first pose, not step after step. Opposite
    to where the limb points now, the way round is not unique and the answer jumps.

    Raises:
        ValueError: no such limb, or a number that is not finite.
    """
    if limb not in LIMBS:
        raise ValueError(f"no limb {limb!r}; there are {', '.join(LIMBS)}")
    if not np.isfinite(target).all() or not (pole is None or np.isfinite(pole).all()):
        raise ValueError(f"target {target} and pole {pole} should be finite")
    first, middle, last, straight_pole = LIMBS[limb]
    world = joint_transforms(axis_angle, joints, root)
    rotations, places = world[:, :3, :3], world[:, :3, 3]
    start = places[first]
    upper, lower = places[middle] - start, places[last] - places[middle]
    a, b = float(np.linalg.norm(upper)), float(np.linalg.norm(lower))
    if min(a, b) < TINY:
        raise ValueError(f"{limb} has a bone of no length")

    line = _direction(places[last] - start, upper)
    present = _across(upper, line, rotations[first] @ np.array(straight_pole))
    bend = _bend(upper, lower)
    hinge = _hinge_side(present, rotations[first] @ np.array(straight_pole), line, bend)
    span = target - start
    d = float(np.linalg.norm(span))
    aim = span / d if d > TINY else line
    d = float(np.clip(d, abs(a - b), a + b))
    if d > TINY:
        cosine = float(np.clip((a * a + d * d - b * b) / (2 * a * d), -1, 1))
    else:
        # equal bones folded together: any plane through the pole will do
        cosine = 0.0
    sine = np.sqrt(1 - cosine * cosine)

    carried = rotation_between(line, aim)
    new_hinge = carried @ hinge
    if pole is None:
        new_bend = np.arccos(np.clip((d * d - a * a - b * b) / (2 * a * b), -1, 1))
        towards = _smoothstep(float(new_bend - bend) / float(BENT - STRAIGHT))
        turn = towards * np.arctan2(np.cross(present, hinge) @ line, present @ hinge)
        pole = carried @ (np.cos(turn) * present + np.sin(turn) * np.cross(line, present))
        pole = _across(pole, aim, new_hinge)
    else:
        pole = new_hinge = _across(pole, aim, new_hinge)
    new_upper = a * (cosine * aim + sine * pole)
    new_lower = d * aim - new_upper
    old_normal, new_normal = np.cross(line, hinge), np.cross(aim, new_hinge)
    turn_upper = _frame(new_upper, new_normal) @ _frame(upper, old_normal).T
    turn_lower = _frame(new_lower, new_normal) @ _frame(lower, old_normal).T

    out = np.array(axis_angle, np.float64)
    upper_world, lower_world = turn_upper @ rotations[first], turn_lower @ rotations[middle]
    out[first] = axis_angle_from_matrix(rotations[PARENTS[first]].T @ upper_world)
    out[middle] = axis_angle_from_matrix(upper_world.T @ lower_world)
    if end == "world":
        out[last] = axis_angle_from_matrix(lower_world.T @ rotations[last])
    return out


def reach_distance(joints: Float[Array, "52 3"], limb: str) -> tuple[float, float]:
    """Shortest and longest distance from first to end joint, metres."""
    first, middle, last, _ = LIMBS[limb]
    a = float(np.linalg.norm(joints[middle] - joints[first]))
    b = float(np.linalg.norm(joints[last] - joints[middle]))
    return abs(a - b), a + b


def _bend(upper: Array, lower: Array) -> float:
    """The angle at the middle joint, 0 when straight."""
    return float(np.arctan2(np.linalg.norm(np.cross(upper, lower)), upper @ lower))


def _hinge_side(present: Array, straight: Array, line: Array, bend: float | int) -> Float[Array, "3"]:
    """The side that the middle joint's hinge opens to: the anatomical one of a straight limb, the present of a bent."""
    share = _smoothstep(float(bend - STRAIGHT) / float(BENT - STRAIGHT))
    anatomical = _across(straight, line, present)
    return _across(share * present + (1 - share) * anatomical, line, anatomical)


def _smoothstep(t: float | int) -> float:
    t = min(max(float(t), 0.0), 1.0)
    return t * t * (3 - 2 * t)


def _across(v: Array, line: Array, otherwise: Array) -> Float[Array, "3"]:
    """The unit vector of v's part across the unit vector `line`; of `otherwise` where v lies along it."""
    for candidate in (v, otherwise, np.eye(3)[np.argmin(np.abs(line))]):
        part = candidate - line * (candidate @ line)
        length = float(np.linalg.norm(part))
        if length > 1e-7 * max(float(np.linalg.norm(candidate)), TINY):
            part = part / length
            # once more: what the first left is large beside a short part
            part = part - line * (part @ line)
            return part / np.linalg.norm(part)
    raise AssertionError("an axis lies across every line")


def _direction(v: Array, otherwise: Array) -> Float[Array, "3"]:
    length = float(np.linalg.norm(v))
    return v / length if length > TINY else otherwise / np.linalg.norm(otherwise)


def _frame(bone: Array, normal: Array) -> Float[Array, "3 3"]:
    """Rotation whose first column is the bone's direction, its second the plane's normal made square to it."""
    x = bone / np.linalg.norm(bone)
    y = _across(normal, x, normal)
    return np.stack([x, y, np.cross(x, y)], -1)
