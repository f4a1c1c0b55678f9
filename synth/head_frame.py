"""The head video's own frame, as structure from motion would leave it: a similarity away from the person's.

    x_head = s R x_canonical + t        (canonical: pose 0; the big pose moves nothing above the hips)

Rotation, translation and scale are seeded. A camera keeps its intrinsics: scaling space and camera centre
together changes no picture, so camera_from_head stays a rigid transform in the head frame's unit.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from avatar.camera import Camera
from avatar.rotation import matrix_from_quaternion
from avatar.skeleton import JOINTS, joint_transforms
from synth.film import Shots
from synth.template import RegisteredTemplate

LANDMARK_NOISE = 0.002  # metres, each axis


def seeded_similarity(seed: int) -> Float[np.ndarray, "4 4"]:
    """head_from_canonical: any rotation, up to 2 units away, 0.4 to 2.5 units a metre."""
    rng = np.random.default_rng([seed, 11])
    q = rng.standard_normal(4)
    similarity = np.eye(4)
    similarity[:3, :3] = np.exp(rng.uniform(np.log(0.4), np.log(2.5))) * matrix_from_quaternion(q / np.linalg.norm(q))
    similarity[:3, 3] = rng.uniform(-1, 1, 3)
    return similarity


def scale_of(similarity: Float[np.ndarray, "4 4"]) -> float:
    """The scale of a similarity: units of the target per unit of the source."""
    return float(np.cbrt(np.linalg.det(similarity[:3, :3])))


def cameras_in_head_frame(
    shots: Shots, joints: Float[np.ndarray, "52 3"], head_from_canonical: Float[np.ndarray, "4 4"]
) -> tuple[Camera, ...]:
    """The cameras of a video as the head sees them, in the head frame."""
    head = JOINTS.index("head")
    G = joint_transforms(shots.axis_angle, joints.astype(np.float64), shots.root)[:, head]
    # what moves with the head: x_world = R (x - J_head) + G_head
    world_from_canonical = G.copy()
    world_from_canonical[:, :3, 3] -= G[:, :3, :3] @ joints[head].astype(np.float64)
    scale = scale_of(head_from_canonical)
    turn, shift = head_from_canonical[:3, :3] / scale, head_from_canonical[:3, 3]
    cameras = []
    for camera, world in zip(shots.cameras, world_from_canonical, strict=True):
        camera_from_canonical = camera.camera_from_world @ world
        camera_from_head = np.eye(4)
        camera_from_head[:3, :3] = camera_from_canonical[:3, :3] @ turn.T
        camera_from_head[:3, 3] = scale * camera_from_canonical[:3, 3] - camera_from_head[:3, :3] @ shift
        cameras.append(replace(camera, camera_from_world=camera_from_head))
    return tuple(cameras)


def landmark_vertices(template: RegisteredTemplate) -> dict[str, int]:
    """Template vertices of a dozen places that a person can point at in pictures of a head; none under hair."""
    rest = template.vertices.astype(np.float64)
    candidates = np.flatnonzero((template.part == 1) & ~template.hair)
    points = rest[candidates]
    frontal = points[np.abs(points[:, 0] - np.median(points[:, 0])) < 0.015]
    nose = frontal[frontal[:, 2].argmax()]
    spots = {
        "nose_tip": nose,
        "brow": nose + [0, 0.055, -0.02],
        "forehead": nose + [0, 0.085, -0.02],
        "chin": nose + [0, -0.075, -0.02],
        "left_eye": nose + [0.045, 0.038, -0.03],
        "right_eye": nose + [-0.045, 0.038, -0.03],
        "left_mouth": nose + [0.027, -0.037, -0.02],
        "right_mouth": nose + [-0.027, -0.037, -0.02],
        "left_ear": nose + [0.085, 0.005, -0.11],
        "right_ear": nose + [-0.085, 0.005, -0.11],
        "left_jaw": nose + [0.06, -0.05, -0.07],
        "right_jaw": nose + [-0.06, -0.05, -0.07],
        "crown": nose + [0, 0.14, -0.11],
        "nape": nose + [0, -0.02, -0.21],
    }
    found = {}
    for name, spot in spots.items():
        # the outermost of the vertices round the spot, so that no landmark lies inside the mouth or an eye
        nearest = np.argsort(np.linalg.norm(points - spot, axis=1))[:8]
        middle = nose - [0, 0, 0.1]
        outermost = nearest[np.linalg.norm(points[nearest] - middle, axis=1).argmax()]
        if np.linalg.norm(points[outermost] - spot) < 0.035:
            found[name] = int(candidates[outermost])
    return found


def landmarks(
    template: RegisteredTemplate, head_from_canonical: Float[np.ndarray, "4 4"], seed: int
) -> dict[str, dict]:
    """landmarks.json: points in the head frame, LANDMARK_NOISE off, and the template vertices they belong to."""
    vertices = landmark_vertices(template)
    assert len(vertices) >= 6, f"only {sorted(vertices)} of the landmarks are free of hair"
    rng = np.random.default_rng([seed, 12])
    places = template.vertices[list(vertices.values())].astype(np.float64) + template.pelvis
    places = places + LANDMARK_NOISE * rng.standard_normal(places.shape)
    in_head = places @ head_from_canonical[:3, :3].T + head_from_canonical[:3, 3]
    return {
        "points": {name: [float(v) for v in point] for name, point in zip(vertices, in_head, strict=True)},
        "vertices": vertices,
    }
