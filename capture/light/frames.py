"""The frame in which a capture's light stands still, and how each video's frames lie in it."""

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from avatar.light import Frame
from avatar.rotation import axis_angle_from_matrix
from avatar.skeleton import JOINTS, skin_transforms
from capture.check.silhouette import canonical_from_head as landmark_registration
from capture.folder import Capture

# a phone in the hand sways by a few degrees; one that is carried round the person turns by all of them
SWAY = np.radians(20.0)


def light_frame(capture: Capture) -> Frame:
    """Where the light stands still: with the camera where the body's camera keeps its direction, else in the world."""
    turns = np.stack([camera.camera_from_world[:3, :3] for camera in capture.videos["body"].cameras])
    away = np.linalg.norm(axis_angle_from_matrix(turns @ turns[0].T), axis=1)
    return "camera" if np.median(away) < SWAY else "world"


def light_from_video(
    capture: Capture, part: str, frame: Frame, canonical_from_head: Float[Array, "4 4"] | None = None
) -> Float[Array, "frames 3 3"]:
    """Rotations from where a video's rays lie to where the light stands still, one a frame.

    Rays of body and hands lie in the world, the head's in the head's own frame; with `canonical_from_head` they are
    canonical. A still person whom a phone is carried round holds the head as in the middle of the body's video.
    """
    video = capture.videos[part]
    turns = np.stack([camera.camera_from_world[:3, :3] for camera in video.cameras])
    if part != "head":
        return turns if frame == "camera" else np.tile(np.eye(3), (len(turns), 1, 1))
    if frame == "camera":
        return turns if canonical_from_head is None else turns @ _rotation(canonical_from_head).T
    body = capture.videos["body"]
    assert body.axis_angle is not None and body.root is not None
    middle = len(body.root) // 2
    held = skin_transforms(body.axis_angle[middle], capture.subject.joints, body.root[middle])
    world_from_canonical = held[JOINTS.index("head"), :3, :3]
    if canonical_from_head is None:
        world_from_canonical = world_from_canonical @ _rotation(landmark_registration(capture))
    return np.tile(world_from_canonical, (len(turns), 1, 1))


def _rotation(similarity: Float[Array, "4 4"]) -> Float[Array, "3 3"]:
    return similarity[:3, :3] / np.cbrt(np.linalg.det(similarity[:3, :3]))
