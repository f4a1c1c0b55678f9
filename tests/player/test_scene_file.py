"""scene.toml, how mistakes in it are answered, and the cameras, places and levels of the film that it becomes."""

import json
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pictures import pictures_in, pixels
from refusals import refused
from tiny_avatar import tiny_avatar

from avatar.camera import orbit_camera, project, write_camera, write_cameras
from command.errors import AssetError
from command.settings import settings_of
from experiments.scene_docs import DOCS, scene_schema, with_tables
from player.effects.background import Background
from player.effects.outline import Outline
from player.film.command import RenderCommand, render_main
from player.film.parts import Parts
from player.film.render import level_of
from player.film.shot import Shot
from player.film.stage import Stage, camera_from_option
from player.scene.effects import STUDIO, Effects
from player.scene.opened import notes_of, opened_avatars
from player.scene.scene import Scene, SceneAvatar, SceneCamera
from player.scene.scene_file import read_scene, write_scene
from player.window.show import opened_show

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


MISTAKES = [  # (what stands in FULL, what stands there instead, line, the complaint)
    ('"turn_deg"', '"turndeg"', 10, r"avatar 1\.turndeg: unknown key in \[\[avatar\]\]; did you mean turn_deg\?"),
    ("[effects]", "[efects]", 26, r"efects: unknown key in a scene; did you mean effects\?"),
    ("exposure", "qqq", 25, r"background\.qqq: unknown key in \[background\]; \[background\] has kind, color, path"),
    ("seconds = 8", 'seconds = "8"', 18, r"camera 1\.seconds: expected a number, found the string '8'"),
    ("start = 1", "start = true", 13, r"avatar 2\.start: expected a number, found true"),
    ("rate = 24", "rate = 0", 2, r"rate: expected at least 0.01, found 0"),
    ("rate = 24", "rate = ", 2, r"Invalid value, column 11"),
    ("[640, 480]", "[640]", 1, r"size: expected 2 whole numbers in brackets, found 1 of them"),
    ("[640, 480]", "[640, 480.5]", 1, r"size: expected a whole number, found the number 480\.5"),
    ("[640, 480]", '"640x480"', 1, r"size: expected 2 whole numbers in brackets, found the string '640x480'"),
    ("  -1]", "  nan]", 6, r"avatar 1\.at: expected a finite number"),
    ('"walking"', '"wlking"', 5, r"avatar 1\.motion: no such file: .*wlking \(and it is none of counting, walking\)"),
    ('"sky.hdr"', '"sky.exr"', 24, r"background\.path: no such file: .*sky\.exr"),
    ('path = "sky.hdr"\n', "", 22, r"background: background hdr needs a path"),
    ('kind = "hdr"', 'kind = "sky"', 23, r"background\.kind: expected one of color, image, video, hdr, transparent"),
    ('"hdr"', '"transparent"\ncolor = "#000000"', 24, r"background\.color: a transparent background takes no color"),
    ("exposure = -1", 'color = "red"', 25, r"background\.color: expected #rrggbb or #rrggbbaa, found the string 'red'"),
    ("exposure = -1", "exposure = 2000", 25, r"background\.exposure: expected at most 30, found 2000"),
    ("vmc:0.0.0.0:39539", "osc:1", 14, r"avatar 2\.live: expected one of vmc:PORT, .*, found 'osc:1'"),
    ("start = 1", 'motion = "walking"', 13, r"avatar 2\.motion: motion and live: expected one of them, found both"),
    ('path = """mannequin:female"""\n', "", 11, r"avatar 2: \[\[avatar\]\] needs the key path: avatar file"),
    ('kind = "front"', 'kind = "file"', 19, r"camera 2: camera file needs a path"),
    ("fov_deg = 40", "fov_deg = 180", 21, r"camera 2\.fov_deg: expected at most 175, found 180"),
    ("width = 3", "width = 0", 30, r"effects\.outline\.width: expected more than 0, found 0"),
    ("width = 3", 'color = "#ff000080"', 30, r"effects\.outline\.color: expected an opaque color"),
    ("width = 3", "with = 2", 30, r"effects\.outline\.with: unknown key in \[effects\.outline\]; did you mean width\?"),
]


