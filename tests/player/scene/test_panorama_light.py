"""The light of a panorama as ambient and lamps: against the integral itself, turned as the background is."""

import numpy as np
import pytest
from radiance_writer import sky

from avatar.camera import Camera
from avatar.rotation import fibonacci_sphere
from player.effects.panorama import direction_from_pixel
from player.effects.panorama_light import LUMINANCE, NORMALS, fitted_light, irradiance


def off_by(light, panorama, turn, normals=fibonacci_sphere(NORMALS)):  # noqa: B008  never written to
    """How far a light is from the panorama's own, of mean 1, root mean square."""
    true = irradiance(panorama, turn, normals) @ LUMINANCE
    true = (true / true.mean()) ** (light.gamma / 2.2)
    return float(np.sqrt(np.mean((light.shading(normals) - true / true.mean()) ** 2)))


def test_even_light_is_its_own_irradiance(within):
    even = np.full((64, 128, 3), 0.7)
    within(np.abs(irradiance(even, 0.3, fibonacci_sphere(50)) - 0.7).max(), 2e-3)
    light = fitted_light(even, 0.0, gamma=2.2, most=4)
    assert light.lamps == () and abs(light.ambient - 1) < 1e-12 and off_by(light, even, 0.0) < 2e-3


def test_a_sun_is_one_lamp_towards_where_the_background_shows_it(within):
    """Also turned: the pixel that the background draws for a direction is the one that lights from there."""
    for turn in (0.0, 1.1):
        panorama = np.full((128, 256, 3), 0.2)
        panorama[30:33, 170:173] = 4000.0
        light = fitted_light(panorama, turn, gamma=2.2, most=4)
        brightest = light.directions[light.strengths.argmax()]
        # as shaders/panorama.frag looks a direction up, after direction_from_pixel has turned it
        camera_turn = direction_from_pixel(Camera(np.eye(3), np.eye(4), (1, 1)), turn)
        looked_up = camera_turn @ brightest
        u = 0.5 + np.arctan2(looked_up[0], -looked_up[2]) / (2 * np.pi)
        v = 0.5 - np.arcsin(looked_up[1]) / np.pi
        assert abs(u - 171.5 / 256) < 0.03 and abs(v - 31.5 / 128) < 0.05
        assert light.strengths.max() > 5 * light.ambient
        within(off_by(light, panorama, turn), 0.12)


@pytest.mark.parametrize("gamma", [1.0, 2.2])
def test_an_evening_sky_is_met_to_some_percent_and_no_lamp_is_negative(within, gamma):
    panorama, normals = sky(256), fibonacci_sphere(400)
    light = fitted_light(panorama, 0.4, gamma=gamma, most=4)
    assert 1 <= len(light.lamps) <= 4 and light.ambient >= 0 and (light.strengths >= 0).all()
    shading = light.shading(normals)
    assert (shading >= 0).all() and abs(shading.mean() - 1) < 0.02
    # at other normals than those it was fitted at
    off = off_by(light, panorama, 0.4, normals)
    within(off, 0.12)
    assert abs(off - off_by(light, panorama, 0.4)) < 0.02


def test_black_lights_nothing_and_is_refused():
    with pytest.raises(ValueError, match="the panorama is black"):
        fitted_light(np.zeros((32, 64, 3)), 0.0, gamma=1.0, most=4)
