"""View modes beside true pictures."""

import json

import numpy as np
import pytest
from PIL import Image

from avatar.camera import orbit_camera
from bench.score.view_modes import better_mode, mode_errors
from capture.held_out import read_held_out
from player.scene.mannequin import mannequin
from player.scene.renderer import Renderer

SIZE = (96, 96)


def write_truth(context, capture, avatar, view):
    """Two poses and two views of the avatar drawn in one mode, as `selfscan synth` writes the truth."""
    facts = {"format": "selfscan-capture", "version": 1, "subject": "mannequin", "light": "even", "sheen": 0.5}
    capture.mkdir()
    (capture / "capture.json").write_text(json.dumps(facts))
    renderer = Renderer(context, [avatar], SIZE, view=view)
    for name in ("novel_pose", "novel_view"):
        folder = capture / "truth" / name
        for kind in ("images", "masks", "parts"):
            (folder / kind).mkdir(parents=True)
        poses, cameras = np.zeros((2, 52, 3)), []
        for index in range(2):
            poses[index, 18 + index] = 0, -0.6, 0
            camera = orbit_camera((0, 0, 0), 2.6, 0.9 * index - 0.4, 0.1, SIZE)
            image = renderer.draw([(poses[index], np.zeros(3))], camera)
            stem = f"{index:06d}_body.png"
            Image.fromarray(np.ascontiguousarray(image[..., :3])).save(folder / "images" / stem)
            Image.fromarray(image[..., 3]).save(folder / "masks" / stem)
            Image.fromarray((image[..., 3] > 0).astype(np.uint8)).save(folder / "parts" / stem)
            cameras.append(camera)
        np.savez(
            folder / "views.npz",
            pose=np.arange(2),
            view=np.array(["body", "body"]),
            poses=poses,
            root=np.zeros((2, 3)),
            K=np.stack([c.K for c in cameras]),
            camera_from_world=np.stack([c.camera_from_world for c in cameras]),
            size=np.array(SIZE),
        )
    renderer.release()


def test_errors_are_those_of_the_pixels_inside_the_person(context, tmp_path):
    avatar = mannequin()
    write_truth(context, tmp_path / "capture", avatar, "off")
    views = read_held_out(tmp_path / "capture", "novel_view")
    image = views[0].folder / "images" / f"{views[0].name}.png"
    pixels = np.asarray(Image.open(image)).astype(int)
    Image.fromarray(np.where(pixels > 127, pixels - 51, pixels + 51).astype(np.uint8)).save(image)  # .2 beside
    found = mode_errors(context, avatar, views[:1], ["off"])["off"]
    assert found["total"].count > 300 and found["head"].count == 0 and found["head"].rounded(1) is None
    assert found["total"].square / found["total"].count == pytest.approx(0.04, rel=1e-4)
    assert found["total"].psnr() == pytest.approx(-20 * np.log10(0.2), abs=1e-3)


@pytest.mark.parametrize(
    "scores, mode",
    [
        ({"off": 24.0, "network": 24.004}, "off"),  # nobody can tell them apart: the simpler one
        ({"off": 24.0, "network": 24.02}, "network"),
        ({"off": 24.0, "linear": 24.5, "network": 24.503, "vertex": 30.0}, "linear"),
        ({"off": 24.3, "linear": 24.0, "network": 23.9}, "off"),
        ({"off": None}, "off"),
    ],
)
def test_the_best_mode_wins_and_a_simpler_one_ties(scores, mode):
    assert better_mode(scores)[0] == mode