@pytest.mark.parametrize(("right", "wrong", "line", "complaint"), MISTAKES, ids=[wrong for _, wrong, _, _ in MISTAKES])
def test_a_mistake_is_answered_by_line_and_key(scene_file, right, wrong, line, complaint):
    assert FULL.count(right) == 1
    path = scene_file(FULL.replace(right, wrong))
    refused(AssetError, rf"scene\.toml:{line}: {complaint}", read_scene, path)


def test_tables_of_the_wrong_kind_are_refused_and_a_bare_scene_has_defaults(scene_file):
    with pytest.raises(AssetError, match=r"toml:1: camera: expected \[\[camera\]\], found a table"):
        read_scene(scene_file('[camera]\n[[avatar]]\npath = "mannequin"'))
    with pytest.raises(AssetError, match=r"toml:1: effects: expected a table, \[effects\], found the number 3"):
        read_scene(scene_file('effects = 3\n[[avatar]]\npath = "mannequin"'))
    refused(AssetError, r"expected at least one \[\[avatar\]\], found none", lambda: read_scene(scene_file("\n")))
    refused(AssetError, r"absent\.toml: no such file; expected a scene", read_scene, Path("absent.toml"))
    scene = read_scene(scene_file('[[avatar]]\npath = "mannequin"\n'))
    assert scene == Scene((SceneAvatar("mannequin"),))
    assert scene.cameras == (SceneCamera("front"),) and scene.background == STUDIO and scene.effects == Effects()
    scene = read_scene(scene_file('background.color = "#ff804080"\n[[avatar]]\npath = "mannequin"'))
    alpha = 128 / 255
    assert scene.background.color == pytest.approx((alpha, alpha * 128 / 255, alpha * 64 / 255, alpha))


EXAMPLES = sorted((DOCS / "scenes").glob("*.toml"))


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_a_scene_that_is_written_is_read_as_it_was(path, tmp_path):
    scene = read_scene(path)
    write_scene(tmp_path / "again.toml", scene)
    again = read_scene(tmp_path / "again.toml")
    assert again.background.color == pytest.approx(scene.background.color, abs=1e-3)
    assert replace(again, background=scene.background) == replace(scene, background=scene.background)


def test_files_beside_a_written_scene_move_with_it_and_odd_names_stay(tiny_path, tmp_path, monkeypatch):
    odd = 'a "quote" \\ ünï \x7f.glb'
    for name in (odd, "counting"):
        (tmp_path / name).write_bytes(b"there")
    monkeypatch.chdir(tmp_path)
    avatars = (SceneAvatar(odd, motion="./counting"), SceneAvatar(tiny_path, motion="counting", start=1e-7))
    camera = SceneCamera("follow", eye=(0.1, 1.5, 1e-9), target=(0.0, 1.25, 0.0))
    write_scene("a.toml", Scene(avatars, (camera,), rate=12.5, effects=Effects(outline=Outline())))
    text = Path("a.toml").read_text("utf-8")
    assert tiny_path in text and str(tmp_path) not in text.replace(tiny_path, "") and "[effects.outline]" in text
    Path("moved").mkdir()
    for name in ("a.toml", odd, "counting"):
        Path(name).rename(Path("moved") / name)
    again = read_scene(Path("moved") / "a.toml")
    assert Path(again.avatars[0].path) == Path("moved") / odd
    assert again.avatars[0].motion == str(Path("moved") / "counting")
    assert again.avatars[1] == avatars[1] and again.cameras == (camera,) and again.rate == 12.5


@pytest.mark.parametrize("scene", EXAMPLES, ids=lambda scene: scene.stem)
def test_examples_can_be_filmed(tmp_path, scene):
    if any(actor.live for actor in read_scene(scene).avatars):
        return
    out = tmp_path / "frame.png"
    assert render_main(["--scene", str(scene), "--frame", "3", "--size", "72x64", "-o", str(out)]) == 0
    image = pixels(out)
    assert image.shape == (64, 72, 4 if scene.stem == "cutout" else 3)
    assert len(np.unique(image.reshape(-1, image.shape[2]), axis=0)) > 100


