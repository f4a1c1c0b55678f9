"""Eyes painted on the free body are found in pictures of its head, and lids and sockets go there."""

from dataclasses import replace

import numpy as np
import pytest

from avatar.camera import orbit_camera
from capture.fit.eyes import (
    FEWEST,
    PIXEL,
    Size,
    drawn,
    explained,
    find_eyes,
    in_order,
    opening_middle,
    with_eyes_of_pictures,
)
from capture.fit.footage import footage_of, unplaced
from capture.fit.person import person_of
from capture.fit.points import body_points
from capture.frame_files import write_picture
from capture.keypoints.record import Keypoints
from capture.raw.scan import RawVideo
from capture.template.eyes import body_sockets, socket_spheres
from geometry.closest import beyond_loop

SKIN, WHITE, IRIS = (0.72, 0.52, 0.42), (0.86, 0.84, 0.83), (0.30, 0.20, 0.14)
FRAMES, SIZE = 7, 300


@pytest.fixture(scope="module")
def body():
    return person_of("male").body.vertices


def painted(vertices, camera, *, off=(0.0, 0.0, 0.0), taller=1.0, colors=(SKIN, WHITE, IRIS), lashes=0.0, before=0.0):
    """What a camera sees of a wall in the plane of the lids with both eyes on it, `off` metres from the template, under
    black lashes of so many metres that stand so far before it."""
    row, column = np.mgrid[:SIZE, :SIZE] + 0.5
    rays = np.stack([column.ravel(), row.ravel(), np.ones(SIZE * SIZE)], 1) @ np.linalg.inv(camera.K).T
    rays = rays @ camera.camera_from_world[:3, :3]
    picture = np.tile(np.array(colors[0]), (SIZE * SIZE, 1))
    for socket in body_sockets():
        middle = opening_middle(vertices, socket.rim)
        loop = in_order(vertices[socket.rim, :2] - middle[:2]) * [1, taller]
        behind, at, beyond = seen_in_plane(camera, rays, middle + off, loop)
        open_ = behind[beyond < 0]
        picture[open_] = colors[1]
        picture[open_[np.hypot(*at[beyond < 0].T) < 0.006]] = colors[2]
        ahead, at, beyond = seen_in_plane(camera, rays, middle + off + [0, 0, before], loop)
        picture[ahead[(np.abs(beyond - lashes / 2) < lashes / 2) & (at[:, 1] > 0)]] = 0.05
    return np.uint8(255 * picture.reshape(SIZE, SIZE, 3))


def seen_in_plane(camera, rays, at, loop):
    """The rays that meet the plane through a place near it, where in that plane, and how far beyond a loop."""
    length = (at[2] - camera.eye[2]) / rays[:, 2]
    places = (camera.eye + length[:, None] * rays)[:, :2] - at[:2]
    near = np.flatnonzero(np.abs(places).max(1) < 0.03)
    return near, places[near], beyond_loop(places[near], loop)


def filmed(vertices, folder, **drawn):
    """Cameras that swing before the face, and a film of it."""
    middle = opening_middle(vertices, body_sockets()[0].rim) * [0, 1, 1]
    cameras = []
    for angle in np.radians(np.linspace(-20, 20, FRAMES)):
        cameras.append(orbit_camera(middle, 0.5, float(angle), 0.1, (SIZE, SIZE), np.radians(24)))
    paths = [folder / f"{number}.png" for number in range(FRAMES)]
    for path, camera in zip(paths, cameras):
        write_picture(path, painted(vertices, camera, **drawn))
    nothing = np.zeros((FRAMES, 0))
    points = Keypoints((), np.zeros((FRAMES, 0, 2)), nothing, (SIZE, SIZE))
    masks = np.zeros((FRAMES, SIZE, SIZE), np.uint8)
    return cameras, RawVideo("head", (SIZE, SIZE), 30.0, np.arange(FRAMES), tuple(paths), masks, points, None)


ALL = np.ones(FRAMES, bool)


def test_eyes_are_found_aside_above_and_behind_the_templates(body, tmp_path):
    cameras, film = filmed(body, tmp_path, off=(0.002, 0.0036, -0.003))
    found = find_eyes(body, cameras, film, ALL)
    assert found is not None and found.size.radius == 0.0062 and found.size.height == 1
    np.testing.assert_allclose(found.moves, [[0.002, 0.0036, -0.0027]] * 2, atol=0.0008)


