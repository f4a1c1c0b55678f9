"""What a bake finds to be loose: what was carved far off the body, and nothing of the body itself."""

from dataclasses import replace

import numpy as np
from loose_avatar import dressed
from painted_capture import free_subject

from avatar.body import builtin_body
from avatar.skinning import SkinWeights
from bake.loose import FAR, NEAR, bare_template, looseness
from capture.folder import CaptureSubject


def subject_of(carved: np.ndarray) -> CaptureSubject:
    """The built-in body with carved vertices joined behind it."""
    bare = free_subject("female")
    count, more = len(bare.vertices), len(carved)
    faces = np.concatenate([bare.faces, count + np.arange(more - more % 3).reshape(-1, 3)])
    whole = np.concatenate([bare.vertices, carved])
    skin = joined(bare.skin, more)
    part, hair = np.zeros(count + more, int), np.zeros(count + more, bool)
    return replace(bare, rest=whole, vertices=whole, faces=faces, skin=skin, part=part, hair=hair)


def joined(skin: SkinWeights, more: int) -> SkinWeights:
    """With so many vertices behind it that follow the pelvis."""
    joints = np.concatenate([skin.joints, np.zeros((more, 4), int)])
    return SkinWeights(joints, np.concatenate([skin.weights, np.float32([[1, 0, 0, 0]] * more).reshape(more, 4)]))


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
    islet = np.concatenate([faces, [[len(positions), len(positions) + 1, len(positions) + 2]]])
    assert looseness(np.concatenate([positions, buckle]), islet, joined(level.skin, 3), subject) is None
    # shoes of ten centimetres
    feet = (level.skin.weights * np.isin(level.skin.joints, (7, 8, 10, 11))).sum(1) > 0.9
    shod = np.where(feet[:, None], positions + [0, 0, 0.15], positions)
    assert looseness(shod, faces, level.skin, subject) is None