def test_schema_tables_and_example_on_the_page_are_those_of_the_dataclasses(tmp_path):
    assert json.loads((DOCS / "scene.schema.json").read_text()) == scene_schema()
    page = (DOCS / "scenes.md").read_text()
    assert with_tables(page) == page
    for record in (SceneAvatar, SceneCamera, Background, Effects):
        assert all(f"| `{fact.name}` |" in page for fact in settings_of(record))
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


def test_cameras_of_a_capture_are_taken_frame_by_frame_and_the_last_one_stays(tiny_path, tmp_path):
    cameras = [orbit_camera((0, 0.9, 0), 3.0, 0.5 * k, 0.1, (40, 48)) for k in range(3)]
    write_cameras(tmp_path / "cameras.npz", cameras)
    base = [tiny_path, "--motion", "walking", "--frames", "0:5"]
    render_main([*base, "--camera", str(tmp_path / "cameras.npz"), "-o", str(tmp_path / "all")])
    taken = pictures_in(tmp_path / "all")
    assert len(taken) == 5 and taken[0].shape == (48, 40, 3)  # the cameras' size
    for k in range(3):
        write_camera(tmp_path / "one.json", cameras[k])
        render_main([*base, "--camera", str(tmp_path / "one.json"), "-o", str(tmp_path / f"{k}")])
        alone = pictures_in(tmp_path / f"{k}")
        assert np.array_equal(taken[k], alone[k])
    assert np.array_equal(taken[4], alone[4]) and not np.array_equal(taken[0], alone[0])


@pytest.mark.parametrize("motion", ["walking", None])
def test_cameras_of_a_file_follow_the_first_motion_at_any_rate_in_films_and_the_window(tmp_path, motion):
    size = (40, 48)
    cameras = [orbit_camera((0, 0.9, 0), 3.0, 0.05 * k, 0.1, size) for k in range(60)]
    write_cameras(tmp_path / "cameras.npz", cameras)
    scene = Scene((SceneAvatar("mannequin", motion),), (SceneCamera("file", str(tmp_path / "cameras.npz")),))
    for rate in (10.0, 30.0, 60.0):
        stage = Stage(scene, 1)
        stage.film_at(rate)
        after_a_second = stage.camera_at(None, 0, stage.frames, size)(rate, np.zeros(3))
        assert np.allclose(after_a_second.camera_from_world, cameras[30].camera_from_world)
    show = opened_show(scene, opened_avatars(scene))
    assert np.allclose(show.cameras.camera(size, 1.0, 30.0).camera_from_world, cameras[30].camera_from_world)
    if motion is None:
        # a body that stands still is shown as long as there are cameras
        assert (stage.frames, show.playback.timeline.frames) == (120, 60)


def test_a_turntable_holds_the_moment_asked_for_at_any_rate():
    stage = Stage(Scene((SceneAvatar("mannequin", "walking"),), (SceneCamera("turntable"),)), 1)
    asked = stage.poses(14)[0]
    stage.hold(14 / stage.rate)
    stage.film_at(10.0)
    assert np.array_equal(stage.poses(3)[0].axis_angle, asked.axis_angle)


def test_a_capture_is_a_camera_by_its_folder_and_part(tmp_path):
    for part, name in (("", None), (":head", "head")):
        found = camera_from_option(f"{tmp_path}{part}")
        assert (found.kind, found.name) == ("capture", name)
    refused(AssetError, r"none\.json", camera_from_option, "none.json")


