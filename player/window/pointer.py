"""The mouse over the picture: what a press takes hold of, what a drag moves, and what a click picks."""

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from avatar.baked_avatar import Avatar, Level
from avatar.camera import Camera, pixel_rays
from avatar.skinning import SkinWeights, dense_weights
from player.draw.drawing import GivenPose
from player.draw.posing import posed_vertices
from player.window.parts import WindowParts

# window units that a click may wander
CLICK = 4.0
Hold = Literal["nothing", "camera", "wipe", "tool"]


class Picked(NamedTuple):
    """A place on an avatar's skin."""

    avatar: int
    # the bone that moves the place most
    joint: int
    face: int
    point: Float[np.ndarray, "3"]  # world, metres
    distance: float  # metres from the eye


class Pointer:
    """Where the pointer is, window units, and what it holds: nothing yet, the camera, the wipe's line or the tool."""

    def __init__(self, parts: WindowParts):
        self.parts, self._screen = parts, parts.state.layout.screen
        self.at: tuple[float, float] = (0.0, 0.0)
        # button and where it went down
        self._pressed: tuple[int, float, float] | None = None
        self._holds: Hold = "nothing"

    @property
    def beside_middle(self) -> tuple[float, float]:
        """How far right of and below the middle of the picture it points, in metres at a metre's depth."""
        camera, (x, y) = self.parts.state.last.camera, self._screen.pixel(*self.at)
        if camera is None:
            return 0.0, 0.0
        return float((x - camera.K[0, 2]) / camera.K[0, 0]), float((y - camera.K[1, 2]) / camera.K[1, 1])

    @property
    def over_picture(self) -> bool:
        """Whether it is in the area that is free of panels."""
        x, y = self._screen.pixel(*self.at)
        left, top, width, height = self.parts.state.layout.area
        return left <= x < left + width and top <= y < top + height

    def move(self, x: float | int, y: float | int) -> None:
        """The pointer moved."""
        cameras, wipe, edit = self.parts.viewpoint.cameras, self.parts.wipe, self.parts.posing.edit
        dx, dy = x - self.at[0], y - self.at[1]
        self.at = (float(x), float(y))
        pixel = self._screen.pixel(x, y)
        if self._pressed is None:
            if edit is not None:
                edit.tool.hover(*pixel)
            return
        button, x0, y0 = self._pressed
        if self._holds == "nothing" and np.hypot(x - x0, y - y0) > CLICK:
            self._holds, dx, dy = "camera", x - x0, y - y0
        if self._holds == "wipe" and wipe is not None:
            wipe.move_to(pixel[0])
        elif self._holds == "tool" and edit is not None:
            edit.tool.drag(*pixel)
        elif self._holds == "camera" and button == 0:
            cameras.turn(dx, dy)
        elif self._holds == "camera":
            cameras.shift(dx, dy, self._screen.units[1])

    def press(self, button: int) -> None:
        """A button went down over the picture."""
        self._pressed, self._holds = (button, *self.at), "nothing"
        if button != 0:
            return
        x, y = self._screen.pixel(*self.at)
        wipe, edit = self.parts.wipe, self.parts.posing.edit
        if edit is not None and edit.tool.press(x, y):
            self._holds = "tool"
        elif wipe is not None and self.parts.viewpoint.shows_video and wipe.near(x):
            self._holds = "wipe"

    def release(self, button: int) -> None:
        """A button was let go: the tool keeps what it did, a click beside it picks."""
        if self._pressed is None or self._pressed[0] != button:
            return
        edit = self.parts.posing.edit
        if self._holds == "tool" and edit is not None:
            edit.tool.release()
        elif self._holds == "nothing" and button == 0:
            self.pick(*self._screen.pixel(*self.at))
        self._pressed, self._holds = None, "nothing"

    def pick(self, x: float | int, y: float | int) -> Picked | None:
        """Select the avatar and joint under a pixel; beside them the joint is let go."""
        state, edit = self.parts.state, self.parts.posing.edit
        if state.last.camera is None or (edit is not None and edit.tool.pick(x, y)):
            return None
        detail = self.parts.look.renderer.detail
        levels = [avatar.level(number) for avatar, number in zip(state.avatars, detail, strict=True)]
        found = pick(state.avatars, levels, state.last.poses, state.last.camera, (x, y))
        if found is None:
            state.selection.joint = None
        else:
            state.selection.choose(found.avatar, found.joint)
        return found


def pick(
    avatars: Sequence[Avatar],
    levels: Sequence[Level],
    poses: Sequence[GivenPose],
    camera: Camera,
    pixel: tuple[float, float],
) -> Picked | None:
    """The nearest triangle that faces the camera on the ray through a pixel (left, top; centres at .5).

    Moeller and Trumbore 1997, in double precision; triangles that turn their back are not drawn and not hit.
    """
    origins, directions = pixel_rays(camera, np.array([pixel], np.float64))
    origin, direction = origins[0], directions[0]
    best: Picked | None = None
    for number, (avatar, level, pose) in enumerate(zip(avatars, levels, poses, strict=True)):
        faces = level.faces.astype(np.int64)
        a, b, c = posed_vertices(avatar, level, pose[:2])[faces.T] - origin
        # (1 - u - v) a + u b + v c = t direction; the volumes are those of Cramer's rule
        p = np.cross(direction, c - a)
        determinant = (p * (b - a)).sum(1)
        q = np.cross(-a, b - a)
        # triangles without area, or seen from behind, are not hit
        faces_us = determinant > 0
        scale = 1 / np.where(faces_us, determinant, 1.0)
        u, v, t = -(a * p).sum(1) * scale, (q @ direction) * scale, (q * (c - a)).sum(1) * scale
        hit = faces_us & (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0)
        if not hit.any():
            continue
        face = int(np.argmin(np.where(hit, t, np.inf)))
        if best is None or t[face] < best.distance:
            corners = np.array([1 - u[face] - v[face], u[face], v[face]])
            skin = SkinWeights(*(part[faces[face]] for part in level.skin))
            joint = int(np.argmax(corners @ dense_weights(skin)))
            best = Picked(number, joint, face, origin + t[face] * direction, float(t[face]))
    return best
