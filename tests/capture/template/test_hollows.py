"""Hollows carved by colour: a ball of skin, a block of brown hair at its side, and cells that are nothing."""

import numpy as np
import pytest
import trimesh
from icosphere import icosphere
from painted_ball import rigid_subject

from avatar.camera import Camera, look_at
from capture.folder import CaptureSubject
from capture.template.hollows import ColorView, Sure, carve_hollows, color_views
from geometry.mesh import TriangleMesh, concatenated
from geometry.rasterise import rasterise

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


def test_what_shows_the_colors_of_the_shirt_is_no_hair():
    cloth = cells((-0.10, -0.05, -0.03), (-0.06, 0.05, 0.03))
    hair, views = TRUE | cloth, filmed(shoulder=True)
    solid = hair | BALL
    sure = Sure(TRUE & cells((0.06, 0, -0.03), (0.10, 0.05, 0.03)), template().vertices[:, 1] < -0.03)
    found = carve_hollows(solid, hair, LOW, CELL, template(), views, sure)
    outside = cloth & ~BALL
    assert (found & outside).sum() > 0.9 * outside.sum()
    assert (found & TRUE).sum() < 0.05 * TRUE.sum()
    # masks alone cannot tell
    assert not (carve_hollows(solid, hair, LOW, CELL, template(), views) & outside).sum() > 0.1 * outside.sum()


def test_pictures_are_averaged_down_with_their_cameras():
    camera = Camera(np.array([[600.0, 0, 150], [0, 600, 150], [0, 0, 1]]), np.eye(4), (300, 300))
    image = np.zeros((300, 300, 3), np.uint8)
    image[:150] = 255
    (view,) = color_views(image[None], np.ones((1, 300, 300), bool), [camera])
    assert view.image.shape == (100, 100, 3) and view.camera.size == (100, 100)
    assert view.image[:50].min() == 1 and view.image[50:].max() == 0
    assert view.camera.K[0, 0] == 200 and view.camera.K[0, 2] == 50