@pytest.mark.parametrize("kind", ["front", "follow", "orbit", "turntable"])
def test_fitted_cameras_see_all_avatars_in_their_places_all_the_time(tiny_path, kind):
    actors = (
        SceneAvatar(tiny_path, "walking", at=(-0.8, 0.0, 0.3), turn_deg=40.0),
        SceneAvatar(tiny_path, "counting", at=(0.9, 0.0, 0.0), start=1.0),
    )
    stage = Stage(Scene(actors, cameras=(SceneCamera(kind, seconds=None if kind == "front" else 1.0),)))
    camera_at = stage.camera_at(stage.fit(0, 45), 0, 45, (300, 200))
    for frame in range(0, 45, 4):
        poses = stage.poses(frame)
        camera = camera_at(frame, poses[0][1])
        pelvises = np.stack([pose.root for pose in poses])
        pixels, depth = project(camera, pelvises)
        assert (depth > 0).all() and (pixels > 20).all() and (pixels < (280, 180)).all()
    if kind in ("orbit", "turntable"):  # one round a second, at the motion's 30 frames
        first, after = (camera_at(frame, np.zeros(3)).camera_from_world for frame in (0, 30))
        assert np.abs(first - after).max() < 1e-9
        assert np.abs(camera_at(15, np.zeros(3)).camera_from_world - first).max() > 1


def test_a_placed_camera_stands_goes_along_and_goes_round(tiny_path):
    eye, target, size = np.array([1.0, 1.4, 2.0]), np.array([0.0, 1.0, 0.0]), (60, 40)
    cameras = {}
    for kind in ("front", "follow", "orbit", "turntable"):
        camera = SceneCamera(kind, seconds=4.0, fov_deg=20.0, eye=tuple(eye.tolist()), target=tuple(target.tolist()))
        stage = Stage(Scene((SceneAvatar(tiny_path, "walking"),), (camera,)))
        assert stage.fit(0, stage.frames) is None
        at = stage.camera_at(None, 0, stage.frames, size)
        cameras[kind] = [at(frame, stage.poses(frame)[0][1]) for frame in (0, 30)]
        assert np.allclose(cameras[kind][0].eye, eye) and project(cameras[kind][0], target[None])[0] == pytest.approx(
            np.array([[30.0, 20.0]])
        )
    walked = (stage.poses(30)[0][1] - stage.poses(0)[0][1]) * [1, 0, 1]
    assert np.allclose(cameras["front"][1].eye, eye) and np.allclose(cameras["follow"][1].eye, eye + walked)
    # a quarter of a round
    quarter = target + [2.0, 0.4, -1.0]
    assert np.allclose(cameras["turntable"][1].eye, quarter) and np.allclose(cameras["orbit"][1].eye, quarter + walked)
    assert cameras["front"][0].K[1, 1] == pytest.approx(20 / np.tan(np.radians(10)))


def test_levels_and_qualities_choose_what_is_drawn(tiny_path, tmp_path):
    def passes(*more):
        out = tmp_path / "passes.json"
        words = "--motion walking --frame 3 --size 40x48 --explain --json".split()
        render_main([tiny_path, *words, str(out), *more, "-o", str(tmp_path / "a.png")])
        return {row["name"]: row for row in json.loads(out.read_text())["passes"]}

    good, draft, best = passes(), passes("--quality", "draft"), passes("--quality", "best")
    triangles = len(tiny_avatar().levels[0].faces), len(tiny_avatar().levels[1].faces)
    fine, coarse = (passes("--view", "off", "--level", level) for level in ("0", "1"))
    assert f"{triangles[0]} triangles" in str(fine) and f"{triangles[1]} triangles" in str(coarse)
    assert f"{triangles[1]} triangles" in str(draft)
    running = [{name for name, row in rows.items() if row["runs"]} for rows in (good, draft, best)]
    assert running[0] == {"avatar: view vertex", "antialiasing: fxaa"} and running[1] == {"avatar: paper"}
    assert running[2] == {"avatar: view network", "antialiasing: msaa"}
    assert "antialiasing: msaa" not in passes("--quality", "best", "--antialiasing", "fxaa")
    assert (
        not {"antialiasing: msaa", "antialiasing: fxaa"} & passes("--quality", "best", "--antialiasing", "none").keys()
    )


def test_a_draft_takes_the_third_of_four_levels_and_the_body_stands_as_it_stands(tiny_path):
    assert level_of(RenderCommand("a.mp4", ("me.glb",), quality="draft")) == 2
    assert level_of(RenderCommand("a.mp4", ("me.glb",), quality="draft", level=3)) == 3
    assert level_of(RenderCommand("a.mp4", ("me.glb",))) == 0
    # A picture reads one level, the window all: both put the root at the same height.
    scene = Scene(avatars=(SceneAvatar(tiny_path, motion="walking"),))
    (all_of,), (one,) = (Stage(scene, levels).poses(7) for levels in (None, 1))
    assert np.array_equal(all_of[0], one[0]) and np.array_equal(all_of[1], one[1])


