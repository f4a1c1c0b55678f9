"""Hollows carved by colour, the inside made solid but no air before it, and eyeballs in their sockets."""

from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh
from capsules import icosphere
from painted_ball import rigid_subject
from painted_capture import free_subject

from avatar.camera import Camera, look_at
from avatar.rotation import fibonacci_sphere
from avatar.skeleton import PARTS
from avatar.skinning import dense_weights
from capture.folder import CaptureSubject, read_capture, read_subject, write_subject
from capture.template.eyes import body_sockets, eye_openings, eye_spheres, fit_sphere
from capture.template.hollows import ColorKinds, ColorView, Sure, carve_hollows, color_views
from capture.template.parts import HEAD, part_boxes, with_rigid_head
from capture.template.solid import outer_air, solid_inside
from command.errors import AssetError
from geometry.mesh import TriangleMesh, concatenated
from geometry.rasterise import rasterise
from train.fused import part_weight

CELL = 0.006
SKIN, BROWN, BLUE = np.array([0.9, 0.7, 0.6]), np.array([0.3, 0.2, 0.1]), np.array([0.5, 0.6, 0.9])
LOW = np.array([-0.15, -0.15, -0.15])


GRID = np.stack(np.meshgrid(*[LOW[0] + CELL * np.arange(51)] * 3, indexing="ij"), -1)
BALL = np.linalg.norm(GRID, axis=-1) < 0.06


def cells(low, high):
    return ((low <= GRID) & (high >= GRID)).all(-1)


TRUE = cells((0.06, -0.05, -0.03), (0.10, 0.05, 0.03))
NOTHING = cells((-0.03, -0.03, 0.05), (0.03, 0.03, 0.09)) & ~BALL


def template() -> CaptureSubject:
    vertices, faces = icosphere(0.06, subdivisions=4)
    return rigid_subject(vertices, faces, np.ones(len(vertices), int))


def filmed(tint: float = 0.0, shoulder: bool = False) -> list[ColorView]:
    """Sixteen pictures from around; `tint` makes hair look different from every side. With `shoulder` the lower part of
    the ball is in a shirt, and a block of it stands off at the other side."""
    ball = template()
    box = trimesh.creation.box((0.04, 0.10, 0.06)).subdivide()
    other = box.copy()
    box.apply_translation((0.08, 0, 0))
    other.apply_translation((-0.08, 0, 0))
    meshes = [ball, box, other] if shoulder else [ball, box]
    vertices, faces = concatenated([TriangleMesh(mesh.vertices, mesh.faces) for mesh in meshes])
    # two halves of the skin in two colours: a cell before it would have to be both
    middle = vertices[faces].mean(1)
    color = np.where((middle[:, :1] * 40).astype(int) % 2 == 0, SKIN, SKIN * 0.8)
    color[len(ball.faces) :] = BROWN
    if shoulder:
        color[(middle[:, 0] < -0.062) | (middle[:, 1] < -0.03) & (np.arange(len(faces)) < len(ball.faces))] = BLUE
    K = np.array([[150.0, 0, 48], [0, 150, 48], [0, 0, 1]])
    views = []
    for i in range(16):
        a = 2 * np.pi * i / 16
        eye = np.array([np.sin(a), 0.3 * np.sin(3 * a), np.cos(a)])
        camera = Camera(K, look_at(eye * 0.45 / np.linalg.norm(eye), np.zeros(3)), (96, 96))
        face = rasterise(vertices, faces, camera).face
        picture = np.where((face >= 0)[..., None], color[face], 0)
        picture = picture + tint * (i % 2) * (face >= len(ball.faces))[..., None]
        views.append(ColorView(picture, face >= 0, camera))
    return views


@pytest.mark.parametrize("shine", [0.0, 0.1])
def test_cells_that_show_what_lies_behind_them_are_carved_and_hair_and_skin_stay(shine):
    hair = TRUE | NOTHING
    carved = carve_hollows(hair | BALL, hair, LOW, CELL, template(), filmed(shine))
    assert (carved & TRUE).sum() < 0.05 * TRUE.sum()
    assert not (carved & BALL & ~TRUE & ~NOTHING).any()
    # cells close before one colour may as well be skin that stands out a little
    assert (carved & NOTHING).sum() > 0.5 * NOTHING.sum()


