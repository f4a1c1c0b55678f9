"""A posing session: the present pose, keyframes, copy and paste, what is pinned.

Every change is a step of the session's history (player/pose/history.py). Moving along the timeline and copying are no
changes: they are not undone and do not make a session unsaved. Which joint is selected is the window's business.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from avatar.limits import clamped, with_angle
from avatar.motion.clip import Clip
from avatar.rotation import axis_angle_from_matrix, matrix_from_axis_angle
from avatar.skeleton import JOINTS, PARENTS, joint_transforms
from command.progress import plural
from player.pose import pose_file
from player.pose.fingers import HandShape, Side, with_finger, with_hand
from player.pose.history import History, PoseState
from player.pose.ik import LIMBS, reach_for
from player.pose.keyframes import Easing, Keys, Pose, clip_of, pose_at, with_key
from player.pose.mirror import PARTNER, mirrored_in_place, onto_other_side


class Pin(NamedTuple):
    """Where the end of a limb is held, and how it is turned there."""

    place: Float[Array, "3"]
    turn: Float[Array, "3 3"]  # world_from_joint


@dataclass(frozen=True, eq=False)
class Copied:
    """Joints on the clipboard and their vectors."""

    joints: tuple[int, ...]
    axis_angle: Float[Array, "52 3"]


class PoseSession:
    """One avatar being posed; `joints` are its rest positions, metres, pelvis at the origin."""

    def __init__(
        self,
        joints: Float[Array, "52 3"],
        *,
        root: Float[Array, "3"] | None = None,
        axis_angle: Float[Array, "52 3"] | None = None,
        pelvis_height: float | None = None,
        rate: float | int = 30.0,
    ):
        if root is None:
            root = np.array([0.0, pelvis_height or 0.0, 0.0])
        self.joints = np.array(joints, np.float64)
        self.pelvis_height = pelvis_height
        self.rest = Pose(np.zeros((52, 3)) if axis_angle is None else axis_angle, root)
        self.history = History(PoseState(self.rest))
        self.limited = True
        # with keys: each change of the pose is a key at once
        self.auto_key = False
        self.pinned: dict[str, Pin] = {}  # limbs whose ends are held in the world
        self.copied: Copied | None = None
        self.rate = rate

    # what there is

    @property
    def state(self) -> PoseState:
        return self.history.state

    @property
    def pose(self) -> Pose:
        return self.state.pose

    @property
    def keys(self) -> Keys:
        return self.state.keys

    @property
    def frame(self) -> int:
        return self.state.frame

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
            touched = (axis_angle != self.pose.axis_angle).any(-1, keepdims=True)
            axis_angle = np.where(touched, clamped(axis_angle), axis_angle)
        pose = Pose(axis_angle, root)
        if drag is None and pose.same(self.pose):
            return
        keys = self.keys
        if self.auto_key and keys:
            keys = with_key(keys, self.frame, pose)
        self.history.change(label, replace(self.state, pose=pose, keys=keys), drag)
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

    def set_hand(self, side: Side, shape: HandShape) -> None:
        self.put(f"{side} hand", with_hand(self.pose.axis_angle, side, shape))

    def set_finger(
        self, side: Side, finger: int, *, curl: float | None = None, spread: float | None = None,
        drag: object | None = None,
    ) -> None:  # fmt: skip
        pose = with_finger(self.pose.axis_angle, side, finger, curl=curl, spread=spread, limited=self.limited)
        self.put(f"{side} fingers", pose, drag=drag)

    def turn(
        self, start: Pose, joint: int, axis: Float[Array, "3"], angle: float | int, *, drag: object | None = None
    ) -> None:
        """The gizmo: one joint turned about a world axis, from the pose in which the ring was seized."""
        pose = turned(start, self.joints, joint, axis, angle)
        self.put(JOINTS[joint], pose, start.root, drag=drag, joint=joint)

    def reach(
        self,
        start: Pose,
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

    def move(self, start: Pose, root: Float[Array, "3"], *, drag: object | None = None) -> None:
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
        self.put("mirror", mirrored_in_place(self.pose.axis_angle), hold=False)

    def to_other_side(self, joints: Sequence[int]) -> None:
        """The other side does what these joints do."""
        self.put("mirror", onto_other_side(self.pose.axis_angle, joints), hold=False)

    def reset(self, joints: Sequence[int]) -> None:
        """These joints to pose 0."""
        pose = np.array(self.pose.axis_angle)
        pose[list(joints)] = 0.0
        self.put("reset", pose, hold=False)

    # copy and paste

    def copy(self, joints: Sequence[int]) -> None:
        self.copied = Copied(tuple(joints), self.pose.axis_angle)

    def paste(self, *, mirrored: bool = False) -> None:
        """What was copied onto the same joints, or mirrored onto the other side's. Nothing copied: nothing happens.

        The body's place is not pasted: a copied pose is taken where the avatar stands.
        """
        if self.copied is None:
            return
        joints = list(self.copied.joints)
        pose = np.array(self.pose.axis_angle)
        if mirrored:
            whole = mirrored_in_place(self.copied.axis_angle)
            onto = PARTNER[joints]
            pose[onto] = whole[onto]
        else:
            pose[joints] = self.copied.axis_angle[joints]
        self.put("paste", pose, hold=False)

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

    # the timeline

    def seek(self, frame: int) -> None:
        """Go to a frame; with keys, the present pose becomes the timeline's there.

        No step of undo, unless the present pose was changed and is no key: then undo brings it back.
        """
        frame = max(int(frame), 0)
        if frame == self.frame:
            return
        self.history.end_drag()
        pose = pose_at(self.keys, frame, self.state.easing) if self.keys else self.pose
        self.history.go_to("go to frame", replace(self.state, pose=pose, frame=frame))

    def key(self) -> None:
        """The present pose becomes a key at the present frame."""
        self.history.change("key", replace(self.state, keys=with_key(self.keys, self.frame, self.pose)))

    def delete_key(self, frame: int | None = None) -> None:
        frame = self.frame if frame is None else frame
        keys = tuple(key for key in self.keys if key[0] != frame)
        if len(keys) != len(self.keys):
            self.history.change("delete key", replace(self.state, keys=keys))

    def ease(self, easing: Easing) -> None:
        if easing != self.state.easing:
            self.history.change("easing", replace(self.state, easing=easing))

    def clip(self) -> Clip:
        """The timeline as a clip, or the present pose as a clip of one frame."""
        keys = self.keys or ((0, self.pose),)
        return clip_of(keys, self.rate, self.state.easing, self.pelvis_height)

    # files

    def save(self, path: Path | str, *, up: str = "z") -> str:
        """Write the keys, or the pose where there are none; what was written, in words."""
        if self.keys:
            pose_file.write_keys(path, self.clip(), self.keys, self.state.easing, up=up)
            done = f"{path}: {plural(len(self.keys), 'keyframe')}, {plural(self.keys[-1][0] + 1, 'frame')}"
        else:
            pose_file.write_pose(path, self.pose, pelvis_height=self.pelvis_height, up=up)
            done = f"{path}: one pose"
        self.history.mark_saved()
        return done

    def load(self, path: Path | str) -> tuple[str, ...]:
        """Take a file's keys, or its pose where it has one frame; a step of undo, and counts as saved.

        Raises:
            AssetError: the file cannot be read; nothing has changed then.
        """
        timeline = pose_file.read_keys(path, pelvis_height=self.pelvis_height)
        pose = timeline.keys[0][1]
        keys = timeline.keys if len(timeline.keys) > 1 else ()
        self.history.end_drag()
        self.history.change("load", PoseState(pose, keys, timeline.easing))
        self.rate = timeline.rate
        self.history.mark_saved()
        self.pinned.clear()
        return timeline.notes


def turned(
    pose: Pose, joints: Float[Array, "52 3"], joint: int, axis: Float[Array, "3"], angle: float | int
) -> Float[Array, "52 3"]:
    """The pose with one joint turned about a world axis through it, radians; all below follows, the root stays."""
    world = joint_transforms(pose.axis_angle, joints, pose.root)[:, :3, :3]
    parent = np.eye(3) if joint == 0 else world[PARENTS[joint]]
    out = np.array(pose.axis_angle, np.float64)
    if angle != 0:
        turn = matrix_from_axis_angle(np.asarray(axis) * angle)
        out[joint] = axis_angle_from_matrix(parent.T @ turn @ world[joint])
    return out
