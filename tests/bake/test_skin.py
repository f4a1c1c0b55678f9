"""Skin weights of a bake, and what of it is loose: carved far off the body, and nothing of the body itself."""

from dataclasses import replace

import numpy as np
import pytest
from capsules import ball_mesh
from loose_avatar import dressed
from painted_capture import free_subject

from avatar.body import builtin_body
from avatar.skinning import SkinWeights
from bake.loose import FAR, NEAR, bare_template, looseness
from bake.skin import detached_vertices, quantised, transferred_weights
from capture.folder import CaptureSubject
from geometry.closest import match_surface
from geometry.harmonic import fill_harmonic
from geometry.mesh import TriangleMesh, concatenated, vertex_normals


@pytest.mark.parametrize(
    "row",
    [
        [1.0, 0, 0, 0, 0],
        [0.25, 0.25, 0.25, 0.25, 0],
        [1 / 3, 1 / 3, 1 / 3, 0, 0],
        [0.999, 1e-9, 1e-9, 1e-9, 1e-9],
        [0.2, 0.2, 0.2, 0.2, 0.2],
        [1e-30, 0, 0, 0, 0],
    ],
)
def test_bytes_sum_to_255_and_are_the_nearest(row):
    joints, weights = quantised(np.array([row]))
    assert weights.sum() == 255
    four = np.sort(row)[::-1][:4] / np.sort(row)[::-1][:4].sum()
    assert np.abs(weights[0] / 255 - four).max() < 1 / 255
    used = joints[0][weights[0] > 0]
    assert len(set(used.tolist())) == len(used) and (joints[0][weights[0] == 0] == 0).all()


@pytest.mark.parametrize("row", [[0.0, 0.0], [np.nan, 1.0], [-0.1, 1.1]])
def test_bad_rows_are_refused(row):
    with pytest.raises(ValueError, match="skin weights"):
        quantised(np.array([row]))


def test_transfer_to_itself_is_exact_and_far_vertices_are_filled_between_their_neighbours():
    ball = ball_mesh()
    normals = ball.vertices / 0.1
    x = np.clip(0.5 + 5 * ball.vertices[:, 0], 0, 1)
    source = np.stack([x, 1 - x], 1)
    match = match_surface(ball.vertices, normals, ball.vertices, ball.faces)
    weights, filled = transferred_weights(match, ball.faces, ball.faces, source)
    assert filled == 0
    np.testing.assert_allclose(weights, source, atol=1e-9)
    far = match._replace(distance=np.where(ball.vertices[:, 1] > 0.06, 1.0, 0.0))
    weights, filled = transferred_weights(far, ball.faces, ball.faces, source)
    assert filled > 50
    np.testing.assert_allclose(weights, source, atol=0.12)  # harmonic, not linear


def test_a_piece_far_from_the_surface_keeps_the_closest_weights():
    """A lock of hair that has come off."""
    ball = ball_mesh(0.03, step=0.004)
    both = concatenated([ball, TriangleMesh(0.4 * ball.vertices + [0.12, 0, 0], ball.faces)])
    x = 0.5 + 10 * ball.vertices[:, 0]
    source, normals = np.stack([x, 1 - x], 1), vertex_normals(*both)
    weights, filled = transferred_weights(match_surface(both.vertices, normals, *ball), both.faces, ball.faces, source)
    lock = weights[len(ball.vertices) :]
    assert filled >= len(lock)
    np.testing.assert_allclose(weights.sum(1), 1, atol=1e-9)
    np.testing.assert_allclose(lock[:, 0], 0.8, atol=0.05)


def test_nothing_known_is_refused():
    with pytest.raises(ValueError, match="nothing to fill from"):
        fill_harmonic(np.ones((4, 1)), np.zeros(4, bool), np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]))


def test_an_islet_of_another_limb_is_inpainted_from_its_own():
    """Two fingers' worth of a ball: a patch of the left half that claims the right half's joint is put right."""
    ball = ball_mesh()
    left = ball.vertices[:, 0] < 0
    weights = np.zeros((len(ball.vertices), 52))
    weights[left, 24], weights[~left, 27] = 1, 1  # index and middle finger
    patch = (ball.vertices[:, 0] < -0.06) & (ball.vertices[:, 1] > 0.03)
    assert 5 < patch.sum() < 0.2 * left.sum()
    weights[patch] = np.roll(weights[patch], 3, axis=1)
    np.testing.assert_array_equal(detached_vertices(weights, ball.faces), patch)
    match = match_surface(ball.vertices, ball.vertices / 0.1, ball.vertices, ball.faces)
    found, filled = transferred_weights(match, ball.faces, ball.faces, weights)
    assert filled == patch.sum()
    np.testing.assert_allclose(found[left, 24], 1, atol=1e-9)
    np.testing.assert_allclose(found[~left, 27], 1, atol=1e-9)


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
