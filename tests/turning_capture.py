"""A capture that is exactly what its template says."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from painted_capture import write_capture

from avatar.camera import Camera, look_at, pinhole
from avatar.skeleton import BIG_POSE, PARTS
from capture.check.silhouette import posed_template
from capture.folder import Capture, read_capture
from geometry.rasterise import rasterise

TURN = 12  # frames of each video


def with_video(capture: Capture, part: str, **changes) -> Capture:
    """The capture with fields of one video changed."""
    return replace(capture, videos={**capture.videos, part: replace(capture.videos[part], **changes)})


def turning_capture(folder: Path) -> Capture:
    """A still person, cameras going round each part, and the template, painted, as picture and mask."""
    found = read_capture(write_capture(folder, size=16, frames=1))
    subject = found.subject
    K, size = pinhole((64, 64), np.radians(35)), (64, 64)
    for index, part in enumerate(PARTS):
        middle = subject.vertices[subject.part == index].mean(0) * (2 if part == "head" else 1)
        far = {"body": 3.3, "head": 1.4}.get(part, 0.5)
        cameras = []
        for turn in 2 * np.pi * (np.arange(TURN) + 0.5) / TURN:
            across = [0, np.sin(turn), np.cos(turn)] if part.startswith("hand") else [np.sin(turn), 0.1, np.cos(turn)]
            cameras.append(Camera(K, look_at(middle + far * np.array(across), middle, (1, 2, 0)), size))
        pose = {"axis_angle": np.tile(BIG_POSE, (TURN, 1, 1)), "root": np.tile(subject.joints[0], (TURN, 1))}
        blank = np.zeros((TURN, 64, 64), bool)
        found = with_video(
            found,
            part,
            cameras=tuple(cameras),
            masks=blank,
            images=np.zeros((TURN, 64, 64, 3), np.uint8),
            **(pose if part != "head" else {}),
        )
        masks, images = [], []
        vertices = posed_template(found, part, 0)
        for frame in range(TURN):
            drawn = rasterise(vertices, subject.faces, cameras[frame])
            masks.append(drawn.face >= 0)
            paint = 0.5 + 0.4 * np.sin(30 * subject.vertices[subject.faces[drawn.face, 0]] + frame)
            images.append(np.uint8(255 * paint * masks[-1][..., None]))
        found = with_video(found, part, masks=np.stack(masks), images=np.stack(images))
    return found
