"""Feet that slide are held where they stand: the toe is locked, the leg follows, the pelvis gives way.

A toe is held from where it is slow *and* low until it is twice as fast or twice as high: one threshold would flicker.
Its place is the median over that time, so that as little as can be is moved at both ends, and it comes there and is let
go over the release time. The foot is moved as it is turned; hip and knee follow by two-bone inverse kinematics
(player/pose/ik.py). Where a leg cannot reach, the pelvis is lowered: with u from the foot's place up to the hip and R
the leg's length,

    drop = u_y - sqrt(R^2 - u_x^2 - u_z^2)

Steps are found in the whole motion when it is first shown. A pose then depends on its frame alone: films in shares,
scrubbing and playing backwards see the same. TOGETHER neighbours are solved at once, since what a frame alone costs is
NumPy's calls (2.2 ms a frame alone, .15 together). Lengths scale with the legs: a rig in centimetres
is held as one in metres.
"""

from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from avatar.motion.clip import Clip, Motion
from avatar.skeleton import JOINTS, joint_transforms
from player.draw.drawing import Pose
from player.effects.foot_lock import FootLock
from player.pose.ik import LIMBS, reach_for, smoothstep

LEGS = ("left_foot", "right_foot")
TOES = [JOINTS.index(leg) for leg in LEGS]
# hip to ankle, metres: legs of this length have the lengths that the settings say
GROWN = 0.82
BLOCK = 256  # frames read at once
TOGETHER = 32  # frames solved at once; the first of them is a multiple of it
STANDING = 5.0  # percent of the heights of both toes: what they stand at
SHORTEST = 0.1  # seconds; a shorter touch is none
# a leg is not stretched further than this share of its length, unless the motion does
STRETCHED = 0.998
MOST_BENT = np.radians(145.0)  # radians of the knee


class Steps(NamedTuple):
    """When and where one toe is held, in order of time."""

    start: Float[Array, "steps"]  # first frame
    stop: Float[Array, "steps"]  # last frame
    place: Float[Array, "steps 3"]  # the toe joint's, metres
    # the toe's distance from its place at both ends, metres: what is left to blend
    first: Float[Array, "steps 3"]
    last: Float[Array, "steps 3"]


class Held(NamedTuple):
    """Consecutive poses; where `changed` is false, they are the motion's own."""

    changed: Bool[Array, "frames"]
    axis_angle: Float[Array, "frames 52 3"]
    root: Float[Array, "frames 3"]


class HeldFeet:
    """One motion's steps on one skeleton; the motion is read once, when the first pose is asked for."""

    def __init__(self, motion: Motion | Clip, joints: Float[Array, "52 3"], lock: FootLock):
        self._motion, self._lock = motion, lock
        self._joints = joints.astype(np.float64)
        self._bones = [leg_bones(self._joints, leg) for leg in LEGS]
        self.unit = leg_unit(self._joints)
        # by their first frame
        self._solved: list[tuple[int, Held]] = []

    @cached_property
    def steps(self) -> list[Steps]:
        """Of the left and the right foot."""
        toes = self._toes()
        ground = float(np.percentile(toes[..., 1], STANDING))
        return [found_steps(toe, ground, self._motion.rate, self._lock, self.unit) for toe in toes]

    def pose(self, frame: int, first: int, block: Clip) -> Pose:
        """The pose of a frame with its feet held; the very pose where neither is. block: the motion from frame `first`,
        with all of the frame's neighbours that are solved with it."""
        start = frame - frame % TOGETHER
        found = next((held for begins, held in self._solved if begins == start), None)
        if found is None:
            near = slice(start - first, start - first + TOGETHER)
            found = self.held(start, block.axis_angle[near], block.root[near])
            # the ones before stay, for stepping back
            self._solved = [*self._solved[-1:], (start, found)]
        i = frame - start
        if found.changed[i]:
            return Pose(found.axis_angle[i], found.root[i])
        return Pose(block.axis_angle[frame - first], block.root[frame - first])

    def held(self, start: int, axis_angle: Float[Array, "frames 52 3"], root: Float[Array, "frames 3"]) -> Held:
        """Consecutive poses from frame `start` on, with their feet held."""
        world = joint_transforms(axis_angle, self._joints, root)[..., :3, 3]
        release = self._motion.rate * self._lock.release
        moved = np.array([[offset(steps, start + i, places[toe], release) for i, places in enumerate(world)]
                          for steps, toe in zip(self.steps, TOES, strict=True)])  # fmt: skip
        # where each ankle should be, and how near to its hip and far from it it can be, metres
        drop, ways = np.zeros((len(world), 1)), list[tuple[Array, Array, Array]]()
        for leg, (a, b), by in zip(LEGS, self._bones, moved, strict=True):
            hip, ankle = world[:, LIMBS[leg].first], world[:, LIMBS[leg].end]
            before = np.linalg.norm(ankle - hip, axis=-1, keepdims=True)
            # at most what the leg is long, at least what the knee bends to: unless the motion itself goes on
            longest = np.maximum(STRETCHED * (a + b), before)
            shortest = np.minimum(np.sqrt(a * a + b * b + 2 * a * b * np.cos(MOST_BENT)), before)
            ways.append((ankle + by, shortest, longest))
            u = hip - (ankle + by)
            below = longest**2 - u[:, :1] ** 2 - u[:, 2:] ** 2
            drop = np.maximum(drop, u[:, 1:2] - np.sqrt(np.maximum(below, 0.0)))
        changed = np.any(moved, axis=2).any(axis=0)
        drop = np.minimum(drop, self._lock.farthest * self.unit) * changed[:, None] * [0.0, 1.0, 0.0]
        axis_angle, root = axis_angle.astype(np.float64), root - drop
        for leg, (target, shortest, longest), by in zip(LEGS, ways, moved, strict=True):
            rows = np.flatnonzero(drop.any(axis=1) | by.any(axis=1))
            if not len(rows):
                continue
            hip = (world[:, LIMBS[leg].first] - drop)[rows]
            away = target[rows] - hip
            length = np.linalg.norm(away, axis=-1, keepdims=True)
            reached = np.clip(length, shortest[rows], longest[rows]) / np.maximum(length, 1e-12)
            axis_angle[rows] = reach_for(axis_angle[rows], root[rows], self._joints, leg, hip + away * reached)
        return Held(changed, axis_angle, root)

    def _toes(self) -> Float[Array, "2 frames 3"]:
        parts = []
        for first in range(0, self._motion.frames, BLOCK):
            clip = self._motion.read(first, min(first + BLOCK, self._motion.frames))
            parts.append(joint_transforms(clip.axis_angle, self._joints, clip.root)[..., :3, 3][:, TOES])
        return np.concatenate(parts).transpose(1, 0, 2)


