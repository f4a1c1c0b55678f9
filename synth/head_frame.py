"""The head video's own frame, as structure from motion would leave it: a similarity away from the person's.

    x_head = s R x_canonical + t        (canonical: pose 0; the big pose moves nothing above the hips)

Rotation, translation and scale are seeded. A camera keeps its intrinsics: scaling space and camera centre
together changes no picture, so camera_from_head stays a rigid transform in the head frame's unit.
"""

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from avatar.camera import Camera
from avatar.rotation import matrix_from_quaternion
from avatar.skeleton import JOINTS, PARTS, joint_transforms
from capture.read.places import landmark_vertices
from capture.template.hull import moved_camera
from synth.film import Shots
from synth.template import RegisteredTemplate

LANDMARK_NOISE = 0.002  # metres, each axis


def seeded_similarity(seed: int) -> Float[Array, "4 4"]:
    """head_from_canonical: any rotation, up to 2 units away, 0.4 to 2.5 units a metre."""
    rng = np.random.default_rng([seed, 11])
    q = rng.standard_normal(4)
    similarity = np.eye(4)
    similarity[:3, :3] = np.exp(rng.uniform(np.log(0.4), np.log(2.5))) * matrix_from_quaternion(q / np.linalg.norm(q))
    similarity[:3, 3] = rng.uniform(-1, 1, 3)
    return similarity


def cameras_in_head_frame(
    shots: Shots, joints: Float[Array, "52 3"], head_from_canonical: Float[Array, "4 4"]
) -> tuple[Camera, ...]:
    """The cameras of a video as the head sees them, in the head frame."""
    head = JOINTS.index("head")
    G = joint_transforms(shots.axis_angle, joints.astype(np.float64), shots.root)[:, head]
    # what moves with the head: x_world = R (x - J_head) + G_head
    world_from_canonical = G.copy()
    world_from_canonical[:, :3, 3] -= G[:, :3, :3] @ joints[head].astype(np.float64)
    canonical_from_head = np.linalg.inv(head_from_canonical)
    return tuple(map(moved_camera, shots.cameras, world_from_canonical @ canonical_from_head))


def landmarks(template: RegisteredTemplate, head_from_canonical: Float[Array, "4 4"], seed: int) -> dict[str, dict]:
    """landmarks.json: points in the head frame, LANDMARK_NOISE off, and the template vertices they belong to; none is
    under hair."""
    mesh = template.mesh
    head = (mesh.part == PARTS.index("head")) & ~template.hair
    vertices = landmark_vertices(mesh.vertices.astype(np.float64), head)
    assert len(vertices) >= 6, f"only {sorted(vertices)} of the landmarks are free of hair"
    rng = np.random.default_rng([seed, 12])
    places = mesh.vertices[list(vertices.values())].astype(np.float64) + template.pelvis
    places = places + LANDMARK_NOISE * rng.standard_normal(places.shape)
    in_head = places @ head_from_canonical[:3, :3].T + head_from_canonical[:3, 3]
    return {
        "points": {name: [float(v) for v in point] for name, point in zip(vertices, in_head, strict=True)},
        "vertices": vertices,
    }
