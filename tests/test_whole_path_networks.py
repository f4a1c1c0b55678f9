"""A tiny run of each preset's networks through every command that reads it: bake, eval and inspect. About a minute."""

import json
import shutil
from dataclasses import replace

import pytest
import torch
from painted_capture import write_capture
from striped_oracle import oracle, small_pictures

from avatar.gltf.avatar_file import read_avatar
from selfscan.__main__ import main
from train.networks.hash import HashNetworks
from train.networks.paper import PaperNetworks
from train.preset import FAST, PAPER, PRESETS
from train.run import read_run

__all__ = ["oracle", "small_pictures"]


def tiny(preset, networks, **changes):
    """A preset of small networks and few steps: it shows little more than the template."""
    parts = (replace(p, iterations=6, networks=networks, cell=max(p.cell, 0.006), spacing=max(p.spacing, 0.006))
             for p in preset.parts)  # fmt: skip
    return replace(
        preset, rays=64, rays_per_frame=300, warm_up=5, appearance_steps=5, surface_cells=(0.03, 0.015, 0.008),
        union=replace(preset.union, iterations=6), parts=tuple(parts), **changes,
    )  # fmt: skip


PAPER_NETWORKS = PaperNetworks(
    width=32, geometry_layers=4, color_layers=2, displacement_layers=4, feature=8, appearance=8, displacement=8
)
TINY = {
    "fast": tiny(FAST, HashNetworks(cell=0.01, levels=4, rows=2**10, width=16, feature=7)),
    "paper": tiny(PAPER, PAPER_NETWORKS, prefit=150, sections=12, shaded=12),
}


@pytest.mark.parametrize("name", TINY)
def test_a_run_of_these_networks_is_composed_baked_evaluated_and_inspected(name, oracle, tmp_path, monkeypatch, capsys):
    capture = write_capture(tmp_path / "person")
    shutil.copytree(oracle[0] / "truth", capture / "truth")
    monkeypatch.setitem(PRESETS, name, TINY[name])
    run, avatar, threads = tmp_path / "run", tmp_path / "a.glb", torch.get_num_threads()
    words = ["--preset", name, "--preview", "0", "--refine-poses", "off"]
    with monkeypatch.context() as patch:
        patch.setattr("os.cpu_count", lambda: 1)
        assert main(["train", str(capture), "-o", str(run), *words]) == 0
    torch.set_num_threads(threads)
    assert read_run(run).preset == TINY[name]

    capsys.readouterr()
    assert main(["bake", str(run), "-o", str(avatar), "--faces", "3000", "--texture", "256"]) == 0
    said = capsys.readouterr()
    lines = [line for line in (said.out + said.err).splitlines() if "fields.onnx" in line]
    assert len(lines) == 1 and "only the networks of preset demo can be exported" in lines[0]
    assert not (run / "fields.onnx").exists()
    assert len(read_avatar(avatar).levels[0].faces) > 1000

    for subject in (run, avatar):
        scores = tmp_path / "scores.json"
        assert main(["eval", str(subject), str(capture), "--poses", "1", "--json", str(scores)]) == 0
        total = json.loads(scores.read_text())["novel_pose"]["total"]
        # metres off would be another person; the template is .3 cm from the truth
        assert total["p2s_cm"] < 3 and total["psnr_db"] > 8
    assert main(["inspect", str(avatar), "-o", str(tmp_path / "pages")]) == 0
    assert (tmp_path / "pages" / "inspect.html").stat().st_size > 10_000
