"""A scene is opened in one way: films and the window have the same avatars, motions and cameras."""

import numpy as np

from avatar.camera import orbit_camera, write_camera
from player.film.stage import Stage
from player.scene.opened import opened_avatars
from player.scene.scene import Scene, SceneAvatar, SceneCamera
from player.window.show import opened_show


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
    assert stage.notes == show.notes != []
    assert stage.frames == show.playback.timeline.frames
    show.playback.timeline.scrub(1.2)
    for filmed, shown in zip(stage.poses(30), show.playback.poses(), strict=True):
        assert np.array_equal(filmed[0], shown[0]) and np.array_equal(filmed[1], shown[1])
    size = stage.size()
    filmed = stage.camera_at(None, 0, stage.frames, size)(30, np.zeros(3))
    assert np.allclose(filmed.camera_from_world, show.cameras.camera(size, 1.2, 30).camera_from_world)
