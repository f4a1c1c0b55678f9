"""Light told from whole captures: the frame in which it stands still."""

import numpy as np
import pytest
from painted_capture import write_capture
from turning_capture import turning_capture, with_video

from avatar.light import CaptureLight, lamps_of
from avatar.skeleton import PARTS
from capture.check.silhouette import posed_template
from capture.folder import Capture, read_capture
from capture.light.fit import fit_capture_light
from capture.light.frames import light_frame, light_from_video
from geometry.mesh import vertex_normals
from geometry.rasterise import rasterise

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


def test_a_still_person_tells_no_light(tmp_path):
    """Nobody turns: each triangle has one shading, and skin and light cannot be told apart."""
    capture = filmed_in(turning_capture(tmp_path / "capture"), LIGHT)
    assert light_frame(capture) == "world"
    assert fit_capture_light(capture).lights == {}


def test_a_phone_on_a_tripod_takes_the_light_along(tmp_path):
    capture = read_capture(write_capture(tmp_path / "capture", size=32, frames=4))
    assert light_frame(capture) == "camera"
    for part in PARTS:
        turns = light_from_video(capture, part, "camera")
        expected = np.stack([camera.camera_from_world[:3, :3] for camera in capture.videos[part].cameras])
        np.testing.assert_allclose(turns, expected, atol=1e-12)
        np.testing.assert_array_equal(light_from_video(capture, "body", "world"), np.tile(np.eye(3), (4, 1, 1)))


def test_canonical_rays_of_the_head_reach_the_same_light(tmp_path):
    capture = turning_capture(tmp_path / "capture")
    turn = np.linalg.qr(np.random.default_rng(0).standard_normal((3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    canonical_from_head = np.eye(4)
    canonical_from_head[:3, :3] = 0.5 * turn
    own = light_from_video(capture, "head", "camera")
    canonical = light_from_video(capture, "head", "camera", canonical_from_head)
    direction = np.array([0.3, -0.5, 0.8])
    for a, b in zip(own, canonical, strict=True):
        np.testing.assert_allclose(b @ (turn @ direction), a @ direction, atol=1e-12)
    assert pytest.approx(1) == np.linalg.det(canonical[0])
