"""A person of the free body who turns before a camera, all of it known: what capture/fit has to find again."""

from typing import NamedTuple

import numpy as np

from avatar.kinematics import skinned
from avatar.rotation import matrix_from_axis_angle
from avatar.skeleton import JOINTS
from capture.fit.body import MOVING, body_names
from capture.fit.footage import Estimate, Footage
from capture.fit.keypoint_term import projected
from capture.fit.person import person_of
from capture.fit.solve import posed_frames
from geometry.rasterise import rasterise

Array = np.ndarray


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
    names = body_names(hands=False)
    focal = 0.75 * size * 3.0 / 1.8
    blank = np.zeros((frames, size, size), np.uint8)
    count = len(names)
    footage = Footage(names, np.zeros((frames, count, 2)), np.full((frames, count), 1 / max(noise, 0.5)), blank, focal,
                      1e-3, MOVING)  # fmt: skip
    truth = Estimate(person, g, np.zeros((count, 3)), 0.0, mean, root, heading, angles)
    pixels = np.stack([projected(truth, footage, frame) for frame in posed_frames(truth)])
    pixels += noise * rng.standard_normal(pixels.shape)
    drawn = np.stack([mask_of(truth, footage, i) for i in range(frames)]) if masks else blank
    told = Footage(names, pixels, footage.sure, drawn, focal * (1 + focal_error), 0.1 if focal_error else 1e-3, MOVING)
    return Twin(truth, told)


def mask_of(truth: Estimate, footage: Footage, i: int) -> Array:
    """The silhouette of one frame."""
    points = truth.skin()
    x = skinned(posed_frames(truth)[i], points)
    return (255 * (rasterise(x, truth.person.body.faces, truth.camera(footage)).face >= 0)).astype(np.uint8)


def limb_error(truth: Estimate, found: Estimate) -> float:
    """Mean distance of hips, knees, ankles, shoulders, elbows and wrists, metres, in the camera's frame."""
    limbs = [JOINTS.index(f"{s}_{n}") for s in ("left", "right")
             for n in ("hip", "knee", "ankle", "shoulder", "elbow", "wrist")]  # fmt: skip
    places = [np.stack([frame.place[limbs] for frame in posed_frames(e)]) for e in (truth, found)]
    return float(np.linalg.norm(places[0] - places[1], axis=2).mean())
