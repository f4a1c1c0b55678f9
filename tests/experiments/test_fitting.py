"""The fit against the truth of raw videos and of pictures: what is measured, its table, its masks."""

import json

import numpy as np
import pytest
from PIL import Image

from avatar.motion.read import read_motion
from capture.fit import body
from capture.keypoints.orders import BODY_25
from command.errors import AssetError
from experiments import fitting
from experiments.body_alone import pictures_of_body
from experiments.body_of_pictures import main as fitted_body
from experiments.fitting import NAMED, Filming, main
from tests.turning_twin import turning_twin


def test_a_tiny_row_is_fitted_once_and_lies_near_the_truth(tmp_path, capsys, monkeypatch):
    small = ["--subjects", "builtin", "--seeds", "0", "--sources", "all", "--frames", "8", "--size", "96"]
    assert main([str(tmp_path), *small]) == 0
    (row,) = json.loads((tmp_path / "rows.json").read_text())["rows"]
    assert (row["source"], row["input"], row["frames"], row["size"]) == ("all", "keypoints", 8, 96)
    # eight frames; an estimate that knew nothing is 4 cm off
    assert row["scores"]["joints"] < 2.5 and abs(row["scores"]["scale"] - 1) < 0.02
    assert row["scores"]["p2s"] < row["scores"]["p2s_in_place"] < 4
    assert (tmp_path / "fitting.png").stat().st_size > 2000
    table = capsys.readouterr().out
    assert "| all of these | keypoints | 1 |" in table and "8 frames of 96 px" in table
    monkeypatch.setattr(fitting, "Filming", None)
    assert main([str(tmp_path), *small]) == 0
    assert (tmp_path / "fitting.md").read_text() in capsys.readouterr().out


def test_pictures_of_a_fit_show_where_its_outline_is(tmp_path):
    small = ["--subjects", "builtin", "--seeds", "0", "--sources", "exact", "--frames", "8", "--size", "160"]
    assert main([str(tmp_path), *small]) == 0
    assert main([str(tmp_path), *small, "--pictures"]) == 0
    # a fit that was kept is not counted twice
    assert len(json.loads((tmp_path / "rows.json").read_text())["rows"]) == 1
    sheet = np.asarray(Image.open(tmp_path / "builtin_0_exact.png").convert("RGB")).astype(int)
    r, g, b = sheet[..., 0], sheet[..., 1], sheet[..., 2]
    orange = (r > 200) & (abs(g - 120) < 40) & (b < 60)
    # two stages of four frames: each part of the sheet holds an outline
    height, width = orange.shape
    for down in range(2):
        for across in range(4):
            part = orange[down * height // 2 :, across * width // 4 :][: height // 2, : width // 4]
            assert part.sum() > 100


@pytest.fixture(scope="module")
def masks(rasteriser):
    """Of five frames, by what they are made with; shares of the person."""
    filming = Filming("builtin", rasteriser)
    names = ("exact", "wide_masks", "narrow_masks", "own_masks", "sent_on")
    found = {name: filming.seen(NAMED[name], 0, 5, 270, outlines=True).footage.masks for name in names}
    return {name: np.asarray(one, float) / np.max(one) for name, one in found.items()}


def overlap(a, b):
    return np.minimum(a, b).sum() / np.maximum(a, b).sum()


def test_masks_are_moved_by_as_much_as_is_said_and_those_of_a_film_nearly_the_persons(masks):
    exact = masks["exact"]
    rim = (np.abs(np.diff(exact, axis=2)).sum() + np.abs(np.diff(exact, axis=1)).sum()) * np.pi / 4
    # 2 px of 1080 are half a pixel of 270
    for name, sign in (("wide_masks", 1), ("narrow_masks", -1)):
        assert sign * (masks[name] - exact).sum() == pytest.approx(0.5 * rim, rel=0.35)
    own, sent = (overlap(masks[name], masks["exact"]) for name in ("own_masks", "sent_on"))
    assert own > 0.92 and 0.6 < sent < own


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
    assert fitted_body([*where, "-o", str(out), "--stature", "1.8", "--focal", "200"]) == 0
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
