"""The frames whose mean a frame of a film is: moments while the shutter is open, places on the lens.

The shutter opens half its time before the frame's own moment and closes half after it. Poses between two of the
motion's are interpolated; where the motion jumps (a cut, a teleport) the frame's own side of the jump is held, so that
nothing is smeared across the room. Seen from a place (x, y) on the lens, the picture is shifted so that what lies at
the focus stays where it is:

    c_x' = c_x + f_x x / focus,    c_y' = c_y + f_y y / focus
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from avatar.camera import Camera
from avatar.face import REST, FaceFrame
from avatar.skeleton import JOINTS
from player.draw.drawing import Pose
from player.draw.face import HEAD_HEIGHT, SMALLEST, head_pixels
from player.draw.posing import PosedBones, Poser
from player.effects.lens import DepthOfField
from player.scene.effects import Effects

View = tuple[list[Pose], Camera]
SEEN = 0.5  # pixels
NEAREST = 0.05  # metres before the lens: nothing nearer is focused on
GOLDEN = np.pi * (3 - 5**0.5)
HEAD = JOINTS.index("head")
# metres: what a shape moves at most, and the radius of an eye, about
LARGEST_SHAPE, LARGEST_BALL = 0.04, 0.012


def exposures(effects: Effects, view_at: Callable[[float], View], posers: Sequence[Poser]) -> list[View]:
    """What is drawn for one frame: its own view alone where the mean of several would show nothing else.

    view_at: poses and camera so many frames after the frame's own moment.
    """
    own = view_at(0.0)
    blur, lens = effects.motion_blur, effects.depth_of_field
    half = 0.0 if blur is None else 0.5 * blur.shutter
    if blur is None or not _moves(view_at(-half), view_at(half), posers):
        half, blur = 0.0, None
    focus = None if lens is None else focused(lens, own, posers)
    # a floor is out of focus somewhere
    grounded = effects.ground is not None or effects.grid is not None
    if lens is None or focus is None or not (grounded or _blurred(lens, focus, own, posers)):
        lens = None
    count = max(1 if blur is None else blur.samples, 1 if lens is None else lens.samples)
    if count == 1:
        return [own]
    views = []
    for i in range(count):
        poses, camera = own if blur is None else view_at(2 * half * ((i + 0.5) / count - 0.5))
        if lens is not None and focus is not None:
            # moments and places on the lens go through their orders independently
            camera = through(camera, lens_point(i * _stride(count) % count, count) * 0.5 * lens.lens, focus)
        views.append((poses, camera))
    return views


def through(camera: Camera, place: Float[Array, "2"], focus: float) -> Camera:
    """The camera seen from a place on its lens, metres to the right and down from the middle."""
    moved, K = camera.camera_from_world.copy(), camera.K.copy()
    moved[:2, 3] -= place
    K[:2, 2] += K[:2, :2] @ place / focus
    return replace(camera, K=K, camera_from_world=moved)


def lens_point(index: int, count: int) -> Float[Array, "2"]:
    """A place on the unit disc; all of them cover it evenly (Vogel 1979)."""
    radius = np.sqrt((index + 0.5) / count)
    return radius * np.array([np.cos(GOLDEN * index), np.sin(GOLDEN * index)])


def focused(lens: DepthOfField, view: View, posers: Sequence[Poser]) -> float:
    """Metres before the lens that are sharp."""
    if lens.focus > 0:
        return max(lens.focus, NEAREST)
    return max(-float(_bones(view, posers)[0].centers[HEAD, 2]), NEAREST)


def _moves(before: View, after: View, posers: Sequence[Poser]) -> bool:
    """Whether anything is seen to move."""
    here, away = before[1], after[1]
    if not (np.array_equal(here.camera_from_world, away.camera_from_world) and np.array_equal(here.K, away.K)):
        return True
    there = _bones(before, posers)
    if any(
        float(np.abs(_pixels(a, before[1]) - _pixels(b, after[1])).max()) > SEEN
        for a, b in zip(there, _bones(after, posers), strict=True)
    ):
        return True
    return any(
        poser.faced
        and (size := head_pixels(bones, before[1])) >= SMALLEST
        and _face_moves(a.face or REST, b.face or REST) * size > SEEN * HEAD_HEIGHT
        for poser, a, b, bones in zip(posers, before[0], after[0], there, strict=True)
    )


def _face_moves(before: FaceFrame, after: FaceFrame) -> float:
    """About how far a face moves, metres."""
    shapes, eyes = (np.abs(a - b).max() for a, b in ((before.weights, after.weights), (before.gaze, after.gaze)))
    return max(LARGEST_SHAPE * float(shapes), LARGEST_BALL * float(eyes))


def _blurred(lens: DepthOfField, focus: float, view: View, posers: Sequence[Poser]) -> bool:
    """Whether any avatar is out of focus: its circle of confusion is f lens |1 / focus - 1 / depth| wide."""
    for bones in _bones(view, posers):
        depth, radius = -bones.centers[bones.radii >= 0, 2], bones.radii[bones.radii >= 0]
        ends = np.maximum(np.array([(depth - radius).min(), (depth + radius).max()]), NEAREST)
        if float((view[1].K[0, 0] * lens.lens * np.abs(1 / focus - 1 / ends)).max()) > SEEN:
            return True
    return False


def _bones(view: View, posers: Sequence[Poser]) -> list[PosedBones]:
    poses, camera = view
    return [poser.posed(*pose[:2], camera) for poser, pose in zip(posers, poses, strict=True)]


def _pixels(bones: PosedBones, camera: Camera) -> Float[Array, "points 2"]:
    """Six points round each bone's joint, as far off as what it moves."""
    used = bones.radii >= 0
    R, radius = bones.view_from_canonical[used, :3, :3], bones.radii[used, None, None]
    arms = np.concatenate([R.swapaxes(1, 2), -R.swapaxes(1, 2)], 1) * radius
    points = (bones.centers[used, None] + arms).reshape(-1, 3) * (1.0, -1.0, -1.0)
    at = points @ camera.K.T
    return at[:, :2] / np.maximum(at[:, 2:], NEAREST)


def _stride(count: int) -> int:
    """A step that visits every one of `count` numbers, far from its neighbours."""
    step = max(round(0.618 * count), 1)
    while np.gcd(step, count) != 1:
        step += 1
    return step
