"""scene.toml: what is read, and how mistakes are answered."""

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest
from pictures import pixels

from command.errors import AssetError
from command.settings import settings_of
from experiments.scene_docs import DOCS, scene_schema, with_tables
from player.effects.background import Background
from player.effects.outline import Outline
from player.film.command import render_main
from player.scene.effects import STUDIO, Effects
from player.scene.scene import Scene, SceneAvatar, SceneCamera
from player.scene.scene_file import lines_of_keys, read_scene

FULL = '''\
size = [640, 480]
rate = 24   # a comment = with [[avatar]] in it
[[avatar]]
path = "mannequin"
motion = "walking"
at = [
  0.5,  # x
  0,
  -1]
"turn_deg" = 30
[[avatar]]
path = """mannequin:female"""
start = 1
live = "vmc:0.0.0.0:39539"

[[camera]]
kind = "turntable"
seconds = 8
[[camera]]
kind = "front"
fov_deg = 40
[background]
kind = "hdr"
path = "sky.hdr"
exposure = -1
[effects]
view = "off"
antialiasing = "fxaa"
[effects.outline]
width = 3
'''


@pytest.fixture
def scene_file(tmp_path):
    """Writes a scene beside the files that FULL names."""
    (tmp_path / "sky.hdr").write_bytes(b"")
    path = tmp_path / "scene.toml"

    def write(text):
        path.write_text(text)
        return path

    return write


def test_every_key_arrives(scene_file):
    path = scene_file(FULL)
    assert read_scene(path) == Scene(
        avatars=(
            SceneAvatar("mannequin", "walking", at=(0.5, 0.0, -1.0), turn_deg=30.0),
            SceneAvatar("mannequin:female", live="vmc:0.0.0.0:39539", start=1.0),
        ),
        cameras=(SceneCamera("turntable", seconds=8.0), SceneCamera("front", fov_deg=40.0)),
        background=Background("hdr", STUDIO.color, str(path.parent / "sky.hdr"), exposure=-1.0),
        effects=Effects("off", "lbs", "fxaa", outline=Outline(width=3.0)),
        size=(640, 480),
        rate=24.0,
    )


def test_a_bare_scene_is_one_avatar_before_the_plain_wall(scene_file):
    scene = read_scene(scene_file('[[avatar]]\npath = "mannequin"\n'))
    assert scene == Scene((SceneAvatar("mannequin"),))
    assert scene.cameras == (SceneCamera("front"),) and scene.background == STUDIO and scene.effects == Effects()


def test_colours_are_premultiplied(scene_file):
    scene = read_scene(scene_file('background.color = "#ff804080"\n[[avatar]]\npath = "mannequin"'))
    alpha = 128 / 255
    assert scene.background.color == pytest.approx((alpha, alpha * 128 / 255, alpha * 64 / 255, alpha))


