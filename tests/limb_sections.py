"""Sections of a limb across its bone, on a mesh fine enough that triangles do not thin it, and poses that strain it.

And how three.js poses it.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
from dual_quaternions import skin_points_dual_quaternion
from node_packages import package_folder, run_node

from avatar.baked_avatar import Avatar, Level
from avatar.gltf.animation import write_animated
from avatar.gltf.avatar_file import write_avatar
from avatar.helper_joints import HelperJoints
from avatar.motion.clip import Clip
from avatar.skeleton import joint_transforms, rigid_inverse
from avatar.skinning import SkinWeights, skin_points
from player.scene.mannequin import mannequin

WRIST = {"left": (18, 20), "right": (19, 21)}


def fine_mannequin() -> Avatar:
    """The built-in body, each triangle in four: 2 cm of a forearm at most, as a baked avatar's are."""
    avatar = mannequin()
    return replace(avatar, levels=(_halved(avatar.levels[0]),))


def _halved(level: Level) -> Level:
    faces = level.faces.astype(np.int64)
    edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    pairs, number = np.unique(edges, axis=0, return_inverse=True)
    middle = number.reshape(-1, 3) + len(level.positions)
    dense = np.zeros((len(level.positions), 52))
    np.add.at(dense, (np.arange(len(dense))[:, None], level.joints), level.weights)
    mixed = dense[pairs].sum(1)
    joints = np.argsort(-mixed, axis=1, kind="stable")[:, :4]
    weights = np.floor(np.take_along_axis(mixed, joints, 1) / 2).astype(np.int64)
    weights[:, 0] += 255 - weights.sum(1)
    joints = np.where(weights > 0, joints, 0)
    a, b, c = faces.T
    ab, bc, ca = middle.T
    quarters = np.concatenate([np.stack(part, 1) for part in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])

    def halfway(values: np.ndarray, *, unit: bool = False) -> np.ndarray:
        new = values[pairs].astype(np.float64).mean(1)
        if unit:
            new /= np.maximum(np.linalg.norm(new, axis=1, keepdims=True), 1e-12)
        return np.concatenate([values, new.astype(np.float32)])

    return replace(
        level,
        positions=halfway(level.positions),
        normals=halfway(level.normals, unit=True),
        uv=halfway(level.uv),
        faces=quarters.astype(np.uint32),
        joints=np.concatenate([level.joints, joints.astype(np.uint8)]),
        weights=np.concatenate([level.weights, weights.astype(np.uint8)]),
        view_dir=halfway(level.view_dir, unit=True),
        view_q=halfway(level.view_q),
        view_seen=halfway(level.view_seen),
    )


def posed(avatar: Avatar, axis_angle: np.ndarray, kind: str) -> np.ndarray:
    """The finest level's vertices: 'lbs' and 'dual' on the 52 joints, 'twist' linear on all bones."""
    joints, level = avatar.joint_positions.astype(np.float64), avatar.levels[0]
    canonical, G = (joint_transforms(pose, joints) for pose in (avatar.canonical_pose, axis_angle))
    if kind != "twist":
        skin = skin_points if kind == "lbs" else skin_points_dual_quaternion
        return skin(level.positions, level.skin, G @ rigid_inverse(canonical))
    assert level.twist is not None
    helpers = HelperJoints(joints, avatar.bend)
    bones = helpers.with_helpers(axis_angle, G) @ rigid_inverse(helpers.with_helpers(avatar.canonical_pose, canonical))
    skin = SkinWeights(level.twist.joints.astype(np.int64), level.twist.weights / np.float32(255))
    return skin_points(level.positions, skin, bones)


def posed_by_three_js(avatar: Avatar, poses: np.ndarray, folder: Path) -> tuple[list[str], list[np.ndarray]]:
    """Joints of the exported file, and the finest level's vertices in each pose (`posed`'s 'twist') as three.js has
    them: bones of its animation, weights of the file, linear blending."""
    modules = package_folder("three")
    write_avatar(folder / "still.glb", avatar)
    write_animated(folder / "moving.glb", folder / "still.glb", Clip(poses, np.zeros((len(poses), 3)), 30.0))
    times = np.arange(len(poses)) / 30
    found = run_node("interchange/three_joints.mjs", folder / "moving.glb", modules, *times)
    count, level = len(found["joints"]), avatar.levels[0]
    inverse = np.swapaxes(np.reshape(found["inverse"], (count, 4, 4)), -1, -2)
    points = []
    for frame in found["frames"]:
        bones = np.swapaxes(np.reshape(frame["world"], (count, 4, 4)), -1, -2) @ inverse
        blended = np.einsum("vs,vsij->vij", level.twist.weights / 255.0, bones[level.twist.joints])
        points.append(np.einsum("vij,vj->vi", blended[:, :3, :3], level.positions) + blended[:, :3, 3])
    return found["joints"], points


def turned(avatar: Avatar, side: str, degrees: float) -> tuple[np.ndarray, np.ndarray]:
    """A pose whose wrist is turned about the forearm, and where sections of it are taken: elbow to wrist, x."""
    elbow, wrist = WRIST[side]
    ends = avatar.joint_positions[[elbow, wrist]]
    along = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    pose = np.zeros((52, 3))
    pose[wrist] = np.radians(degrees) * along
    return pose, np.linspace(ends[0, 0], ends[1, 0], 30)


def section_areas(points: np.ndarray, faces: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Area in which each plane x = place cuts a closed mesh, square metres: half the sum of p x q over its cuts."""
    out, onwards = [], [1, 2, 0]
    for place in places:
        side = points[:, 0] - place
        crossing = faces[(side[faces].min(1) < 0) & (side[faces].max(1) >= 0)]
        corners, side = points[crossing], side[crossing]
        below = side < 0
        # each triangle goes up through the plane once, and down once
        up, down = below & ~below[:, onwards], ~below & below[:, onwards]
        change = side - side[:, onwards]
        share = (side / np.where(change == 0, 1, change))[:, :, None]
        cut = corners + share * (corners[:, onwards] - corners)
        p, q = cut[up], cut[down]
        out.append(abs(float((p[:, 1] * q[:, 2] - p[:, 2] * q[:, 1]).sum())) / 2)
    return np.array(out)