def leg_unit(joints: Float[Array, "52 3"]) -> float:
    """Metres of this body in one of a grown person's."""
    return float(np.mean([sum(leg_bones(joints, leg)) for leg in LEGS])) / GROWN


def leg_bones(joints: Float[Array, "52 3"], leg: str) -> tuple[float, float]:
    """Lengths of thigh and shin, metres."""
    first, middle, end, _ = LIMBS[leg]
    thigh, shin = joints[middle] - joints[first], joints[end] - joints[middle]
    return float(np.linalg.norm(thigh)), float(np.linalg.norm(shin))


def found_steps(toe: Float[Array, "frames 3"], ground: float, rate: float, lock: FootLock, unit: float) -> Steps:
    """Where one toe is held. ground: the height it stands at; unit: metres of this body in one of a grown person's."""
    speed = np.linalg.norm(np.gradient(toe, axis=0), axis=1) * rate / unit if len(toe) > 1 else np.zeros(len(toe))
    height = (toe[:, 1] - ground) / unit
    begins = (speed < lock.speed) & (height < lock.height)
    ends = (speed > 2 * lock.speed) | (height > 2 * lock.height)
    found, frame = [], 0
    while frame < len(toe):
        start = frame + int(begins[frame:].argmax())
        if not begins[start]:
            break
        stop = start + int(ends[start:].argmax()) if ends[start:].any() else len(toe)
        found += _within(toe, start, stop, lock.farthest * unit)
        frame = stop
    found = [(a, b) for a, b in found if b - a >= max(SHORTEST * rate, 2)]
    places = np.array([np.median(toe[a:b], axis=0) for a, b in found]).reshape(-1, 3)
    bounds = np.array(found, np.int64).reshape(-1, 2) - [0, 1]
    return Steps(
        bounds[:, 0].astype(float), bounds[:, 1].astype(float), places,
        places - toe[bounds[:, 0]], places - toe[bounds[:, 1]],
    )  # fmt: skip


def _within(toe: Float[Array, "frames 3"], start: int, stop: int, farthest: float) -> list[tuple[int, int]]:
    """The stretch, halved until no toe is farther than that from its middle place."""
    place = np.median(toe[start:stop], axis=0)
    if stop - start < 2 or np.linalg.norm(toe[start:stop] - place, axis=1).max() <= farthest:
        return [(start, stop)]
    middle = (start + stop) // 2
    return [*_within(toe, start, middle, farthest), *_within(toe, middle, stop, farthest)]


def offset(steps: Steps, frame: int, toe: Float[Array, "3"], release: float) -> Float[Array, "3"]:
    """How far a toe is moved in a frame, metres; exactly 0 away from all steps. release: frames."""
    last = int(np.searchsorted(steps.start, frame, "right")) - 1
    if last >= 0 and frame <= steps.stop[last]:
        return steps.place[last] - toe
    out = np.zeros(3)
    # between two steps there is at most as much time as lies between them
    gap = steps.start[last + 1] - steps.stop[last] if 0 <= last < len(steps.start) - 1 else np.inf
    over = min(release, gap)
    if last >= 0:
        out += (1 - smoothstep((frame - steps.stop[last]) / over)) * steps.last[last]
    if last + 1 < len(steps.start):
        out += (1 - smoothstep((steps.start[last + 1] - frame) / over)) * steps.first[last + 1]
    return out
