"""Light told from videos where they tell little, contradict each other or are no pictures at all."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from painted_capture import write_capture
from turning_ball import turning_ball
from turning_capture import with_video

from avatar.light import LAMPS, STRONGEST, CaptureLight, Lamp, lamps_of
from avatar.similarity import similarity_from_landmarks
from avatar.skeleton import PARTS
from capture.folder import Capture, read_capture
from capture.light.fit import LEAST, LightFit, fit_capture_light, fit_light, light_line
from capture.light.pixels import LitPixels
from train.compose import consistent_placement
from train.light import seen_light, seen_lights_from_json, video_light

SIDE = (0.45, -0.65, -0.6)


def lit(ambient: float, *lamps: tuple[tuple[float, float, float], float], gloss: float = 0.0) -> CaptureLight:
    directions, strengths = np.array([d for d, _ in lamps]), np.array([s for _, s in lamps])
    return CaptureLight(ambient, lamps_of(directions, strengths), gloss)


@pytest.fixture(scope="module")
def ball() -> LitPixels:
    return turning_ball(lit(0.45, (SIDE, 0.55), gloss=0.1))


def check(fit: LightFit, pixels: LitPixels) -> None:
    """What every answer promises: finite numbers, light everywhere, a mean shading of one."""
    assert "nan" not in light_line(fit)
    for light in fit.lights.values():
        shading = light.shading(pixels.normal)
        assert np.isfinite(shading).all() and shading.min() > 0
        assert max(light.ambient, *light.strengths) < STRONGEST
    if fit.shared and fit.lights:
        assert fit.lights["body"].shading(pixels.normal).mean() == pytest.approx(1, abs=1e-6)


def degrees_off(light: CaptureLight, direction: tuple[float, float, float]) -> float:
    towards = np.array(direction) / np.linalg.norm(direction)
    return float(np.degrees(np.arccos(np.clip(light.directions @ towards, -1, 1))).min())


def with_normals(*normal: float):
    return lambda ball: ball._replace(normal=np.tile(normal, (len(ball.face), 1)))


def with_colors(color):
    return lambda ball: ball._replace(color=color(ball.color.shape))


NO_LIGHT = {
    # all normals alike: each triangle has one shading
    "a wall of a person": with_normals(0.0, 0.0, -1.0),
    "a wall aslant": with_normals(0.6, 0.0, -0.8),
    "black": with_colors(np.zeros),
    "white": with_colors(np.ones),
    "noise": with_colors(np.random.default_rng(0).random),
    # an albedo of its own explains each pixel, under any light
    "triangles that are seen once": lambda ball: ball._replace(face=np.arange(len(ball.face))),
}


@pytest.mark.rows
@pytest.mark.parametrize("case", NO_LIGHT)
def test_pixels_that_tell_no_light_give_none(ball, case):
    pixels = NO_LIGHT[case](ball)
    fit = fit_light(pixels)
    check(fit, pixels)
    assert fit.lights == {}


@pytest.mark.parametrize("part", ["body", "hand_left"])
def test_one_video_alone_tells_the_light_of_all(part, within):
    pixels = turning_ball(lit(0.45, (SIDE, 0.55), gloss=0.1), frames=30)
    one = pixels.chosen(pixels.video == PARTS.index(part))
    fit = fit_light(one)
    check(fit, one)
    assert set(fit.lights) == set(PARTS)
    within(degrees_off(fit.lights[part], SIDE), 1.0, "degrees")


@pytest.mark.parametrize("albedo", [0.0, 1.0])
def test_half_of_the_person_black_or_white_tells_the_same_light(ball, albedo, within):
    light = lit(0.3, (SIDE, 0.35))
    pixels = turning_ball(light)
    half = pixels.face % 2 == 0
    color = np.where(half[:, None], albedo * light.shading(pixels.normal)[:, None], pixels.color)
    fit = fit_light(pixels._replace(color=np.clip(color, 0, 1)))
    check(fit, pixels)
    within(degrees_off(fit.lights["body"], SIDE), 1.5, "degrees")


@pytest.mark.parametrize("ambient", [0.0, 0.001, 0.01])
def test_a_lamp_in_the_dark_is_found(ambient, within):
    pixels = turning_ball(lit(ambient, (SIDE, 1.0)))
    fit = fit_light(pixels)
    check(fit, pixels)
    found = fit.lights["body"]
    within(degrees_off(found, SIDE), 1.0, "degrees")
    within(found.ambient / found.strengths[0] - ambient, 0.02, "of the lamp")


def test_lamps_on_both_sides_are_found_where_one_explains_nothing(within):
    sides = ((0.9, 0.0, -0.4), (-0.9, 0.0, -0.4))
    pixels = turning_ball(lit(0.1, *((side, 0.6) for side in sides)))
    fit = fit_light(pixels)
    check(fit, pixels)
    within(max(degrees_off(fit.lights["body"], side) for side in sides), 3.0, "degrees")


def test_a_light_that_changes_in_the_middle_leaves_its_residual():
    """Nothing between the two is right; what is found is a light, and says how little it explains."""
    first, second = (turning_ball(lit(0.45, ((x, -0.6, -0.6), 0.55))) for x in (0.5, -0.6))
    early = np.zeros(len(first.face), bool)
    for video in range(len(PARTS)):
        own = np.flatnonzero(first.video == video)
        early[own[: len(own) // 2]] = True
    both = first._replace(color=np.where(early[:, None], first.color, second.color))
    fit = fit_light(both)
    check(fit, both)
    steady = fit_light(first)
    assert fit.residual > 2 * steady.residual


def test_a_video_half_as_bright_from_its_middle_on_moves_the_lamp_little(ball, within):
    dim = np.zeros(len(ball.face), bool)
    own = np.flatnonzero(ball.video == 0)
    dim[own[len(own) // 2 :]] = True
    fit = fit_light(ball._replace(color=ball.color * np.where(dim, 0.5, 1.0)[:, None]))
    check(fit, ball)
    within(degrees_off(fit.lights["body"], SIDE), 3.0, "degrees")


def test_videos_1_2_times_as_bright_tell_the_same_light(ball, within):
    fits = [fit_light(ball._replace(color=share * ball.color / 1.2)) for share in (1.0, 1.2)]
    ours, theirs = (fit.lights["body"] for fit in fits)
    within(degrees_off(theirs, tuple(ours.directions[0])), 0.5, "degrees")
    within(ours.ambient / ours.strengths[0] - theirs.ambient / theirs.strengths[0], 0.02, "of the lamp")


@pytest.mark.parametrize("way", ["brighter", "darker", "to and fro"])
def test_an_exposure_that_drifts_by_a_fifth_moves_the_lamp_little(ball, within, way):
    """Frames follow each other in the pixels' order; every video drifts alike."""
    share = np.concatenate([np.linspace(0, 1, n) for n in np.bincount(ball.video)])
    drift = {"brighter": share, "darker": 1 - share, "to and fro": np.abs(2 * share - 1)}[way]
    fit = fit_light(ball._replace(color=ball.color * (0.8 + 0.2 * drift)[:, None]))
    check(fit, ball)
    within(degrees_off(fit.lights["body"], SIDE), 4.0, "degrees")


