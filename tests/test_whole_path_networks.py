"""A tiny run of each preset's networks through every command that reads it: bake, eval and inspect. About a minute."""

import json
import shutil

import pytest
from striped_oracle import oracle, small_pictures
from tiny import tiny, tiny_training

from avatar.gltf.avatar_file import read_avatar
from selfscan.__main__ import main
from train.networks.hash import HashNetworks
from train.networks.paper import PaperNetworks
from train.preset import FAST, PAPER
from train.run import read_run

pytestmark = pytest.mark.slow

__all__ = ["oracle", "small_pictures"]


PAPER_NETWORKS = PaperNetworks(
    width=32, geometry_layers=4, color_layers=2, displacement_layers=4, feature=8, appearance=8, displacement=8
)
TINY = {
    "fast": tiny(FAST, HashNetworks(cell=0.01, levels=4, rows=2**10, width=16, feature=7)),
    "paper": tiny(PAPER, networks=PAPER_NETWORKS, prefit=150, sections=12, shaded=12),
}


@pytest.mark.parametrize("name", TINY)
def test_a_run_of_these_networks_is_composed_baked_evaluated_and_inspected(name, oracle, tiny_capture, tmp_path):
    capture, run, avatar = tmp_path / "person", tmp_path / "run", tmp_path / "a.glb"
    shutil.copytree(tiny_capture, capture)
    shutil.copytree(oracle[0] / "truth", capture / "truth")
    tiny_training(capture, run, "--refine-poses", "off", preset=TINY[name])
    assert read_run(run).preset == TINY[name]

    assert main(["bake", str(run), "-o", str(avatar), "--faces", "3000", "--texture", "256"]) == 0
    assert len(read_avatar(avatar).levels[0].faces) > 1000

    for subject in (run, avatar):
        scores = tmp_path / "scores.json"
        assert main(["eval", str(subject), str(capture), "--poses", "1", "--json", str(scores)]) == 0
        total = json.loads(scores.read_text())["novel_pose"]["total"]
        # metres off would be another person; the template is .3 cm from the truth
        assert total["p2s_cm"] < 3 and total["psnr_db"] > 8
    assert main(["inspect", str(avatar), "-o", str(tmp_path / "pages")]) == 0
    assert (tmp_path / "pages" / "inspect.html").stat().st_size > 10_000
