"""Accuracy against time on the oracle avatar."""

import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from avatar.gltf.avatar_file import read_avatar
from bench.contact import LARGEST, WIDTH, contact_sheet, fitting_font, save_sheet, sheet
from bench.part_boxes import part_boxes
from bench.report import bench_main
from bench.rung_page import label_offsets
from bench.rung_pictures import motion_frames
from bench.rung_scores import flicker, mark_dominated, median_interval
from player.ladder import rungs_of, views_of
from player.mannequin import mannequin
from player.rung import shown, with_halved_textures


def test_bench_writes_json_table_plot_and_pictures(oracle, tmp_path, capsys):
    capture, avatar, _ = oracle
    out = tmp_path / "bench"
    assert bench_main([str(avatar), "--capture", str(capture), "-o", str(out), "--rounds", "2"]) == 0
    result = json.loads((out / "bench.json").read_text())
    assert result["machine"]["renderer"] and result["machine"]["cores"] >= 1
    assert 0 <= result["machine"]["others_cpu_share"] <= 1
    best, *_ = result["rungs"]
    (half,) = (row for row in result["rungs"] if row["name"].endswith("1 joint, quarter resolution"))
    for row in result["rungs"]:
        assert row.keys() >= {"name", "ms_median", "ms_p95", "bytes", "psnr_db", "ssim", "flip", "dominated"}
        low, high = row["ms_interval"]
        assert low <= row["ms_median"] <= high
        assert 0 < row["ms_median"] <= row["ms_p95"] and row["bytes"] > 0
    assert best["times_faster"] == 1
    assert best["psnr_db"] is None and "identical" in best["reasons"]["psnr_db"]
    assert best["flip"] == 0 and best["flicker"] == 0 and half["flicker"] > 0 and half["start_ms"] > 0
    assert half["parts"]["head"]["flip"] > 0 and half["parts"]["hands"]["psnr_db"] < 40
    assert 0 < half["psnr_mask_db"] < half["psnr_db"]
    assert half["psnr_db"] < 35 and half["bytes"] < best["bytes"]
    assert best["against_truth"]["psnr_db"] > half["against_truth"]["psnr_db"]
    # effects are points beside truth, the twisted limbs of dual quaternions at the time of the rung they change
    points = [row["point"] for row in result["effects"]]
    assert points[0]["name"] == f"{best['name']}, dual quaternions" and "head" in points[0]["against_truth"]["parts"]
    assert points[0]["ms_median"] == pytest.approx(best["ms_median"] * result["effects"][0]["times_plain"], rel=0.01)
    assert "dominated" in points[0]["against_truth"] and points[0]["name"] in (out / "bench.html").read_text()
    assert {path.name for path in out.iterdir()} >= {"bench.html", "bench.json", "bench.md", "pareto.png", "rungs.png"}
    assert "half resolution" in capsys.readouterr().out


def test_the_interval_of_a_median_holds_it_19_times_of_20():
    rng = np.random.default_rng(0)
    hits = 0
    for _ in range(2000):
        low, high = median_interval(rng.exponential(size=20))
        hits += low <= np.log(2) <= high
    assert 0.94 < hits / 2000 < 0.98
    assert median_interval(np.array([3.0, 1.0, 2.0])) == (1.0, 3.0)


def test_no_number_of_the_plot_lies_on_a_point_or_on_another():
    places = np.array([[50.0, 50], [51, 50], [52, 51], [50, 53], [120, 50], [54, 48]])
    offsets = np.array(label_offsets(places))
    labels = places + offsets
    for i, label in enumerate(labels):
        assert all((np.abs(label - other) >= [8, 7]).any() for other in places)
        assert all((np.abs(label - other) >= [10, 8]).any() for other in np.delete(labels, i, 0))


def timed(name, low, high, *flips):
    return {"name": name, "ms_interval": [low, high], "flip": float(np.mean(flips)), "flip_each": list(flips)}


def test_a_rung_is_dominated_only_by_one_that_is_surely_faster_and_nowhere_less_exact():
    rows = [
        timed("best", 9, 11, 0.0, 0.0), timed("good", 4, 5, 0.02, 0.03), timed("worse", 6, 7, 0.03, 0.03),
        timed("perhaps slower", 4.5, 6, 0.03, 0.03), timed("better once", 6, 7, 0.01, 0.06),
    ]  # fmt: skip
    mark_dominated(rows)
    assert [row["dominated_by"] for row in rows] == [None, None, "good", None, None]
    assert [row["dominated"] for row in rows] == [False, False, True, False, False]


def test_rungs_that_took_turns_are_compared_round_by_round():
    """Rounds of a shared machine differ by more than the rungs do: medians overlap, ratios do not."""
    load = np.linspace(1, 3, 20)
    rows = [timed("a", 10, 30, 0.01), timed("b", 11, 33, 0.02)]
    mark_dominated(rows)
    assert not rows[1]["dominated"]
    mark_dominated(rows, [10 * load, 11 * load])
    assert rows[1]["dominated_by"] == "a" and not rows[0]["dominated"]


