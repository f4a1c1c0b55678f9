"""A face that moves: its shapes blended and its eyes turned, once a frame and avatar, and brought to the shaders.

    o(x) = sum_i w_i d_i(x)                              of a vertex that shapes move (avatar/face.py)
    o(x) = (R_y(yaw) R_x(-pitch) - 1) (x - c)            of a vertex of an eye's ball about its center c
    |x + o(x) - c| >= min(r + .3 mm, |x - c|)            of lids afterwards: moving vertices beside the ball

Every pass that draws the avatar adds o to the canonical position before the bones (shaders/face.glsl). An avatar whose
face has not moved yet has none of this in its plan; where its face rests or cannot be seen nothing is uploaded.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass

import moderngl
import numpy as np
from jaxtyping import Float32
from numpy import ndarray as Array

from avatar.baked_avatar import Level
from avatar.camera import Camera
from avatar.face import REST, SHAPES, Eye, FaceFrame, eye_turn
from avatar.gaze import with_blinks, within_reach
from avatar.skeleton import JOINT_NUMBERS
from player.draw.drawing import Drawing, FrameInputs, Pose
from player.draw.plan import FACE_UNIT, OUT_OF_VIEW, Addition, Decision, Draft, Pass, PassState
from player.draw.posing import PosedBones
from player.draw.resources import AnyHandle, Handle, PlanResources

CLEARANCE, BESIDE = 3e-4, 18e-3  # metres from a ball to its lids, and to the farthest skin that could come so near
HEAD, HEAD_HEIGHT = JOINT_NUMBERS["head"], 0.23  # metres
SMALLEST = 40  # pixels; the face of a smaller head is drawn at rest
IDENTITY = np.eye(3)
WIDTH = 64  # texels of a row, shaders/face.glsl
AT_REST = Decision(PassState.SKIPPED, "at rest")
SMALL = Decision(PassState.SKIPPED, f"the head is less than {SMALLEST} pixels tall")


class FaceBlend:
    """The face of one level of an avatar: what a frame moves its vertices by."""

    def __init__(self, level: Level, eyes: tuple[Eye, Eye]):
        face = level.face
        assert face is not None, "asked of levels with a face"
        balls = [np.arange(first, first + count) for first, count in face.balls.astype(int).tolist()]
        # the slot of each vertex of the level; 0 never moves
        self.slots = np.zeros(len(level.positions), np.uint32)
        moved = np.concatenate([face.vertices.astype(int), *balls])
        self.slots[moved] = np.arange(1, len(moved) + 1)
        self.count = 1 + len(moved)
        self.rows = -(-self.count // WIDTH)
        self.shapes = face.offsets.reshape(len(SHAPES), -1)
        # metres that each shape moves a vertex by at most
        self.farthest = np.linalg.norm(face.offsets, axis=2).max(1)
        rest = level.positions[face.vertices]
        self.moving = slice(1, 1 + len(rest))
        # by eye: its ball's slots, from its center; its lids among the moving, from its center, and how near they come
        self.balls: list[tuple[slice, Array, float]] = []
        self.lids: list[tuple[Array, Array, Array]] = []
        end = self.moving.stop
        reach = np.linalg.norm(face.offsets, axis=2).sum(0)
        for eye, ball in zip(eyes, balls, strict=True):
            center = eye.center.astype(np.float32)
            self.balls.append((slice(end, end + len(ball)), level.positions[ball] - center, eye.radius))
            end += len(ball)
            near = np.linalg.norm(rest - center, axis=1)
            lids = np.flatnonzero(near < eye.radius + np.minimum(CLEARANCE + reach, BESIDE))
            self.lids.append((lids, rest[lids] - center, np.minimum(near[lids], eye.radius + CLEARANCE)))

    def offsets(self, frame: FaceFrame) -> Float32[Array, "texels 4"]:
        """Offsets by slot, metres; the fourth number is 1 / r of a ball, whose normals turn with it, else 0."""
        out = np.zeros((self.rows * WIDTH, 4), np.float32)
        weights = frame.weights.astype(np.float32)
        active = np.flatnonzero(weights)
        by = (weights[active] @ self.shapes[active]).reshape(-1, 3)
        for (slots, from_center, radius), (lids, rest, least), gaze in zip(
            self.balls, self.lids, frame.gaze.tolist(), strict=True
        ):
            if any(gaze):
                out[slots, :3] = from_center @ (eye_turn(*gaze) - IDENTITY).T.astype(np.float32)
                out[slots, 3] = 1 / radius
            if len(active):
                there = rest + by[lids]
                distance = np.sqrt(np.einsum("ni,ni->n", there, there))
                by[lids] += there * (np.maximum(least / np.maximum(distance, 1e-9), 1) - 1)[:, None]
        out[self.moving, :3] = by
        return out


def within_limits(frame: FaceFrame) -> FaceFrame:
    """Weights from 0 to 1 with blinks that close, and eyes no further than they turn."""
    return FaceFrame(with_blinks(np.clip(frame.weights, 0.0, 1.0)), within_reach(frame.gaze))


def head_pixels(bones: PosedBones, camera: Camera) -> float:
    """About how tall the head is on screen."""
    return float(camera.K[1, 1]) * HEAD_HEIGHT / max(-float(bones.centers[HEAD, 2]), 1e-3)


def moves_face(pose: Pose, bones: PosedBones, camera: Camera) -> bool:
    """Whether a pose moves the face of an avatar, and it is large enough to be seen."""
    return pose.face is not None and not pose.face.rests and head_pixels(bones, camera) >= SMALLEST


class FaceMotion:
    """The face of one avatar from frame to frame: what was shown last, and what is on the GPU."""

    def __init__(self, level: Level, eyes: tuple[Eye, Eye]):
        self.blend = FaceBlend(level, eyes)
        self._good = self._shown = REST
        # milliseconds of the last change
        self.ms = 0.0

    def wanted(self, frame: FaceFrame | None) -> FaceFrame:
        """A frame within limits; of one with a number that is not finite, the last that was good."""
        if frame is None:
            return REST
        if np.isfinite(frame.weights).all() and np.isfinite(frame.gaze).all():
            self._good = within_limits(frame)
        return self._good

    def upload(self, frame: FaceFrame, texture: moderngl.Texture) -> None:
        """Bring a frame to the GPU, unless it is there."""
        if np.array_equal(frame.weights, self._shown.weights) and np.array_equal(frame.gaze, self._shown.gaze):
            return
        began = time.perf_counter()
        texture.write(self.blend.offsets(frame))
        self._shown = frame
        self.ms = 1e3 * (time.perf_counter() - began)


@dataclass(frozen=True)
class FaceOffsets(Addition):
    """One avatar's face in a plan."""

    avatar: int
    motion: FaceMotion
    texture: Handle[moderngl.Texture]

    @property
    def handles(self) -> tuple[AnyHandle, ...]:
        return (*super().handles, self.texture)

    def frame(self, drawing: Drawing) -> FaceFrame:
        """What the face does in this frame; the poses that are drawn have faces that can be seen."""
        return self.motion.wanted(drawing.inputs.poses[self.avatar].face)

    def bind(self, drawing: Drawing) -> None:
        texture = drawing.resources[self.texture]
        self.motion.upload(drawing.once(self.texture, lambda: self.frame(drawing)), texture)
        texture.use(FACE_UNIT)

    def warm(self, resources: PlanResources) -> None:
        resources[self.texture].use(FACE_UNIT)


