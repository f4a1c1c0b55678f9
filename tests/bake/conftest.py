from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from capsules import make_run
from filmed_part import FoundVideos
from scipy.ndimage import gaussian_filter

from avatar.camera import Camera, orbit_camera
from avatar.skeleton import PARTS
from bake.bake import BakeOptions
from capture.folder import PartVideo
from player.scene.mannequin import mannequin
from player.scene.renderer import Renderer

# of the mannequin's pictures
SIZE = (96, 96)


@pytest.fixture(scope="session")
def sheen_run():
    return make_run(sheen=0.5)


@pytest.fixture(scope="session")
def small():
    """Everything the real bake does, at a size for tests."""
    return BakeOptions(faces=2000, texture=256, body_step=0.012, fine_step=0.006, samples=6000, steps=150, image=128)


@pytest.fixture(scope="module")
def painted():
    """The mannequin with colors that vary over centimetres."""
    avatar = mannequin()
    noise = np.random.default_rng(0).normal(size=(256, 256, 3))
    smooth = gaussian_filter(noise, (3, 3, 0), mode="wrap")
    image = np.clip(0.5 + 0.2 * smooth / smooth.std(), 0, 1)
    level = replace(avatar.levels[0], base_color=np.uint8(255 * image))
    return replace(avatar, levels=(level,), network=None, linear=None, default_view="off")


@pytest.fixture(scope="module")
def videos(context, painted):
    """Turning videos of the body and of the head, which is filmed in a frame of its own, twice as large."""
    renderer = Renderer(context, [painted], SIZE, view="off")
    found = {}
    head_from_canonical = np.diag([2.0, 2.0, 2.0, 1.0])
    head_from_canonical[:3, 3] = 0.3, -0.2, 0.1
    for part in PARTS:
        cameras, images, masks = [], [], []
        middle, far = ((0, 0.6, 0), 0.8) if part == "head" else ((0, -0.1, 0), 3.2)
        # a head is filmed as it stands in the canonical pose, which is the mannequin's
        pose = np.asarray(painted.canonical_pose, np.float64)
        for turn in 2 * np.pi * np.arange(8) / 8:
            camera = orbit_camera(middle, far, turn, 0.05, SIZE)
            image = renderer.draw([(pose, np.zeros(3))], camera)
            images.append(image[..., :3].copy())
            masks.append(image[..., 3] == 255)
            if part == "head":
                # the same picture from a camera in the head's frame
                view = camera.camera_from_world @ np.linalg.inv(head_from_canonical)
                view[:3] *= 2
                camera = Camera(camera.K, view, SIZE)
            cameras.append(camera)
        posed = part != "head"
        found[part] = PartVideo(
            part, np.stack(images), np.stack(masks), tuple(cameras),
            np.tile(pose, (8, 1, 1)) if posed else None, np.zeros((8, 3)) if posed else None, None, None,
        )  # fmt: skip
    renderer.release()
    return FoundVideos(Path(), None, head_from_canonical, {}, False, None, False, None, found)
