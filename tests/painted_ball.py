"""A painted, dented ball for a head, filmed from around."""

import numpy as np
import trimesh

from avatar.camera import Camera, look_at
from avatar.skeleton import PARTS
from capture.folder import CaptureSubject, PartVideo
from capture.template.parts import rigid_weights
from geometry.rasterise import rasterise

SIZE = 96


def head() -> CaptureSubject:
    ball = trimesh.creation.icosphere(subdivisions=5, radius=0.1)
    x, y, z = ball.vertices.T
    # longer than wide, dented and with a nose, so that no turn leaves it as it is
    vertices = ball.vertices * np.array([0.8, 1.1, 1.0])
    nose = 0.12 * np.exp(-((x**2 + y**2) / 0.0006)) * (z > 0)
    vertices *= (1 + nose + 0.04 * np.sin(40 * x))[:, None]
    return rigid_subject(vertices, ball.faces, np.full(len(vertices), PARTS.index("head")))


def rigid_subject(vertices: np.ndarray, faces: np.ndarray, part: np.ndarray) -> CaptureSubject:
    """A person of one bone without hair, as it stands in pose 0."""
    count = len(vertices)
    nobody = np.zeros(count, bool)
    return CaptureSubject("ball", vertices, vertices, faces, rigid_weights(count), np.zeros((52, 3)), part, nobody)


def paint(points: np.ndarray) -> np.ndarray:
    waves = [np.sin(points @ np.array(k)) for k in ((90, 20, 0), (0, 80, 30), (30, 0, 100))]
    return 0.5 + 0.4 * np.stack(waves, 1)


def filmed(subject: CaptureSubject) -> PartVideo:
    K = np.array([[1.9 * SIZE, 0, SIZE / 2], [0, 1.9 * SIZE, SIZE / 2], [0, 0, 1]])
    color = paint(subject.vertices[subject.faces].mean(1))
    images, masks, cameras = [], [], []
    for i in range(10):
        a = np.radians(-60 + 120 * i / 9)
        eye = 0.6 * np.array([np.sin(a), 0.3 * np.cos(2 * a), np.cos(a)])
        camera = Camera(K, look_at(eye, np.zeros(3)), (SIZE, SIZE))
        face = rasterise(subject.vertices, subject.faces, camera).face
        images.append(np.where((face >= 0)[..., None], 255 * color[face], 0).astype(np.uint8))
        masks.append(face >= 0)
        cameras.append(camera)
    return PartVideo("head", np.stack(images), np.stack(masks), tuple(cameras), None, None, None, None)
