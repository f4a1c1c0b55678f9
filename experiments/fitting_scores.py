"""How far a fitted body is from the truth: limb joints, surface, poses, distance and focal length."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Int

from avatar.skeleton import joint_transforms, skin_transforms
from avatar.skinning import skin_points
from bench.score.skeleton_distance import BODY, LIMBS, PosedSkeletons, joints_off, turned_off
from capture.fit.footage import Estimate, Footage
from capture.fit.scan import posed_video, template_of
from geometry.closest import closest_points, triangle_index
from geometry.icp import rigid_icp
from synth.raw.movement import RawShots
from synth.subject import SynthSubject

Array = np.ndarray

# frames that surfaces are compared in, and points in each
MEASURED, POINTS = 3, 1000


class Truth(NamedTuple):
    """What the fit does not see."""

    subject: SynthSubject
    visible: Bool[Array, "faces"]
    shots: RawShots
    frames: Int[Array, "kept"]


def scores(estimate: Estimate, footage: Footage, truth: Truth) -> dict[str, float]:
    """Distances in cm and angles in degrees, means over frames.

    `joints`: limb joints after the best rigid motion of each frame, `joints_in_place` without it. `p2s`: from visible
    points of the subject to the fitted surface, after a scale by the limb joints and rigid ICP of each frame;
    `p2s_in_place` without. `depth`: by how much the person is too near. `degrees`: of the body's joints, each joint's
    own mean removed. `scale` and `focal`: over the truth's.
    """
    template = template_of(estimate)
    video = posed_video(estimate, footage, np.ones(len(truth.frames), bool), level=True)
    shots, frames = truth.shots, truth.frames
    assert video.axis_angle is not None and video.root is not None
    joints = truth.subject.joints.astype(np.float64)
    M = shots.camera.camera_from_world
    theirs = (M @ joint_transforms(shots.axis_angle[frames], joints, shots.root[frames]))[..., :3, 3]
    placed = joint_transforms(video.axis_angle, template.joints, video.root)
    ours = np.stack([c.camera_from_world @ G for c, G in zip(video.cameras, placed)])[..., :3, 3]
    posed = PosedSkeletons(ours, theirs, video.axis_angle, shots.axis_angle[frames])
    size = [np.linalg.norm(x - x.mean(1, keepdims=True), axis=(1, 2)) for x in (ours[:, LIMBS], theirs[:, LIMBS])]
    scale = size[0] / size[1]

    seen, rng = np.unique(truth.subject.faces[truth.visible]), np.random.default_rng(0)
    surface = []
    for i in np.linspace(0, len(frames) - 1, min(MEASURED + 1, len(frames)))[:-1].astype(int):
        points = rng.choice(seen, min(POINTS, len(seen)), replace=False)
        B = skin_transforms(shots.axis_angle[frames[i]], joints, shots.root[frames[i]], rest=np.zeros((52, 3)))
        true = skin_points(truth.subject.vertices, truth.subject.skin, M @ B)[points]
        B = skin_transforms(video.axis_angle[i], template.joints, video.root[i], rest=np.zeros((52, 3)))
        x = skin_points(template.vertices, template.skin, video.cameras[i].camera_from_world @ B)
        index = triangle_index(x, template.faces)
        moved = (true - theirs[i, LIMBS].mean(0)) * scale[i] + ours[i, LIMBS].mean(0)
        T = rigid_icp(moved, index)
        near = closest_points(moved @ T[:3, :3].T + T[:3, 3], index).distance / scale[i]
        surface.append((near.mean(), closest_points(true, index).distance.mean()))
    p2s, p2s_in_place = 100 * np.mean(surface, axis=0)
    found = {
        "joints": joints_off(posed, LIMBS, aligned=True),
        "joints_in_place": joints_off(posed, LIMBS, aligned=False),
        "p2s": p2s,
        "p2s_in_place": p2s_in_place,
        "depth": 100 * (theirs - ours)[:, LIMBS, 2].mean(),
        "degrees": turned_off(posed, BODY),
        "scale": scale.mean(),
        "focal": estimate.camera(footage).K[0, 0] / shots.camera.K[0, 0],
    }
    return {name: round(float(value), 4) for name, value in found.items()}
