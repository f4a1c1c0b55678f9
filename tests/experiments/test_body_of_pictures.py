"""Pictures, masks and OpenPose's points of a known person become that person again; what does not belong is refused."""

import json

import numpy as np
import pytest
from PIL import Image

from avatar.motion.read import read_motion
from capture.fit import body
from capture.keypoints.openpose import BODY_25
from command.errors import AssetError
from experiments.body_alone import pictures_of_body
from experiments.body_of_pictures import main
from tests.turning_twin import turning_twin

FRAMES, SIZE = 11, 160


@pytest.fixture(scope="module")
def pictures(tmp_path_factory):
    """A folder of grey pictures, masks and BODY_25 points of somebody who turns: 10.png after 9.png."""
    root = tmp_path_factory.mktemp("me")
    truth, footage = turning_twin(FRAMES, SIZE, masks=True)
    for name in ("images", "masks", "points"):
        (root / name).mkdir()
    for i, mask in enumerate(footage.masks):
        Image.fromarray(np.stack([128 - mask // 3] * 3, 2)).save(root / "images" / f"{i}.png")
        Image.fromarray(mask).save(root / "masks" / f"{i}.png")
        rows = np.zeros((len(BODY_25), 3))
        for k, name in enumerate(BODY_25):
            if name in footage.names:
                # of the first pixel's middle, as OpenPose counts
                rows[k] = *(footage.pixels[i, footage.names.index(name)] - 0.5), 0.9
        person = {"pose_keypoints_2d": rows.ravel().tolist()}
        (root / "points" / f"{i}_keypoints.json").write_text(json.dumps({"version": 1.3, "people": [person]}))
    return root, truth


def test_body_alone_is_found_and_written(pictures, tmp_path, monkeypatch):
    root, truth = pictures
    monkeypatch.setattr(body, "WEIGHTS", (0.02,))
    out = tmp_path / "fit"
    where = [str(root / name) for name in ("images", "masks", "points")]
    assert main([*where, "-o", str(out), "--stature", "1.8", "--focal", "200"]) == 0
    facts = json.loads((out / "fit.json").read_text())
    assert facts["left_out"] == [] and facts["stature"] == pytest.approx(1.8, abs=0.03)
    assert facts["distance"] == pytest.approx(3.0, abs=0.15)
    # most of a pixel is noise
    assert facts["keypoints_off_pixels"] < 1.5
    motion = read_motion(out / "poses.npz")
    assert motion.frames == FRAMES
    with Image.open(out / "overlays.png") as sheet:
        assert sheet.width > 1000
    assert {path.name for path in out.iterdir()} >= {"subject.npz", "body.ply"}


def test_folders_of_other_lengths_are_refused(pictures):
    root, _ = pictures
    with pytest.raises(AssetError, match=r"expected 11 masks, one for each picture in .*, found 1"):
        (root / "one").mkdir()
        Image.new("L", (SIZE, SIZE), 255).save(root / "one" / "0.png")
        pictures_of_body(root / "images", root / "one", root / "points")
