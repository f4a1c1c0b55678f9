"""Accuracy against time on the oracle avatar."""

import json
from dataclasses import replace

import numpy as np
import pytest

from bench.bench_command import bench_main
from bench.ladder.rung_pictures import motion_frames
from bench.ladder.rung_scores import mark_dominated, median_interval, part_boxes
from bench.report.rung_page import frontier_of, label_heights, points_of, trade_sentence
from bench.report.sheet import LARGEST, WIDTH, fitting_font, save_sheet, sheet
from command.errors import AssetError
from player.budget.ladder import rungs_of
from player.budget.rung import shown, with_halved_textures
from player.scene.mannequin import mannequin


def test_bench_writes_json_table_plot_and_pictures(oracle, tmp_path, capsys):
    capture, avatar, _ = oracle
    out = tmp_path / "bench"
    assert bench_main([str(avatar), "--capture", str(capture), "-o", str(out), "--rounds", "6"]) == 0
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
    assert best["flip"] == 0 and half["start_ms"] > 0
    assert half["parts"]["head"]["flip"] > 0 and half["parts"]["hands"]["psnr_db"] < 40
    assert 0 < half["psnr_mask_db"] < half["psnr_db"]
    assert half["psnr_db"] < 35 and half["bytes"] < best["bytes"]
    assert best["against_truth"]["psnr_db"] > half["against_truth"]["psnr_db"]
    assert {path.name for path in out.iterdir()} >= {"bench.html", "bench.json", "bench.md", "pareto.png"}
    printed = [line for line in capsys.readouterr().out.splitlines() if " ms " in line]
    assert len(printed) == len(result["rungs"]) and len({line.index(" ms ") for line in printed}) == 1


def test_a_run_that_is_none_is_refused_before_anything_is_timed(tmp_path, monkeypatch):
    monkeypatch.setattr("bench.report.report.time_rungs", None)
    with pytest.raises(AssetError, match=r"run\.json: no such file"):
        bench_main(["builtin", "--run", str(tmp_path), "-o", str(tmp_path / "out")])


def test_the_interval_of_a_median_holds_it_19_times_of_20():
    rng = np.random.default_rng(0)
    hits = 0
    for _ in range(2000):
        low, high = median_interval(rng.exponential(size=20))
        hits += low <= np.log(2) <= high
    assert 0.94 < hits / 2000 < 0.98
    assert median_interval(np.array([3.0, 1.0, 2.0])) == (1.0, 3.0)
    with pytest.raises(SystemExit):  # lowest and highest of five hold it in 15 of 16
        bench_main(["builtin", "-o", "out", "--rounds", "5"])


def ladder(*points):
    rows = [{"name": name, "ms_median": ms, "flip": flip} for name, ms, flip in points]
    return {"best_rung": "field", "rungs": rows}


def test_the_figure_names_points_that_nothing_beats_by_their_true_errors():
    ms = np.geomspace(1, 100, 40)
    front = [(f"rung {k}", float(t), float(0.1 / t)) for k, t in enumerate(ms)]
    beaten = [(f"beaten {k}", float(1.5 * t), float(0.11 / t)) for k, t in enumerate(ms)]
    named = frontier_of(points_of(ladder(*front, *beaten)))
    assert len(named) == 12 and {named[0].name, named[-1].name} == {"rung 0", "rung 39"}
    assert all(a.ms < b.ms and a.flip > b.flip and a.name in dict.fromkeys(n for n, _, _ in front)
               for a, b in zip(named, named[1:]))  # fmt: skip
    result = ladder(("field", 40_000.0, 0.0), ("baked", 9.0, 0.03), ("small", 1.0, 0.08))
    assert [point.flip for point in points_of(result)] == [0.0, 0.03, 0.08]
    for row, flip in zip(result["rungs"], (0.067, 0.0585, 0.1)):
        row["against_truth"] = {"flip": flip}
    assert trade_sentence(result) == (
        "9.0 ms is more exact than 40 s (FLIP 0.059 and 0.067); 1.7 times the error at 1.0 ms."
    )
    wanted = [0.0, 0.01, 0.02, 0.5, 0.97, 0.98, 0.99, 1.0, 1.0, 1.0, 1.0, 1.0]
    placed = np.array(label_heights(wanted))
    assert (np.diff(placed) >= 1 / 12 - 1e-9).all() and placed[0] >= 0 and placed[-1] <= 1
    assert label_heights([0.1, 0.5]) == [0.1, 0.5]


