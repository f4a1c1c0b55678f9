"""Light as a factor while a part learns, and the mean of it that the finished person shows."""

from pathlib import Path

import numpy as np
import pytest
import torch
from painted_capture import write_capture
from sphere_field import sphere_field, turned_head

from avatar.light import CaptureLight, lamps_of
from avatar.rotation import matrix_from_axis_angle, quaternion_from_matrix
from avatar.skeleton import PARTS
from capture.folder import read_capture
from capture.template.parts import Box, Part
from command.errors import AssetError
from command.settings import settings_json
from train.command import TrainOptions
from train.deform import canonical_directions, posed_directions
from train.field import TEMPLATE_SHARE
from train.fused import FusedField
from train.light import harmonics, light_facts, seen_lights_from_json, video_light, world_light
from train.preset import PRESETS, HairPreset, chosen_preset
from train.run import lights_of

LAMPS = lamps_of(np.array([[0.5, -0.6, -0.7], [-0.8, 0.0, -0.3]]), np.array([0.5, 0.3]))


def unit(seed: int, *shape: int) -> np.ndarray:
    found = np.random.default_rng(seed).standard_normal((*shape, 3))
    return found / np.linalg.norm(found, axis=-1, keepdims=True)


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    return read_capture(write_capture(tmp_path_factory.mktemp("lit") / "capture", size=24, frames=4))


@pytest.mark.parametrize("gamma", [1.0, 2.2])
def test_sections_are_lit_as_numpy_says_in_the_frame_of_each_ray(capture, gamma):
    light = CaptureLight(0.4, LAMPS, gloss=0.1, gamma=gamma)
    video = video_light(capture, "body", light, np.eye(4))
    normals, eyes, frame = unit(0, 60, 3), unit(1, 60), np.arange(60) % 4
    albedo = np.random.default_rng(2).uniform(0.05, 0.9, (60, 3, 3))
    put = lambda array: torch.as_tensor(array, dtype=torch.float32)
    found = video.tensors(torch.device("cpu")).lit(put(albedo), put(normals), put(eyes), torch.as_tensor(frame))
    for ray in range(60):
        R = video.light_from_ray[frame[ray]]
        n, v = normals[ray] @ R.T, np.tile(R @ eyes[ray], (3, 1))
        expected = light.shown(albedo[ray], light.shading(n), light.highlight(n, v))
        np.testing.assert_allclose(found[ray].numpy(), expected, atol=2e-6)


def test_harmonics_are_orthogonal_and_posed_directions_undo_canonical_ones():
    rotations = matrix_from_axis_angle(np.random.default_rng(4).uniform(-2, 2, (50, 4, 3)))
    bones = torch.as_tensor(quaternion_from_matrix(rotations)).float()
    weights = torch.rand(50, 4, generator=torch.Generator().manual_seed(0)).sort(1, descending=True).values
    directions = torch.as_tensor(unit(5, 50)).float()
    back = posed_directions(canonical_directions(directions, weights, bones), weights, bones)
    torch.testing.assert_close(back, directions, rtol=0, atol=1e-5)
    basis = harmonics(unit(9, 200_000))
    gram = basis.T @ basis / len(basis)
    scale = np.sqrt(np.diag(gram))
    assert np.abs(gram / np.outer(scale, scale) - np.eye(25)).max() < 0.02


