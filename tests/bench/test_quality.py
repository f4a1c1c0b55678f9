"""The evaluation against a case whose answer is known: the subject's own mesh as the avatar."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from refusals import refused
from scipy.ndimage import distance_transform_cdt

from avatar.camera import Camera, look_at, pinhole, pixel_rays
from avatar.gltf.avatar_file import read_avatar
from bench.eval_command import eval_main
from bench.score.picture_scores import box_pixels, is_t_pose, region_of
from bench.score.quality import evaluate
from bench.score.true_mesh import read_true_mesh
from capture.held_out import read_held_out
from command.errors import AssetError
from experiments.ceiling import ceiling_surface
from experiments.quality_page import people_table
from experiments.view_modes import better_mode, view_modes

KEYS = {"p2s_cm", "back_cm", "back_95_cm", "chamfer_cm", "f_5mm", "f_1cm", "psnr_db", "ssim", "flip", "lpips"}


@pytest.fixture(scope="session")
def result(oracle):
    capture, avatar, _ = oracle
    return evaluate(avatar, capture)


@pytest.mark.parametrize("region", ["head", "left_hand", "right_hand", "hands", "total"])
def test_a_perfect_avatar_has_no_distance_and_near_perfect_pictures(result, region):
    novel = result["novel_pose"][region]
    assert novel.keys() >= KEYS
    # weights are rounded to bytes; a face at the edge of sight may count as seen on one side only
    assert novel["p2s_cm"] < 0.03 and novel["chamfer_cm"] < 0.03
    assert novel["psnr_db"] > 30 and novel["ssim"] > 0.95 and novel["flip"] < 0.05
    assert novel["lpips"] is None and "weights" in novel["reasons"]["lpips"]


def test_a_perfect_avatar_has_true_outlines_its_own_weights_and_t_pose_frames_apart(result):
    assert result["beside"]["poses"] == 1
    assert result["beside"]["t_pose_frames"]["total"]["psnr_db"] > 30
    assert result["novel_view"]["total"]["psnr_db"] > 30
    for name in ("novel_pose", "novel_view"):
        assert 0.97 < result[name]["total"]["outline_worst"] <= result[name]["total"]["outline_iou"]
        assert result[name]["head"]["outline_iou"] is None  # of whole people alone
    for region in ("head", "hands", "total"):
        scores = result["beside"]["t_pose"][region]
        assert 0.97 < scores["outline_worst"] <= scores["outline_iou"]
    assert result["beside"]["own_weights"]["total"]["chamfer_cm"] < 0.03
    assert result["baked_vs_field"] == {"paper_db": 40.0, "network_db": None}


def test_a_perfect_template_has_no_ceiling(oracle):
    capture, _, _ = oracle
    truth = read_true_mesh(capture)
    view = read_held_out(capture, "novel_pose")[0]
    apart = ceiling_surface(capture, truth).posed(view.axis_angle, view.root) - truth.posed(view.axis_angle, view.root)
    outside = np.unique(truth.faces[truth.visible])
    assert np.quantile(np.linalg.norm(apart[outside], axis=1), 0.95) < 5e-4  # metres; the rest are lips and eyelids


def test_a_view_mode_farther_from_the_truth_loses(oracle):
    """The same avatar with matrices that brighten the side: worse beside true pictures that show no such thing."""
    capture, path, _ = oracle
    avatar = read_avatar(path)
    level = avatar.levels[0]
    level = replace(level, view_seen=np.ones_like(level.view_seen), features=np.full((4, 4, 4), 255, np.uint8))
    tinted = replace(avatar, levels=(level,), linear=np.full((4, 3, 3), 0.1, np.float32), default_view="linear")
    found = view_modes(tinted, {name: read_held_out(capture, name) for name in ("novel_pose", "novel_view")})
    assert (found["default"], found["best"]) == ("linear", "off")
    for name in ("novel_pose", "novel_view"):
        scores = found["psnr_db"][name]
        assert scores.keys() == {"off", "vertex", "linear"}
        assert scores["linear"]["total"] < scores["off"]["total"] - 3
        assert abs(scores["vertex"]["total"] - scores["linear"]["total"]) < 1  # linear is smooth across triangles
        assert scores["off"]["total"] > 30 and scores["off"]["head"] > 30
    assert found["reason"].startswith("nearest to the true pictures: off")


@pytest.mark.parametrize(
    "scores, mode",
    [
        ({"off": 24.0, "network": 24.004}, "off"),  # nobody can tell them apart: the simpler one
        ({"off": 24.0, "network": 24.02}, "network"),
        ({"off": 24.0, "linear": 24.5, "network": 24.503, "vertex": 30.0}, "linear"),
        ({"off": 24.3, "linear": 24.0, "network": 23.9}, "off"),
        ({"off": None}, "off"),
    ],
)
def test_the_best_mode_wins_and_a_simpler_one_ties(scores, mode):
    assert better_mode(scores)[0] == mode


def test_the_command_prints_a_table_and_writes_json(oracle, tmp_path, capsys, result, monkeypatch):
    capture, avatar, _ = oracle
    monkeypatch.setattr("bench.score.quality.evaluate", lambda *_, **__: result)
    assert eval_main([str(avatar), str(capture), "--json", str(tmp_path / "q.json")]) == 0
    printed = capsys.readouterr().out
    assert "input: given" in printed
    head, total = (next(line for line in printed.splitlines() if key in line) for key in ("FLIP", "novel pose: total"))
    # numbers end where their headings do
    assert total[: head.index("FLIP") + 4].endswith(f" {result['novel_pose']['total']['flip']:.3f}")
    assert json.loads((tmp_path / "q.json").read_text())["novel_pose"]["total"] == result["novel_pose"]["total"]


def test_people_of_different_lights_are_in_sections_of_their_own_and_never_averaged(result):
    def person(light, psnr, **facts):
        numbers = {"p2s_cm": 0.1, "chamfer_cm": 0.1, "psnr_db": psnr, "psnr_mask_db": psnr - 4}
        scores = dict.fromkeys(("head", "hands", "total"), numbers)
        return {"capture": {"subject": light, "light": light, **facts}, "novel_pose": scores, "beside": {}}

    text = people_table([person("fixed", 20.0), person("even", 30.0, sheen=0.5), person("even", 27.0),
                         person("even", 28.0), person("even", 24.0, pose_noise_deg=2.0)])  # fmt: skip
    titles = [line for line in text.splitlines() if line.startswith("## ")]
    assert titles == ["## Even light", "## Even light, pose noise 2 degrees", "## Even light, sheen 0.5",
                      "## Fixed light"]  # fmt: skip
    means = [line for line in text.splitlines() if line.startswith("| **mean**")]
    assert [float(line.split("|")[4]) for line in means[::3]] == [27.5, 24.0, 30.0, 20.0]
    assert [float(line.split("|")[5]) for line in means[::3]] == [23.5, 20.0, 26.0, 16.0]


def test_kinds_of_input_are_in_sections_of_their_own_and_the_paper_beside_what_was_estimated():
    def person(psnr, **kind):
        scores = {key: {"p2s_cm": 0.1, "chamfer_cm": 0.1, "psnr_db": psnr} for key in ("head", "hands", "total")}
        return {"capture": {"subject": "she", "light": "room"}, "novel_pose": scores, "beside": {}, **kind}

    text = people_table([person(30.0), person(20.0, input="from pixels"), person(24.0, input="given")])
    given, pixels = text[text.index("## Room light") :].split("## Room light, from pixels")
    assert "| **mean** | 0.10 | 0.10 | 27.00 |" in given and "paper" not in given
    assert "| **mean** | 0.10 | 0.10 | 20.00 |" in pixels
    assert "| paper (SynTotalHuman; crops unknown) | 1.84 |" in pixels


def test_box_pixels_are_those_of_the_projected_box():
    camera = Camera(pinhole((64, 48), 0.8), look_at((0.3, 0.2, 3.0), (0, 0, 0)), (64, 48))
    low, high = np.array([-0.4, -0.3, -0.2]), np.array([0.5, 0.35, 0.25])
    inside = box_pixels(camera, low, high)
    origins, directions = pixel_rays(camera)
    t = np.linspace(1.5, 4.5, 3001)
    marched = np.zeros(len(origins), bool)
    for start in range(0, len(origins), 512):
        points = origins[start : start + 512, None] + t[None, :, None] * directions[start : start + 512, None]
        marched[start : start + 512] = ((points >= low) & (points <= high)).all(-1).any(-1)
    differing = inside.ravel() != marched
    assert differing.sum() <= 3  # rays that graze an edge for less than a marching step


def test_a_part_is_compared_within_five_pixels_of_its_mask_and_only_the_t_pose_counts_as_one(oracle):
    capture, _, _ = oracle
    view = next(v for v in read_held_out(capture, "novel_pose") if v.view == "hand_left")
    mask, around = region_of(view, "left_hand")
    assert mask.any() and not around.all()
    np.testing.assert_array_equal(around, np.asarray(distance_transform_cdt(~mask, "chessboard")) <= 5)
    views = read_held_out(oracle[0], "novel_pose")
    assert [is_t_pose(v) for v in views if v.view == "body"] == [False, True]


def test_a_capture_without_truth_and_a_field_of_the_wrong_shape_are_refused_by_name(oracle, tmp_path):
    capture, avatar, _ = oracle
    (tmp_path / "capture.json").write_text((capture / "capture.json").read_text())
    refused(AssetError, r"truth/rest\.npz", eval_main, [str(avatar), str(tmp_path)])
    refused(AssetError, r"nothing\.glb", eval_main, [str(tmp_path / "nothing.glb"), str(capture)])
    shutil.copytree(oracle[0] / "truth", tmp_path / "truth")
    path = tmp_path / "truth" / "rest.npz"
    with np.load(path) as data:
        fields = dict(data)
    fields["part"] = fields["part"][:-1]
    np.savez(path, **fields)
    refused(AssetError, "part should be", read_true_mesh, tmp_path)