@pytest.mark.parametrize("count", [0, 1, LEAST - 1])
def test_too_few_pixels_are_said_and_are_no_light(ball, count):
    fit = fit_light(ball.chosen(np.arange(count)))
    assert fit.lights == {}
    assert f"taken as even, {count} pixels" in light_line(fit)


@pytest.fixture(scope="module")
def capture(tmp_path_factory) -> Capture:
    return read_capture(write_capture(tmp_path_factory.mktemp("light") / "capture", size=48, frames=4))


SPOILT = {
    "empty masks": {"masks": lambda video: np.zeros_like(video.masks)},
    "full masks": {"masks": lambda video: np.ones_like(video.masks)},
    "black": {"images": lambda video: np.zeros_like(video.images)},
    "white": {"images": lambda video: np.full_like(video.images, 255)},
    "noise": {"images": lambda video: np.random.default_rng(0).integers(0, 256, video.images.shape).astype(np.uint8)},
    "unsure": {"unsure": lambda video: np.ones_like(video.masks)},
    "turned away": {
        "cameras": lambda video: tuple(
            replace(camera, camera_from_world=np.diag([-1.0, 1, -1, 1]) @ camera.camera_from_world)
            for camera in video.cameras
        )
    },
}


@pytest.mark.parametrize("spoilt", SPOILT)
@pytest.mark.parametrize("parts", [("head",), PARTS], ids=["head", "all"])
def test_a_spoilt_video_lets_the_light_even_and_the_head_at_its_landmarks(capture, spoilt, parts):
    for part in parts:
        changes = {name: change(capture.videos[part]) for name, change in SPOILT[spoilt].items()}
        capture = with_video(capture, part, **changes)
    fit = fit_capture_light(capture)
    assert fit.lights == {}
    assert "nan" not in light_line(fit)
    _placed_by_landmarks(capture)


