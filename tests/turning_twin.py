"""A person of the free body, a hand and a head that turn before a camera, all known: what capture/fit finds again."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from avatar.kinematics import skinned
from avatar.rotation import matrix_from_axis_angle
from avatar.skeleton import JOINTS
from capture.fit import hand, head
from capture.fit.body import MOVING, body_names
from capture.fit.footage import Estimate, Footage
from capture.fit.keypoint_term import projected
from capture.fit.person import person_of
from capture.fit.solve import posed_frames
from geometry.mesh import vertex_normals
from geometry.rasterise import rasterise

Array = np.ndarray
FRAMES, SIZE = 16, 400  # of a hand's or a head's turn; pixels


class Twin(NamedTuple):
    """The truth, and what a detector and a mask tool make of it."""

    truth: Estimate
    footage: Footage


def turning_twin(
    frames: int = 16,
    size: int = 256,
    *,
    noise: float = 0.5,
    focal_error: float = 0.0,
    masks: bool = False,
    seed: int = 0,
) -> Twin:
    """One turn in a T-pose with sagging arms; `noise` in pixels, the focal length told `focal_error` too long."""
    rng = np.random.default_rng(seed)
    person = person_of("male", 1.8)
    g = np.where(person.fingers, 0.0, 0.4 * person.sigma * rng.standard_normal(len(person.sigma)))
    # as tall as is told
    height, row = person.height()
    g -= row * (height + row @ g - person.stature) / (row @ row)
    turn = 2 * np.pi * np.arange(frames) / frames
    mean = np.zeros((52, 3))
    mean[MOVING] = np.radians(rng.normal(0, 2, (len(MOVING), 3)))
    for side in ("left", "right"):
        mean[JOINTS.index(f"{side}_shoulder"), 0] -= np.radians(8)
    angles = np.tile(mean, (frames, 1, 1))
    phase = rng.uniform(0, 2 * np.pi, (len(MOVING), 3))
    angles[:, MOVING] += np.radians(1.5) * np.sin(turn[:, None, None] + phase)
    heading = matrix_from_axis_angle(turn[:, None] * [0, 1.0, 0])
    root = np.stack([0.02 * np.sin(turn), 0.1 + 0 * turn, -3.0 + 0.02 * np.cos(turn)], 1)
    truth = Estimate(person, g, np.zeros((1, 3)), 0.0, mean, root, heading, angles)
    truth, footage = pictured(truth, body_names(hands=False), MOVING, size=size, focal=0.75 * size * 3.0 / 1.8)
    noisy = footage.pixels + noise * rng.standard_normal(footage.pixels.shape)
    told = replace(footage, pixels=noisy, sure=footage.sure / max(noise, 0.5))
    if masks:
        told = in_clothes(truth, told, 0.0)
    if focal_error:
        told = replace(told, focal=(1 + focal_error) * told.focal, focal_sigma=0.1)
    return Twin(truth, told)


def pixels_of(truth: Estimate, footage: Footage) -> Array:
    """Where the footage's points are in its pictures."""
    return projected(truth, footage, posed_frames(truth))


def pictured(truth: Estimate, names: tuple[str, ...], moving: Array, *, size: int, focal: float) -> Twin:
    """Footage of an estimate: all points where they are, each to a pixel, and masks that show nobody."""
    frames, count = len(truth.root), len(names)
    footage = Footage(names, np.zeros((frames, count, 2)), np.ones((frames, count)),
                      np.zeros((frames, size, size), np.uint8), focal, 1e-3, moving)  # fmt: skip
    truth = replace(truth, bias=np.zeros((count, 3)))
    return Twin(truth, replace(footage, pixels=pixels_of(truth, footage)))


def in_clothes(truth: Estimate, footage: Footage, thickness: Array | float) -> Footage:
    """The footage with masks of the person in clothes so thick (metres, for all vertices or for each)."""
    person = truth.person
    normals = vertex_normals(person.vertices(truth.g), person.body.faces)
    worn = np.broadcast_to(thickness, len(normals))[:, None] * normals
    clothed = replace(truth, person=replace(person, offsets=worn))
    return replace(footage, masks=np.stack([mask_of(clothed, footage, i) for i in range(len(truth.root))]))


def mask_of(truth: Estimate, footage: Footage, i: int) -> Array:
    """The silhouette of one frame."""
    points = truth.skin()
    x = skinned(posed_frames(truth).each[i], points)
    return (255 * (rasterise(x, truth.person.body.faces, truth.camera(footage)).face >= 0)).astype(np.uint8)


def limb_error(truth: Estimate, found: Estimate) -> float:
    """Mean distance of hips, knees, ankles, shoulders, elbows and wrists, metres, in the camera's frame."""
    limbs = [JOINTS.index(f"{s}_{n}") for s in ("left", "right")
             for n in ("hip", "knee", "ankle", "shoulder", "elbow", "wrist")]  # fmt: skip
    places = [posed_frames(e).place[:, limbs] for e in (truth, found)]
    return float(np.linalg.norm(places[0] - places[1], axis=2).mean())


def shown(truth, names, moving):
    """Footage of an estimate that is the truth, with half a pixel of noise."""
    truth, footage = pictured(truth, names, moving, size=SIZE, focal=700.0)
    noise = 0.5 * np.random.default_rng(0).standard_normal(footage.pixels.shape)
    return truth, replace(footage, pixels=footage.pixels + noise, sure=2 * footage.sure)


def truth_of(person, root, heading, angles):
    """The truth of frames of a person of the free body's shape."""
    return Estimate(person, np.zeros(len(person.sigma)), np.zeros((1, 3)), 0.0, angles[0], root, heading, angles)


def turned_hand(side):
    """A bent hand that turns once, its roll and its footage."""
    person = person_of("male")
    wrist = person.body.joints[JOINTS.index(f"{side}_wrist")]
    roll = 2 * np.pi * np.arange(FRAMES) / FRAMES
    sign = 1 if side == "left" else -1
    up = matrix_from_axis_angle(np.array([0, 0, sign * np.pi / 2]))
    heading = matrix_from_axis_angle(roll[:, None] * [0, 1.0, 0]) @ up
    angles = np.zeros((FRAMES, 52, 3))
    angles[:, hand.hand_joints(side)[1:], 0] = np.radians(12)
    truth = truth_of(person, np.array([0, 0, -0.5]) - heading @ wrist, heading, angles)
    return shown(truth, hand.hand_names(side)[:-1], hand.hand_joints(side))


def turning_head(turn, **changed):
    """A head that turns so, radians, as found, and its footage; `changed` biases of points."""
    person = person_of("female")
    heading = matrix_from_axis_angle(turn[:, None] * [0, 1.0, 0])
    neck = person.body.joints[head.HEAD]
    truth = truth_of(person, np.array([0, 0, -0.7]) - heading @ neck, heading, np.zeros((len(turn), 52, 3)))
    truth, footage = shown(truth, head.NAMES, np.zeros(0, np.int64))
    for name, bias in changed.items():
        truth.bias[footage.names.index(name)] = bias
    return truth, footage