def test_flicker_is_change_that_the_reference_does_not_have():
    rng = np.random.default_rng(0)
    moving = [rng.random((4, 4, 3), np.float32) * 0.5 for _ in range(5)]
    everywhere = [np.ones((4, 4), bool)] * 5
    assert flicker(moving, moving, everywhere) == 0
    # darker all the time is no flicker, darker every second frame is
    assert flicker(moving, [picture + np.float32(0.1) for picture in moving], everywhere) < 1e-3
    blinking = [picture + np.float32(0.1 * (k % 2)) for k, picture in enumerate(moving)]
    assert flicker(moving, blinking, everywhere) == pytest.approx(25.5, rel=1e-3)


def test_head_and_hands_are_where_they_are_drawn():
    avatar = mannequin()
    frame = motion_frames(avatar, 1, (320, 320))[0]
    boxes = part_boxes(avatar, *frame.pose, frame.camera)
    assert set(boxes) == {"head", "hand_left", "hand_right"}
    head, left, right = (boxes[name] for name in ("head", "hand_left", "hand_right"))
    assert head[0].stop < 160 and head[0].stop - head[0].start < 70
    # the person faces us: the left hand is on the right
    assert right[1].start < head[1].start < left[1].stop


def test_the_ladder_offers_only_what_the_file_holds(oracle):
    avatar = read_avatar(oracle[1])
    side = min(avatar.levels[0].base_color.shape[:2])
    rungs = rungs_of(avatar)
    assert views_of(avatar) == ["off"] and {(r.view, r.level) for r in rungs} == {("off", 0)}
    shares, halvings = [r.share for r in rungs], [r.halvings for r in rungs]
    most = avatar.levels[0].influences
    smaller, fewer = [n for n in (1, 2, 3) if side >> n >= 64], [k for k in (2, 1) if k < most]
    assert [share for share in shares if share < 1] == [0.75, 0.5, 0.25, *[0.25] * bool(smaller)]
    assert [share for share in shares if share > 1] == [4, 2]
    assert halvings == [0, *smaller, *[0] * len(fewer), 0, 0, 0, *smaller[-1:], 0, 0]
    assert [r.joints for r in rungs if r.joints < 4] == [*fewer, *fewer[-1:] * bool(smaller)]


def test_all_modes_levels_textures_and_resolutions_are_rungs_of_their_own():
    avatar = mannequin()
    coarse = replace(avatar.levels[0], faces=avatar.levels[0].faces[::3])
    rungs = rungs_of(replace(avatar, levels=(avatar.levels[0], coarse)))
    assert len({r.name for r in rungs}) == len(rungs)
    assert len({(r.view, r.level, r.share, r.halvings, r.joints) for r in rungs}) == len(rungs)
    assert [r.view for r in rungs[:4]] == ["network", "linear", "vertex", "off"]
    for view in ("network", "off"):
        assert {(r.level, r.share, r.halvings) for r in rungs if r.view == view} >= {
            (1, 1.0, 0), (0, 1.0, 1), (0, 1.0, 2), (0, 0.75, 0), (0, 0.5, 0),
        }  # fmt: skip


def test_a_level_without_features_is_a_rung_of_paper_mode_alone():
    avatar = mannequin()
    bare = replace(avatar.levels[0], features=None, faces=avatar.levels[0].faces[::3])
    rungs = rungs_of(replace(avatar, levels=(avatar.levels[0], bare)))
    assert {rung.view for rung in rungs if rung.level == 1} == {"off"}


def test_pixels_are_enlarged_linearly_and_samples_averaged():
    squares = np.zeros((8, 8, 3), np.uint8)
    squares[:4, :4], squares[4:, 4:] = 200, 100
    assert shown(squares, (8, 8)) is squares
    assert shown(squares, (2, 2))[..., 0].tolist() == [[200, 0], [0, 100]]
    squares[:2, :2] = 0
    assert shown(squares, (2, 2))[0, 0].tolist() == [150, 150, 150]
    assert 0 < shown(squares, (16, 16))[6, 8, 0] < 200


def test_all_textures_are_halved():
    avatar = with_halved_textures(mannequin(), 1)
    assert avatar.levels[0].base_color.shape == (256, 256, 3)
    assert avatar.levels[0].features.shape == (32, 32, 4)


def test_the_contact_sheet_shows_truth_beside_the_avatar(oracle, tmp_path):
    capture, avatar, _ = oracle
    contact_sheet(None, avatar, capture, tmp_path / "contact.png")
    with Image.open(tmp_path / "contact.png") as page:
        assert page.width == WIDTH
        assert np.asarray(page).std() > 10


def test_a_sheet_is_scaled_down_until_it_fits(tmp_path):
    noise = np.random.default_rng(0).integers(0, 255, (900, 900, 3), dtype=np.uint8)
    page = sheet([[noise]] * 4, [["noise"]] * 4, "noise", columns=2)
    save_sheet(tmp_path / "noise.png", page)
    assert (tmp_path / "noise.png").stat().st_size <= LARGEST


@pytest.mark.parametrize("rounds", ["0", "-1"])
def test_no_rounds_is_wrong_usage(oracle, tmp_path, rounds):
    with pytest.raises(SystemExit) as stop:
        bench_main([str(oracle[1]), "-o", str(tmp_path / "x"), "--rounds", rounds])
    assert stop.value.code == 2


def test_a_long_title_is_set_within_its_tile():
    title = "ground: the shadow alone, at rest, 1.26 x"
    for width in (190, 240):
        assert fitting_font(title, width).getlength(title) <= width
    assert fitting_font("bare", 190).size == 12