@pytest.mark.parametrize("shine", [0.0, 0.3])
def test_what_shows_the_colors_of_the_shirt_is_no_hair_and_what_shows_those_of_hair_is_although_views_disagree(shine):
    cloth = cells((-0.10, -0.05, -0.03), (-0.06, 0.05, 0.03))
    hair, views = TRUE | cloth, filmed(shine, shoulder=True)
    solid = hair | BALL
    grows = TRUE & cells((0.06, 0, -0.03), (0.10, 0.05, 0.03))
    sure = Sure(grows, TRUE, template().vertices[:, 1] < -0.03)
    found = carve_hollows(solid, hair, LOW, CELL, template(), views, sure)
    outside = cloth & ~BALL
    assert (found & outside).sum() > 0.9 * outside.sum()
    assert (found & TRUE).sum() < 0.05 * TRUE.sum()
    if shine:
        # by agreement alone it would have gone
        sure = sure._replace(behind=np.zeros_like(TRUE), hair=np.zeros_like(TRUE))
        assert (carve_hollows(solid, hair, LOW, CELL, template(), views, sure) & TRUE).sum() > 0.3 * TRUE.sum()
        return
    # masks alone cannot tell
    assert not (carve_hollows(solid, hair, LOW, CELL, template(), views) & outside).sum() > 0.1 * outside.sum()


def test_skin_in_the_shade_is_no_hair_though_some_cells_of_hair_show_it():
    """A dark neck beside black hair: darker than any skin that is known, and not near hair's colors."""
    rng = np.random.default_rng(0)
    hair = np.clip(rng.normal(0.16, 0.05, (4000, 1)) + rng.normal(0, 0.01, (4000, 3)), 0, 1)
    skin = np.array([0.62, 0.42, 0.31]) * rng.uniform(0.85, 1, (500, 1)) + rng.normal(0, 0.01, (500, 3))
    shade = 0.5 * np.array([0.62, 0.42, 0.31])
    hair[:: 4000 // 12] = shade
    kinds = ColorKinds.between(hair, skin)
    shown = np.stack([shade, skin[0], hair[1]])[None].repeat(3, 0)
    assert kinds.share(kinds.other, shown).tolist() == [1, 1, 0]
    assert kinds.share(kinds.hair, shown)[2] == 1


def test_pictures_are_averaged_down_with_their_cameras():
    camera = Camera(np.array([[600.0, 0, 150], [0, 600, 150], [0, 0, 1]]), np.eye(4), (300, 300))
    image = np.zeros((300, 300, 3), np.uint8)
    image[:150] = 255
    (view,) = color_views(image[None], np.ones((1, 300, 300), bool), [camera])
    assert view.image.shape == (100, 100, 3) and view.camera.size == (100, 100)
    assert view.image[:50].min() == 1 and view.image[50:].max() == 0
    assert view.camera.K[0, 0] == 200 and view.camera.K[0, 2] == 50


def lined_shoe() -> CaptureSubject:
    """A coarse ball, and in it the fine lining of its front, which faces inwards as a shoe's does; a head above
    and something below: what is lowest is searched for folds."""
    ball = trimesh.creation.icosphere(subdivisions=0, radius=0.1)
    lining = trimesh.creation.icosphere(subdivisions=4, radius=0.075)
    front = lining.triangles_center[:, 2] > 0.04
    balls = [TriangleMesh(ball.vertices + [0, y, 0], ball.faces) for y in (0, 1, -1)]
    vertices, faces = concatenated([*balls, TriangleMesh(lining.vertices, lining.faces[front][:, ::-1])])
    return rigid_subject(vertices, faces, np.where(vertices[:, 1] > 0.5, PARTS.index("head"), PARTS.index("body")))


def test_air_before_a_lining_stays_air_and_what_is_inside_becomes_solid():
    shoe = lined_shoe()
    # between the ball's corners the nearest four vertices are the lining's
    rays = trimesh.creation.icosphere(subdivisions=3).vertices
    solid = solid_inside(lambda points: np.full(len(points), 0.03), shoe)
    for distance in (0.14, 0.16):
        assert (solid(distance * rays) == 0.03).all()
    assert (solid(0.05 * rays[rays[:, 2] < -0.8]) < 0).mean() > 0.8


def test_outer_air_is_outside_and_not_near_the_surface_and_a_hole_three_centimetres_wide_lets_none_in():
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.1)
    rays = trimesh.creation.icosphere(subdivisions=2).vertices
    # the hole is 2.8 cm wide
    for faces in (ball.faces, ball.faces[ball.triangles_center[:, 2] < 0.099]):
        air = outer_air(ball.vertices, faces)
        assert air(0.15 * rays).all() and air(9.0 * rays).all()
        assert not air(0.05 * rays).any() and not air(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.07]])).any()
        if faces is ball.faces:
            assert not air(0.1 * rays).any()


