"""The line round avatars: where it is drawn and how wide it is."""

import json
from dataclasses import replace

import numpy as np
import pytest
from pictures import pixels
from scipy.ndimage import binary_dilation

from avatar.camera import orbit_camera
from player.effects.outline import Outline
from player.film.command import render_main
from player.scene.effects import PLAIN, Effects
from player.scene.scene_file import read_scene

SIZE = (160, 180)
CAMERA = orbit_camera((0.1, 0, -0.2), 2.6, 0.5, 0.1, SIZE)
RED = (1.0, 0.0, 0.0, 1.0)


def grown(mask, pixels):
    """Pixels at most so far from the mask."""
    y, x = np.mgrid[-pixels : pixels + 1, -pixels : pixels + 1]
    return binary_dilation(mask, x * x + y * y <= pixels * pixels)


@pytest.mark.parametrize("skinning", ["lbs", "dual_quaternion"])
@pytest.mark.parametrize("distance", [2.6, 9.0])
def test_the_line_is_as_wide_as_it_says_near_and_far(render, avatar, pose, skinning, distance):
    camera = orbit_camera((0.1, 0, -0.2), distance, 0.5, 0.1, SIZE)
    plain = render(avatar, SIZE, effects=replace(PLAIN, skinning=skinning)).draw([pose], camera)
    effects = replace(PLAIN, skinning=skinning, outline=Outline(RED, 4.0))
    lined = render(avatar, SIZE, effects=effects).draw([pose], camera)
    body, line = plain[..., 3] > 0, (lined == (255, 0, 0, 255)).all(-1)
    added = (lined[..., 3] > 0) & ~body
    assert (added <= line).all() and not (added & ~grown(body, 5)).any()
    near, far = grown(body, 3) & ~body, grown(body, 4) & ~body
    assert added[near].mean() > 0.97 and 0.6 < added[far].mean() <= 1
    inside = body & (lined != plain).any(-1)
    assert (inside <= line).all() and (inside.sum() < 0.2 * body.sum() or distance > 3), "limbs before the body"


def test_msaa_resolves_all_of_a_wide_line(render, avatar, pose):
    """One sample a pixel and four cover the same, but for the line's edge."""
    one, four = (
        render(avatar, SIZE, effects=Effects("off", antialiasing=kind, outline=Outline(RED, 17.0))).draw([pose], CAMERA)
        for kind in ("none", "msaa")
    )
    assert not ((one[..., 3] > 0) & (four[..., 3] == 0)).sum() > 60


def test_an_option_and_a_table_of_the_scene_ask_for_it(tmp_path):
    scene = tmp_path / "scene.toml"
    scene.write_text('[[avatar]]\npath = "mannequin"\n[effects.outline]\ncolor = "#ff0000"\n')
    assert read_scene(scene).effects == Effects(outline=Outline(RED))
    names = [tmp_path / name for name in ("plain.png", "option.png", "scene.png", "both.png")]
    base, size = ["mannequin", "--antialiasing", "none"], ["--size", "60x80", "--frame", "0", "-o"]
    render_main([*base, *size, str(names[0])])
    render_main([*base, "--effect", "outline", "--explain", "--json", str(tmp_path / "a.json"), *size, str(names[1])])
    from_scene = ["--scene", str(scene), "--antialiasing", "none"]
    render_main([*from_scene, *size, str(names[2])])
    render_main([*from_scene, "--effect", "outline", *size, str(names[3])])
    plain, option, red, both = map(pixels, names)
    assert (plain != option).any() and (option != red).any() and np.array_equal(red, both)
    rows = {row["name"]: row for row in json.loads((tmp_path / "a.json").read_text())["passes"]}
    assert rows["outline"]["runs"] and rows["outline"]["bytes"] > 0 and rows["outline"]["why"] == "2 pixels"
