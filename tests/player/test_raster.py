import numpy as np
import pytest

from avatar.body import builtin_body
from avatar.camera import Camera, look_at, orbit_camera, project
from player.draw.raster import clip_planes


@pytest.fixture(scope="module")
def body():
    body = builtin_body("female")
    return body.vertices.astype(np.float64), body.faces


def surface_pixels(fragments, vertices, faces, camera):
    """Where avatar.camera.project puts the surface points found, and the pixel centres they were found at."""
    hit = fragments.face >= 0
    rows, columns = np.nonzero(hit)
    points = (vertices[faces[fragments.face[hit]]] * fragments.barycentric[hit][:, :, None].astype(float)).sum(1)
    pixels, depth = project(camera, points)
    return pixels, np.stack([columns + 0.5, rows + 0.5], 1), depth, fragments.depth[hit]


@pytest.mark.parametrize("skew", [0.0, 12.0])
def test_every_fragment_lies_on_its_pixel_as_project_says(rasteriser, body, skew):
    camera = orbit_camera((0.1, 0, 0), 2.5, 0.7, 0.3, (211, 160))
    K = camera.K + np.array([[0, skew, -17.3], [0, 31.0, 9.1], [0, 0, 0]])  # off-centre, oblong pixels
    camera = Camera(K, camera.camera_from_world, camera.size)
    pixels, centers, depth, found = surface_pixels(rasteriser.draw(*body, camera), *body, camera)
    assert len(pixels) > 1500
    assert np.abs(pixels - centers).max() < 5e-3  # vertices snap to 1/256 pixel
    assert np.abs(depth - found).max() < 1e-4


def test_a_single_triangle_covers_exactly_the_pixel_centres_inside_it(rasteriser):
    camera = Camera(np.array([[8.0, 0, 4], [0, 8, 4], [0, 0, 1]]), np.eye(4), (8, 8))
    corners = np.array([[0.6, 0.6], [6.9, 0.6], [0.6, 6.9]])  # pixels
    vertices = np.concatenate([(corners - 4) / 8, np.ones((3, 1))], 1)
    fragments = rasteriser.draw(vertices, np.array([[0, 1, 2]]), camera)
    y, x = np.mgrid[:8, :8] + 0.5
    inside = (x > 0.6) & (y > 0.6) & (x + y < 7.5)
    assert np.array_equal(fragments.face == 0, inside)
    assert np.isinf(fragments.depth[~inside]).all() and (fragments.barycentric[~inside] == 0).all()
    weights = fragments.barycentric[inside]
    assert np.abs(weights.sum(1) - 1).max() < 1e-6
    assert np.abs(weights @ corners - np.stack([x, y], -1)[inside]).max() < 0.05  # corners snap to 1/256


def test_barycentrics_are_perspective_correct(rasteriser):
    camera = Camera(np.array([[50.0, 0, 32], [0, 50, 32], [0, 0, 1]]), np.eye(4), (64, 64))
    vertices = np.array([[-0.5, -0.5, 1.0], [5.0, -5.0, 10.0], [-5.0, 5.0, 10.0]])
    fragments = rasteriser.draw(vertices, np.array([[0, 1, 2]]), camera)
    hit = fragments.face == 0
    depth = fragments.barycentric[hit].astype(float) @ vertices[:, 2]
    assert np.abs(depth / fragments.depth[hit] - 1).max() < 1e-4
    assert depth.min() < 1.2 and depth.max() > 8


def test_the_nearer_triangle_wins_whatever_the_order(rasteriser):
    camera = Camera(np.array([[50.0, 0, 8], [0, 50, 8], [0, 0, 1]]), np.eye(4), (16, 16))
    triangle = np.array([[-1, -1, 0], [1, -1, 0], [0, 1, 0]]) * 0.1
    vertices = np.concatenate([triangle + [0, 0, 1], triangle + [0, 0, 1.001]])
    faces = np.array([[0, 1, 2], [3, 4, 5]])
    near_first = rasteriser.draw(vertices, faces, camera).face
    near_last = rasteriser.draw(vertices, faces[::-1], camera).face
    assert set(np.unique(near_first)) <= {-1, 0} and set(np.unique(near_last)) <= {-1, 1}


def test_back_faces_show_only_without_culling(rasteriser, body):
    camera = orbit_camera((0, 0, 0), 0.01, 0, 0, (16, 16))  # inside the belly
    assert (rasteriser.draw(*body, camera).face >= 0).all()
    assert (rasteriser.draw(*body, camera, cull=True).face >= 0).mean() < 0.5
    inside_out = body[1][:, ::-1]
    assert (rasteriser.draw(body[0], inside_out, camera, cull=True).face >= 0).all()


def test_size_redraws_the_same_view_on_another_grid(rasteriser, body):
    camera = orbit_camera((0, 0, 0), 2.5, 0.2, 0.1, (200, 200))
    small = rasteriser.draw(*body, camera, (50, 100))
    assert small.face.shape == (100, 50)
    same = rasteriser.draw(*body, camera.resized((50, 100)))
    assert np.array_equal(small.face, same.face)


def test_all_behind_the_camera_is_an_empty_image(rasteriser, body):
    behind = Camera(np.array([[50.0, 0, 8], [0, 50, 8], [0, 0, 1]]), look_at((0, 0, -9), (0, 0, -10)), (16, 12))
    fragments = rasteriser.draw(*body, behind)
    assert (fragments.face == -1).all() and fragments.depth.shape == (12, 16)


def test_faces_past_the_vertices_are_refused(rasteriser, body):
    camera = orbit_camera((0, 0, 0), 2, 0, 0, (8, 8))
    with pytest.raises(ValueError, match=r"0\.\.2 of 2 vertices"):
        rasteriser.draw(np.zeros((2, 3)), np.array([[0, 1, 2]]), camera)


@pytest.mark.parametrize("depth", [[1.0, 3.0], [2.0, 2.0], [-5.0, 4.0], [0.0, 1e-3], [1e4, 2e4]])
def test_clip_planes_hold_the_points_in_front(depth):
    planes = clip_planes(np.array(depth))
    assert planes is not None
    near, far = planes
    assert 0 < near < far and far > max(depth) and (near <= depth[0] or near <= 1e-3 * far)
    assert clip_planes(np.array([-3.0, -1.0])) is None