def test_an_order_names_all_its_files_and_changes_with_each(tiny_path, tmp_path):
    camera = tmp_path / "camera.json"
    write_camera(camera, orbit_camera((0, 0.9, 0), 3.0, 0.5, 0.1, (40, 48)))
    scene = Scene((SceneAvatar(tiny_path, "walking"),), cameras=(SceneCamera("file", str(camera)),))
    shot = Shot(scene, 0, 10, (40, 48), 30.0, None)
    assert shot.files() == sorted([tiny_path, str(camera)])
    before = Parts(tmp_path / "a.mp4", 0, 10, shot.identity())
    before.begin(resume=False)
    write_camera(camera, orbit_camera((0, 0.9, 0), 3.0, 0.6, 0.1, (40, 48)))
    with pytest.raises(AssetError, match=r"\(files differ\)"):
        Parts(tmp_path / "a.mp4", 0, 10, shot.identity()).begin(resume=True)


@pytest.mark.parametrize(
    ("scene", "message"),
    [
        (Scene(()), "no avatar"),
        (Scene((SceneAvatar("mannequin", live="vmc:39539"),)), "live = 'vmc:39539' is for `selfscan play`"),
        (Scene((SceneAvatar("mannequin"),), cameras=(SceneCamera("capture", "none"),)), "none"),
    ],
)
def test_scenes_that_make_no_film_are_refused(scene, message):
    refused(AssetError, message, Stage, scene)


def test_what_was_assumed_about_several_motions_says_of_which_avatar(tiny_path, tmp_path):
    pose = np.zeros((4, 156))
    pose[:, 0] = np.pi / 2
    np.savez(tmp_path / "in.npz", poses=pose, trans=np.tile([0, 0, 0.9], (4, 1)), mocap_framerate=30.0)
    one, two = SceneAvatar(tiny_path, motion=str(tmp_path / "in.npz")), SceneAvatar("mannequin", motion="counting")
    both, alone = Stage(Scene((one, two))), Stage(Scene((one,)))
    assert both.name == "the scene" and alone.name.endswith("in.npz")
    assert sum(note.startswith("hands: as stored") for note in both.notes) == 1
    assert any(note.startswith("avatar 1 (") and "up: z" in note for note in both.notes)
    assert any(note.startswith("avatar 2 (counting), up: y") for note in both.notes)
    assert Stage(Scene((two, two))).notes == Stage(Scene((two,))).notes
    assert not any(note.startswith("avatar 1") for note in alone.notes)


def test_films_and_the_window_open_a_scene_alike(tmp_path):
    write_camera(tmp_path / "camera.json", orbit_camera((0, 1, 0), 3.0, 0.2, 0.0, (50, 70)))
    scene = Scene(
        (SceneAvatar("mannequin", "walking", at=(0.5, 0.0, -1.0), turn_deg=30.0, start=0.5), SceneAvatar("mannequin")),
        cameras=(SceneCamera("file", str(tmp_path / "camera.json")),),
        rate=25.0,
    )
    stage, show = Stage(scene), opened_show(scene, opened_avatars(scene))
    assert stage.avatars[0] is stage.avatars[1], "read once"
    assert [track.name for track in stage.tracks] == [track.name for track in show.playback.tracks]
    assert stage.notes == notes_of(show.playback.tracks) != []
    assert stage.frames == show.playback.timeline.frames
    show.playback.timeline.scrub(1.2)
    for filmed, shown in zip(stage.poses(30), show.playback.poses(), strict=True):
        assert np.array_equal(filmed[0], shown[0]) and np.array_equal(filmed[1], shown[1])
    size = stage.size()
    filmed = stage.camera_at(None, 0, stage.frames, size)(30, np.zeros(3))
    assert np.allclose(filmed.camera_from_world, show.cameras.camera(size, 1.2, 30).camera_from_world)
