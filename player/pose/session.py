"""A posing session: the present pose, what is pinned.

Every change is a step of the session's history (player/pose/history.py). Which joint is selected is the window's
business.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from avatar.face import REST, FaceFrame, mirrored_face
from avatar.limits import clamped, with_angle
from avatar.rotation import axis_angle_from_matrix, matrix_from_axis_angle
from avatar.skeleton import JOINTS, PARENTS, joint_transforms
from player.pose.fingers import HandShape, Side, with_finger, with_hand
from player.pose.history import History, KeptPose
from player.pose.ik import LIMBS, reach_for
from player.pose.library import read_pose, write_pose
from player.pose.mirror import mirrored_in_place, onto_other_side

# radians; inverse kinematics come back to a pose within some 1e-15
ROUNDING = 1e-9


class Pin(NamedTuple):
    """Where the end of a limb is held, and how it is turned there."""

    place: Float[Array, "3"]
    turn: Float[Array, "3 3"]  # world_from_joint


class PoseSession:
    """One avatar being posed; `joints` are its rest positions, metres, pelvis at the origin."""

    def __init__(
        self,
        joints: Float[Array, "52 3"],
        *,
        root: Float[Array, "3"] | None = None,
        axis_angle: Float[Array, "52 3"] | None = None,
        pelvis_height: float | None = None,
        face: FaceFrame | None = None,
    ):
        if root is None:
            root = np.array([0.0, pelvis_height or 0.0, 0.0])
        self.joints = np.array(joints, np.float64)
        self.pelvis_height = pelvis_height
        face = face or REST
        self.history = History(
            KeptPose(np.zeros((52, 3)) if axis_angle is None else axis_angle, root, face.weights, face.gaze)
        )
        self.limited = True
        self.pinned: dict[str, Pin] = {}  # limbs whose ends are held in the world

    # what there is

    @property
    def pose(self) -> KeptPose:
        return self.history.pose

    def world(self) -> Float[Array, "52 4 4"]:
        """world_from_joint of the present pose."""
        return joint_transforms(self.pose.axis_angle, self.joints, self.pose.root)

    # changing it

    def put(
        self,
        label: str,
        axis_angle: Float[Array, "52 3"],
        root: Float[Array, "3"] | None = None,
        *,
        drag: object | None = None,
        limited: bool | None = None,
        hold: bool = True,
        joint: int | None = None,
    ) -> None:
        """Another pose. Limits, where they are on, are put on the joints that the change touches, and come last.

        hold: pinned hands and feet are brought back to their places; without it they are pinned where they come
        to be. joint: the one that was turned; if it is a pinned hand or foot, it is held as it is turned now.

        Raises:
            ValueError: a number is not finite.
        """
        root = self.pose.root if root is None else root
        if not (np.isfinite(axis_angle).all() and np.isfinite(root).all()):
            raise ValueError("a pose holds a number that is not finite")
        for limb, pin in self.pinned.items():
            if hold:
                axis_angle = self._held(axis_angle, root, limb, pin, turning=LIMBS[limb].end == joint)
        if self.limited if limited is None else limited:
            # where a drag comes back to, the joint is as it was, also one that was beyond its limits
            before = self.history.before(drag).axis_angle
            touched = (np.abs(axis_angle - before) > ROUNDING).any(-1, keepdims=True)
            axis_angle = np.where(touched, clamped(axis_angle), before)
        pose = replace(self.pose, axis_angle=axis_angle, root=root)
        if drag is None and pose.same(self.pose):
            return
        self.history.change(label, pose, drag)
        for limb in self.pinned:
            if not hold or LIMBS[limb].end == joint:
                self.pin(limb, True)

    def _held(self, axis_angle: Array, root: Array, limb: str, pin: Pin, *, turning: bool) -> Array:
        out = reach_for(axis_angle, root, self.joints, limb, pin.place)
        if not turning:
            end = LIMBS[limb].end
            parent = joint_transforms(out, self.joints, root)[PARENTS[end], :3, :3]
            out[end] = axis_angle_from_matrix(parent.T @ pin.turn)
        return out

    def set_angle(self, joint: int, freedom: int, value: float | int, *, drag: object | None = None) -> None:
        """One slider: a named angle of a joint, radians."""
        pose = with_angle(self.pose.axis_angle, joint, freedom, value, limited=self.limited)
        self.put(JOINTS[joint], pose, drag=drag, joint=joint)

    def set_face(self, weights: Float[Array, "52"], gaze: Float[Array, "2 2"], *, drag: object | None = None) -> None:
        """Another face, the body as it is.

        Raises:
            ValueError: a number is not finite.
        """
        if not (np.isfinite(weights).all() and np.isfinite(gaze).all()):
            raise ValueError("a face holds a number that is not finite")
        pose = replace(self.pose, weights=weights, gaze=gaze)
        if drag is not None or not pose.same(self.pose):
            self.history.change("face", pose, drag)

    def set_hand(self, side: Side, shape: HandShape) -> None:
        self.put(f"{side} hand", with_hand(self.pose.axis_angle, side, shape))

    def set_finger(
        self, side: Side, finger: int, *, curl: float | None = None, spread: float | None = None,
        drag: object | None = None,
    ) -> None:  # fmt: skip
        pose = with_finger(self.pose.axis_angle, side, finger, curl=curl, spread=spread, limited=self.limited)
        self.put(f"{side} fingers", pose, drag=drag)

    def turn(
        self, start: KeptPose, joint: int, axis: Float[Array, "3"], angle: float | int, *, drag: object | None = None
    ) -> None:
        """The gizmo: one joint turned about a world axis, from the pose in which the ring was seized."""
        pose = turned(start, self.joints, joint, axis, angle)
        self.put(JOINTS[joint], pose, start.root, drag=drag, joint=joint)

    def reach(
        self,
        start: KeptPose,
        limb: str,
        target: Float[Array, "3"],
        *,
        follow: bool = False,
        pole: Float[Array, "3"] | None = None,
        drag: object | None = None,
    ) -> None:
        """A hand or foot to a place in the world, from the pose in which the drag began."""
        pose = reach_for(
            start.axis_angle, start.root, self.joints, limb, target, pole=pole, end="follow" if follow else "world"
        )
        held = self.pinned.pop(limb, None)
        self.put(limb.replace("_", " "), pose, start.root, drag=drag)
        if held is not None:
            self.pin(limb, True)

    def move(self, start: KeptPose, root: Float[Array, "3"], *, drag: object | None = None) -> None:
        """The whole body to another place; pinned hands and feet stay."""
        self.put("place", start.axis_angle, root, drag=drag)

    def pin(self, limb: str, on: bool) -> None:
        """Hold a hand or foot where it is while the body moves, or let it go."""
        if on:
            end = self.world()[LIMBS[limb].end]
            self.pinned[limb] = Pin(end[:3, 3].copy(), end[:3, :3].copy())
        else:
            self.pinned.pop(limb, None)

    def mirror(self) -> None:
        step, face = object(), mirrored_face(FaceFrame(self.pose.weights, self.pose.gaze))
        self.put("mirror", mirrored_in_place(self.pose.axis_angle), drag=step, hold=False)
        self.set_face(face.weights, face.gaze, drag=step)
        self.history.end_drag()

    def to_other_side(self, joints: Sequence[int]) -> None:
        self.put("mirror", onto_other_side(self.pose.axis_angle, joints), hold=False)

    def reset(self, joints: Sequence[int]) -> None:
        """These joints to pose 0."""
        pose = np.array(self.pose.axis_angle)
        pose[list(joints)] = 0.0
        self.put("reset", pose, hold=False)

    # undo

    def undo(self) -> str | None:
        """One step back; its name, or None where there is none."""
        return self._pinned_again(self.history.undo())

    def redo(self) -> str | None:
        return self._pinned_again(self.history.redo())

    def _pinned_again(self, label: str | None) -> str | None:
        """Held where they are in the pose that came back."""
        if label is not None:
            for limb in self.pinned:
                self.pin(limb, True)
        return label

    # files

    def save(self, path: Path | str) -> str:
        """Write the pose as a motion of one frame; what was written, in words."""
        write_pose(path, self.pose, pelvis_height=self.pelvis_height)
        self.history.mark_saved()
        return f"{path}: one pose"

    def load(self, path: Path | str) -> None:
        """Take the first pose of a file; a step of undo, and counts as saved.

        Raises:
            AssetError: the file cannot be read; nothing has changed then.
        """
        pose = read_pose(path, pelvis_height=self.pelvis_height)
        self.history.end_drag()
        self.history.change("load", pose)
        self.history.mark_saved()
        self.pinned.clear()


def turned(
    pose: KeptPose, joints: Float[Array, "52 3"], joint: int, axis: Float[Array, "3"], angle: float | int
) -> Float[Array, "52 3"]:
    """The pose with one joint turned about a world axis through it, radians; all below follows, the root stays."""
    world = joint_transforms(pose.axis_angle, joints, pose.root)[:, :3, :3]
    parent = np.eye(3) if joint == 0 else world[PARENTS[joint]]
    out = np.array(pose.axis_angle, np.float64)
    if angle != 0:
        turn = matrix_from_axis_angle(np.asarray(axis) * angle)
        out[joint] = axis_angle_from_matrix(parent.T @ turn @ world[joint])
    return out