def face_of(draft: Draft, avatar: int, level: int) -> FaceOffsets | None:
    """An avatar's face at a level of detail; None: it has not moved yet, or the level has none."""
    who = draft.avatars[avatar]
    mesh, eyes = who.level(level), who.eyes
    if avatar not in draft.faces or mesh.face is None or eyes is None:
        return None
    motion = draft.keep(("face", avatar, level), lambda: FaceMotion(mesh, eyes))
    rows = motion.blend.rows

    def make(made: PlanResources) -> moderngl.Texture:
        texture = made.context.gl.texture((WIDTH, rows), 4, bytes(16 * WIDTH * rows), dtype="f4")
        texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        return texture

    texture = draft.texture(f"{draft.tag(avatar)} face", 16 * WIDTH * rows, avatar, level, make=make)
    slots = draft.vertices("face slots", avatar, 4, lambda: motion.blend.slots, level)
    return FaceOffsets(((slots, "1u4", "face_slot"),), (), avatar, motion, texture)


@dataclass(frozen=True)
class FacePass(Pass):
    """Brings one avatar's face to the GPU."""

    face: FaceOffsets

    def reach(self, avatar: int, pose: Pose) -> float:
        if avatar != self.face.avatar:
            return 0.0
        return float(self.face.motion.wanted(pose.face).weights @ self.face.motion.blend.farthest)

    def cost(self, drawn: float, inputs: FrameInputs, frame: Callable[[], float]) -> float:
        """What the last change took, blending and upload."""
        return drawn + self.face.motion.ms

    def decide(self, drawing: Drawing) -> Decision:
        """Whether the face moves in this picture: not out of view, small or at rest."""
        pose, bones = drawing.inputs.poses[self.face.avatar], drawing.bones[self.face.avatar]
        if not drawing.visible[self.face.avatar]:
            return OUT_OF_VIEW
        if head_pixels(bones, drawing.inputs.camera) < SMALLEST:
            return SMALL
        frame = self.face.motion.wanted(pose.face)
        if frame.rests:
            return AT_REST
        return Decision(PassState.RUNS, f"{np.count_nonzero(frame.weights)} of {len(SHAPES)} shapes")

    def draw(self, drawing: Drawing) -> None:
        self.face.bind(drawing)
