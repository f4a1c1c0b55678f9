"""The whole path, small and real: film the built-in person, train, bake, render, evaluate. Minutes, not seconds."""

import json
from pathlib import Path

import numpy as np
import pytest

from avatar.gltf.avatar_file import read_avatar
from bench.score.view_modes import decibels_by_region, mode_errors
from capture.held_out import read_held_out, some_poses
from selfscan.__main__ import main

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def out(tmp_path_factory) -> Path:
    """A capture, a run and an avatar of the built-in person, made by the commands themselves."""
    out = tmp_path_factory.mktemp("whole")
    assert main(["synth", "builtin", str(out / "capture"), "--size", "128", "--frames", "16", "--seed", "1"]) == 0
    assert main(["train", str(out / "capture"), "-o", str(out / "run"), "--iterations", "150"]) == 0
    sizes = ["--faces", "12000", "--texture", "1024"]
    assert main(["bake", str(out / "run"), "-o", str(out / "a.glb"), *sizes, "--texture-from", "field"]) == 0
    assert main(["bake", str(out / "run"), "-o", str(out / "videos.glb"), *sizes]) == 0
    return out


def test_textures_from_the_videos_are_nearer_to_the_true_pictures(out, context):
    """The bake found the capture by what the run says of it; geometry is the same, held-out pictures judge."""
    avatars = {name: read_avatar(out / f"{name}.glb") for name in ("a", "videos")}
    facts = avatars["videos"].provenance["baked"]
    assert facts["texture_from"] == "videos" and facts["videos"]["hand_left"]["pixels"] > 1000
    against, same = facts["against_field"], avatars["a"].provenance["baked"]["against_field"]
    # beside the videos' textures the field's picture has half the texels a side
    assert same["paper_db"] - 3 < against["paper_db"] < same["paper_db"] + 0.1
    assert np.array_equal(avatars["a"].levels[0].positions, avatars["videos"].levels[0].positions)
    views = some_poses(read_held_out(out / "capture", "novel_view"), 3)
    field, videos = (
        decibels_by_region(mode_errors(context, avatar, views, ["off"])["off"]) for avatar in avatars.values()
    )
    assert videos["total"] > field["total"] + 1 and videos["hands"] > field["hands"] + 1


def test_the_avatar_is_whole(out):
    avatar = read_avatar(out / "a.glb")
    assert len(avatar.levels[0].faces) <= 12_500
    capture = json.loads((out / "capture" / "capture.json").read_text())
    assert "CC0" in capture["body_licence"]
    for name in ("body_licence", "subject_licence"):
        assert avatar.provenance[name] == capture[name]


def test_the_avatar_is_near_the_person_it_was_filmed_from(out):
    """Held-out poses, few steps, 128 px: far from the demo's numbers, near enough that a broken stage shows."""
    assert main(["eval", str(out / "run"), str(out / "capture"), "--poses", "4", "--json", str(out / "run.json")]) == 0
    scores = json.loads((out / "run.json").read_text())["novel_pose"]
    assert scores["total"]["p2s_cm"] < 0.8
    assert scores["hands"]["p2s_cm"] < 0.5
    assert scores["head"]["p2s_cm"] < 0.6
    assert scores["total"]["psnr_db"] > 20
    assert scores["head"]["psnr_db"] > 16


def test_baking_kept_what_the_field_shows(out):
    words = ["--run", str(out / "run"), "--poses", "4", "--json", str(out / "avatar.json")]
    assert main(["eval", str(out / "a.glb"), str(out / "capture"), *words]) == 0
    scores = json.loads((out / "avatar.json").read_text())
    assert scores["baked_vs_field"]["paper_db"] > 30
    assert scores["view_modes"]["default"] in scores["view_modes"]["psnr_db"]["novel_pose"]
    assert scores["novel_pose"]["total"]["psnr_db"] > 19.5


def test_the_run_says_how_flat_irises_were_found(out):
    facts = json.loads((out / "run" / "run.json").read_text())["iris"]
    assert 0 <= facts["depth_mm"] < 4 and facts["residual_best"] <= facts["residual_round"]


def test_a_film_has_every_frame_and_moves(out):
    av = pytest.importorskip("av")
    film = out / "film.mp4"
    words = ["--motion", "counting", "--frames", "60:90", "--size", "320x320", "-o", str(film)]
    assert main(["render", str(out / "a.glb"), *words]) == 0
    with av.open(str(film)) as container:
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    assert len(frames) == 30 and frames[0].shape == (320, 320, 3)
    moved = np.abs(frames[0].astype(int) - frames[-1]).max(-1) > 40
    assert 0.001 < moved.mean() < 0.3
    assert (frames[0].max(-1) > 30).mean() > 0.04  # someone is in the picture
