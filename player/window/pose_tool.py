"""Posing with the mouse and keys: what lies over the avatar that is posed by hand, and what a drag of it does.

Over the picture are the gizmo on the selected joint (player/pose/gizmo.py), a handle at each hand and foot, one at
the pelvis for the whole body, and dots at elbows and knees that swing them about the line from shoulder to hand. A
drag is always worked out from the pose in which it began, so that it is one step of undo and that coming back to
where it began is coming back to the pose.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import glfw
import numpy as np
from jaxtyping import Float

from avatar.camera import Camera, project
from avatar.errors import AssetError
from avatar.skeleton import JOINTS, joint_transforms
from player.framing import pelvis_height
from player.pose.gizmo import (
    Frame,
    Gizmo,
    Grab,
    drag_angle,
    gizmo_at,
    grabbed,
    on_plane_through,
    picked_joint,
    picked_ring,
)
from player.pose.ground import grounded
from player.pose.ik import LIMBS
from player.pose.keyframes import Pose
from player.pose.library import Library
from player.pose.session import PoseSession, limb_of

if TYPE_CHECKING:
    from player.window.window import Window

# of the gizmo, window units
RADIUS = 75.0
# window units round a handle that still seize it
HANDLE = 11.0
DOT = 8.0
# window units that a press on a handle may wander and still be a click
CLICK = 3.0
CONTROL = (glfw.KEY_LEFT_CONTROL, glfw.KEY_RIGHT_CONTROL, glfw.KEY_LEFT_SUPER, glfw.KEY_RIGHT_SUPER)
SHIFT = (glfw.KEY_LEFT_SHIFT, glfw.KEY_RIGHT_SHIFT)


@dataclass(frozen=True)
class Handle:
    """Something to pull: a joint's place on the screen, and what the pull does."""

    name: str
    joint: int
    kind: str  # "end", "middle" or "body"


HANDLES = (
    *(Handle(name, limb.end, "end") for name, limb in LIMBS.items()),
    Handle("body", 0, "body"),
    *(Handle(name, limb.middle, "middle") for name, limb in LIMBS.items()),
)


@dataclass(eq=False)
class Drag:
    """What the pointer holds, and the pose in which it took hold."""

    start: Pose
    pressed: tuple[float, float]
    grab: Grab | None = None
    angle: float = 0.0  # of the ring
    handle: Handle | None = None
    offset: Float[np.ndarray, "3"] | None = None  # from the pointer to the handle, metres
    moved: bool = False


