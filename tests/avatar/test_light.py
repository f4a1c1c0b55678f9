"""The light of a capture: what it multiplies, and that files give it back."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from avatar.light import CaptureLight, Lamp, lamps_of, light_from_json
from command.settings import settings_json
from synth.light import light_of, shade

FRONT = (0.6, 0.0, 0.8)
LIGHT = CaptureLight(0.4, (Lamp(FRONT, 0.5), Lamp((0.0, 1.0, 0.0), 0.25)), gloss=0.1, gamma=2.2, frame="world")


def directions(count: int, seed: int) -> np.ndarray:
    found = np.random.default_rng(seed).standard_normal((count, 3))
    return found / np.linalg.norm(found, axis=1, keepdims=True)


def test_it_shows_what_synth_shows_under_its_own_lamp():
    truth = light_of("fixed", "body", 0)
    lamps = lamps_of(np.array([truth.direction]), np.array([truth.key]))
    light = CaptureLight(truth.ambient, lamps, gloss=truth.specular)
    normals, eyes = directions(500, 0), directions(500, 1)
    normals *= np.sign((normals * eyes).sum(1, keepdims=True))  # of what is seen
    albedo = np.random.default_rng(2).uniform(0, 0.9, (500, 3))
    expected = np.clip(shade(255 * albedo, normals, eyes, truth, 0.0) / 255, 0, 1)
    shown = light.shown(albedo, light.shading(normals), light.highlight(normals, eyes))
    np.testing.assert_allclose(shown, expected, atol=1e-12)


@pytest.mark.parametrize("gamma", [1.0, 1.4, 2.2])
def test_albedo_is_shown_backwards(gamma):
    light = replace(LIGHT, gamma=gamma)
    normals, eyes = directions(300, 3), directions(300, 4)
    shading, highlight = light.shading(normals), light.highlight(normals, eyes)
    albedo = np.random.default_rng(5).uniform(0.05, 0.8, (300, 3))
    shown = light.shown(albedo, shading, highlight)
    unclipped = (shown < 1).all(1)
    assert unclipped.sum() > 200
    back = light.albedo(shown, shading, highlight)
    np.testing.assert_allclose(back[unclipped], albedo[unclipped], rtol=1e-10, atol=1e-12)


def test_a_lamp_lights_nothing_that_faces_away_and_turns_with_the_surface():
    light = CaptureLight(0.3, (Lamp((0.0, 0.0, 1.0), 0.7),), gloss=0.2)
    normals = np.array([[0, 0, 1.0], [0, 0, -1.0], [1.0, 0, 0]])
    np.testing.assert_allclose(light.shading(normals), [1.0, 0.3, 0.3], atol=1e-15)
    behind = np.array([[0, 0, -1.0]] * 3)
    np.testing.assert_array_equal(light.highlight(normals, behind), 0)
    R = np.linalg.qr(np.random.default_rng(6).standard_normal((3, 3)))[0]
    R *= np.sign(np.linalg.det(R))
    turned = LIGHT.turned(R, "camera")
    normals, eyes = directions(50, 7), directions(50, 8)
    assert turned.frame == "camera"
    np.testing.assert_allclose(turned.shading(normals @ R.T), LIGHT.shading(normals), atol=1e-12)
    np.testing.assert_allclose(turned.highlight(normals @ R.T, eyes @ R.T), LIGHT.highlight(normals, eyes), atol=1e-12)
    assert light_from_json(json.loads(json.dumps(settings_json(LIGHT)))) == LIGHT


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"ambient": -0.1}, "ambient: expected at least 0, found -0.1"),
        ({"ambient": float("nan")}, "ambient: expected a finite number, found nan"),
        ({"ambient": "bright"}, "ambient: expected a number, found the string 'bright'"),
        ({"gamma": 0.5}, "gamma: expected at least 1, found 0.5"),
        ({"frame": "head"}, "frame: expected one of camera, world, found the string 'head'"),
        ({"ambient": 10**400}, "ambient: expected a number below 1e+18, found a whole number of 1329 bits"),
        ({"lamps": 3}, "lamps: expected values in brackets, found the number 3"),
        ({"lamps": 5 * [{"direction": [0, 0, 1], "strength": 1}]}, "lamps: expected at most 4, found 5"),
        ({"lamps": [{"direction": [0, 0, 2], "strength": 1}]}, "lamps 1.direction: expected three numbers of length 1"),
        ({"lamps": [{"direction": [0, 1], "strength": 1}]}, "lamps 1.direction: expected 3 numbers in brackets"),
        ({"lamps": [{"direction": [0, 0, 1]}]}, "lamps 1: [[lamps]] needs the key strength"),
        ({"sun": 1}, "sun: unknown key in a light; a light has ambient, lamps, gloss"),
        ({"ambient": 0, "lamps": []}, "ambient: expected light, with that of the lamps, found none"),
    ],
)
def test_what_is_no_light_is_refused(change, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        light_from_json({**settings_json(LIGHT), **change})