def timed(name, low, high, *flips):
    return {"name": name, "ms_interval": [low, high], "flip": float(np.mean(flips)), "flip_each": list(flips)}


def test_a_rung_is_dominated_only_by_one_surely_faster_and_round_by_round_where_they_took_turns():
    rows = [
        timed("best", 9, 11, 0.0, 0.0), timed("good", 4, 5, 0.02, 0.03), timed("worse", 6, 7, 0.03, 0.03),
        timed("perhaps slower", 4.5, 6, 0.03, 0.03), timed("better once", 6, 7, 0.01, 0.06),
    ]  # fmt: skip
    mark_dominated(rows)
    assert [row["dominated_by"] for row in rows] == [None, None, "good", None, None]
    assert [row["dominated"] for row in rows] == [False, False, True, False, False]
    # Rounds of a shared machine differ by more than the rungs do: medians overlap, ratios do not.
    load = np.linspace(1, 3, 20)
    rows = [timed("a", 10, 30, 0.01), timed("b", 11, 33, 0.02)]
    mark_dominated(rows)
    assert not rows[1]["dominated"]
    mark_dominated(rows, [10 * load, 11 * load])
    assert rows[1]["dominated_by"] == "a" and not rows[0]["dominated"]


def test_head_and_hands_are_where_they_are_drawn():
    avatar = mannequin()
    frame = motion_frames(avatar, 1, (320, 320))[0]
    boxes = part_boxes(avatar, *frame.pose, frame.camera)
    assert set(boxes) == {"head", "hand_left", "hand_right"}
    head, left, right = (boxes[name] for name in ("head", "hand_left", "hand_right"))
    assert head[0].stop < 160 and head[0].stop - head[0].start < 70
    # the person faces us: the left hand is on the right
    assert right[1].start < head[1].start < left[1].stop


def test_modes_levels_textures_and_resolutions_are_rungs_and_a_level_without_features_one_of_paper_alone():
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
    bare = replace(avatar.levels[0], features=None, faces=avatar.levels[0].faces[::3])
    rungs = rungs_of(replace(avatar, levels=(avatar.levels[0], bare)))
    assert {rung.view for rung in rungs if rung.level == 1} == {"off"}


def test_pixels_are_enlarged_linearly_samples_averaged_and_textures_halved():
    squares = np.zeros((8, 8, 3), np.uint8)
    squares[:4, :4], squares[4:, 4:] = 200, 100
    assert shown(squares, (8, 8)) is squares
    assert shown(squares, (2, 2))[..., 0].tolist() == [[200, 0], [0, 100]]
    squares[:2, :2] = 0
    assert shown(squares, (2, 2))[0, 0].tolist() == [150, 150, 150]
    assert 0 < shown(squares, (16, 16))[6, 8, 0] < 200
    avatar = with_halved_textures(mannequin(), 1)
    assert avatar.levels[0].base_color.shape == (256, 256, 3)
    assert avatar.levels[0].features.shape == (32, 32, 4)


def test_a_sheet_is_scaled_down_until_it_fits_and_a_long_title_is_set_within_its_tile(tmp_path):
    noise = np.random.default_rng(0).integers(0, 255, (900, 900, 3), dtype=np.uint8)
    page = sheet([[noise]] * 4, [["noise"]] * 4, "noise", columns=2)
    assert page.width == WIDTH
    save_sheet(tmp_path / "noise.png", page)
    assert (tmp_path / "noise.png").stat().st_size <= LARGEST
    title = "ground: the shadow alone, at rest, 1.26 x"
    for width in (190, 240):
        assert fitting_font(title, width).getlength(title) <= width
    assert fitting_font("bare", 190).size == 12