class PoseTool:
    """One avatar of the window being posed; the window's tool (player/window/pointer.py) while that is so."""

    def __init__(self, window: "Window", index: int):
        avatar = window.show.avatars[index]
        axis_angle, root = window.playback.poses()[index]
        self.window, self.index = window, index
        self.session = PoseSession(
            avatar.joint_positions.astype(np.float64),
            axis_angle=axis_angle,
            root=root,
            pelvis_height=pelvis_height(avatar),
            rate=window.timeline.rate,
        )
        self.library = Library()
        self.frame: Frame = "local"
        # hands and feet turn with forearm and shin
        self.follow = False
        self.held: Drag | None = None
        # a ring or a handle
        self.hovered: int | Handle | None = None
        self.keys_down: set[int] = set()
        self.typed = {"name": "", "file": ""}  # in the panel's fields
        # the state of which was said that leaving loses it
        self.warned: object = None
        # of the timeline before, for leaving
        self.lasted = window.timeline.frames

    # -- places

    @property
    def joint(self) -> int | None:
        """The joint that gizmo and sliders turn."""
        selection = self.window.selection
        return selection.joint if selection.avatar == self.index else None

    def camera(self) -> Camera | None:
        """The camera of the last picture, pixels of the framebuffer."""
        return self.window.camera

    def units(self) -> float:
        """Framebuffer pixels per window unit."""
        return self.window.pixel(1.0, 1.0)[0]

    def gizmo(self) -> Gizmo | None:
        """The rings on the selected joint; while one is held they stay as they were seized."""
        if self.held is not None and self.held.grab is not None:
            return self.held.grab.gizmo
        camera, joint = self.camera(), self.joint
        if camera is None or joint is None:
            return None
        pose = self.session.pose
        size = self.units() * RADIUS * (0.55 if joint >= 22 else 1.0)  # fingers are small
        return gizmo_at(pose.axis_angle, pose.root, self.session.joints, joint, camera, frame=self.frame, pixels=size)

    def place(self, handle: Handle) -> Float[np.ndarray, "3"]:
        return self.session.world()[handle.joint, :3, 3]

    def under(self, x: float, y: float) -> int | Handle | None:
        """The handle or ring at a pixel. Handles of ends come first, then rings, then the rest."""
        camera, panels = self.camera(), self.window.panels
        if camera is None or panels is None or not panels.drawn:
            # nothing is seized that is not shown
            return None
        places = self.session.world()[[h.joint for h in HANDLES], :3, 3]
        pixels, depth = project(camera, places)
        distance = np.where(depth > 1e-3, np.linalg.norm(pixels - [x, y], axis=1), np.inf) / self.units()
        ends = distance[:4]
        if ends.min() <= HANDLE:
            return HANDLES[int(np.argmin(ends))]
        gizmo = self.gizmo()
        if gizmo is not None:
            ring = picked_ring(gizmo, camera, np.array([x, y], np.float64))
            if ring is not None:
                return ring
        distance = np.where(np.arange(len(HANDLES)) > 4, distance * HANDLE / DOT, distance)
        return HANDLES[int(np.argmin(distance))] if distance.min() <= HANDLE else None

    # -- the pointer (pixels of the framebuffer)

    def press(self, x: float, y: float) -> bool:
        """Take hold of a ring or handle; False where there is none."""
        camera, found = self.camera(), self.under(x, y)
        if camera is None or found is None:
            return False
        self._pause()
        pixel = np.array([x, y], np.float64)
        self.held = Drag(self.session.pose, (x, y))
        if isinstance(found, Handle):
            place = self.place(found)
            self.held.handle = found
            self.held.offset = place - on_plane_through(camera, place, pixel)
        else:
            gizmo = self.gizmo()
            assert gizmo is not None
            self.held.grab = grabbed(gizmo, found, camera, pixel)
        return True

    def drag(self, x: float, y: float) -> None:
        """Move what is held."""
        held, camera = self.held, self.camera()
        if held is None or camera is None:
            return
        if not held.moved and np.hypot(x - held.pressed[0], y - held.pressed[1]) <= CLICK * self.units():
            return
        held.moved = True
        pixel = np.array([x, y], np.float64)
        if held.grab is not None:
            joint = self.joint
            if joint is None:
                return
            held.angle = drag_angle(held.grab, camera, pixel, held.angle)
            axis = held.grab.gizmo.axes[held.grab.ring]
            self.session.turn(held.start, joint, axis, held.angle, drag=held)
        elif held.handle is not None and held.offset is not None:
            self._pull(held.handle, held, on_plane_through(camera, self._start_place(held), pixel) + held.offset)

    def _start_place(self, held: Drag) -> Float[np.ndarray, "3"]:
        """Where the handle was: all of a drag is at that depth."""
        assert held.handle is not None
        return _places(self.session, held.start)[held.handle.joint]

    def _pull(self, handle: Handle, held: Drag, target: Float[np.ndarray, "3"]) -> None:
        session, start = self.session, held.start
        if handle.kind == "body":
            session.move(start, start.root + target - self._start_place(held), drag=held)
        elif handle.kind == "end":
            session.reach(start, handle.name, target, follow=self.follow, drag=held)
        else:
            limb, places = LIMBS[handle.name], _places(session, start)
            pole = target - places[limb.first]
            session.reach(start, handle.name, places[limb.end], follow=self.follow, pole=pole, drag=held)

    def release(self, x: float, y: float) -> None:
        """Let go; a press that did not move selects the handle's joint."""
        held, self.held = self.held, None
        if held is None:
            return
        self.session.end_drag()
        if not held.moved and held.handle is not None:
            self.window.select(self.index, held.handle.joint)

    def hover(self, x: float, y: float) -> None:
        """Where the pointer is, for what lights up."""
        self.hovered = self.under(x, y) if self.held is None else None

    def pick(self, x: float, y: float) -> bool:
        """A click beside rings and handles: the joint whose dot is there; False: let the picture decide."""
        camera = self.camera()
        if camera is None:
            return False
        near = picked_joint(self.session.world()[:22, :3, 3], camera, np.array([x, y], np.float64), 5.0 * self.units())
        if near is None:
            return False
        self.window.select(self.index, near)
        return True

    def cancel(self) -> bool:
        """Give up the drag; whether there was one."""
        if self.held is None:
            return False
        held, self.held = self.held, None
        self.session.put("cancel", held.start.axis_angle, held.start.root, drag=held, limited=False, hold=False)
        self.session.end_drag()
        return True

    # -- keys

    def key(self, key: int, down: bool) -> bool:
        """A key; True where posing took it."""
        if key in CONTROL or key in SHIFT:
            (self.keys_down.add if down else self.keys_down.discard)(key)
            return False
        if not down:
            return False
        if key == glfw.KEY_ESCAPE:
            return self.cancel()
        if self.keys_down.intersection(CONTROL):
            act = WITH_CONTROL.get(key)
            if act is not None:
                act(self)
            return act is not None
        act = ALONE.get(key)
        if act is not None:
            act(self)
        return act is not None

    def undo(self) -> None:
        self.cancel()
        self._walk("undone", self.session.undo)

    def redo(self) -> None:
        self.cancel()
        self._walk("redone", self.session.redo)

    def _walk(self, word: str, step: Callable[[], str | None]) -> None:
        """A step back or forth; with keys the window goes to the frame that it was made at."""
        keyed = bool(self.session.keys)
        label = step()
        self.window.say(f"{word}: {label.replace('_', ' ')}" if label else f"nothing to be {word}")
        if label and (keyed or self.session.keys):
            self.show_frame()

    def undo_or_redo(self) -> None:
        (self.redo if self.keys_down.intersection(SHIFT) else self.undo)()

    def copy(self, what: str = "limb") -> None:
        """Copy the selected joint, its limb, or the whole pose; without a selection the whole."""
        joint = self.joint
        if joint is None or what == "whole":
            joints, name = tuple(range(52)), "the whole pose"
        elif what == "joint":
            joints, name = (joint,), spoken(joint)
        else:
            joints, name = limb_of(joint) if joint else tuple(range(52)), f"the limb of {spoken(joint)}"
        self.session.copy(joints)
        self.window.say(f"copied: {name}")

    def paste(self, *, mirrored: bool = False) -> None:
        self.session.paste(mirrored=mirrored)

    def insert_key(self) -> None:
        self.session.key()
        self.window.say(f"key at frame {self.session.frame}; {len(self.session.keys)} in all")

    def to_ground(self) -> None:
        """The body up or down until its lowest point touches the ground."""
        pose = self.session.pose
        root = grounded(self.window.show.avatars[self.index], pose.axis_angle, pose.root)
        self.session.put("to the ground", pose.axis_angle, root, hold=False)

    # -- time

    def follow_timeline(self) -> None:
        """The session's frame is the one that the window shows."""
        line = self.window.timeline
        if self.session.keys:
            line.frames = max(line.frames, round((self.session.keys[-1][0] + 1) * line.rate / self.session.rate))
        self.session.seek(int(line.seconds * self.session.rate + 1e-6))

    def _pause(self) -> None:
        """A timeline that plays keys would take the pose out of one's hands."""
        if self.session.keys:
            self.window.timeline.playing = False

    def show_frame(self) -> None:
        """The window goes to the session's frame: after undo, and after loading."""
        line = self.window.timeline
        line.playing = False
        if self.session.keys:
            line.frames = max(line.frames, round((self.session.keys[-1][0] + 1) * line.rate / self.session.rate))
        line.seek(int((self.session.frame + 0.5) * line.rate / self.session.rate))

    # -- files

    def take(self, name: str) -> None:
        """A pose of the library."""

        def ground(axis_angle: np.ndarray, root: np.ndarray) -> np.ndarray:
            return grounded(self.window.show.avatars[self.index], axis_angle, root)

        session = self.session
        pose = self.library.read(name, root=session.pose.root, pelvis_height=session.pelvis_height, ground=ground)
        session.load_pose(name, pose)

    def keep(self, name: str) -> None:
        """The pose in hand into the library."""
        path = self.library.write(name, self.session.pose, pelvis_height=self.session.pelvis_height)
        self.window.say(f"{path} written")
        if not self.session.keys:
            self.session.saved = self.session.state

    def tried(self, act: Callable[[], object]) -> None:
        """Do what may be refused, and say why it was."""
        self._pause()
        try:
            act()
        except (AssetError, ValueError) as error:
            self.window.say(str(error))

    def may_leave(self) -> bool:
        """Whether posing can end; what is not saved is said once and lost the second time."""
        if self.session.dirty and self.warned is not self.session.state:
            self.warned = self.session.state
            self.window.say("the pose is not saved; once more to leave it")
            return False
        return True