def test_the_head_is_rigid_where_only_it_has_a_weight_and_nothing_changes_below_the_overlap(tiny_capture):
    subject = read_capture(tiny_capture).subject
    share = part_weight(torch.as_tensor(subject.vertices), part_boxes(subject)[1]).numpy()
    before, after = dense_weights(subject.skin), dense_weights(with_rigid_head(subject).skin)
    alone, below = share == 1, share <= 0.5
    assert alone.sum() > 100 and below.sum() > 100
    assert np.abs(after[alone, HEAD] - 1).max() < 1e-6
    np.testing.assert_allclose(after[below], before[below], atol=1e-6)
    np.testing.assert_allclose(after.sum(1), 1, atol=1e-6)
    assert (before[alone, HEAD] < 0.99).any()  # the body model's own weights bend it


STATED = np.array([[0.03, 0.65, 0.12, 0.016], [-0.03, 0.65, 0.12, 0.015]])


@pytest.fixture(scope="module")
def subject():
    return free_subject("male")


def spheres_of(subject):
    spheres = eye_spheres(subject)
    assert spheres is not None
    return spheres


def test_a_sphere_is_found_from_a_cap_of_it_and_points_of_a_plane_are_none():
    cap = fibonacci_sphere(2000)
    cap = cap[cap[:, 2] > 0.7]
    centre, radius = fit_sphere([1.0, 2.0, 3.0] + 0.012 * cap)
    assert np.abs(centre - [1, 2, 3]).max() < 1e-9 and abs(radius - 0.012) < 1e-9  # 64-bit least squares
    with pytest.raises(ValueError, match="not in a plane"):
        fit_sphere(np.random.default_rng(0).random((50, 3)) * [1, 1, 0])


def test_the_free_body_has_eyeballs_and_stated_ones_follow_the_head_bone(subject):
    spheres = spheres_of(subject)
    for centre, radius, socket in zip(spheres.centres, spheres.radii, body_sockets()):
        rim = np.linalg.norm(subject.vertices[socket.rim] - centre, axis=1)
        # the lids' edges lie on the ball or up to 2.5 mm in front of it
        assert (rim - radius).min() > -0.0005 and (rim - radius).max() < 0.0025
        assert 0.011 < radius < 0.0135
    assert spheres.centres[0, 0] > 0 > spheres.centres[1, 0]
    spheres = spheres_of(replace(subject, eyes=STATED))
    assert np.array_equal(spheres.radii, STATED[:, 3])
    # the big pose turns only the hips
    assert np.abs(spheres.centres - STATED[:, :3]).max() < 1e-9
    other = replace(subject, faces=subject.faces[:, [1, 2, 0]])
    assert eye_spheres(other) is None
    assert len(eye_openings(other)) == 0


def test_the_opening_is_what_the_lids_leave_free(subject):
    opening = eye_openings(subject)
    spheres = spheres_of(subject)
    assert np.abs(spheres.distance(opening)).max() < 1e-9
    for side, socket in zip((1, -1), body_sockets()):
        points, rim = opening[side * opening[:, 0] > 0], subject.vertices[socket.rim]
        low, high = rim.min(0), rim.max(0)
        # within the rim, and most of the way across it
        assert (points[:, :2] > low[:2] - 1e-3).all() and (points[:, :2] < high[:2] + 1e-3).all()
        assert (np.ptp(points[:, :2], axis=0) > 0.7 * (high - low)[:2]).all()


def test_stated_eyeballs_survive_the_file_and_one_outside_the_person_is_refused(tmp_path, subject):
    for eyes in (STATED, None):
        write_subject(tmp_path / "subject.npz", replace(subject, eyes=eyes))
        np.testing.assert_array_equal(read_subject(tmp_path / "subject.npz").eyes, eyes)
    write_subject(tmp_path / "subject.npz", replace(subject, eyes=STATED * [[1, 10, 1, 1], [1, 1, 1, 1]]))
    with pytest.raises(AssetError, match=r"eyes should hold a centre within the template.*left"):
        read_subject(tmp_path / "subject.npz")
