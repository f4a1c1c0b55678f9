"""Cameras, places and levels of a film, through the command."""

import json

import numpy as np
import pytest
from pictures import pictures_in
from tiny_avatar import tiny_avatar

from avatar.camera import orbit_camera, project, write_camera, write_cameras
from command.errors import AssetError
from player.film.command import RenderCommand, render_main
from player.film.parts import Parts
from player.film.render import level_of
from player.film.shot import Shot
from player.film.stage import Stage, camera_from_option
from player.scene.scene import Scene, SceneAvatar, SceneCamera


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


def test_what_camera_means_is_seen_from_the_name_and_the_file(tmp_path):
    camera = orbit_camera((0, 0.9, 0), 3.0, 0.5, 0.1, (40, 48))
    write_camera(tmp_path / "camera.json", camera)
    (tmp_path / "path.json").write_text(json.dumps({"keys": [{"t": 0, "eye": [0, 1, 2], "target": [0, 1, 0]}]}))
    (tmp_path / "capture").mkdir()
    kinds = {
        "front": ("front", None), "orbit": ("orbit", None), "turntable": ("turntable", None),
        str(tmp_path / "camera.json"): ("file", None), str(tmp_path / "path.json"): ("path", None),
        str(tmp_path / "cameras.npz"): ("file", None), str(tmp_path / "capture"): ("capture", None),
        f"{tmp_path / 'capture'}:head": ("capture", "head"),
    }  # fmt: skip
    for text, (kind, name) in kinds.items():
        found = camera_from_option(text)
        assert (found.kind, found.name) == (kind, name)
    with pytest.raises(AssetError, match=r"none\.json"):
        camera_from_option("none.json")


@pytest.mark.parametrize("kind", ["front", "orbit", "turntable"])
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
        pelvises = np.stack([root for _, root in poses])
        pixels, depth = project(camera, pelvises)
        assert (depth > 0).all() and (pixels > 20).all() and (pixels < (280, 180)).all()
    if kind != "front":  # one round a second, at the motion's 30 frames
        first, after = (camera_at(frame, np.zeros(3)).camera_from_world for frame in (0, 30))
        assert np.abs(first - after).max() < 1e-9
        assert np.abs(camera_at(15, np.zeros(3)).camera_from_world - first).max() > 1


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


def test_a_draft_is_not_drawn_in_the_coarsest_of_four_levels():
    assert level_of(RenderCommand("a.mp4", ("me.glb",), quality="draft")) == 2
    assert level_of(RenderCommand("a.mp4", ("me.glb",), quality="draft", level=3)) == 3
    assert level_of(RenderCommand("a.mp4", ("me.glb",))) == 0


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
    with pytest.raises(AssetError, match=message):
        Stage(scene)


def test_a_body_stands_where_it_stands_whatever_levels_are_read(tiny_path):
    """A picture reads one level, the window all: both put the root at the same height."""
    scene = Scene(avatars=(SceneAvatar(tiny_path, motion="walking"),))
    (all_of,), (one,) = (Stage(scene, levels).poses(7) for levels in (None, 1))
    assert np.array_equal(all_of[0], one[0]) and np.array_equal(all_of[1], one[1])


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
