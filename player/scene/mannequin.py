"""The built-in body as an avatar: something to draw where there is no avatar file (checks and tests)."""

from dataclasses import replace

import numpy as np
from PIL import Image, ImageDraw

from avatar.baked_avatar import Avatar, Level, ViewNetwork
from avatar.body import builtin_body
from avatar.skeleton import BIG_POSE, JOINTS, skin_transforms
from avatar.skinning import skin_points


def mannequin(sex: str = "male", *, texture: int = 512) -> Avatar:
    """The built-in body, painted with a checkered gradient; its view network is random (seeded),
    its cone 20 degrees.
    """
    body = builtin_body(sex)
    assert body.uv is not None and body.uv_faces is not None
    rng = np.random.default_rng(0)
    corners = np.stack([body.faces.reshape(-1), body.uv_faces.reshape(-1)], 1)
    split, number = np.unique(corners, axis=0, return_inverse=True)
    vertex, texcoord = split.T
    transforms = skin_transforms(BIG_POSE, body.joints, rest=np.zeros((52, 3)))
    positions = skin_points(body.vertices, body.skin, transforms)
    normals = _normals(positions, body.faces)[vertex].astype(np.float32)
    weights = np.floor(body.skin.weights[vertex].astype(np.float64) * 255 + 1e-6).astype(np.int64)
    # the heaviest bone takes what rounding left
    weights[:, 0] += 255 - weights.sum(1)
    joints = np.where(weights > 0, body.skin.joints[vertex], 0)
    y, x = np.mgrid[:texture, :texture] / texture
    checks = (np.floor(24 * x) + np.floor(24 * y)) % 2
    color = np.stack([70 + 110 * checks, 80 + 100 * x, 100 + 140 * y], -1).astype(np.uint8)
    cone = np.zeros((len(vertex), 6), np.float32)
    cone[:, [0, 3, 5]] = 1 / (1.6 * np.sin(np.radians(20.0))) ** 2
    level = Level(
        positions=positions[vertex].astype(np.float32), normals=normals, uv=body.uv[texcoord].astype(np.float32),
        faces=number.reshape(-1, 3).astype(np.uint32), joints=joints.astype(np.uint8), weights=weights.astype(np.uint8),
        view_dir=-normals, view_q=cone, view_seen=np.ones(len(vertex), np.float32), base_color=color,
        features=rng.integers(0, 256, (64, 64, 4)).astype(np.uint8),
    )  # fmt: skip
    shapes = {"w1": (16, 8), "b1": (16,), "w2": (3, 16), "b2": (3,)}
    network = ViewNetwork(**{name: rng.normal(size=shape).astype(np.float32) for name, shape in shapes.items()})
    linear = (0.2 * rng.normal(size=(4, 3, 3))).astype(np.float32)
    return Avatar(
        name=f"mannequin {sex}", joint_positions=body.joints, canonical_pose=np.array(BIG_POSE), levels=(level,),
        network=network, linear=linear, amplitude=0.6, default_view="network",
        provenance={"body_licence": body.licence},
    )  # fmt: skip


# sRGB of what the clothed body wears, by the first letters of the joints that move it; the rest is skin
CLOTHES = {
    "male": {"spine": (62, 92, 122), "pelvis": (52, 52, 60), "hair": (58, 44, 36), "skin": (214, 168, 140)},
    "female": {"spine": (150, 60, 66), "pelvis": (46, 62, 92), "hair": (92, 62, 40), "skin": (226, 182, 156)},
}
WORN = {
    "spine": ("spine", "left_collar", "right_collar", "left_shoulder", "right_shoulder"),
    "pelvis": ("pelvis", "left_hip", "right_hip", "left_knee", "right_knee"),
    "shoes": ("left_ankle", "right_ankle", "left_foot", "right_foot"),
}
# metres above the middle of the head, along a line that leans back, from which on there is hair
HAIRLINE = 0.05
# texels
SIDE = 1024


def clothed(sex: str) -> Avatar:
    """The built-in body in plain clothes, as example scenes show it: each triangle painted by the joint that moves it,
    a little darker where it faces down."""
    body = mannequin(sex)
    level, colors = body.levels[0], CLOTHES[sex] | {"shoes": (38, 36, 38)}
    heaviest = level.skin.heaviest
    names = [next((what for what, first in WORN.items() if name.startswith(first)), "skin") for name in JOINTS]
    paint = np.array([colors[names[joint]] for joint in heaviest], np.float64)
    # where the scalp is, in the pose of the mesh
    above = level.positions - level.positions[heaviest == JOINTS.index("head")].mean(0)
    paint[(heaviest == JOINTS.index("head")) & (above[:, 1] - 0.8 * above[:, 2] > HAIRLINE)] = colors["hair"]
    paint *= (0.88 + 0.12 * level.normals[:, 1] + 0.04 * level.normals[:, 2])[:, None]
    image = Image.new("RGB", (SIDE, SIDE), colors["skin"])
    draw = ImageDraw.Draw(image)
    corners = (level.uv * SIDE)[level.faces]
    tones = np.clip(paint[level.faces].mean(1), 0, 255).astype(int)
    painted = [
        ([tuple(at) for at in triangle], tuple(tone)) for triangle, tone in zip(corners.tolist(), tones.tolist())
    ]
    # beyond the edges of charts first: coarse mips look there
    for triangle, tone in painted:
        draw.line([*triangle, triangle[0]], tone, width=5)
    for triangle, tone in painted:
        draw.polygon(triangle, tone, tone)
    return replace(body, levels=(replace(level, base_color=np.asarray(image)),), default_view="off")


def _normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    corners = vertices[faces]
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    out = np.zeros_like(vertices)
    for corner in range(3):
        np.add.at(out, faces[:, corner], area)
    length = np.linalg.norm(out, axis=1, keepdims=True)
    return np.where(length > 0, out / np.maximum(length, 1e-30), [0.0, 0.0, 1.0])