MISTAKES = [  # (what stands in FULL, what stands there instead, line, the complaint)
    (
        '"turn_deg" = 30',
        '"turndeg" = 30',
        10,
        r"avatar 1\.turndeg: unknown key in \[\[avatar\]\]; did you mean turn_deg\?",
    ),
    ("[effects]", "[efects]", 26, r"efects: unknown key in a scene; did you mean effects\?"),
    ("exposure", "qqq", 25, r"background\.qqq: unknown key in \[background\]; \[background\] has kind, color, path"),
    ("seconds = 8", 'seconds = "8"', 18, r"camera 1\.seconds: expected a number, found the string '8'"),
    ("start = 1", "start = true", 13, r"avatar 2\.start: expected a number, found true"),
    ("start = 1", "start = -1", 13, r"avatar 2\.start: expected at least 0, found -1"),
    ("rate = 24", "rate = 0", 2, r"rate: expected at least 0.01, found 0"),
    ("rate = 24", "rate = inf", 2, r"rate: expected a finite number, found inf"),
    ("rate = 24", "rate = ", 2, r"Invalid value, column 11"),
    ("[640, 480]", "[640]", 1, r"size: expected 2 whole numbers in brackets, found 1 of them"),
    ("[640, 480]", "[640, 480.5]", 1, r"size: expected a whole number, found the number 480\.5"),
    ("[640, 480]", '"640x480"', 1, r"size: expected 2 whole numbers in brackets, found the string '640x480'"),
    ("  -1]", "  nan]", 6, r"avatar 1\.at: expected a finite number"),
    ('"walking"', '"wlking"', 5, r"avatar 1\.motion: no such file: .*wlking \(and it is none of counting, walking\)"),
    ('"sky.hdr"', '"sky.exr"', 24, r"background\.path: no such file: .*sky\.exr"),
    ('path = "sky.hdr"\n', "", 22, r"background: background hdr needs a path"),
    ('kind = "hdr"', 'kind = "sky"', 23, r"background\.kind: expected one of color, image, video, hdr, transparent"),
    (
        'kind = "hdr"',
        'kind = "transparent"\ncolor = "#000000"',
        24,
        r"background\.color: a transparent background takes no color",
    ),
    ("exposure = -1", 'color = "red"', 25, r"background\.color: expected #rrggbb or #rrggbbaa, found the string 'red'"),
    ("vmc:0.0.0.0:39539", "osc:1", 14, r"avatar 2\.live: expected vmc:PORT or udp:PORT or ws:PORT, found 'osc:1'"),
    ("start = 1", 'motion = "walking"', 13, r"avatar 2\.motion: motion and live: expected one of them, found both"),
    ('path = """mannequin:female"""\n', "", 11, r"avatar 2: \[\[avatar\]\] needs the key path: avatar file"),
    ('kind = "front"', 'kind = "file"', 19, r"camera 2: camera file needs a path"),
    ("fov_deg = 40", "fov_deg = 180", 21, r"camera 2\.fov_deg: expected less than 180, found 180"),
    ("width = 3", "width = 0", 30, r"effects\.outline\.width: expected more than 0, found 0"),
    ("width = 3", 'color = "#ff000080"', 30, r"effects\.outline\.color: expected an opaque color"),
    ("width = 3", "with = 2", 30, r"effects\.outline\.with: unknown key in \[effects\.outline\]; did you mean width\?"),
    ("fxaa", "smaa", 28, r"effects\.antialiasing: expected one of auto, none, fxaa, msaa, found 'smaa'"),
]


@pytest.mark.parametrize(("right", "wrong", "line", "complaint"), MISTAKES, ids=[wrong for _, wrong, _, _ in MISTAKES])
def test_a_mistake_is_answered_by_line_and_key(scene_file, right, wrong, line, complaint):
    assert FULL.count(right) == 1
    path = scene_file(FULL.replace(right, wrong))
    with pytest.raises(AssetError, match=rf"scene\.toml:{line}: {complaint}"):
        read_scene(path)


def test_tables_of_the_wrong_kind_and_empty_scenes(scene_file):
    with pytest.raises(AssetError, match=r"toml:1: camera: expected \[\[camera\]\], found a table"):
        read_scene(scene_file('[camera]\n[[avatar]]\npath = "mannequin"'))
    with pytest.raises(AssetError, match=r"toml:1: effects: expected a table, \[effects\], found the number 3"):
        read_scene(scene_file('effects = 3\n[[avatar]]\npath = "mannequin"'))
    with pytest.raises(AssetError, match=r"toml:1: effects\.outline: expected a table, \[effects\.outline\], found"):
        read_scene(scene_file('effects.outline = 3\n[[avatar]]\npath = "mannequin"\n'))
    with pytest.raises(AssetError, match=r"expected at least one \[\[avatar\]\], found none"):
        read_scene(scene_file("\n"))
    with pytest.raises(AssetError, match=r"absent\.toml: no such file; expected a scene"):
        read_scene(Path("absent.toml"))


