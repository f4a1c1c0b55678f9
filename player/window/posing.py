"""Posing by hand in the window: one avatar leaves its motion, and keys and panels change its pose.

The pose itself, keyframes and undo are the session's (player/pose/session.py), the mouse is player/window/pose_tool.py.
Here is what ties them to the window: its timeline, its messages, files and the library.
"""

from collections.abc import Callable
from functools import partial

import numpy as np

from command.errors import AssetError
from player.draw.posing import grounded
from player.pose.library import Library
from player.pose.mirror import limb_of
from player.pose.session import PoseSession
from player.scene.framing import pelvis_height
from player.scene.renderer import Pose
from player.window.pose_tool import PoseTool
from player.window.recorder import free_name
from player.window.state import WindowState, joint_name

ALL = tuple(range(52))


class Posing:
    """Whether an avatar is being posed, and which."""

    def __init__(self, state: WindowState):
        self.state = state
        self.edit: PoseEdit | None = None

    def toggle(self) -> None:
        """Pose the selected avatar by hand, or let its motion have it again."""
        line = self.state.timeline
        if self.edit is None:
            line.playing = False
            self.edit = PoseEdit(self.state, self.state.selection.avatar)
        elif self.edit.may_leave():
            line.frames = self.edit.frames_before
            line.seek(line.frame)
            self.edit = None

    def may_leave(self) -> bool:
        """Whether the window may close; False, once, where a pose would be lost, which is said."""
        return self.edit is None or self.edit.may_leave()

    def poses(self) -> list[Pose]:
        """The poses of now; the avatar that is posed by hand has its hand-made one."""
        if self.edit is not None:
            self.edit.follow_timeline()
        poses = self.state.playback.poses()
        if self.edit is not None:
            pose = self.edit.session.pose
            poses[self.edit.index] = (pose.axis_angle, pose.root)
        return poses


class PoseEdit:
    """One avatar being posed: its session, the mouse on it, and what keys and panels ask for."""

    def __init__(self, state: WindowState, index: int):
        self.state, self.index, self.avatar = state, index, state.avatars[index]
        axis_angle, root = state.playback.poses()[index]
        self.session = PoseSession(
            self.avatar.joint_positions.astype(np.float64),
            axis_angle=axis_angle,
            root=root,
            pelvis_height=pelvis_height(self.avatar),
            rate=state.timeline.rate,
        )
        self.tool = PoseTool(state, self.session, index)
        self.library = Library()
        # what is typed into the panel's fields
        self.name = self.file = ""
        # the timeline's frames when posing began, to go back to
        self.frames_before = state.timeline.frames
        # the state of which was said that leaving loses it
        self._warned: object = None

    # -- changes

    def undo(self) -> None:
        self._walk("undone", self.session.undo)

    def redo(self) -> None:
        self._walk("redone", self.session.redo)

    def _walk(self, word: str, step: Callable[[], str | None]) -> None:
        """A step back or forth; with keyframes the window goes to the frame that it was made at."""
        self.tool.cancel()
        keyed = bool(self.session.keys)
        label = step()
        self.state.messages.say(f"{word}: {label.replace('_', ' ')}" if label else f"nothing to be {word}")
        if label and (keyed or self.session.keys):
            self.show_frame()

    def copy_pose(self) -> None:
        self.copy(ALL, "the whole pose")

    def copy_limb(self) -> None:
        """Copy the selected joint's limb; of the pelvis, or without a selection, the whole pose."""
        joint = self.tool.joint
        if joint:
            self.copy(limb_of(joint), f"the limb of {joint_name(joint)}")
        else:
            self.copy_pose()

    def copy(self, joints: tuple[int, ...], name: str) -> None:
        self.session.copy(joints)
        self.state.messages.say(f"copied: {name}")

    def to_ground(self) -> None:
        """The body up or down until its lowest point touches the ground."""
        pose = self.session.pose
        self.session.put(
            "to the ground", pose.axis_angle, grounded(self.avatar, pose.axis_angle, pose.root), hold=False
        )

    def set_key(self) -> None:
        self.session.key()
        self.state.messages.say(f"keyframe at frame {self.session.frame}; {len(self.session.keys)} in all")

    def tried(self, act: Callable[[], object]) -> None:
        """Do what may be refused, and say why it was."""
        self.pause()
        try:
            act()
        except (AssetError, ValueError) as error:
            self.state.messages.say(str(error))

    # -- time

    def pause(self) -> None:
        """A timeline that plays keyframes would take the pose out of one's hands."""
        if self.session.keys:
            self.state.timeline.playing = False

    def follow_timeline(self) -> None:
        """The session goes to the frame that the window shows."""
        line = self.state.timeline
        self._lengthen()
        self.session.seek(int(line.seconds * self.session.rate + 1e-6))

    def show_frame(self, frame: int | None = None) -> None:
        """The window goes to a frame of the session, paused; None: to the one the session is at."""
        line = self.state.timeline
        line.playing = False
        self._lengthen()
        frame = self.session.frame if frame is None else frame
        line.seek(int((frame + 0.5) * line.rate / self.session.rate))

    def set_length(self, seconds: float) -> None:
        """Another length of the timeline, at most an hour; the last keyframe stays on it."""
        line = self.state.timeline
        line.frames = max(round(min(seconds, 3600.0) * line.rate), self._last_frame(), 1)
        line.seek(line.frame)

    def _lengthen(self) -> None:
        """The timeline reaches the last keyframe."""
        if self.session.keys:
            self.state.timeline.frames = max(self.state.timeline.frames, self._last_frame())

    def _last_frame(self) -> int:
        """Frames that the timeline needs for the keyframes."""
        last = self.session.keys[-1][0] if self.session.keys else 0
        return round((last + 1) * self.state.timeline.rate / self.session.rate)

    # -- files

    def save(self) -> None:
        """Write the keyframes, or the pose where there are none, to the file that is named, else to a new one."""
        self.state.messages.say(self.session.save(self.file or free_name("selfscan-pose", ".npz")) + " written")

    def load(self) -> None:
        """Take the pose or the keyframes of the file that is named."""
        for note in self.session.load(self.file):
            self.state.messages.say(note)
        self.show_frame()

    def take(self, name: str) -> None:
        """A pose of the library."""
        session, ground = self.session, partial(grounded, self.avatar)
        pose = self.library.read(name, root=session.pose.root, pelvis_height=session.pelvis_height, ground=ground)
        session.put(name, pose.axis_angle, pose.root, limited=False, hold=False)

    def keep(self, name: str) -> None:
        """The present pose into the library."""
        path = self.library.write(name, self.session.pose, pelvis_height=self.session.pelvis_height)
        self.state.messages.say(f"{path} written")
        if not self.session.keys:
            self.session.history.mark_saved()

    def may_leave(self) -> bool:
        """Whether posing can end; what is not saved is said once and lost the second time."""
        if self.session.history.dirty and self._warned is not self.session.state:
            self._warned = self.session.state
            self.state.messages.say("the pose is not saved; once more to leave it")
            return False
        return True
