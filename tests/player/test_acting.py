"""Life and speech in scenes: never unasked in films, the same in any order, and silent where a face is driven."""

import wave
from dataclasses import replace

import numpy as np
import pytest
from faced_avatar import faced

from avatar.camera import orbit_camera
from avatar.face import SHAPES
from avatar.gaze import YAW
from avatar.gltf.avatar_file import write_avatar
from avatar.motion.amass import write_amass
from avatar.motion.clip import Clip
from player.draw.drawing import Pose
from player.film.stage import Stage
from player.play_command import with_life
from player.scene.acting import ALONE, Acting
from player.scene.motions import standing
from player.scene.opened import still_faces
from player.scene.scene import Scene, SceneAvatar
from player.scene.track import Track
from player.window.playback import Playback

JAW = SHAPES.index("jawOpen")
EYE = np.array([0.0, 1.6, 2.0])


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """An avatar with a face, a second of a buzzing voice, and a motion of three seconds with a face of its own."""
    folder = tmp_path_factory.mktemp("acting")
    write_avatar(folder / "a.glb", faced())
    voice = np.zeros(16_000)
    voice[4000:12_000] = 9000 * np.sign(np.sin(2 * np.pi * 110 * np.arange(8000) / 16_000))
    with wave.open(str(folder / "a.wav"), "wb") as file:
        file.setparams((1, 2, 16_000, 0, "NONE", ""))
        file.writeframes(voice.astype("<i2").tobytes())
    still, root = np.zeros((90, 52, 3)), np.tile([0.0, 0.9, 0.0], (90, 1))
    write_amass(folder / "a.npz", Clip(still, root, 30.0, face=np.full((90, 52), 0.25), gaze=np.zeros((90, 2, 2))))
    return {name: str(folder / f"a.{name}") for name in ("glb", "wav", "npz")}


def stage(files, **asked):
    return Stage(Scene((SceneAvatar(files["glb"], **asked),)))


def shown(stage, frame):
    camera = orbit_camera((0, 1.6, 0), 1.0, 0.2, 0.0, (64, 64))
    return stage.faced(stage.poses(frame), frame, camera)[0]


def test_nothing_lives_unasked_and_what_was_asked_is_the_same_in_any_order(files):
    plain = stage(files)
    assert plain.frames == 1 and shown(plain, 0).face is None
    first, second = stage(files, life=3), stage(files, life=3)
    assert first.frames == ALONE * 30
    frames = [0, 40, 200, 299]
    forwards = [shown(first, frame) for frame in frames]
    backwards = [shown(second, frame) for frame in reversed(frames)][::-1]
    for a, b in zip(forwards, backwards, strict=True):
        assert a.axis_angle.tobytes() == b.axis_angle.tobytes() and a.face.weights.tobytes() == b.face.weights.tobytes()
    assert np.abs(forwards[0].axis_angle - forwards[2].axis_angle).max() > 1e-3


def test_a_moved_body_does_not_sway_a_driven_face_does_not_live_and_a_voice_moves_both_mouths(files):
    moving = stage(files, motion=files["npz"], life=1)
    assert moving.frames == 90
    pose = shown(moving, 40)
    assert np.array_equal(pose.axis_angle, moving.tracks[0]._own(40).axis_angle) and np.allclose(
        pose.face.weights, 0.25
    )
    talking = [stage(files, speech=files["wav"], **more) for more in ({}, {"motion": files["npz"]}, {"life": 1})]
    assert [one.frames for one in talking] == [30, 90, 30]
    for one, rest in zip(talking, (0, 0.25, 0), strict=True):
        jaw = [shown(one, frame).face.weights[JAW] for frame in (0, 15, 29)]
        assert abs(jaw[0] - rest) < 1e-3 and jaw[1] > rest + 0.1 and jaw[2] < rest + 0.02


@pytest.mark.parametrize("side", [-1, 1])
def test_eyes_are_at_the_camera_wherever_the_body_stands_and_leave_one_that_is_behind(side):
    acting, turned = Acting(faced(), 1), np.zeros((52, 3))
    turned[0, 1] = 0.5
    pose = Pose(turned, np.array([1.0, 0.9, 2.0]))
    head = np.array([1.0, faced().eyes[0].center[1] + 0.9, 2.0])

    def at(angle):
        direction = np.array([np.sin(0.5 + angle), 0.0, np.cos(0.5 + angle)])
        return acting.gaze(pose, head + 3 * direction)[:, 0].mean()

    assert abs(at(0.4 * side) - 0.4 * side) < 0.03 and abs(at(0.0)) < 0.03
    assert abs(at(side * np.pi * 0.9)) < 1e-9 and abs(at(side * 1.5 * YAW)) < abs(at(side * YAW)) <= YAW
    face = acting.faced(pose, 0.0, head + [0, 0, 9.0]).face
    assert face.gaze[:, 0].mean() < -0.4  # past its own shoulder
    later = turned.copy()
    later[15, 1] = 0.3  # the head will turn to the left
    behind, ahead = head - 3 * np.array([np.sin(0.5), 0.0, np.cos(0.5)]), Pose(later, pose.root)
    assert np.allclose(acting.gaze(pose, behind, ahead), [[0.3, 0]] * 2, atol=1e-6)


def test_the_window_gives_life_to_faces_alone_and_none_where_it_is_not_wanted(avatar):
    scene = Scene((SceneAvatar("builtin"), SceneAvatar("builtin", life=9), SceneAvatar("mannequin")))
    avatars = [faced(), faced(), avatar]
    assert [one.life for one in with_life(scene, avatars, True).avatars] == [1, 9, None]
    assert [one.life for one in with_life(scene, avatars, False).avatars] == [None] * 3
    track = Track(standing(0.9), acting=Acting(faced(), 1))
    playback = Playback([track])
    assert playback.lives and playback.timeline.frames == 1
    before = playback.poses()[0].axis_angle
    for _ in range(20):
        playback.advance(0.1)
    assert (
        np.abs(playback.poses()[0].axis_angle - before).max() > 1e-4 and playback.faced(playback.poses(), EYE)[0].face
    )
    playback.timeline.playing = False
    assert not playback.lives and not Playback([replace(track, acting=None)]).lives


@pytest.mark.parametrize("asked", [{"life": 1}, {"speech": "wav"}, {"motion": "npz"}], ids=str)
def test_a_face_that_stays_still_for_want_of_one_is_said(avatar, files, asked):
    tracks = stage(files, **{name: files.get(value, value) for name, value in asked.items()}).tracks
    coarse = replace(faced(), levels=(*faced().levels, *avatar.levels))
    assert still_faces(tracks, [coarse]) == [] == still_faces(stage(files).tracks, [avatar])
    assert [note.partition(";")[0].partition(": ")[2] for one, level in ((coarse, 7), (avatar, 0)) for note in
            still_faces(tracks, [one], level)] == [
        "its face stays still at level 1", "its face stays still for want of one in its file",
    ]  # fmt: skip
