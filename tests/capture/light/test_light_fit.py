"""Light found in pixels of balls that turn before a camera, and in whole captures: the frame where it stands still."""

from functools import partial

import numpy as np
import pytest
from painted_capture import write_capture
from turning_ball import turning_ball
from turning_capture import with_video

from avatar.light import CaptureLight, Lamp, lamps_of
from avatar.skeleton import PARTS
from capture.check.silhouette import posed_template
from capture.folder import Capture, read_capture
from capture.light.fit import fit_capture_light, fit_light
from capture.light.frames import light_frame, light_from_video
from geometry.mesh import vertex_normals
from geometry.rasterise import rasterise

SIDE = lamps_of(np.array([[0.45, -0.65, -0.6]]), np.array([0.55]))
seen = partial(turning_ball, noise=0.01, odd=True, triangles=400, frames=12)


def degrees_between(a: Lamp, b: Lamp) -> float:
    return float(np.degrees(np.arccos(np.clip(np.dot(a.direction, b.direction), -1, 1))))


def test_ambient_lamp_and_highlight_are_found_and_the_mean_shading_is_one():
    pixels = seen(CaptureLight(0.45, SIDE, gloss=0.1))
    found = fit_light(pixels)
    light = found.lights["body"]
    assert found.shared
    assert len(light.lamps) == 1
    assert light.gamma == 1.0
    assert degrees_between(light.lamps[0], SIDE[0]) < 1
    assert light.ambient / light.lamps[0].strength == pytest.approx(0.45 / 0.55, abs=0.02)
    assert light.gloss == pytest.approx(0.1, abs=0.02)
    assert light.shading(pixels.normal).mean() == pytest.approx(1, abs=1e-9)
    assert found.residual < 0.5 * found.residual_without


@pytest.mark.parametrize("ambient", [1.0, 0.99])
def test_even_light_is_no_light(ambient):
    lamp = lamps_of(np.array([SIDE[0].direction]), np.array([1 - ambient]))
    found = fit_light(seen(CaptureLight(ambient, lamp)))
    assert found.lights == {}
    assert found.residual == found.residual_without


@pytest.mark.slow
def test_a_sheen_that_follows_the_eye_is_no_lamp_and_a_soft_light_is_a_light():
    assert fit_light(seen(CaptureLight(1.0), sheen=0.5)).lights == {}
    light = fit_light(seen(CaptureLight(0.45, SIDE), sheen=0.5)).lights["body"]
    assert len(light.lamps) == 1
    assert degrees_between(light.lamps[0], SIDE[0]) < 1.5
    assert light.ambient / light.lamps[0].strength == pytest.approx(0.45 / 0.55, abs=0.04)
    found = fit_light(seen(CaptureLight(0.75, lamps_of(np.array([SIDE[0].direction]), np.array([0.25])))))
    light = found.lights["body"]
    assert degrees_between(light.lamps[0], SIDE[0]) < 1.5
    assert light.ambient / light.lamps[0].strength == pytest.approx(3, abs=0.15)


@pytest.mark.slow
def test_a_second_lamp_is_found_where_it_explains_more():
    lamps = lamps_of(np.array([[0.8, -0.2, -0.6], [-0.7, -0.7, -0.2]]), np.array([0.5, 0.4]))
    light = fit_light(seen(CaptureLight(0.3, lamps))).lights["body"]
    assert len(light.lamps) == 2
    nearest = [min(degrees_between(lamp, other) for other in light.lamps) for lamp in lamps]
    assert max(nearest) < 3


@pytest.mark.slow
@pytest.mark.parametrize("gamma", [1.0, 2.2])
def test_the_space_in_which_light_multiplies_is_found(gamma):
    light = fit_light(seen(CaptureLight(0.1, SIDE, gamma=gamma), noise=0.004)).lights["body"]
    assert light.gamma == gamma
    assert light.ambient / light.lamps[0].strength == pytest.approx(0.1 / 0.55, abs=0.03)


def test_videos_in_lights_of_their_own_get_one_each_on_one_scale():
    lights = {
        part: CaptureLight(ambient, lamps_of(np.array([[x, -0.5, -0.7]]), np.array([1 - ambient])))
        for part, ambient, x in zip(PARTS, (0.5, 0.4, 0.6, 0.7), (0.9, -0.9, 0.2, -0.4), strict=True)
    }
    found = fit_light(seen(lights))
    assert not found.shared
    scale = found.lights["body"].ambient / lights["body"].ambient
    for part in PARTS:
        assert degrees_between(found.lights[part].lamps[0], lights[part].lamps[0]) < 2
        assert found.lights[part].ambient / lights[part].ambient == pytest.approx(scale, rel=0.05)


LIGHT = CaptureLight(0.4, lamps_of(np.array([[0.5, 0.7, 0.5]]), np.array([0.5])), frame="world")


def filmed_in(capture: Capture, light: CaptureLight) -> Capture:
    """The capture with a painted template under a light that stands still in the world."""
    subject = capture.subject
    albedo = 0.4 + 0.3 * np.sin(30 * subject.vertices[subject.faces].mean(1))
    for part in PARTS:
        video, images = capture.videos[part], []
        turns = light_from_video(capture, part, "world")
        for frame, camera in enumerate(video.cameras):
            vertices = posed_template(capture, part, frame)
            face = rasterise(vertices, subject.faces, camera).face
            n = vertex_normals(vertices, subject.faces)[subject.faces].mean(1)
            n = n / np.linalg.norm(n, axis=1, keepdims=True) @ turns[frame].T
            shown = light.shown(albedo, light.shading(n), np.zeros(len(n)))
            images.append(np.uint8(np.round(255 * shown[face] * (face >= 0)[..., None])))
        capture = with_video(capture, part, images=np.stack(images))
    return capture


@pytest.mark.slow
def test_a_still_person_tells_no_light_and_canonical_rays_of_the_head_reach_the_same(turning):
    """Nobody turns: each triangle has one shading, and skin and light cannot be told apart."""
    capture = filmed_in(turning, LIGHT)
    assert light_frame(capture) == "world"
    assert fit_capture_light(capture).lights == {}
    turn = np.linalg.qr(np.random.default_rng(0).standard_normal((3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    canonical_from_head = np.eye(4)
    canonical_from_head[:3, :3] = 0.5 * turn
    own = light_from_video(turning, "head", "camera")
    canonical = light_from_video(turning, "head", "camera", canonical_from_head)
    direction = np.array([0.3, -0.5, 0.8])
    for a, b in zip(own, canonical, strict=True):
        np.testing.assert_allclose(b @ (turn @ direction), a @ direction, atol=1e-12)
    assert pytest.approx(1) == np.linalg.det(canonical[0])


@pytest.mark.slow
def test_a_phone_on_a_tripod_takes_the_light_along(tmp_path):
    capture = read_capture(write_capture(tmp_path / "capture", size=32, frames=4))
    assert light_frame(capture) == "camera"
    for part in PARTS:
        turns = light_from_video(capture, part, "camera")
        expected = np.stack([camera.camera_from_world[:3, :3] for camera in capture.videos[part].cameras])
        np.testing.assert_allclose(turns, expected, atol=1e-12)
        np.testing.assert_array_equal(light_from_video(capture, "body", "world"), np.tile(np.eye(3), (4, 1, 1)))
