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
from numpy import ndarray as Array

from avatar.rotation import axis_angle_from_matrix, rotation_between
from avatar.skeleton import JOINTS, PARENTS, joint_transforms

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
    axis_angle: Float[Array, "*poses 52 3"],
    root: Float[Array, "*poses 3"],
    joints: Float[Array, "52 3"],
    limb: str,
    target: Float[Array, "*poses 3"],
    *,
    pole: Float[Array, "*poses 3"] | None = None,
    end: Literal["world", "follow"] = "world",
) -> Float[Array, "*poses 52 3"]:
    """The pose whose wrist or ankle joint is at `target` (world, metres), or as near as the limb reaches.

    Many poses at once cost little more than one: a NumPy call takes longer than its arithmetic.

    pole: world direction, seen from the first joint, that the elbow or knee points to; None: where it points now,
    carried along with the limb. end: "world" keeps the hand or foot turned as it is in the world, "follow" lets it
    turn with the forearm or shin.

    A target at the shoulder itself has no direction: the limb folds along the one it has. The same start gives a
    continuous answer for a moving target, so a drag is solved from its first pose, not step after step. Opposite
    to where the limb points now, the way round is not unique and the answer jumps.

    Raises:
        ValueError: a number that is not finite, or a bone of no length.
    """
    if not np.isfinite(target).all() or not (pole is None or np.isfinite(pole).all()):
        raise ValueError(f"target {target} and pole {pole} should be finite")
    first, middle, last, straight_pole = LIMBS[limb]
    world = joint_transforms(axis_angle, joints, root)
    rotations, places = world[..., :3, :3], world[..., :3, 3]
    start = places[..., first, :]
    upper, lower = places[..., middle, :] - start, places[..., last, :] - places[..., middle, :]
    a, b = _length(upper), _length(lower)
    if min(a.min(initial=np.inf), b.min(initial=np.inf)) < TINY:
        raise ValueError(f"{limb} has a bone of no length")

    straight = rotations[..., first, :, :] @ np.array(straight_pole)
    line = _direction(places[..., last, :] - start, upper)
    present = _across(upper, line, straight)
    bend = np.arctan2(_length(np.cross(upper, lower)), _dot(upper, lower))
    hinge = _hinge_side(present, straight, line, bend)
    span = target - start
    aim = _direction(span, line)
    d = np.clip(_length(span), np.abs(a - b), a + b)
    folded = d <= TINY
    # equal bones folded together: any plane through the pole will do
    cosine = np.where(folded, 0.0, np.clip((a * a + d * d - b * b) / (2 * a * np.where(folded, 1.0, d)), -1, 1))
    sine = np.sqrt(1 - cosine * cosine)

    carried = rotation_between(line, aim)
    new_hinge = _turned(carried, hinge)
    if pole is None:
        new_bend = np.arccos(np.clip((d * d - a * a - b * b) / (2 * a * b), -1, 1))
        towards = smoothstep((new_bend - bend) / (BENT - STRAIGHT))
        turn = towards * np.arctan2(_dot(np.cross(present, hinge), line), _dot(present, hinge))
        pole = np.cos(turn) * present + np.sin(turn) * np.cross(line, present)
        pole = _across(_turned(carried, pole), aim, new_hinge)
    else:
        pole = new_hinge = _across(np.broadcast_to(pole, aim.shape), aim, new_hinge)
    new_upper = a * (cosine * aim + sine * pole)
    new_lower = d * aim - new_upper
    old_normal, new_normal = np.cross(line, hinge), np.cross(aim, new_hinge)
    upper_world = _frame(new_upper, new_normal) @ _frame(upper, old_normal).mT @ rotations[..., first, :, :]
    lower_world = _frame(new_lower, new_normal) @ _frame(lower, old_normal).mT @ rotations[..., middle, :, :]

    parents = [rotations[..., PARENTS[first], :, :], upper_world, lower_world]
    children = [upper_world, lower_world, rotations[..., last, :, :]]
    count = 3 if end == "world" else 2
    turned = np.stack(parents[:count], -3).mT @ np.stack(children[:count], -3)
    out = np.array(axis_angle, np.float64)
    out[..., [first, middle, last][:count], :] = axis_angle_from_matrix(turned)
    return out


def _hinge_side(
    present: Float[Array, "*poses 3"], straight: Float[Array, "*poses 3"], line: Float[Array, "*poses 3"],
    bend: Float[Array, "*poses 1"],
) -> Float[Array, "*poses 3"]:  # fmt: skip
    """The side that the middle joint's hinge opens to: the anatomical one of a straight limb, the present of a bent.

    bend: the angle at the middle joint, 0 when straight.
    """
    share = smoothstep((bend - STRAIGHT) / (BENT - STRAIGHT))
    anatomical = _across(straight, line, present)
    return _across(share * present + (1 - share) * anatomical, line, anatomical)


def smoothstep(t: Float[Array, "*poses 1"] | float) -> Float[Array, "*poses 1"] | float:
    """From 0 at 0 to 1 at 1, flat at both ends."""
    t = np.clip(t, 0.0, 1.0)
    return t * t * (3 - 2 * t)


def _across(
    v: Float[Array, "*poses 3"], line: Float[Array, "*poses 3"], otherwise: Float[Array, "*poses 3"]
) -> Float[Array, "*poses 3"]:
    """The unit vector of v's part across the unit vector `line`; of `otherwise` where v lies along it, of the axis
    that is farthest from the line where that does, too."""
    candidates = np.stack([v, otherwise, np.eye(3)[np.abs(line).argmin(-1)]], -2)
    line = line[..., None, :]
    part = candidates - line * _dot(candidates, line)
    length = _length(part)
    usable = length > 1e-7 * np.maximum(_length(candidates), TINY)
    chosen = usable.argmax(-2)[..., None, :]
    part = np.take_along_axis(part, chosen, -2) / np.take_along_axis(length, chosen, -2)
    # once more: what the first left is large beside a short part
    part = part - line * _dot(part, line)
    return (part / _length(part))[..., 0, :]


def _direction(v: Float[Array, "*poses 3"], otherwise: Float[Array, "*poses 3"]) -> Float[Array, "*poses 3"]:
    length = _length(v)
    usable = length > TINY
    return np.where(usable, v / np.where(usable, length, 1.0), otherwise / _length(otherwise))


def _frame(bone: Float[Array, "*poses 3"], normal: Float[Array, "*poses 3"]) -> Float[Array, "*poses 3 3"]:
    """Rotation whose first column is the bone's direction, its second the plane's normal made square to it."""
    x = bone / _length(bone)
    y = _across(normal, x, normal)
    return np.stack([x, y, np.cross(x, y)], -1)


def _length(v: Float[Array, "*b 3"]) -> Float[Array, "*b 1"]:
    return np.sqrt(_dot(v, v))


def _dot(a: Float[Array, "*#b 3"], b: Float[Array, "*#b 3"]) -> Float[Array, "*b 1"]:
    return (a * b).sum(-1, keepdims=True)


def _turned(rotation: Float[Array, "*b 3 3"], v: Float[Array, "*b 3"]) -> Float[Array, "*b 3"]:
    return (rotation @ v[..., None])[..., 0]