@pytest.mark.slow
def test_a_taller_opening_is_taller(body, tmp_path):
    cameras, film = filmed(body, tmp_path, taller=1.8)
    found = find_eyes(body, cameras, film, ALL)
    assert found is not None and found.size.height > 1
    np.testing.assert_allclose(found.moves, 0, atol=0.0008)


def test_lids_and_sockets_go_there_and_brows_and_nose_hardly_move(body, tmp_path):
    cameras, film = filmed(body, tmp_path, off=(-0.002, 0.003, 0.002))
    person = person_of("male")
    points = footage_of(film.keypoints, film.masks, (), np.zeros(0, np.int64), focal=1.0, focal_sigma=1.0)
    before = unplaced(person, np.zeros(len(person.sigma)), points)
    after = with_eyes_of_pictures(before, cameras, film, ALL)
    moved = after.person.offsets
    for socket in body_sockets():
        np.testing.assert_allclose(moved[socket.rim].mean(0), [-0.002, 0.003, 0.002], atol=0.0008)
        assert np.ptp(moved[socket.inside], axis=0).max() < 1e-3
    balls = socket_spheres(body), socket_spheres(body + moved)
    np.testing.assert_allclose(balls[1][:, :3] - balls[0][:, :3], [[-0.002, 0.003, 0.002]] * 2, atol=0.0008)
    np.testing.assert_allclose(balls[1][:, 3], balls[0][:, 3], atol=2e-4)
    for name in ("face_19", "face_24", "face_30"):
        assert np.linalg.norm(moved[body_points()[name].vertices], axis=1).max() < 0.0012, name
    middles = np.stack([opening_middle(body, socket.rim) for socket in body_sockets()])
    assert (moved[np.linalg.norm(body[:, None] - middles, axis=2).min(1) > 0.05] == 0).all()


@pytest.mark.slow
def test_closed_eyes_too_few_frames_and_a_head_from_afar_move_nothing(body, tmp_path):
    cameras, film = filmed(body, tmp_path, colors=(SKIN, SKIN, SKIN))
    assert find_eyes(body, cameras, film, ALL) is None
    cameras, film = filmed(body, tmp_path)
    assert find_eyes(body, cameras, film, np.arange(FRAMES) < FEWEST - 1) is None
    far = [replace(camera, K=np.diag([0.1, 0.1, 1]) @ camera.K) for camera in cameras]
    assert find_eyes(body, far, film, ALL) is None


@pytest.mark.slow
def test_thick_lashes_over_whites_in_their_shade_are_no_iris(body, tmp_path):
    shaded = (SKIN, (0.50, 0.42, 0.37), IRIS)
    cameras, film = filmed(body, tmp_path, off=(0.0012, -0.0016, 0.0), colors=shaded, lashes=0.0025)
    found = find_eyes(body, cameras, film, ALL)
    assert found is not None
    np.testing.assert_allclose(found.moves[:, :2], [[0.0012, -0.0016]] * 2, atol=0.0008)


@pytest.mark.slow
def test_lashes_before_the_eyes_say_nothing_of_their_depth(body, tmp_path):
    cameras, film = filmed(body, tmp_path, lashes=0.003, before=0.006)
    found = find_eyes(body, cameras, film, ALL)
    assert found is not None
    np.testing.assert_allclose(found.moves[:, 2], 0, atol=0.001)


@pytest.mark.parametrize(
    ("white", "explains"),
    [(WHITE, True), ((0.50, 0.42, 0.37), True), ((0.20, 0.19, 0.18), False), ((0.72, 0.26, 0.18), False)],
)
def test_a_white_is_brighter_than_the_iris_and_hardly_more_colorful_than_skin(body, white, explains):
    rim = body_sockets()[0].rim
    loop = in_order(body[rim, :2] - opening_middle(body, rim)[:2])
    parts, counts = drawn(loop, Size(0.006, 0.001, 1.0), 1, PIXEL)
    picture = np.einsum("phw,pc->hwc", parts, np.array([IRIS, white, SKIN, SKIN, SKIN]))
    middle = explained(picture, parts, counts)[tuple(size // 2 for size in counts.shape)]
    assert middle > 0.95 if explains else middle == -1
