"""The smallest whole path: four tiny videos, a run of few steps, an avatar and a frame of it."""

import json

import numpy as np
from PIL import Image

from avatar.gltf.avatar_file import read_avatar
from avatar.skeleton import PARTS
from selfscan.__main__ import main
from train.run import read_run


def test_four_videos_become_a_run_an_avatar_and_a_frame(tiny_capture, tiny_run, tiny_avatar_file, tmp_path):
    assert set(json.loads((tiny_run / "run.json").read_text())["parts"]) == set(PARTS)
    assert len(read_run(tiny_run).surface.vertices) > 1000
    avatar = read_avatar(tiny_avatar_file)
    assert 1000 < len(avatar.levels[0].faces) <= 3100
    assert 1.4 < np.ptp(avatar.levels[0].positions[:, 1]) < 2.0
    assert avatar.provenance["baked"]["texture_from"] == "videos"

    words = [str(tiny_avatar_file), "--motion", "walking", "--frame", "40", "--size", "96x96"]
    assert main(["render", *words, "-o", str(tmp_path / "a.png")]) == 0
    with Image.open(tmp_path / "a.png") as picture:
        pixels = np.asarray(picture.convert("RGB")).astype(int)
    assert pixels.shape == (96, 96, 3)
    person = np.abs(pixels - pixels[0, 0]).max(-1) > 20
    # someone stands in the middle, painted in more than one color
    assert 0.03 < person.mean() < 0.4 and person[:, 40:56].mean() > 2 * person.mean()
    assert pixels[person].std(0).min() > 10
