"""The mouse over an avatar that is posed by hand: what lies over it, and what a drag of it does.

Over the picture are the gizmo on the selected joint (player/pose/gizmo.py), a handle at each hand and foot, one at
the pelvis for the whole body, and dots at elbows and knees that swing them about the line from shoulder to hand. A
drag is always worked out from the pose in which it began, so that it is one step of undo and that coming back to
where it began is coming back to the pose.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from avatar.camera import Camera, project
from avatar.skeleton import joint_transforms
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
from player.pose.ik import LIMBS
from player.pose.keyframes import Pose
from player.pose.session import PoseSession
from player.window.state import WindowState

# the gizmo's, window units
RADIUS = 75.0
# window units round a handle that still seize it
HANDLE = 11.0
DOT = 8.0
# window units that a press on a handle may wander and still be a click
CLICK = 3.0


@dataclass(frozen=True)
class PullHandle:
    """Something to pull: a joint's place on the screen, and what the pull does."""

    name: str
    joint: int
    kind: str  # "end", "middle" or "body"


HANDLES = (
    *(PullHandle(name, limb.end, "end") for name, limb in LIMBS.items()),
    PullHandle("body", 0, "body"),
    *(PullHandle(name, limb.middle, "middle") for name, limb in LIMBS.items()),
)


@dataclass(eq=False)
class Drag:
    """What the pointer holds, and the pose in which it took hold."""

    start: Pose
    pressed: tuple[float, float]
    grab: Grab | None = None
    angle: float = 0.0  # the ring's
    handle: PullHandle | None = None
    offset: Float[np.ndarray, "3"] | None = None  # from the pointer to the handle, metres
    moved: bool = False


class PoseTool:
    """The mouse on one avatar: what it is over, and what it holds. Places are pixels of the framebuffer."""

    def __init__(self, state: WindowState, session: PoseSession, index: int):
        self.state, self.session, self.index = state, session, index
        self.frame: Frame = "local"
        # hands and feet turn with forearm and shin
        self.follow = False
        self.held: Drag | None = None
        # a ring or a handle
        self.hovered: int | PullHandle | None = None

    # -- places

    @property
    def joint(self) -> int | None:
        """The joint that gizmo and sliders turn."""
        selection = self.state.selection
        return selection.joint if selection.avatar == self.index else None

    @property
    def _camera(self) -> Camera | None:
        return self.state.last.camera

    @property
    def _scale(self) -> float:
        """Pixels a window unit."""
        return self.state.layout.screen.scale

    def gizmo(self) -> Gizmo | None:
        """The rings on the selected joint; while one is held they stay as they were seized."""
        if self.held is not None and self.held.grab is not None:
            return self.held.grab.gizmo
        camera, joint = self._camera, self.joint
        if camera is None or joint is None:
            return None
        pose = self.session.pose
        size = self._scale * RADIUS * (0.55 if joint >= 22 else 1.0)  # fingers are small
        return gizmo_at(pose.axis_angle, pose.root, self.session.joints, joint, camera, frame=self.frame, pixels=size)

    def place(self, handle: PullHandle) -> Float[np.ndarray, "3"]:
        return self.session.world()[handle.joint, :3, 3]

    def under(self, x: float, y: float) -> int | PullHandle | None:
        """The handle or ring at a pixel. Handles of ends come first, then rings, then the rest."""
        camera = self._camera
        # nothing is seized that is not shown
        if camera is None or not self.state.layout.panels_drawn:
            return None
        places = self.session.world()[[h.joint for h in HANDLES], :3, 3]
        pixels, depth = project(camera, places)
        distance = np.where(depth > 1e-3, np.linalg.norm(pixels - [x, y], axis=1), np.inf) / self._scale
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

    # -- the pointer

    def press(self, x: float, y: float) -> bool:
        """Take hold of a ring or handle; False where there is none."""
        camera, found = self._camera, self.under(x, y)
        if camera is None or found is None:
            return False
        pixel = np.array([x, y], np.float64)
        self.held = Drag(self.session.pose, (x, y))
        if isinstance(found, PullHandle):
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
        held, camera = self.held, self._camera
        if held is None or camera is None:
            return
        if not held.moved and np.hypot(x - held.pressed[0], y - held.pressed[1]) <= CLICK * self._scale:
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

    def _pull(self, handle: PullHandle, held: Drag, target: Float[np.ndarray, "3"]) -> None:
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
        self.session.history.end_drag()
        if not held.moved and held.handle is not None:
            self.state.selection.choose(self.index, held.handle.joint)

    def hover(self, x: float, y: float) -> None:
        """Where the pointer is, for what lights up."""
        self.hovered = self.under(x, y) if self.held is None else None

    def pick(self, x: float, y: float) -> bool:
        """A click beside rings and handles: the joint whose dot is there; False: let the picture decide."""
        camera = self._camera
        if camera is None:
            return False
        near = picked_joint(self.session.world()[:22, :3, 3], camera, np.array([x, y], np.float64), 5.0 * self._scale)
        if near is None:
            return False
        self.state.selection.choose(self.index, near)
        return True

    def cancel(self) -> bool:
        """Give up the drag; whether there was one."""
        if self.held is None:
            return False
        held, self.held = self.held, None
        self.session.put("cancel", held.start.axis_angle, held.start.root, drag=held, limited=False, hold=False)
        self.session.history.end_drag()
        return True


def _places(session: PoseSession, pose: Pose) -> Float[np.ndarray, "52 3"]:
    return joint_transforms(pose.axis_angle, session.joints, pose.root)[:, :3, 3]
