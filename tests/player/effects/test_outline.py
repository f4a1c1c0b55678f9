"""The line round avatars: where it is drawn and how wide it is."""

import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from avatar.camera import orbit_camera
from command.errors import AssetError
from player.effects import antialiasing as fxaa_pass
from player.effects.outline import Outline
from player.film.command import render_main
from player.gl.tiles import covered
from player.scene.effects import PLAIN, Effects
from player.scene.scene_file import read_scene

SIZE = (160, 180)
CAMERA = orbit_camera((0.1, 0, -0.2), 2.6, 0.5, 0.1, SIZE)
RED = (1.0, 0.0, 0.0, 1.0)


def grown(mask, pixels):
    """Pixels at most so far from the mask."""
    out = np.zeros_like(mask)
    padded = np.pad(mask, pixels)
    for y in range(-pixels, pixels + 1):
        for x in range(-pixels, pixels + 1):
            if x * x + y * y <= pixels * pixels:
                out |= padded[pixels + y :, pixels + x :][: mask.shape[0], : mask.shape[1]]
    return out


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


def test_it_is_smoothed_with_the_avatar_on_tiles_as_on_the_whole_picture(render, avatar, pose, monkeypatch):
    effects = Effects("off", antialiasing="fxaa", outline=Outline(RED, 17.0))
    renderer = render(avatar, SIZE, effects=effects)
    tiles = renderer.draw([pose], CAMERA)
    monkeypatch.setattr(fxaa_pass, "covered", lambda boxes, size, margin: np.full_like(covered(boxes, size, 0), True))
    assert np.array_equal(tiles, renderer.draw([pose], CAMERA))
    assert ((tiles[..., 3] > 0) & (tiles[..., 3] < 255)).sum() > 100


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
    plain, option, red, both = (np.asarray(Image.open(name)) for name in names)
    assert (plain != option).any() and (option != red).any() and np.array_equal(red, both)
    rows = {row["name"]: row for row in json.loads((tmp_path / "a.json").read_text())["passes"]}
    assert rows["outline"]["runs"] and rows["outline"]["bytes"] > 0 and rows["outline"]["why"] == "2 pixels"


@pytest.mark.parametrize(
    ("line", "complaint"),
    [
        ("width = 0", r"scene\.toml:4: effects\.outline\.width: expected more than 0, found 0"),
        ('color = "#ff000080"', r"scene\.toml:4: effects\.outline\.color: expected an opaque color"),
        (
            "with = 2",
            r"scene\.toml:4: effects\.outline\.with: unknown key in \[effects\.outline\]; did you mean width\?",
        ),
    ],
)
def test_a_mistake_in_its_table_is_answered_by_line_and_key(tmp_path, line, complaint):
    scene = tmp_path / "scene.toml"
    scene.write_text(f'[[avatar]]\npath = "mannequin"\n[effects.outline]\n{line}\n')
    with pytest.raises(AssetError, match=complaint):
        read_scene(scene)
    scene.write_text('effects.outline = 3\n[[avatar]]\npath = "mannequin"\n')
    with pytest.raises(AssetError, match=r"toml:1: effects\.outline: expected a table, \[effects\.outline\], found"):
        read_scene(scene)
