"""Posing by hand in the window: one avatar leaves its motion, and keys and panels change its pose.

The pose itself and undo are the session's (player/pose/session.py), the mouse is player/window/pose_tool.py.
Here is what ties them to the window: its messages, files and the library.
"""

from collections.abc import Callable
from functools import partial

import numpy as np

from command.errors import AssetError
from player.draw.drawing import Pose
from player.draw.posing import grounded
from player.pose.library import Library
from player.pose.session import PoseSession
from player.scene.framing import pelvis_height
from player.window.pose_tool import PoseTool
from player.window.recorder import free_name
from player.window.state import WindowState


class Posing:
    """Whether an avatar is being posed, and which."""

    def __init__(self, state: WindowState):
        self.state = state
        self.edit: PoseEdit | None = None

    def toggle(self) -> None:
        """Pose the selected avatar by hand, or let its motion have it again."""
        if self.edit is None:
            self.state.timeline.playing = False
            self.edit = PoseEdit(self.state, self.state.selection.avatar)
        elif self.edit.may_leave():
            self.edit = None

    def may_leave(self) -> bool:
        """Whether the window may close; False, once, where a pose would be lost, which is said."""
        return self.edit is None or self.edit.may_leave()

    def poses(self) -> list[Pose]:
        """The poses of now; the avatar that is posed by hand has its hand-made one."""
        poses = self.state.playback.poses()
        if self.edit is not None:
            pose = self.edit.session.pose
            poses[self.edit.index] = Pose(pose.axis_angle, pose.root, pose.face)
        return poses


class PoseEdit:
    """One avatar being posed: its session, the mouse on it, and what keys and panels ask for."""

    def __init__(self, state: WindowState, index: int):
        self.state, self.index, self.avatar = state, index, state.avatars[index]
        axis_angle, root, face = state.playback.poses()[index]
        self.session = PoseSession(
            self.avatar.joint_positions.astype(np.float64),
            axis_angle=axis_angle,
            root=root,
            pelvis_height=pelvis_height(self.avatar),
            face=face,
        )
        self.tool = PoseTool(state, self.session, index)
        self.library = Library()
        # what is typed into the panel's fields
        self.name = self.file = ""
        # the pose of which was said that leaving loses it
        self._warned: object = None

    # -- changes

    def undo(self) -> None:
        self._walk("undone", self.session.undo)

    def redo(self) -> None:
        self._walk("redone", self.session.redo)

    def _walk(self, word: str, step: Callable[[], str | None]) -> None:
        self.tool.cancel()
        label = step()
        self.state.messages.say(f"{word}: {label.replace('_', ' ')}" if label else f"nothing to be {word}")

    def to_ground(self) -> None:
        """The body up or down until its lowest point touches the ground."""
        pose = self.session.pose
        self.session.put(
            "to the ground", pose.axis_angle, grounded(self.avatar, pose.axis_angle, pose.root), hold=False
        )

    def tried(self, act: Callable[[], object]) -> None:
        """Do what may be refused, and say why it was."""
        try:
            act()
        except (AssetError, ValueError) as error:
            self.state.messages.say(str(error))

    # -- files

    def save(self) -> None:
        """Write the pose to the file that is named, else to a new one."""
        self.state.messages.say(self.session.save(self.file or free_name("selfscan-pose", ".npz")) + " written")

    def load(self) -> None:
        """Take the pose of the file that is named."""
        self.session.load(self.file)

    def take(self, name: str) -> None:
        """A pose of the library; one without a face leaves the face as it is."""
        session, ground = self.session, partial(grounded, self.avatar)
        pose = self.library.read(name, root=session.pose.root, pelvis_height=session.pelvis_height, ground=ground)
        step = object()
        session.put(name, pose.axis_angle, pose.root, drag=step, limited=False, hold=False)
        if pose.face is not None:
            session.set_face(pose.weights, pose.gaze, drag=step)
        session.history.end_drag()

    def keep(self, name: str) -> None:
        """The present pose into the library."""
        path = self.library.write(name, self.session.pose, pelvis_height=self.session.pelvis_height)
        self.state.messages.say(f"{path} written")
        self.session.history.mark_saved()

    def may_leave(self) -> bool:
        """Whether posing can end; what is not saved is said once and lost the second time."""
        if self.session.history.dirty and self._warned is not self.session.pose:
            self._warned = self.session.pose
            self.state.messages.say("the pose is not saved; once more to leave it")
            return False
        return True
