"""The experiment on light: what it makes, keeps and resumes, and the numbers and page it makes of pictures."""

from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest
from recorded_commands import recorded_commands

import experiments.light
from avatar.light import CaptureLight
from bench.field.drawer import Drawer
from capture.held_out import HeldOutView
from experiments.light import main
from experiments.light_scores import Compared, common_gain, compare, scores
from synth.light import light_of
from synth.photo import Studio
from train.fused import FusedField
from train.run import Run


def compared(region: str, *, albedo: float, captured: float, gain: float = 1.0) -> Compared:
    """A picture of a hundred grey pixels, ten of them turned away; ours is off by what is said."""
    true = np.full((100, 3), 0.4)
    away = np.arange(100) < 10
    pairs = {
        "captured": (true, true + np.where(away, 3 * captured, captured)[:, None]),
        "mean_light": (true, true + 0.2),
        "albedo": (true, (true + albedo * np.where(away, -9, 1)[:, None]) / gain),
    }
    return Compared(region, away, pairs, lambda gain: true + 0.01 * gain, true)


def test_scores_are_of_all_pixels_and_those_turned_away_with_one_gain_between_albedo_and_texture():
    found = scores([compared("total", albedo=0.0, captured=0.1, gain=0.5)])
    # mean of 90 pixels off by .1 and 10 by .3
    assert found["captured"]["total"] == pytest.approx(-10 * np.log10(0.9 * 0.01 + 0.1 * 0.09), abs=0.006)
    assert found["turned_away"]["captured"]["total"] == pytest.approx(-10 * np.log10(0.09), abs=0.006)
    assert found["mean_light"]["total"] == pytest.approx(-20 * np.log10(0.2), abs=0.006)
    assert found["turned_away"]["share"]["total"] == 0.1
    assert found["captured"]["head"] is None
    pictures = [
        compared("total", albedo=0.0, captured=0.1, gain=0.5),
        compared("hands", albedo=0, captured=0, gain=0.5),
    ]
    assert common_gain(pictures) == pytest.approx(0.5)
    found = scores(pictures)
    assert found["gain"] == 0.5
    assert found["albedo_rms"]["hands"] == pytest.approx(0, abs=1e-6)
    # the key light is asked for with that gain
    assert found["key"]["total"] == pytest.approx(-20 * np.log10(0.005), abs=0.006)


@pytest.fixture
def made(monkeypatch, tmp_path):
    """Commands that the experiment runs, which leave empty captures and runs; scores by light."""

    def leave(words):
        place = Path(words[words.index("-o") + 1]) if "-o" in words else Path(words[3])
        place.mkdir(parents=True)
        (place / ("run.json" if "-o" in words else "capture.json")).write_text("{}")

    def measured(run, person, even, light, seed, poses):
        off = {"even": 0.05, "fixed": 0.1}[light]
        each = scores([compared(region, albedo=0.0, captured=off) for region in ("total", "head", "hands")])
        return {"found": "none", "novel_pose": each, "novel_view": each}

    monkeypatch.setattr(experiments.light, "measured", measured)
    return recorded_commands(monkeypatch, experiments.light, leave), tmp_path / "out"


def test_every_light_is_filmed_trained_and_measured_once(made, capsys):
    calls, out = made
    words = ["some/Person.glb", "-o", str(out), "--lights", "fixed", "--steps", "450"]
    assert main(words) == 0
    kinds = [call[1] for call in calls]
    assert kinds == ["synth", "train", "synth", "train"]
    # the even capture holds the truth of all of them, and the lights share a seed
    assert "--no-truth" not in calls[0] and "--no-truth" in calls[2]
    assert all(call[call.index("--seed") + 1] == "0" for call in (calls[0], calls[2]))
    assert all(call[call.index("--iterations") + 1] == "450" for call in (calls[1], calls[3]))
    page = (out / "light.md").read_text()
    # twice as far off: 6 dB, of the key light none
    assert "| Person, fixed | 450 steps a part, 103% of those of preset demo |" in page
    assert "| 6.0 / 6.0 / 6.0 | 0.8 / 0.5 / 1 |" in page
    assert main(words) == 0
    assert len(calls) == 4
    assert "Person, fixed: kept" in capsys.readouterr().err
    # another run asks for new scores
    (out / "Person" / "fixed" / "run" / "run.json").write_text('{"other": 1}')
    assert main(words) == 0
    assert "Person, fixed: measuring" in capsys.readouterr().err


def test_a_training_without_the_factor_is_asked_for_beside_it(made):
    calls, out = made
    assert main(["builtin", "-o", str(out), "--lights", "even", "--without"]) == 0
    trainings = [call for call in calls if call[1] == "train"]
    assert ["--without" in call for call in trainings] == [False, True]
    assert trainings[1][trainings[1].index("--without") + 1] == "light"
    assert "| builtin, even, no factor |" in (out / "light.md").read_text()


def _as_bright_as_its_light(light) -> Mock:
    """A drawer of one pixel, which is as bright as the light that its field is lit by."""
    drawer = Mock(spec=Drawer, field=SimpleNamespace(light=light))
    shown = lambda: 0.5 if drawer.field.light is None else drawer.field.light.ambient
    drawer.draw = lambda *_: SimpleNamespace(color=np.full((1, 1, 3), shown()))
    return drawer


@pytest.mark.parametrize("own", [None, CaptureLight(0.7, frame="world")])
def test_a_field_is_lit_by_each_light_in_turn_and_then_as_it_was(monkeypatch, own):
    monkeypatch.setattr("experiments.light_scores.region_of", lambda *_: (np.ones((1, 1), bool),))
    monkeypatch.setattr("experiments.light_scores.turned_away", lambda *_: np.zeros((1, 1), bool))
    drawer = _as_bright_as_its_light("before")
    studio = Mock(spec=Studio, posed=lambda *_: np.zeros((3, 3)))
    studio.take = lambda vertices, camera, light: SimpleNamespace(image=np.full((1, 1, 3), 255 * light.ambient))
    run = Mock(spec=Run, field=Mock(spec=FusedField), world_light=own)
    view = Mock(spec=HeldOutView, view="body", axis_angle=None, root=None, camera=None)
    found = compare(drawer, run, studio, view, light_of("fixed", "body", 0), np.zeros(3))
    ours = {name: float(pair[1][0, 0]) for name, pair in found.pairs.items()}
    assert ours == {"captured": 0.5 if own is None else 0.7, "mean_light": 0.5, "albedo": 1.0}
    assert float(found.relit(1.0)[0, 0]) == pytest.approx(0.35) and drawer.field.light == "before"
