"""How an avatar's rest bones lie along those of a rig in whose rest pose no person stands, found from its motion.

Bandai Namco's and LaFAN1's rigs have every bone along its own x axis: with all rotations 0 the skeleton is a stick,
and the rest pose says neither where the knees point nor where the chest faces. What does not depend on the rest pose:

    pelvis, chest   sides and height of the body as the joint's own frame sees them, averaged over the motion
    thigh           its direction, and the hinge of the knee: the axis about which the shin swings, averaged
    upper arm       its direction, and the hinge of the elbow
    shin, forearm   passed down: with its rotations 0 a limb is straight
    foot            the direction of the toes, pitched as it is while the ankle is lowest (flat on the ground)
    spine           between pelvis and chest, on average
    neck, collar    as the chest, on average

Frames of torso joints that lie within 25 degrees of the axes are snapped to them: rigs are built that way.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from avatar.motion.rest_pose import Alignment, RestBones, below_elbow, cosine, hinge, snapped
from avatar.motion.rig import AnimatedRig, JointMap
from avatar.rotation import (
    axis_angle_from_matrix,
    axis_name,
    left_up_frame,
    nearest_rotation,
    rotation_part_way,
    unit_or_zero,
)
from command.errors import AssetError

NEAR_AXES = np.radians(25.0)
# mean of the sines of a hinge's angle under which it says nothing, and the share of it that must agree
LEAST_BEND, LEAST_AGREEMENT = 0.05, 0.7
# the share of frames with the ankle lowest, in which the foot stands
LOWEST = 20.0  # percent


class Sampled(NamedTuple):
    """Frames of a rig's motion, spread over it."""

    rotations: Float[Array, "frames joints 3 3"]  # turns away from rest, in the file's world
    places: Float[Array, "frames joints 3"]
    up: Float[Array, "3"]  # up axis of the file's world

    def mean_direction(self, joint: int, a: Array, b: Array) -> Float[Array, "3"]:
        """Mean direction from a to b (frames 3) as the joint's frame sees it."""
        return (np.swapaxes(self.rotations[:, joint], -1, -2) @ unit_or_zero(b - a)[..., None])[..., 0].mean(0)


def calibrated_alignment(
    rig: AnimatedRig, joints: JointMap, sampled: Sampled, ours: Float[Array, "52 3"], notes: list[str]
) -> Alignment:
    """The alignment of a rig that does not rest as a person stands.

    Raises:
        AssetError: the motion does not show where the body's sides are.
    """
    bones, G, at, place = RestBones(rig, joints, ours), sampled.rotations, sampled.places, joints.places
    hips = (at[:, place["left_hip"]] + at[:, place["right_hip"]]) / 2
    shoulders = (at[:, place["left_shoulder"]] + at[:, place["right_shoulder"]]) / 2

    def torso(joint: int, name: str, up: Array) -> Float[Array, "3 3"]:
        left = sampled.mean_direction(joint, at[:, place[f"right_{name}"]], at[:, place[f"left_{name}"]])
        if min(np.linalg.norm(left), np.linalg.norm(up)) < 0.3 or abs(cosine(left, up)) > 0.7:
            raise AssetError(
                f"{rig.path}: the rest pose is no person's, and the motion does not show the sides of "
                f"{rig.names[joint]}; expected a rig that rests in T-pose, or a motion of a standing person"
            )
        return near_axes(left_up_frame(left, up))

    pelvis = torso(joints.pelvis, "hip", sampled.mean_direction(joints.pelvis, hips, shoulders))
    chest = pelvis
    if joints.chest != joints.pelvis:
        chest = torso(joints.chest, "shoulder", sampled.mean_direction(joints.chest, shoulders, at[:, joints.head]))
    notes.append(
        f"rest pose: no person's (all bones along one axis); found from the motion: up {axis_name(pelvis[:, 1])}, "
        f"facing {axis_name(pelvis[:, 2])} of {rig.names[joints.pelvis]}"
    )
    bottom, top = G[:, joints.pelvis] @ pelvis, G[:, joints.chest] @ chest
    column = {joints.pelvis: pelvis, joints.chest: chest}
    for n, joint in enumerate(joints.spine[:-1], start=1):
        between = rotation_part_way(bottom, top, n / len(joints.spine))
        column[joint] = near_axes(_mean_relative(G[:, joint], between))
    for joint in (*joints.neck, joints.head):
        column[joint] = near_axes(_mean_relative(G[:, joint], top))

    A: dict[str, Array] = {}
    for side in ("left", "right"):
        hip, knee, ankle, foot = (f"{side}_{n}" for n in ("hip", "knee", "ankle", "foot"))
        A[hip] = _limb(bones, sampled, (hip, knee, ankle), bottom, notes)
        A[knee] = bones.aligned(A[hip], knee, ankle)
        A[ankle] = A[foot] = _foot(bones, sampled, side, A[knee])
        collar, shoulder, elbow, wrist = (f"{side}_{n}" for n in ("collar", "shoulder", "elbow", "wrist"))
        A[collar] = chest
        if collar in joints.turns:
            A[collar] = near_axes(_mean_relative(G[:, joints.turns[collar]], top))
        if wrist in place:
            A[shoulder] = _limb(bones, sampled, (shoulder, elbow, wrist), top, notes)
        else:
            A[shoulder] = bones.aligned(_mean_relative(G[:, joints.turns[shoulder]], top), shoulder, elbow)
        A |= below_elbow(bones, side, A[shoulder])
    return Alignment(A, column)