@pytest.mark.parametrize("change", ["all hair", "no head"])
def test_a_template_without_bare_skin_on_its_head_leaves_it_at_its_landmarks(capture, change):
    subject = capture.subject
    changed = {
        "all hair": {"hair": np.ones(len(subject.vertices), bool)},
        "no head": {"part": np.zeros_like(subject.part)},
    }[change]
    said = _placed_by_landmarks(replace(capture, subject=replace(subject, **changed)))
    assert "no bare skin on its head" in said


def _placed_by_landmarks(capture: Capture) -> str:
    """What is said where a capture's head stays exactly where its landmarks put it."""
    video = capture.videos["head"]
    assert video.landmarks is not None and video.landmark_vertices is not None
    landmarks = similarity_from_landmarks(video.landmarks, capture.subject.vertices[video.landmark_vertices])
    lines: list[str] = []
    placed = consistent_placement(capture, landmarks, lines.append)
    np.testing.assert_array_equal(placed.canonical_from_head, landmarks.transform)
    assert "the place by landmarks stays" in lines[0]
    return lines[0]


def test_the_mean_of_one_sharp_lamp_is_nowhere_darker_than_black(capture, within):
    """Harmonics of a lamp in the dark fall below zero behind it; what is shown never does."""
    light = CaptureLight(0.0, (Lamp((0.0, 0.0, -1.0), 4.0),), gloss=0.5, exponent=1000.0)
    rng = np.random.default_rng(0)
    normals = rng.standard_normal((4000, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    for part in PARTS:
        seen = seen_light(capture, part, video_light(capture, part, light, np.eye(4)))
        factors = seen_lights_from_json("", dict.fromkeys(PARTS, seen))[0].at(torch.as_tensor(normals).float()).numpy()
        assert np.isfinite(factors).all()
        assert factors[:, 0].min() >= 0.01 and factors[:, 1].min() >= 0
        within(np.maximum(factors[:, 0] - 4.0, 0).max(), 0.4, "brighter than the lamp")


@pytest.mark.parametrize("albedo", [0.0, 1.0])
@pytest.mark.parametrize("gamma", [1.0, 4.0])
@pytest.mark.parametrize("ambient", [0.0, 0.5])
def test_albedo_of_nothing_and_of_all_is_shown_and_learnt_with_finite_numbers(capture, albedo, gamma, ambient, within):
    light = CaptureLight(ambient, LAMPS * (Lamp((0.0, 0.6, 0.8), STRONGEST / 8),), gloss=1.0, gamma=gamma)
    tensors = video_light(capture, "body", light, np.eye(4)).tensors(torch.device("cpu"))
    # towards the lamp, away from it, across it, and none at all
    normals = torch.tensor([[0, 0.6, 0.8], [0, -0.6, -0.8], [1.0, 0, 0], [0, 0, 0]])[None].expand(3, -1, -1)
    # also an eye straight behind the lamp
    eyes = torch.tensor([[0, 0, 1.0], [0, -0.6, -0.8], [0, 0.6, 0.8]])
    color = torch.full((3, 4, 3), albedo, requires_grad=True)
    shown = tensors.lit(color, normals, eyes, torch.zeros(3, dtype=torch.long))
    shown.sum().backward()
    assert color.grad is not None and torch.isfinite(color.grad).all()
    R = tensors.lamps[0, 0].numpy()
    expected = []
    for eye in eyes.numpy().astype(float):
        n = normals[0].numpy().astype(float)
        posed = replace(light, lamps=lamps_of(np.tile(R, (LAMPS, 1)).astype(float), light.strengths))
        glow = posed.highlight(n, np.tile(eye, (4, 1)))
        expected.append(posed.shown(np.full((4, 3), albedo), posed.shading(n), glow))
    # (1e-8)^(1/4), the least that a finite slope allows
    within(shown.detach().numpy() - np.array(expected), 0.011 if gamma == 4 else 1e-5, f"gamma {gamma:g}")