def _places(session: PoseSession, pose: Pose) -> Float[np.ndarray, "52 3"]:
    return joint_transforms(pose.axis_angle, session.joints, pose.root)[:, :3, 3]


def spoken(joint: int) -> str:
    """A joint's name as one says it: "left elbow", "right little finger 2"."""
    name = JOINTS[joint].replace("_", " ").replace("pinky", "little finger")
    if name[-1].isdigit():
        return f"{name[:-1]} {name[-1]}"
    parts = {"foot": "toes", "collar": "collar bone"}
    words = name.split()
    return " ".join([*words[:-1], parts.get(words[-1], words[-1])])


WITH_CONTROL: dict[int, Callable[[PoseTool], None]] = {
    glfw.KEY_Z: PoseTool.undo_or_redo,
    glfw.KEY_Y: PoseTool.redo,
    glfw.KEY_C: lambda tool: tool.copy("limb"),
    glfw.KEY_A: lambda tool: tool.copy("whole"),
    glfw.KEY_V: lambda tool: tool.paste(mirrored=bool(tool.keys_down.intersection(SHIFT))),
}
ALONE: dict[int, Callable[[PoseTool], None]] = {
    glfw.KEY_M: lambda tool: tool.session.mirror(),
    glfw.KEY_I: PoseTool.insert_key,
    glfw.KEY_DELETE: lambda tool: tool.session.delete_key(),
    glfw.KEY_N: PoseTool.to_ground,
}


def toggle_posing(window: "Window") -> None:
    """Pose the selected avatar by hand, or let its motion have it again."""
    tool = window.tool
    if isinstance(tool, PoseTool):
        if not tool.may_leave():
            return
        glfw.set_window_close_callback(window.handle, lambda _handle: None)
        window.tool, window.pose_session = None, None
        window.timeline.frames = tool.lasted
        window.timeline.seek(window.timeline.frame)
        return
    index = window.selection.avatar
    window.timeline.playing = False
    posing = tool = PoseTool(window, index)
    glfw.set_window_close_callback(
        window.handle, lambda handle: glfw.set_window_should_close(handle, posing.may_leave())
    )
    window.tool, window.pose_session, window.posed = tool, tool.session, index
