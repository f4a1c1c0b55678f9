"""A tiny capture made in the test: the built-in body with painted skin and eyes, drawn by the training march itself."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from avatar.body import builtin_body
from avatar.camera import Camera, look_at, pinhole, pixel_rays, write_cameras
from avatar.rotation import matrix_from_axis_angle
from avatar.skeleton import BIG_POSE, PARTS, skin_transforms
from avatar.skinning import skin_normals, skin_points
from capture.folder import CaptureSubject, read_subject, write_subject
from capture.read.template import part_of
from capture.template.surface import surface_cloud
from files.whole import whole_folder
from train.rays import Band, Samples, march


def free_subject(sex: str) -> CaptureSubject:
    """The free body as the subject of a capture, without hair."""
    body = builtin_body(sex)
    rest = body.vertices.astype(np.float64)
    canonical = skin_points(rest, body.skin, skin_transforms(BIG_POSE, body.joints, rest=np.zeros((52, 3))))
    part, hair = part_of(body.skin).astype(np.int64), np.zeros(len(rest), bool)
    return CaptureSubject("test", rest, canonical, body.faces.astype(np.int64), body.skin, body.joints, part, hair)


def write_capture(out: Path, *, size: int = 48, frames: int = 4) -> Path:
    """A capture folder of `frames` frames per part, `size` pixels square."""
    with whole_folder(out) as folder:
        write_subject(folder / "subject.npz", free_subject("male"))
        subject = read_subject(folder / "subject.npz", "test")
        cloud = surface_cloud(subject, 0, np.ones(len(subject.faces), bool), 0.02, 0.02)
        for index, name in enumerate(PARTS):
            _write_video(folder / name, subject, cloud, index, size, frames)
        facts = {"format": "selfscan-capture", "version": 1, "subject": "test", "units": "metres",
                 "parts": list(PARTS), "light": "even", "seed": 0, "size": size,
                 "body_licence": "a licence of the body's own"}  # fmt: skip
        (folder / "capture.json").write_text(json.dumps(facts))
    return out


def _write_video(folder: Path, subject, cloud, index: int, size: int, frames: int) -> None:
    (folder / "images").mkdir(parents=True)
    (folder / "masks").mkdir()
    middle = subject.rest[subject.part == index].mean(0) if index else np.zeros(3)
    distance = 3.5 if index == 0 else 0.8 if index == 1 else 0.6
    K = pinhole((size, size), np.radians(35))
    cameras, poses = [], np.zeros((frames, 156))
    for frame in range(frames):
        turn = 2 * np.pi * frame / frames
        poses[frame, 1] = turn  # the root turns about y; the camera stands still
        B = skin_transforms(poses[frame].reshape(52, 3), subject.joints, np.zeros(3))
        target = matrix_from_axis_angle(np.array([0, turn, 0])) @ middle
        camera = Camera(K, look_at(target + [0, 0.1, distance], target), (size, size))
        origins, directions = pixel_rays(camera)
        points, normals = skin_points(cloud.points, cloud.skin, B), skin_normals(cloud.normals, cloud.skin, B)
        ray, _, s, sample = march(origins, directions, Samples(points, normals, cloud.gap), Band(0.03, 0.02, 0.005))
        image = np.zeros((size * size, 3))
        inside = np.flatnonzero(s < 0)[::-1]  # the first step inside is written last
        image[ray[inside]] = 0.5 + 0.4 * np.sin(20 * cloud.points[sample[inside]])
        mask = np.zeros(size * size, np.uint8)
        mask[ray[inside]] = 255
        Image.fromarray((image * 255).astype(np.uint8).reshape(size, size, 3)).save(folder / f"images/{frame:06d}.png")
        Image.fromarray(mask.reshape(size, size)).save(folder / f"masks/{frame:06d}.png")
        if index == 1:  # rigid: the camera goes round a still head, in a frame of its own
            world = np.eye(4)
            world[:3, :3] = matrix_from_axis_angle(np.array([0, turn, 0]))
            camera = Camera(K, _scaled(camera.camera_from_world @ world), (size, size))
        cameras.append(camera)
    write_cameras(folder / "cameras.npz", cameras)
    if index == 1:
        chosen = np.flatnonzero(subject.part == 1)[::200][:12]
        points = {f"p{i:02d}": (2.0 * subject.vertices[v]).tolist() for i, v in enumerate(chosen)}
        vertices = {f"p{i:02d}": int(v) for i, v in enumerate(chosen)}
        (folder / "landmarks.json").write_text(json.dumps({"points": points, "vertices": vertices}))
    else:
        np.savez(folder / "poses.npz", poses=poses, trans=np.zeros((frames, 3)))


def _scaled(camera_from_world: np.ndarray) -> np.ndarray:
    """The same camera in a frame whose unit is half a metre."""
    out = camera_from_world.copy()
    out[:3, 3] *= 2.0
    return out


FORWARD = np.array([0.0, 0.0, 1.0])


def paint(points: np.ndarray, centre: np.ndarray, radius: float) -> np.ndarray:
    """A dark iris with spokes and a white round it, by place on the eye."""
    x, y = (points[..., :2] - centre[:2]).T / radius
    iris = np.hypot(x, y) < np.sin(np.radians(25))
    spokes = 0.35 + 0.3 * np.sin(5 * np.arctan2(y, x))
    white = 0.85 + 0.1 * np.sin(25 * x)
    return np.where(iris, spokes, white).T[..., None] * np.array([1.0, 0.8, 0.9])


def traced(camera: Camera, centre: np.ndarray, radius: float, angle: float) -> tuple[np.ndarray, np.ndarray]:
    """Of each pixel the way to an eye that is cut at `angle` (0: a ball), infinite beside it, and its color there."""
    origins, directions = pixel_rays(camera)
    away = origins - centre
    b = (away * directions).sum(1)
    root = b**2 - (away**2).sum(1) + radius**2
    ball = -b - np.sqrt(np.maximum(root, 0))
    plane = (radius * np.cos(angle) - away @ FORWARD) / (directions @ FORWARD)
    # the cut ball is where both are: a ray enters it where it has entered both
    enters = np.maximum(ball, plane) if angle else ball
    return np.where(root > 0, enters, np.inf), paint(origins + enters[:, None] * directions, centre, radius)


def filmed(
    centres: Sequence[np.ndarray], radii: Sequence[float], angle: float, *, size: int = 96, focal: float = 8.0
) -> list[tuple[Camera, np.ndarray]]:
    """Eyes cut at `angle` on a black ground, from eleven sides; `focal` in widths of a picture."""
    K = np.array([[focal * size, 0, size / 2], [0, focal * size, size / 2], [0, 0, 1]])
    middle, views = np.mean(centres, axis=0), []
    for side in np.radians(np.linspace(-50, 50, 11)):
        eye = middle + 0.25 * np.array([np.sin(side), 0.1, np.cos(side)])
        camera = Camera(K, look_at(eye, middle), (size, size))
        color, nearest = np.zeros((size * size, 3)), np.full(size * size, np.inf)
        for centre, radius in zip(centres, radii, strict=True):
            length, own = traced(camera, centre, radius, angle)
            color = np.where((length < nearest)[:, None], own, color)
            nearest = np.minimum(nearest, length)
        views.append((camera, np.round(255 * color.reshape(size, size, 3)).astype(np.uint8)))
    return views
