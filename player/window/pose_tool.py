"""The mouse over an avatar that is posed by hand: what lies over it, and what a drag of it does.

Over the picture are the rings on the selected joint (ImGuizmo's, player/window/panels/pose_overlay.py), a handle at
each hand and foot, one at the pelvis for the whole body, and dots at elbows and knees that swing them about the line
from shoulder to hand. A drag is always worked out from the pose in which it began, so that it is one step of undo and
that coming back to where it began is coming back to the pose.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from avatar.camera import Camera, pixel_rays, project
from avatar.limits import joint_angles, limits
from avatar.rotation import axis_angle_from_matrix, matrix_from_axis_angle
from player.pose.history import KeptPose
from player.pose.ik import LIMBS
from player.pose.session import PoseSession
from player.window.state import WindowState

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

    start: KeptPose
    # the joints' places in that pose, world
    places: Float[Array, "52 3"]
    pressed: tuple[float, float] | None = None
    # a handle, and from the pointer to it, metres
    handle: PullHandle | None = None
    offset: Float[Array, "3"] | None = None
    # the rings: their axes when they were seized and now, world
    seized: Float[Array, "3 3"] | None = None
    axes: Float[Array, "3 3"] | None = None
    moved: bool = False


class PoseTool:
    """The mouse on one avatar: what it is over, and what it holds. Places are pixels of the framebuffer."""

    def __init__(self, state: WindowState, session: PoseSession, index: int):
        self.state, self.session, self.index = state, session, index
        # the axes that the rings turn about
        self.frame: Literal["world", "local"] = "local"
        # hands and feet turn with forearm and shin
        self.follow = False
        self.held: Drag | None = None
        self.hovered: PullHandle | None = None
        # the pointer is on a ring, or holds one
        self.on_ring = False
        # the drag of a ring was given up, and the button is still down
        self.given_up = False

    # -- places

    @property
    def joint(self) -> int | None:
        """The joint that gizmo and sliders turn."""
        selection = self.state.selection
        return selection.joint if selection.avatar == self.index else None

    @property
    def _scale(self) -> float:
        """Pixels a window unit."""
        return self.state.layout.screen.scale

    def _places(self) -> Float[Array, "52 3"]:
        """Of the joints, world."""
        return self.session.world()[:, :3, 3]

    def ring_axes(self) -> Float[Array, "3 3"]:
        """Axes of the rings as columns, world: x, y and z, or the joint's own. Those are flexion, abduction and
        twist, carried along by its swing and not by its twist, so that a hinge's first ring changes its flexion
        alone, and every third ring the twist alone. While a ring is held they are as it was turned, whatever the
        joint's limits make of it."""
        if self.held is not None and self.held.axes is not None:
            return self.held.axes
        joint, axis_angle = self.joint, self.session.pose.axis_angle
        if joint is None or self.frame == "world":
            return np.eye(3)
        axes = limits().axes[joint]
        untwisted = matrix_from_axis_angle(-joint_angles(axis_angle)[joint, 2] * axes[2])
        out = self.session.world()[joint, :3, :3] @ untwisted @ axes.T
        # the table's axes of some joints are left-handed, those of the gizmo are not
        return out * [1.0, 1.0, np.sign(np.linalg.det(out))]

    def under(self, x: float, y: float) -> PullHandle | None:
        """The handle at a pixel; those of ends come first."""
        camera = self.state.last.camera
        # nothing is seized that is not shown
        if camera is None or not self.state.layout.panels_drawn:
            return None
        pixels, depth = project(camera, self._places()[[handle.joint for handle in HANDLES]])
        distance = np.where(depth > 1e-3, np.linalg.norm(pixels - [x, y], axis=1), np.inf) / self._scale
        ends = distance[:4]
        if ends.min() <= HANDLE:
            return HANDLES[int(np.argmin(ends))]
        distance = np.where(np.arange(len(HANDLES)) > 4, distance * HANDLE / DOT, distance)
        return HANDLES[int(np.argmin(distance))] if distance.min() <= HANDLE else None

    # -- the pointer

    def press(self, x: float, y: float) -> bool:
        """Take hold of a handle; False where there is none."""
        camera, found = self.state.last.camera, self.under(x, y)
        if camera is None or found is None:
            return False
        places = self._places()
        place = places[found.joint]
        offset = place - on_plane_through(camera, place, np.array([x, y], np.float64))
        self.held = Drag(self.session.pose, places, (x, y), found, offset)
        return True

    def drag(self, x: float, y: float) -> None:
        """Move what is held."""
        held, camera = self.held, self.state.last.camera
        if held is None or camera is None or held.handle is None or held.pressed is None or held.offset is None:
            return
        if not held.moved and np.hypot(x - held.pressed[0], y - held.pressed[1]) <= CLICK * self._scale:
            return
        held.moved = True
        place = held.places[held.handle.joint]
        # all of a drag is at the depth at which it began
        target = on_plane_through(camera, place, np.array([x, y], np.float64)) + held.offset
        session, start, name = self.session, held.start, held.handle.name
        if held.handle.kind == "body":
            session.move(start, start.root + target - place, drag=held)
        elif held.handle.kind == "end":
            session.reach(start, name, target, follow=self.follow, drag=held)
        else:
            limb = LIMBS[name]
            pole = target - held.places[limb.first]
            session.reach(start, name, held.places[limb.end], follow=self.follow, pole=pole, drag=held)

    def turn(self, axes: Float[Array, "3 3"]) -> None:
        """A ring is held and turned so that the rings' axes are these."""
        joint = self.joint
        if joint is None:
            return
        if self.held is None:
            self.held = Drag(self.session.pose, self._places(), seized=self.ring_axes())
        held = self.held
        assert held.seized is not None
        # ImGuizmo's numbers are of single precision: a press alone is no turn
        if not held.moved and np.abs(axes - held.seized).max() < 1e-5:
            return
        held.moved = True
        held.axes = axes
        self.session.turn(held.start, joint, axis_angle_from_matrix(axes @ held.seized.T), 1.0, drag=held)

    def release(self) -> None:
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
        """A click beside handles: the joint whose dot is there; False: let the picture decide."""
        camera = self.state.last.camera
        if camera is None:
            return False
        near = picked_joint(self._places()[:22], camera, np.array([x, y], np.float64), 5.0 * self._scale)
        if near is None:
            return False
        self.state.selection.choose(self.index, near)
        return True

    def cancel(self) -> None:
        """Give up the drag, where there is one."""
        if self.held is None:
            return
        held, self.held = self.held, None
        self.given_up = held.handle is None
        self.session.put("cancel", held.start.axis_angle, held.start.root, drag=held, limited=False, hold=False)
        self.session.history.end_drag()


def picked_joint(
    places: Float[Array, "joints 3"], camera: Camera, pixel: Float[Array, "2"], near_enough: float
) -> int | None:
    """The joint under the pointer: of those within `near_enough` pixels the nearest on the screen, then to the eye."""
    pixels, depth = project(camera, places)
    distance = np.where(depth > 1e-3, np.linalg.norm(pixels - pixel, axis=1), np.inf)
    if not distance.min() <= near_enough:
        return None
    return int(np.lexsort((depth, np.round(distance)))[0])


def on_plane_through(camera: Camera, point: Float[Array, "3"], pixel: Float[Array, "2"]) -> Float[Array, "3"]:
    """The world point under the pointer at the same depth as `point`: where a handle is dragged to."""
    origins, directions = pixel_rays(camera, np.asarray(pixel, np.float64)[None])
    forward = camera.camera_from_world[2, :3]
    return origins[0] + directions[0] * float((point - origins[0]) @ forward) / float(directions[0] @ forward)
