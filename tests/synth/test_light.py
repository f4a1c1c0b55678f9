"""Light and sheen."""

import numpy as np
import pytest

from synth.light import light_of, shade

RNG = np.random.default_rng(0)


def _unit(n):
    v = RNG.standard_normal((n, 3))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def test_even_light_without_sheen_shows_the_base_colour():
    base = RNG.uniform(0, 255, (50, 3))
    assert np.array_equal(shade(base, _unit(50), _unit(50), light_of("even", "body", 0), 0.0), base)


@pytest.mark.parametrize("mode", ["soft", "varied"])
def test_a_point_that_faces_the_key_light_shows_its_base_colour(mode):
    light = light_of(mode, "head", 3)
    towards = np.array([light.direction]) / np.linalg.norm(light.direction)
    aside = np.cross(towards, [[0.0, 1, 0]])
    view = 0.5 * towards + np.sqrt(0.75) * aside / np.linalg.norm(aside)  # half-way vector 30 degrees off
    shown = shade(np.full((1, 3), 100.0), towards, view, light, 0.0)
    np.testing.assert_allclose(shown - 255 * light.specular * np.sqrt(0.75) ** 20, 100.0, atol=1e-9)


def test_sheen_depends_on_the_angle_between_normal_and_view_only():
    normals, views = _unit(200), _unit(200)
    turn = np.linalg.qr(RNG.standard_normal((3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    even = light_of("even", "body", 0)
    base = np.full((200, 3), 90.0)
    np.testing.assert_allclose(
        shade(base, normals, views, even, 0.5), shade(base, normals @ turn.T, views @ turn.T, even, 0.5), atol=1e-9
    )
    assert np.ptp(shade(base, normals, views, even, 0.5)) > 25  # of 255: sheen at .5 is plainly seen


def test_varied_light_differs_between_videos_and_repeats_with_the_seed():
    lights = {video: light_of("varied", video, 5) for video in ("body", "head", "hand_left", "hand_right")}
    assert len(set(lights.values())) == 4
    assert lights["head"] == light_of("varied", "head", 5) != light_of("varied", "head", 6)


@pytest.mark.parametrize(
    "mode, shown",
    [
        ("soft", [94.42985758771519, 93.25811121601309, 100.81467432779634]),
        ("fixed", [88.6181405909465, 60.52270978890758, 94.95123060755891]),
        ("varied", [76.49849580931544, 57.51132791365749, 101.72478555371293]),
    ],
)
def test_lights_of_display_values_are_the_same_bits_as_ever(mode, shown):
    base = np.array([[100.0], [120.0], [80.0]]).repeat(3, 1)
    normals = np.array([[0.6, 0, 0.8], [0.0, -0.6, 0.8], [0.28, 0.96, 0.0]])
    view = np.array([[0.0, 0, 1], [0.0, 0, 1], [0.6, 0.0, 0.8]])
    assert shade(base, normals, view, light_of(mode, "head", 3), 0.5)[:, 0].tolist() == shown


def test_an_unknown_mode_is_refused():
    with pytest.raises(ValueError, match="disco"):
        light_of("disco", "body", 0)