def _limb(
    bones: RestBones, sampled: Sampled, chain: tuple[str, str, str], above: Array, notes: list[str]
) -> Float[Array, "3 3"]:
    """A of a thigh or upper arm: its direction, and its hinge; where that never bends, as the body on average."""
    turn, (joint, end) = bones.joints.turns[chain[0]], (bones.joints.places[name] for name in chain[1:])
    lower = unit_or_zero(sampled.places[:, end] - sampled.places[:, joint])[..., None]
    # how far the lower bone has swung from where it lies with its rotations 0, as the upper one's frame sees it
    straight = unit_or_zero(bones.rig_bone(chain[1], chain[2]))
    hinges = np.cross(straight, (np.swapaxes(sampled.rotations[:, turn], -1, -2) @ lower)[..., 0])
    sines = np.linalg.norm(hinges, axis=1)
    # wide bends count most: knees that are no hinge, or knock a little, tilt the axis of small ones
    axis, agreement = (hinges * sines[:, None]).sum(0), (sines * sines).sum()
    upper = bones.rig_bone(chain[0], chain[1])
    agrees = np.linalg.norm(axis) > LEAST_AGREEMENT * agreement and abs(cosine(axis, upper)) < 0.7
    if sines.mean() > LEAST_BEND and agrees:
        return left_up_frame(axis, upper) @ left_up_frame(hinge(chain[0]), bones.ours(chain[0], chain[1])).T
    notes.append(f"{chain[1]}: it hardly bends, so the limb's own turn is only guessed")
    return bones.aligned(_mean_relative(sampled.rotations[:, turn], above), chain[0], chain[1])


def _foot(bones: RestBones, sampled: Sampled, side: str, shin: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
    """A of an ankle: the avatar's foot is flat where the rig's stands."""
    ankle, foot = f"{side}_ankle", f"{side}_foot"
    toe, mine = bones.toe(side), bones.ours(ankle, foot)
    across = shin[:, 0]
    if np.linalg.norm(toe) < 1e-9 or abs(cosine(toe, across)) > 0.7:
        return shin
    height = sampled.places[:, bones.joints.places[ankle]] @ sampled.up
    standing = height <= np.percentile(height, LOWEST)
    directions = sampled.rotations[standing][:, bones.joints.turns[ankle]] @ unit_or_zero(toe)
    pitch = float(np.median(np.arcsin(np.clip(directions @ sampled.up, -1, 1))))
    heading = unit_or_zero(mine * [1, 0, 1])
    pitched = np.cos(pitch) * heading + np.sin(pitch) * np.array([0.0, 1, 0])
    return left_up_frame(across, toe) @ left_up_frame(np.cross([0.0, 1, 0], heading), pitched).T


def _mean_relative(rig: Float[Array, "frames 3 3"], ours: Float[Array, "frames 3 3"]) -> Float[Array, "3 3"]:
    """The A for which rig @ A is nearest to ours, in the mean of squares (Procrustes)."""
    return nearest_rotation((np.swapaxes(rig, -1, -2) @ ours).mean(0))


def near_axes(R: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
    """R, snapped to the axes where it lies near them."""
    axes = snapped(R)
    return axes if np.linalg.norm(axis_angle_from_matrix(axes.T @ R)) < NEAR_AXES else R
