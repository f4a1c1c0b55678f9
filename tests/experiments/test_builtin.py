"""The built-in subject: dressed off the skin, bare hands, closed, painted, the same as the file that ships."""

import json
from dataclasses import fields
from importlib.resources import files

import numpy as np
import pytest
import trimesh
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from avatar.body import builtin_body
from command.errors import AssetError
from experiments.builtin import builtin_subject
from experiments.builtin.atlas import layout
from experiments.builtin.dress import dress
from experiments.builtin.dressed import BELT, EYE, HAIR, LINING, SHIRT, SHOE, SKIN, SKIRT, SOLE, TROUSERS
from experiments.builtin.glb import write_subject
from experiments.builtin.looks import FEMALE, MALE
from experiments.builtin.refine import TexturedMesh, cut_along, refined
from experiments.builtin.texels import covered_texels
from synth.command import load_subject
from synth.subject import read_subject

SEXES = ("male", "female")


@pytest.fixture(scope="module", params=SEXES)
def dressed(request):
    return dress(builtin_body(request.param), {"male": MALE, "female": FEMALE}[request.param])


@pytest.fixture(scope="module")
def subject():
    return builtin_subject("male", 512)


def off_skin(dressed, sex, *kinds):
    """Distance of the vertices of these kinds alone to the naked body."""
    rows = np.isin(dressed.kind, kinds)
    ids = np.setdiff1d(np.unique(dressed.mesh.faces[rows]), np.unique(dressed.mesh.faces[~rows]))
    naked = builtin_body(sex)
    mesh = trimesh.Trimesh(naked.vertices, naked.faces, process=False)
    ids = ids[:: max(1, len(ids) // 1500)]
    return trimesh.proximity.closest_point(mesh, dressed.mesh.vertices[ids])[1]


def sex_of(dressed):
    return "male" if (dressed.kind == BELT).sum() == 0 else "female"


def test_clothes_hair_and_shoes_stand_off_the_skin_by_their_thickness(dressed):
    for kind in (SHIRT, TROUSERS):
        gap = off_skin(dressed, sex_of(dressed), kind)
        assert np.percentile(gap, 2) > 0.0045
        assert np.percentile(gap, 99.5) < 0.031
    hair = off_skin(dressed, sex_of(dressed), HAIR)
    assert np.median(hair) > 0.007 and hair.max() < 0.031
    shoe = off_skin(dressed, sex_of(dressed), SHOE)
    assert np.percentile(shoe, 2) > 0.002 and 0.005 < np.median(shoe) < 0.02


def test_her_skirt_stands_off_up_to_twenty_centimetres_and_moves_with_both_legs():
    dressed = dress(builtin_body("female"), FEMALE)
    gap = off_skin(dressed, "female", SKIRT)
    assert gap.min() > 0.006 and np.median(gap) > 0.06 and 0.17 < gap.max() < 0.21
    rows = np.unique(dressed.mesh.faces[dressed.kind == SKIRT])
    at, weights = dressed.mesh.vertices[rows], dressed.mesh.weights[rows]
    left, right = weights[:, [1, 4]].sum(1), weights[:, [2, 5]].sum(1)
    hem = at[:, 1] < at[:, 1].min() + 0.05
    middle = hem & (np.abs(at[:, 0]) < 0.02)
    assert middle.sum() > 20 and np.abs(left - right)[middle].max() < 0.25 and (left + right)[middle].min() > 0.8
    assert left[hem & (at[:, 0] > 0.28)].min() > 0.7 and right[hem & (at[:, 0] < -0.28)].min() > 0.7
    # no jump from one vertex to the next
    skirt = dressed.mesh.faces[dressed.kind == SKIRT]
    step = np.abs(dressed.mesh.weights[skirt] - dressed.mesh.weights[np.roll(skirt, 1, 1)]).max()
    assert step < 0.12


def test_face_and_hands_are_bare_and_what_is_written_ships(dressed, tmp_path):
    naked = builtin_body(sex_of(dressed))
    rows = np.unique(dressed.mesh.faces[dressed.kind == SKIN])
    fingers = rows[np.abs(dressed.mesh.vertices[rows, 0]) > np.abs(naked.joints[20:22, 0]).max()]
    mesh = trimesh.Trimesh(naked.vertices, naked.faces, process=False)
    assert len(fingers) > 2000
    assert trimesh.proximity.closest_point(mesh, dressed.mesh.vertices[fingers[::7]])[1].max() < 1e-6
    write_subject(tmp_path / "male.glb", load_subject("builtin"))
    expected = (files("synth") / "data" / "builtin_male.glb").read_bytes()
    assert (tmp_path / "male.glb").read_bytes() == expected
    assert len(expected) < 8e6
    assert (files("synth") / "data" / "builtin_female.glb").stat().st_size < 8e6


def test_every_piece_is_closed_and_no_face_is_degenerate(dressed):
    mesh = trimesh.Trimesh(dressed.mesh.vertices, dressed.mesh.faces, process=False)
    pieces = mesh.split(only_watertight=False)
    # the person, two shoes, two eyes, and her skirt
    assert len(pieces) == (5 if sex_of(dressed) == "male" else 6)
    assert all(piece.is_watertight and piece.is_winding_consistent and piece.volume > 0 for piece in pieces)
    assert mesh.area_faces.min() > 0
    assert set(np.unique(dressed.kind)) >= {SKIN, SHIRT, TROUSERS, HAIR, SHOE, SOLE, LINING, EYE}


def test_no_two_islands_share_a_texel(dressed):
    """A shoe that lay over the tip of a finger painted it black."""
    material, atlas = layout(dressed)
    assert atlas.min() >= 0 and atlas.max() <= 1
    ends = np.concatenate([dressed.mesh.uv_faces[:, [0, 1]], dressed.mesh.uv_faces[:, [1, 2]]])
    graph = coo_matrix((np.ones(len(ends)), ends.T), (len(dressed.mesh.uv),) * 2)
    island = connected_components(graph, directed=False)[1][dressed.mesh.uv_faces[:, 0]]
    for number in (0, 1):
        faces = np.flatnonzero(material == number)
        # the later triangle wins a texel: whoever paints it in this order paints it in the other
        owner, swapped = np.full((2, 1024**2), -1)
        texels = covered_texels(atlas[faces], 1024)
        owner[texels.index] = island[faces[texels.face]]
        texels = covered_texels(atlas[faces[::-1]], 1024)
        swapped[texels.index] = island[faces[::-1][texels.face]]
        np.testing.assert_array_equal(owner, swapped)


@pytest.mark.parametrize("sex", SEXES)
def test_the_shipped_person_is_the_painted_one(sex):
    """Painted anew, but for rounding; after the painter changed, `python -m experiments.builtin` writes the files."""
    painted, shipped = builtin_subject(sex), load_subject(f"builtin:{sex}")
    for field in fields(painted):
        made, read = getattr(painted, field.name), getattr(shipped, field.name)
        if field.name in ("textures", "skin"):
            assert len(made) == len(read)
            for one, other in zip(made, read):
                np.testing.assert_allclose(one.astype(float), other, rtol=0, atol=1 if one.dtype == np.uint8 else 1e-6)
        elif isinstance(made, np.ndarray):
            np.testing.assert_allclose(made, read, rtol=0, atol=1e-7)
        else:
            assert made == read


@pytest.mark.parametrize(
    "field, value", [("vertices", "faces"), ("faces", "hair"), ("hair", "weights"), ("weights", 99)]
)
def test_a_broken_order_is_refused_by_name(tmp_path, field, value):
    data = (files("synth") / "data" / "builtin_male.glb").read_bytes()
    length = int.from_bytes(data[12:16], "little")
    document = json.loads(data[20 : 20 + length])
    extras = document["asset"]["extras"]["selfscan"]
    extras[field] = extras.get(value, value)
    text = json.dumps(document, separators=(",", ":")).encode()
    assert len(text) <= length
    path = tmp_path / "broken.glb"
    path.write_bytes(data[:20] + text.ljust(length) + data[20 + length :])
    with pytest.raises(AssetError, match=field if value != 99 else "accessors|weights"):
        read_subject(path)


def test_splitting_keeps_a_surface_closed_and_cuts_run_along_the_line():
    box = trimesh.creation.icosphere(subdivisions=2, radius=0.1)
    uv = np.asarray(box.vertices)[:, :2]
    weights = np.eye(52)[np.zeros(len(box.vertices), int)]
    mesh = TexturedMesh(np.asarray(box.vertices), np.asarray(box.faces), uv, np.asarray(box.faces), weights)
    fine = refined(mesh, lambda points: np.where(points[:, 0] > 0, 0.01, 0.03))
    cut = cut_along(fine, fine.vertices[:, 1], 0.0213)
    assert len(cut.faces) > len(fine.faces) > len(mesh.faces)
    assert trimesh.Trimesh(cut.vertices, cut.faces, process=False).is_watertight
    height = cut.vertices[cut.faces][..., 1] - 0.0213
    assert not ((height.max(1) > 1e-9) & (height.min(1) < -1e-9)).any()
    np.testing.assert_allclose(cut.uv[cut.uv_faces].mean(), cut.vertices[cut.faces][..., :2].mean(), atol=2e-3)
