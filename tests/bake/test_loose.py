"""What a bake finds to be loose: what was carved far off the body, and nothing of the body itself."""

import numpy as np
from loose_avatar import dressed

from avatar.body import builtin_body
from avatar.skeleton import BIG_POSE, skin_transforms
from avatar.skinning import SkinWeights, skin_points
from bake.loose import FAR, NEAR, bare_template, looseness
from capture.folder import CaptureSubject


def subject_of(carved: np.ndarray) -> CaptureSubject:
    """The built-in body with carved vertices joined behind it."""
    body = builtin_body("female")
    vertices = skin_points(body.vertices, body.skin, skin_transforms(BIG_POSE, body.joints, rest=np.zeros((52, 3))))
    count, more = len(vertices), len(carved)
    skin = SkinWeights(
        np.concatenate([body.skin.joints, np.zeros((more, body.skin.joints.shape[1]), int)]),
        np.concatenate([body.skin.weights, np.eye(1, body.skin.weights.shape[1], dtype=np.float32).repeat(more, 0)]),
    )
    faces = np.concatenate([body.faces, count + np.arange(more - more % 3).reshape(-1, 3)])
    whole = np.concatenate([vertices, carved])
    return CaptureSubject(
        "x", whole, whole, faces.astype(np.int64), skin, body.joints, np.zeros(count + more, int),
        np.zeros(count + more, bool),
    )  # fmt: skip


def test_skirt_and_hair_are_loose_by_their_distance_and_skin_is_not():
    level = dressed().levels[0]
    sheets = level.loose > 0
    subject = subject_of(level.positions[sheets].astype(float))
    assert len(bare_template(subject)) == len(builtin_body("female").vertices)
    found = looseness(level.positions.astype(float), level.faces.astype(int), level.skin, subject)
    body = np.arange(len(level.positions)) < len(dressed(skirt=False, hair=False).levels[0].positions)
    assert not found[body].any()
    away = np.linalg.norm(level.positions[sheets][:, None] - bare_template(subject)[::3], axis=2).min(1)
    loose = found[sheets]
    assert (loose[away > FAR + 0.02] == 1).all() and (loose > 0.5).mean() > 0.3 and found.dtype == np.float32
    assert 0 < NEAR < FAR


def test_islets_hands_and_feet_are_not_loose():
    level = dressed(skirt=False, hair=False).levels[0]
    subject = subject_of(np.zeros((0, 3)))
    positions, faces = level.positions.astype(float), level.faces.astype(int)
    assert looseness(positions, faces, level.skin, subject) is None
    # a buckle of two square centimetres a hand's breadth before the belly
    buckle = np.array([[0, 0, 0.3], [0.02, 0, 0.3], [0, 0.02, 0.3]])
    skin = SkinWeights(
        np.concatenate([level.skin.joints, np.zeros((3, 4), int)]),
        np.concatenate([level.skin.weights, np.float32([[1, 0, 0, 0]] * 3)]),
    )
    islet = np.concatenate([faces, [[len(positions), len(positions) + 1, len(positions) + 2]]])
    assert looseness(np.concatenate([positions, buckle]), islet, skin, subject) is None
    # shoes of ten centimetres
    feet = (level.skin.weights * np.isin(level.skin.joints, (7, 8, 10, 11))).sum(1) > 0.9
    shod = np.where(feet[:, None], positions + [0, 0, 0.15], positions)
    assert looseness(shod, faces, level.skin, subject) is None
