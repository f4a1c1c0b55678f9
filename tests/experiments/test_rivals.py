"""The rivals: sparse convolutions, inverse skinning, learning that goes on, refusals, and what the page says."""

import json
import shutil
import signal

import numpy as np
import pytest
import torch
from refusals import refused
from torch import nn

from capture.folder import read_capture
from command.errors import AssetError
from command.interrupt import Stopped
from experiments.rivals.aninerf import unposed
from experiments.rivals.density import DensityField, Frame, Sections, filmed_parts
from experiments.rivals.learning import Budget, Learning
from experiments.rivals.neuralbody import _OFFSETS, SparseConvolution, Volume, sites_at
from experiments.rivals.page import TITLES, first_sentence, sign_test
from train.run import RIVAL, read_facts


def test_a_sparse_convolution_is_the_dense_one_at_its_sites_and_halves_as_a_stride_of_two():
    torch.manual_seed(0)
    sites = sites_at(torch.rand(7, 6, 8) < 0.15)
    values = torch.randn(len(sites.at), 4)
    layer = SparseConvolution(4, 5)
    layer.norm = nn.Identity()
    dense = torch.zeros(1, 4, 7, 6, 8)
    dense[0, :, sites.at[:, 0], sites.at[:, 1], sites.at[:, 2]] = values.T
    kernel = layer.weight.weight.view(5, 3, 3, 3, 4).permute(0, 4, 1, 2, 3)
    for stride, own in ((1, sites), (2, sites.coarser())):
        expected = torch.relu(nn.functional.conv3d(dense, kernel, stride=stride, padding=1))[0]
        found = layer(values, sites.numbers(stride * own.at[:, None] + _OFFSETS))
        there = (own.at < torch.tensor(expected.shape[1:])).all(1)
        x, y, z = own.at[there].T
        torch.testing.assert_close(found[there], expected[:, x, y, z].T, atol=1e-5, rtol=0)
        # nothing is lost: beyond the sites a convolution of the coarser level sees nothing
        if stride == 2:
            expected[:, x, y, z] = 0
            assert not expected.any()


def test_a_volume_is_trilinear_between_its_sites_and_nothing_elsewhere():
    sites = sites_at(torch.ones(3, 3, 3, dtype=torch.bool))
    volume = Volume(sites, sites.at.float() @ torch.tensor([[1.0], [10.0], [100.0]]), 0.02)
    points = torch.tensor([[0.01, 0.03, 0.005], [0.5, 0.5, 0.5], [-0.5, 0.0, 0.0]])
    torch.testing.assert_close(volume.at(points)[:, 0], torch.tensor([0.5 + 15 + 25, 0.0, 0.0]))


def test_unposing_is_the_inverse_of_the_blended_transform():
    torch.manual_seed(0)
    M = torch.cat([torch.eye(3) + 0.3 * torch.randn(20, 3, 3), torch.randn(20, 3, 1)], -1)
    points = torch.randn(20, 3)
    back, inverse = unposed((M[:, :, :3] @ points[:, :, None])[..., 0] + M[:, :, 3], M)
    torch.testing.assert_close(back, points, atol=2e-4, rtol=0)
    torch.testing.assert_close(inverse @ M[:, :, :3], torch.eye(3).expand(20, 3, 3), atol=2e-4, rtol=0)


class Fog(DensityField):
    """One density and one color."""

    def __init__(self):
        super().__init__()
        self.raw = nn.Parameter(torch.zeros(4))

    def sections(self, points, frame: Frame) -> Sections:
        shape = points.shape[:2]
        return Sections(100 * self.raw[0].exp().expand(shape), self.raw[1:].sigmoid().expand(*shape, 3))


def foggy(rays: int = 200) -> Frame:
    """Rays of a red square, half of which miss it."""
    ends = torch.zeros(rays, 6, 3)
    ends[..., 2] = torch.linspace(0, 0.05, 6)
    mask = (torch.arange(rays) % 2).float()
    near = mask[:, None].bool().expand(rays, 6)
    color = mask[:, None] * torch.tensor([1.0, 0.2, 0.1])
    return Frame(ends, torch.zeros(rays, 6).long(), near, ends[:, 0], torch.zeros(52, 3, 4), 0, color, mask)


def test_learning_that_a_signal_stopped_goes_on_as_if_it_never_was(tmp_path):
    budget, frames, kept = Budget(steps=60, rays=32, rate=0.1), [foggy()], tmp_path / "fog.ckpt"
    whole, stopped, again = (Learning(Fog(), frames, budget) for _ in range(3))
    whole.go_on("whole", None)
    step = stopped.step

    def asked_to_stop() -> float:
        if stopped.at.iteration == 20:
            signal.raise_signal(signal.SIGTERM)
        return step()

    stopped.step = asked_to_stop
    with pytest.raises(Stopped):
        stopped.go_on("stopped", kept)
    assert stopped.at.iteration == 21
    again.go_on("again", kept)
    assert again.at.iteration == 60 and torch.equal(again.field.raw, whole.field.raw)
    assert whole.step() > 10  # dB, on the square


def test_a_density_is_not_baked_and_hands_may_be_missing_but_not_the_body(tiny_capture, tmp_path):
    (tmp_path / "run.json").write_text(json.dumps({"format": RIVAL, "version": 1, "system": "neuralbody"}))
    refused(AssetError, "is a run of neuralbody, which has no surface and no colors", read_facts, tmp_path)
    capture = shutil.copytree(tiny_capture, tmp_path / "capture")
    for name in ("hand_left", "hand_right"):
        shutil.rmtree(capture / name)
    assert filmed_parts(capture) == ("body", "head")
    assert set(read_capture(capture, parts=filmed_parts(capture)).videos) == {"body", "head"}
    refused(AssetError, "no folder hand_left, hand_right; all four videos are needed", read_capture, capture)
    shutil.rmtree(capture / "body")
    refused(AssetError, "no folder body; a person needs the videos of body and head", filmed_parts, capture)


def row(system: str, person: str, p2s: float, psnr: float) -> dict:
    scores = {"p2s_cm": p2s, "chamfer_cm": p2s, "psnr_db": psnr, "psnr_mask_db": psnr, "ssim": 0.9, "flip": None}
    sets = {name: dict.fromkeys(("head", "hands", "total"), scores) for name in ("novel_pose", "novel_view")}
    return {"system": system, "person": person, "input": "given", "seed": 0, **sets}


def test_the_first_sentence_says_who_wins_over_the_people_that_all_have():
    rows = [row("ours", "a", 1.0, 20.0), row("anisdf", "a", 2.0, 25.0), row("anisdf", "b", 0.1, 1.0)]
    text = first_sentence([*rows, row("ours", "b", 0.2, 2.0)], "given")
    assert text.startswith(f"**Given: {TITLES['ours']} is best in 9 of 15 scores of novel poses; AniSDF in 6 (head ")
    assert sign_test(5, 0) == 2 / 32 and sign_test(3, 3) == 1.0 and np.isclose(sign_test(6, 1), 16 / 128)