def degrees(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    return torch.rad2deg(torch.atan2(torch.linalg.cross(a, b).norm(dim=1), (a * b).sum(1)))


def test_light_falls_on_normals_that_do_not_jump_from_cell_to_cell():
    template, d = sphere_field(0.1).template, torch.as_tensor(unit(10, 4000)).float()
    smooth = torch.nn.functional.normalize(template.smooth_gradient(0.1 * d), dim=1)
    own = torch.nn.functional.normalize(template.sample(0.1 * d)[1], dim=1)
    assert degrees(smooth, d).max() < 1.0
    assert degrees(own, d).max() > 2.0


@pytest.mark.parametrize("tilt", [0.0, 10.0, 40.0])
def test_a_wrinkle_of_the_field_turns_the_normal_by_its_share(tilt):
    field, d = sphere_field(0.1).requires_grad_(False), torch.as_tensor(unit(11, 500)).float()
    aside = torch.nn.functional.normalize(torch.linalg.cross(d, torch.as_tensor(unit(12, 500)).float()), dim=1)
    angle = torch.deg2rad(torch.tensor(tilt))
    # of any length, as gradients are
    found = field.light_normal(0.1 * d, 1.3 * (angle.cos() * d + angle.sin() * aside))
    k = 1 - TEMPLATE_SHARE
    expected = torch.rad2deg(torch.atan2(k * angle.sin(), 1 - k + k * angle.cos()))
    torch.testing.assert_close(found.norm(dim=1), torch.ones(500), rtol=0, atol=1e-5)
    assert (degrees(found, d) - expected).abs().max() < 1.0


def test_the_normals_that_light_falls_on_are_canonical_also_where_the_head_was_turned():
    """Eq. 5 turns the head's field by 37 degrees; a ball's normals still point away from its middle."""
    wide = Box(np.full(3, -0.2), np.full(3, 0.2))
    parts = (Part("body", wide, None, 0.0), Part("head", wide, wide, 0.1))
    fused = FusedField([sphere_field(0.1), sphere_field(0.1)], parts, turned_head(1.02)).eval().requires_grad_(False)
    d = torch.as_tensor(unit(13, 500)).float()
    # the untrained networks add wrinkles, of which a third is left
    assert degrees(fused.light_normal(0.1 * d), d).max() < 2.0
    assert fused.light_normal(torch.zeros(0, 3)).shape == (0, 3)


def test_the_seen_light_is_the_mean_over_the_frames_that_face_a_normal(capture):
    """Of a head whose frames are rigid: by hand, at normals between those that it was fitted at."""
    light = CaptureLight(0.5, LAMPS)
    video = video_light(capture, "head", light, np.eye(4))
    facts = light_facts(capture, {part: video_light(capture, part, light, np.eye(4)) for part in PARTS})
    seen = seen_lights_from_json("light_seen", facts["light_seen"])[PARTS.index("head")]
    normals = unit(6, 40)
    sums = np.zeros((2, 40))
    for R in video.light_from_ray:
        weight = np.maximum(normals @ R.T @ [0, 0, -1.0], 0) + 1e-3
        sums += weight * np.stack([np.ones(40), light.shading(normals @ R.T)])
    found = seen.at(torch.as_tensor(normals).float())[:, 0].numpy()
    # four frames and 25 numbers
    assert np.abs(found - sums[1] / sums[0]).mean() < 0.03


def test_an_even_light_is_seen_as_one_and_the_world_light_is_the_cameras_turned(capture):
    videos = {part: video_light(capture, part, CaptureLight(1.0), np.eye(4)) for part in PARTS}
    facts = light_facts(capture, videos)
    for seen in seen_lights_from_json("x", facts["light_seen"]):
        albedo = torch.rand(20, 3, generator=torch.Generator().manual_seed(1))
        torch.testing.assert_close(seen.shown(albedo, torch.as_tensor(unit(7, 20)).float()), albedo, rtol=0, atol=1e-5)
    light = CaptureLight(0.4, LAMPS)
    world = world_light(capture, light)
    camera_from_world = capture.videos["body"].cameras[0].camera_from_world[:3, :3]
    normals = unit(8, 30)
    assert world.frame == "world"
    np.testing.assert_allclose(world.shading(normals), light.shading(normals @ camera_from_world.T), atol=1e-12)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"gamma": 10**400}, "head should hold shading, highlight and gamma"),
        ({"shading": [10**400] * 25}, "head should hold shading, highlight and gamma"),
        ({"shading": [1.0] * 24}, "head should hold 25 finite numbers each and a gamma from 1 to 4"),
        ({"highlight": [float("nan")] * 25}, "head should hold 25 finite numbers each"),
        ({"gamma": 0.5}, "head should hold 25 finite numbers each and a gamma from 1 to 4"),
    ],
)
def test_seen_lights_that_are_none_are_refused(change, message):
    whole = {"shading": [1.0] * 25, "highlight": [0.0] * 25, "gamma": 1.0}
    content = {part: whole | (change if part == "head" else {}) for part in PARTS}
    with pytest.raises(AssetError, match=f"run.json: {message}"):
        seen_lights_from_json("run.json", content)


def test_the_paper_has_no_light_factor_and_older_runs_have_no_lights(tmp_path):
    assert not PRESETS["paper"].light
    options = lambda **changes: chosen_preset(TrainOptions(capture=tmp_path, out=tmp_path / "run", **changes))
    assert options().light
    assert not options(without=("light",)).light
    bare = options(without=("light", "hair", "clothes"))
    assert bare.hair == HairPreset() != options().hair and not bare.clothes and bare.parts == options().parts
    assert options(preset="paper", without=("light", "hair", "clothes")) == options(preset="paper")
    assert lights_of(Path("run"), {}) == lights_of(Path("run"), {"light": None}) == {}
    told = {"light": {part: settings_json(LIGHT) for part in PARTS}}
    assert lights_of(Path("run"), told) == dict.fromkeys(PARTS, LIGHT)


LIGHT = CaptureLight(0.5, LAMPS)


@pytest.mark.parametrize(
    ("light", "message"),
    [
        (
            {"body": settings_json(LIGHT)},
            r"run.json: light should hold body, head, hand_left, hand_right or be null, is \['bo",
        ),
        ("fixed", "run.json: light should hold .* is 'fixed'"),
        (
            {part: {**settings_json(LIGHT), "gamma": 9} for part in PARTS},
            "run.json: light: gamma: expected at most 4, found 9",
        ),
    ],
)
def test_lights_that_are_none_are_refused(light, message):
    with pytest.raises(AssetError, match=message):
        lights_of(Path("run"), {"light": light})
