"""The fit against the truth of raw videos: what is measured, its table, and the masks that it is tried with."""

import json

import numpy as np
import pytest
from PIL import Image

from experiments import fitting
from experiments.fitting import NAMED, Filming, main


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


def test_outlines_are_moved_by_as_much_as_is_said(masks):
    exact = masks["exact"]
    rim = (np.abs(np.diff(exact, axis=2)).sum() + np.abs(np.diff(exact, axis=1)).sum()) * np.pi / 4
    # 2 px of 1080 are half a pixel of 270
    for name, sign in (("wide_masks", 1), ("narrow_masks", -1)):
        assert sign * (masks[name] - exact).sum() == pytest.approx(0.5 * rim, rel=0.35)


def test_masks_of_a_film_are_nearly_those_of_the_person_and_worse_when_it_was_sent_on(masks):
    own, sent = (overlap(masks[name], masks["exact"]) for name in ("own_masks", "sent_on"))
    assert own > 0.92 and 0.6 < sent < own
