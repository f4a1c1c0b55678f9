"""The light of a panorama as ambient and lamps: against the integral itself, turned as the background is."""

import numpy as np
import pytest
from radiance_writer import sky

from avatar.rotation import fibonacci_sphere
from player.effects.panorama import direction_from_pixel
from player.effects.panorama_light import GAINS, LUMINANCE, fitted_light, gains_of, irradiance, linear_mean


def test_even_light_is_its_own_irradiance(within):
    even = np.full((64, 128, 3), 0.7)
    within(np.abs(irradiance(even, 0.3, fibonacci_sphere(50)) - 0.7).max(), 2e-3)
    light = fitted_light(even, 0.0, gamma=2.2, most=4)
    assert light.light.lamps == () and abs(light.light.ambient - 1) < 1e-12 and light.error < 2e-3


def test_a_sun_is_one_lamp_towards_where_the_background_shows_it(within):
    """Also turned: the pixel that the background draws for a direction is the one that lights from there."""
    for turn in (0.0, 1.1):
        panorama = np.full((128, 256, 3), 0.2)
        panorama[30:33, 170:173] = 4000.0
        fitted = fitted_light(panorama, turn, gamma=2.2, most=4)
        light = fitted.light
        brightest = light.directions[light.strengths.argmax()]
        # as shaders/panorama.frag looks a direction up, after direction_from_pixel has turned it
        camera_turn = direction_from_pixel(_identity(), turn)
        looked_up = camera_turn @ brightest
        u = 0.5 + np.arctan2(looked_up[0], -looked_up[2]) / (2 * np.pi)
        v = 0.5 - np.arcsin(looked_up[1]) / np.pi
        assert abs(u - 171.5 / 256) < 0.03 and abs(v - 31.5 / 128) < 0.05
        assert light.strengths.max() > 5 * light.ambient
        within(fitted.error, 0.12)


def _identity():
    from avatar.camera import Camera

    return Camera(np.eye(3), np.eye(4), (1, 1))


@pytest.mark.parametrize("gamma", [1.0, 2.2])
def test_an_evening_sky_is_met_to_some_percent_and_no_lamp_is_negative(within, gamma):
    panorama, normals = sky(256), fibonacci_sphere(400)
    fitted = fitted_light(panorama, 0.4, gamma=gamma, most=4)
    light = fitted.light
    assert 1 <= len(light.lamps) <= 4 and light.ambient >= 0 and (light.strengths >= 0).all()
    true = irradiance(panorama, 0.4, normals) @ LUMINANCE
    true = (true / true.mean()) ** (gamma / 2.2)
    true = true / true.mean()
    shading = light.shading(normals)
    assert (shading >= 0).all()
    off = float(np.sqrt(np.mean((shading - true) ** 2)))
    within(off, 0.12)
    # at other normals than those it was fitted at
    assert abs(off - fitted.error) < 0.02
    assert abs(shading.mean() - 1) < 0.02


def test_black_lights_nothing_and_is_refused():
    with pytest.raises(ValueError, match="the panorama is black"):
        fitted_light(np.zeros((32, 64, 3)), 0.0, gamma=1.0, most=4)


def test_gains_follow_brightness_and_tint_by_half_and_stay_within_limits():
    assert gains_of(np.full(3, 0.18)) == (1.0, 1.0, 1.0)
    warm = gains_of(np.array([0.36, 0.18, 0.09]))
    assert warm[0] > 1 == warm[1] > warm[2] and warm[0] == pytest.approx(1 / warm[2])
    assert gains_of(np.zeros(3)) == (GAINS[0],) * 3 and gains_of(np.full(3, 1e6)) == (GAINS[1],) * 3


def test_the_mean_is_of_linear_light():
    pixels = np.zeros((2, 4, 3))
    pixels[:, 2:] = 1.0
    np.testing.assert_allclose(linear_mean(pixels), 0.5)
    np.testing.assert_allclose(linear_mean(np.full((2, 2, 3), 0.46)), 0.18, atol=2e-3)