def test_lines_of_keys_knows_every_key_that_toml_reads():
    text = '''a = 1
"b.c" = """
d = 2
"""  # e = 3
f.g = [ # h = 1
  { i = 1 },
  "j = ]",
]
[k."l m"]
n = 'o = 1'
[[p]]
[p.q]
r = { s = 1 }
[[p]]
t = 2020-01-01'''
    lines = lines_of_keys(text)
    assert lines == {
        ("a",): 1, ("b.c",): 2, ("f",): 5, ("f", "g"): 5, ("k", "l m"): 9, ("k", "l m", "n"): 10, ("p", 0): 11,
        ("p", 0, "q"): 12, ("p", 0, "q", "r"): 13, ("p", 0, "q", "r", "s"): 13,
        ("p", 1): 14, ("p", 1, "t"): 15,
    }  # fmt: skip
    content = tomllib.loads(text)
    for key in lines:
        place = content
        for part in key:
            place = place[part]


@pytest.mark.parametrize("scene", sorted((DOCS / "scenes").glob("*.toml")), ids=lambda scene: scene.stem)
def test_examples_can_be_filmed(tmp_path, scene):
    if any(actor.live for actor in read_scene(scene).avatars):
        return
    out = tmp_path / "frame.png"
    assert render_main(["--scene", str(scene), "--frame", "3", "--size", "72x64", "-o", str(out)]) == 0
    image = pixels(out)
    assert image.shape == (64, 72, 4 if scene.stem == "cutout" else 3)
    assert len(np.unique(image.reshape(-1, image.shape[2]), axis=0)) > 100


def test_schema_and_tables_in_docs_are_those_of_the_dataclasses():
    assert json.loads((DOCS / "scene.schema.json").read_text()) == scene_schema()
    page = (DOCS / "scenes.md").read_text()
    assert with_tables(page) == page
    for record in (SceneAvatar, SceneCamera, Background, Effects):
        assert all(f"| `{fact.name}` |" in page for fact in settings_of(record))


def test_the_example_on_the_page_is_a_scene(tmp_path):
    page = (DOCS / "scenes.md").read_text()
    text = page.split("```toml\n")[1].split("```")[0]
    (tmp_path / "me.glb").touch()
    (tmp_path / "sky.hdr").touch()
    (tmp_path / "scene.toml").write_text(text)
    assert len(read_scene(tmp_path / "scene.toml").avatars) == 2


def test_the_schema_allows_what_is_read_and_refuses_the_mistakes_it_can_see():
    """Our own few lines of JSON schema; each keyword that the schema uses is checked here."""
    schema = scene_schema()
    accepts(schema, tomllib.loads(FULL))
    caught = 0
    for right, wrong, _, _ in MISTAKES:
        try:
            content = tomllib.loads(FULL.replace(right, wrong))
        except tomllib.TOMLDecodeError:
            continue
        try:
            accepts(schema, content)
        except AssertionError:
            caught += 1
    assert caught >= 13  # files, addresses and rules between keys are beyond a schema


def accepts(schema, value):
    kinds = {"object": dict, "array": list, "string": str, "number": (int, float), "integer": int, "boolean": bool}
    assert isinstance(value, kinds[schema["type"]]) and isinstance(value, bool) == (schema["type"] == "boolean")
    if isinstance(value, dict):
        assert set(schema.get("required", ())) <= set(value) <= set(schema["properties"])
        for key, one in value.items():
            accepts(schema["properties"][key], one)
    elif isinstance(value, list):
        assert schema.get("minItems", 0) <= len(value) <= schema.get("maxItems", 99)
        for one in value:
            accepts(schema["items"], one)
    elif isinstance(value, bool):
        return
    elif isinstance(value, str):
        assert value in schema.get("enum", (value,))
        assert "pattern" not in schema or __import__("re").search(schema["pattern"], value)
    else:
        assert value >= schema.get("minimum", value) and value > schema.get("exclusiveMinimum", value - 1)
