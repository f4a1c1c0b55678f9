"""The single network that the four parts stand against."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from tiny import tiny_training

from capture.fit.refine import with_refined
from capture.folder import read_capture
from command.errors import AssetError
from experiments import single
from experiments.variants import seam_steps
from train import run as run_folder
from train.preset import DEMO
from train.template_grid import TemplateGrid


@pytest.fixture(scope="module")
def capture(tiny_capture):
    return read_capture(tiny_capture)


def trained(capture, out, *options):
    """The run of a single network with these options."""
    return run_folder.read_run(tiny_training(capture.path, out, *options, command=single.main))


@pytest.mark.slow
def test_a_single_network_has_the_parameters_rays_steps_and_head_of_the_four_parts(
    capture, tiny_run, tmp_path, monkeypatch
):
    # a place that only this run has
    own_run = Path(shutil.copytree(tiny_run, tmp_path / "own"))
    facts = json.loads((own_run / "run.json").read_text())
    place = np.linalg.inv(facts["head_from_canonical"])
    place[:3, 3] += [0.001, 0.002, -0.003]
    facts["head_from_canonical"] = np.linalg.inv(place).tolist()
    (own_run / "run.json").write_text(json.dumps(facts))
    given, rays_of = [], single.single_rays
    remembered = lambda job, *rest: given.append(job.canonical_from_head) or rays_of(job, *rest)
    monkeypatch.setattr(single, "single_rays", remembered)
    run = trained(capture, tmp_path / "run", "--head-from", str(own_run))
    np.testing.assert_allclose(given[0], place, atol=1e-12)
    np.testing.assert_allclose(np.linalg.inv(run.provenance["head_from_canonical"]), place, atol=1e-12)
    assert np.array_equal(run.provenance["canonical_from_head_field"], np.eye(4))
    with pytest.raises(AssetError, match="is a single network; --head-from needs a run of four parts"):
        trained(capture, tmp_path / "again", "--head-from", str(run.path))
    assert len(run.field.fields) == 1 and run.provenance["parts"]["single"]["steps"] == 4 * 6
    field = run.field.field(0)
    assert len(field.appearance.weight) == sum(len(video.images) for video in capture.videos.values())
    body = field.appearance.weight[: len(capture.videos["body"].images)].mean(0)
    torch.testing.assert_close(field.reference, body)
    # the same vertices have hands and a head, with their own videos' view statistics
    assert set(np.unique(run.surface.part)) == {0, 1, 2, 3}
    assert all((run.surface.view_count[run.surface.part == part] > 0).mean() > 0.4 for part in range(4))
    points = torch.as_tensor(run.surface.vertices, dtype=torch.float32)
    assert run.field.distance(points).abs().quantile(0.95) < 0.003
    assert seam_steps(run) == {}


@pytest.mark.slow
def test_a_single_network_without_a_run_of_ours_has_body_and_head_placed_first(capture, tmp_path):
    run = trained(capture, tmp_path / "run", "--refine-poses", "on")
    registration = run.provenance["registration"]
    assert registration["from"] == "body and head trained for it"
    assert "moved_mm" in registration["video"] or registration["video"]["kept"] == "surfaces"
    assert set(run.provenance["parts"]) == {"single"} and len(run.field.fields) == 1
    # the poses that the body learned for the placement are not the single network's
    assert "poses_learned_deg" not in run.provenance["parts"]["single"]
    aligned = with_refined(capture, run.path).videos["body"].axis_angle
    assert np.abs(aligned - capture.videos["body"].axis_angle).max() > 1e-4


def test_the_demo_single_network_has_as_many_parameters_as_the_parts_together(capture):
    template = TemplateGrid(torch.zeros(2, 2, 2), torch.zeros(3), 1.0)
    count = lambda index, part, frames: sum(
        p.numel() for p in run_folder.build_field(capture.subject, index, part, template, frames).parameters()
    )
    parts = sum(count(index, part, 40) for index, part in enumerate(DEMO.parts))
    alone = count(0, single.single_part(DEMO), 160)
    assert abs(alone / parts - 1) < 0.02
