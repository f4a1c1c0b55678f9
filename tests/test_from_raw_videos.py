"""Four raw videos and a height to an avatar, small and real: nothing is given, and all that is made is ours.

The surface is coarse and training short: little more than that no
stage breaks on what the one before it makes of films.
"""

from dataclasses import replace

import numpy as np
import pytest

from avatar.gltf.avatar_file import read_avatar
from avatar.skeleton import JOINTS
from selfscan.__main__ import main
from train.preset import DEMO, PRESETS

pytestmark = pytest.mark.slow

COARSE = replace(
    DEMO, rays_per_frame=2000, warm_up=5, appearance_steps=20, surface_cells=(0.02, 0.01, 0.006),
    union=replace(DEMO.union, iterations=10),
    parts=tuple(replace(part, cell=max(part.cell, 0.006), spacing=max(part.spacing, 0.006)) for part in DEMO.parts),
)  # fmt: skip


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Videos, a capture, a run and an avatar by the commands of the README, with a detector's keypoints."""
    out = tmp_path_factory.mktemp("raw")
    me, patch = out / "me", pytest.MonkeyPatch()
    patch.setitem(PRESETS, "demo", COARSE)
    filming = ["--raw", "--keypoints", "--size", "200", "--seconds", "3", "--light", "fixed", "--no-truth"]
    videos = [str(me / f"{name}.mp4") for name in ("body", "head", "left", "right")]
    try:
        assert main(["synth", "builtin", str(me), *filming]) == 0
        known = ["--keypoints", str(me / "keypoints"), "--stature", "1.8", "--frames", "10"]
        assert main(["import", "video", *videos, *known, "-o", str(out / "capture")]) == 0
        assert main(["train", str(out / "capture"), "-o", str(out / "run"), "--iterations", "20"]) == 0
        sizes = ["--faces", "6000", "--texture", "512"]
        assert main(["bake", str(out / "run"), "-o", str(out / "me.glb"), *sizes]) == 0
    finally:
        patch.undo()
    return out


def test_the_avatar_is_as_tall_as_was_told_and_colored(made):
    avatar = read_avatar(made / "me.glb")
    assert avatar.joint_positions.shape == (len(JOINTS), 3)
    assert np.ptp(avatar.levels[0].positions[:, 1]) == pytest.approx(1.8, abs=0.15)
    assert avatar.levels[0].base_color.reshape(-1, 3).std(0).min() > 5


def test_no_licence_but_our_own_is_on_it(made):
    provenance = read_avatar(made / "me.glb").provenance
    assert "CC0" in provenance["body_licence"]
