"""People drawn from a seed: the same each time, all kinds among twelve, closed, skinned, cut as drawn, and filmed."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import KDTree

from avatar.skeleton import JOINTS, PARTS
from command.errors import AssetError
from geometry.mesh import TriangleMesh, component_labels, enclosed_volume, half_edges, weld
from synth.command import load_subject
from synth.face_places import face_places
from synth.film import frame_points
from synth.light import STILL
from synth.people.body import figure
from synth.people.cloth import cloth_picture
from synth.people.clothes import leg_height
from synth.people.looks import HAIR, PATTERNS, WEAR, Fabric, draw
from synth.people.person import made, subject_of
from synth.photo import Studio

WOMAN = 1  # in a dress, on heels, with long hair


@pytest.fixture(scope="module")
def woman():
    return made(draw(WOMAN))


def closed(piece):
    """Faces of a piece whose repeated points are one, without those that have no area; every edge has two faces."""
    faces = weld(piece.points.astype(np.float32))[piece.faces]
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(1)]
    ends = half_edges(faces)
    key, back = (np.sort(ends @ np.array(scale)) for scale in ([len(piece.points), 1], [1, len(piece.points)]))
    return faces, np.array_equal(key, back) and len(np.unique(key)) == len(key)


def check(pieces):
    for piece in pieces:
        assert np.isfinite(piece.points).all() and np.isfinite(piece.uv).all()
        np.testing.assert_allclose(piece.weights.sum(1), 1, atol=1e-6)
        assert piece.weights.min() >= -1e-12
        if piece.kind in ("hair", "cloth", "shoe"):
            assert closed(piece)[1]
            assert enclosed_volume(TriangleMesh(piece.points, piece.faces)) > 0


def test_pieces_are_finite_closed_and_follow_bones(woman):
    check(woman[0])


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2, 3, 4, 5, 7, 10, 11])
def test_every_kind_of_person_is_finite_closed_and_follows_bones(seed):
    check(made(draw(seed))[0])


def test_twelve_seeds_hold_every_kind_and_a_seed_is_one_person(woman):
    drawn = [draw(seed) for seed in range(1, 13)]
    for field, kinds in (("hair", HAIR), ("wear", WEAR)):
        assert {vars(looks)[field] for looks in drawn} == {kind for sex in kinds.values() for kind in sex}
    assert {looks.sex for looks in drawn} == {"male", "female"}
    statures = [looks.stature for looks in drawn]
    assert 1.5 <= min(statures) < 1.6 and 1.9 < max(statures) <= 2.0
    assert min(looks.heavy for looks in drawn) == 0 and max(looks.heavy for looks in drawn) > 0.7
    assert any(looks.betas[3] > 1 for looks in drawn)
    again, joints = made(draw(WOMAN))
    np.testing.assert_array_equal(joints, woman[1])
    for ours, theirs in zip(again, woman[0], strict=True):
        np.testing.assert_array_equal(ours.points, theirs.points)
        np.testing.assert_array_equal(ours.picture, theirs.picture)


def test_a_figure_is_as_tall_as_drawn_and_heavier_where_it_is_heavy():
    for seed in (1, 10):
        looks = draw(seed)
        body = figure(looks)
        assert np.ptp(body.vertices[:, 1]) == pytest.approx(looks.stature, abs=1e-9)
        belly = np.abs(body.vertices[:, 1] - body.joints[JOINTS.index("spine1"), 1]) < 0.02
        girth = np.ptp(body.vertices[belly, 2]) / looks.stature
        assert (girth > 0.14) == (looks.heavy > 0.5)


def test_a_dress_is_one_tube_open_below_that_ends_as_drawn(woman):
    looks, (pieces, _) = draw(WOMAN), woman
    hem = leg_height(figure(looks).joints, looks.hem)
    ends = [piece for piece in pieces if piece.kind == "cloth" and abs(piece.points[:, 1].min() - hem) < 0.01]
    assert len(ends) == 1
    (skirt,) = ends
    faces, _ = closed(skirt)
    vertices = len(np.unique(faces))
    # a tube with a thickness is a torus: without a floor and without a hole
    assert vertices - len(half_edges(faces)) // 2 + len(faces) == 0
    assert len(np.unique(component_labels(faces, len(skirt.points))[faces])) == 1
    # legs go on under it
    skin = np.concatenate([piece.points[np.unique(piece.faces)] for piece in pieces if piece.kind == "skin"])
    assert (np.abs(skin[:, 1] - hem - 0.15) < 0.02).sum() > 50


def test_long_hair_ends_as_drawn_and_stands_off_the_neck(woman):
    looks, (pieces, joints) = draw(WOMAN), woman
    hair = np.concatenate([piece.points for piece in pieces if piece.kind == "hair"])
    neck = joints[JOINTS.index("neck")]
    assert neck[1] - hair[:, 1].min() == pytest.approx(looks.hair_length, abs=0.02)
    body = figure(looks)
    nape = body.vertices[(np.abs(body.vertices[:, 1] - neck[1] - 0.05) < 0.01) & (np.abs(body.vertices[:, 0]) < 0.03)]
    level = hair[(np.abs(hair[:, 1] - neck[1] - 0.05) < 0.01) & (np.abs(hair[:, 0]) < 0.02)]
    assert level[:, 2].max() < nape[:, 2].min() - 0.005


def test_masks_and_parts_hold_hair_and_dress(woman, rasteriser):
    pieces, joints = woman
    subject = subject_of(pieces, joints, "builtin:1")
    assert subject.hair.any() and subject.eye is not None and subject.eye.any()
    bare = subject_of([piece for piece in pieces if piece.kind in ("skin", "eye")], joints, "bare")
    corners = np.array([[-0.4, -0.9, 0], [0.4, 0.8, 0]])
    camera = frame_points([0, 0, -3], np.zeros(3), corners, 96)  # from behind
    whole, naked = (
        Studio(rasteriser, who, 1).take(who.vertices, camera, STILL["even"]) for who in (subject, bare)
    )
    assert ((naked.mask > 0) <= (whole.mask > 0)).mean() > 0.999
    assert (whole.mask > 0).sum() > 1.25 * (naked.mask > 0).sum()
    shoulders = int(48 - camera.K[1, 1] * (joints[JOINTS.index("neck"), 1] - 0.05) / 3)
    assert whole.parts[shoulders, 48] == 1 + PARTS.index("head")


def test_pictures_of_cloth_repeat_without_a_seam():
    for pattern in (*PATTERNS, "denim"):
        picture = cloth_picture(Fabric(pattern, ((200, 60, 60), (40, 60, 110), (230, 230, 220))), 5).astype(float)
        for tile in (picture, picture.swapaxes(0, 1)):
            inner = np.abs(np.diff(tile, axis=0)).mean((1, 2))
            assert np.abs(tile[0] - tile[-1]).mean() <= inner.max() * 1.01
        assert (picture.std((0, 1)).max() > 12) == (pattern not in ("plain", "denim"))


def test_a_seed_is_a_subject_and_another_word_is_refused():
    assert load_subject("builtin:2").name == "builtin:2"
    for name in ("builtin:-1", "builtin:child", "builtin:1.5", "builtin2"):
        with pytest.raises(AssetError, match="builtin:SEED"):
            load_subject(name)


@pytest.mark.parametrize("seed", [1, 4])
def test_features_of_a_face_are_on_it_in_heels_too(seed):
    someone = load_subject(f"builtin:{seed}")
    found = face_places(someone)
    away = KDTree(someone.vertices).query(np.stack(list(found.values())))[0]
    assert away.max() < 0.004
    assert found["face_57"][1] < found["face_62"][1] < found["face_51"][1] < found["face_33"][1]
    guessed = face_places(replace(someone, features=None))
    assert np.linalg.norm(found["left_ear"] - guessed["left_ear"]) > 0.005
