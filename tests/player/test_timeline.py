"""Time that plays, loops, steps and scrubs, the tracks on it, and cameras that move along it."""

import json

import numpy as np
import pytest
from pictures import pictures_in

from avatar.camera import Camera, look_at, orbit_camera, pinhole, project
from avatar.motion.amass import write_amass
from avatar.motion.clip import Clip, Motion, fitted, resample
from avatar.motion.read import read_motion
from avatar.rotation import matrix_from_axis_angle
from command.errors import AssetError
from player.film.command import render_main
from player.scene.camera_path import CameraPath, is_path
from player.scene.motions import BLOCK
from player.scene.track import Track
from player.window.playback import Playback
from player.window.timeline import SPEEDS, Timeline


def test_a_second_of_play_is_a_second_of_clip_at_any_speed():
    for speed in SPEEDS:
        line = Timeline(1000, 30)
        line.speed = speed
        for _ in range(60):
            line.advance(1 / 60)
        assert line.frame == int(30 * speed) and abs(line.seconds - speed) < 1e-12


def test_steps_pause_and_stay_in_the_clip():
    line = Timeline(100, 30)
    line.step(-3)
    assert line.frame == 0 and not line.playing
    line.step(500)
    assert line.frame == 99
    for seconds in (0.0, 1.0, 1.033, 99.0, -1.0):
        line.scrub(seconds)
        assert line.frame == min(max(int(seconds * 30 + 1e-6), 0), 99)


def numbered(frames, rate=30.0, reads=None):
    """A motion whose pelvis is as high as the frame's number."""

    def block(start, stop):
        if reads is not None:
            reads.append((start, stop))
        root = np.zeros((stop - start, 3))
        root[:, 1] = np.arange(start, stop)
        return np.zeros((stop - start, 52, 3)), root

    return Track(Motion("", frames, rate, (), block))


def test_tracks_have_their_own_time_and_place_and_read_blocks():
    slow, fast = numbered(10, 10.0), numbered(200, 100.0)
    fast.start = 0.5
    playback = Playback([slow, fast])
    assert playback.timeline.duration == 1.5 and playback.timeline.rate == 10
    playback.timeline.seconds = 0.42
    assert [pose[1][1] for pose in playback.poses()] == [4, 92]
    playback.timeline.seconds = 1.45
    assert [pose[1][1] for pose in playback.poses()] == [9, 195]  # past its end the last frame is held
    reads = []
    track = numbered(10 * BLOCK, reads=reads)
    for frame in [*range(3 * BLOCK), 3 * BLOCK - 1, 2 * BLOCK - 1, 2 * BLOCK]:
        assert track.pose((frame + 0.5) / 30)[1][1] == frame
    assert reads == [(k * BLOCK, (k + 1) * BLOCK) for k in range(3)]
    assert len(track._blocks) == 2
    rng = np.random.default_rng(1)
    axis_angle, root = rng.normal(size=(1, 52, 3)), rng.normal(size=(1, 3))
    track = Track(Clip(axis_angle, root, 30.0), at=np.array([1.0, 0.0, -2.0]), turn=2.0)
    turned = matrix_from_axis_angle(np.array([0.0, 2.0, 0.0]))
    pose, place, face = track.pose(0.0)
    assert face is None
    assert np.allclose(place, turned @ root[0] + [1, 0, -2], atol=1e-12)
    assert np.allclose(matrix_from_axis_angle(pose[0]), turned @ matrix_from_axis_angle(axis_angle[0, 0]), atol=1e-12)
    assert np.array_equal(pose[1:], axis_angle[0, 1:])


def test_a_film_behind_goes_on_where_the_timeline_has_one_frame():
    still, moving = Playback([numbered(1)]), Playback([numbered(10, 10.0)])
    for _ in range(30):
        still.advance(0.05)
        moving.advance(0.05)
    assert still.film_seconds == pytest.approx(1.5) and moving.film_seconds == moving.timeline.seconds
    still.timeline.playing = False
    still.advance(1.0)
    assert still.film_seconds == pytest.approx(1.5)


def test_a_face_travels_from_its_file_to_the_poses_of_a_track(tmp_path):
    face, gaze = np.linspace(0, 1, 4 * 52).reshape(4, 52), np.linspace(-0.3, 0.3, 16).reshape(4, 2, 2)
    clip = Clip(np.zeros((4, 52, 3)), np.zeros((4, 3)), 10.0, face=face, gaze=gaze)
    write_amass(tmp_path / "talk.npz", clip)
    track = Track(fitted(read_motion(tmp_path / "talk.npz"), 0.9), start=0.1)
    shown = track.pose(0.1).face
    assert np.array_equal(shown.weights, face[2]) and np.array_equal(shown.gaze, gaze[2])
    between = track.pose_beside(0.1, 0.05).face
    assert np.allclose(between.weights, face[2:].mean(0)) and np.allclose(between.gaze, gaze[2:].mean(0))
    assert np.allclose(resample(clip, 20).face[1], face[:2].mean(0))


SIZE = (320, 240)
KEYS = [
    {"t": 0.0, "eye": [0, 1, 3], "target": [0, 1, 0]},
    {"t": 1.0, "eye": [2, 1.5, 2], "target": [0.2, 1, 0], "fov_deg": 20},
    {"t": 3.5, "eye": [3, 1, 0], "target": [0, 1.2, 0.1], "fov_deg": 60},
]


def written(tmp_path, keys):
    path = tmp_path / "path.json"
    path.write_text(json.dumps({"keys": keys}))
    return path


@pytest.fixture
def path(tmp_path):
    return CameraPath.read(written(tmp_path, KEYS))


@pytest.mark.parametrize("number", range(3))
def test_the_path_passes_through_its_keys(path, number):
    key = KEYS[number]
    camera = path.camera(key["t"], SIZE)
    expected = look_at(key["eye"], key["target"])
    assert np.abs(camera.camera_from_world - expected).max() < 1e-12
    assert np.abs(camera.K - pinhole(SIZE, np.radians(key.get("fov_deg", 35)))).max() < 1e-9


def test_the_path_is_smooth_stands_still_at_its_ends_and_a_straight_run_stays_even(path):
    """Second differences over a step h fall as h^2 (no kink), and first ones as h (no jump)."""
    for time in (1.0, 0.4, 2.0):
        rows = []
        for h in (1e-3, 5e-4):
            cameras = [path.camera(time + k * h, SIZE) for k in (-1, 0, 1)]
            flat = [np.concatenate([c.K.ravel(), c.camera_from_world.ravel()]) for c in cameras]
            rows.append((flat[2] - flat[0], flat[2] - 2 * flat[1] + flat[0]))
        assert np.allclose(rows[0][0], 2 * rows[1][0], rtol=0.05, atol=1e-4)
        assert np.abs(rows[1][1]).max() <= 0.6 * np.abs(rows[0][1]).max() + 1e-9
    for time, key in ((-5.0, 0), (99.0, 2)):
        assert np.allclose(path.camera(time, SIZE).eye, KEYS[key]["eye"], atol=1e-12)
    assert path.duration == 3.5
    cameras = [Camera(pinhole(SIZE, 0.6), look_at((x, 1, 4), (x, 1, 0)), SIZE) for x in (0.0, 0.5, 2.0)]
    run = CameraPath.through([0.0, 1.0, 4.0], cameras)
    for time in np.linspace(0, 4, 9):
        assert np.abs(run.camera(time, SIZE).eye - (0.5 * time, 1, 4)).max() < 1e-12


def test_camera_files_are_keys_and_any_size_shows_the_same_height(tmp_path):
    K = np.array([[900.0, 1.5, 300], [0, 880, 260], [0, 0, 1]])
    held = Camera(K, look_at((1, 2, 3), (0, 1, 0), (0.3, 1, 0)), (640, 480))
    key = {"t": 2.0, "size": [640, 480], "K": K.tolist(), "camera_from_world": held.camera_from_world.tolist()}
    path = CameraPath.read(written(tmp_path, [KEYS[0], key]))
    same = path.camera(2.0, (640, 480))
    assert np.abs(same.K - K).max() < 1e-9
    assert np.abs(same.camera_from_world - held.camera_from_world).max() < 1e-12
    wide = path.camera(2.0, (1280, 480))  # more to the sides, the same from top to bottom
    points = np.random.default_rng(0).normal(size=(20, 3)) * 0.3 + [0, 1, 0]
    (a, _), (b, _) = project(same, points), project(wide, points)
    assert np.abs(b - a - (320, 0)).max() < 1e-6


def test_what_is_written_is_read_again(path, tmp_path):
    tilted = Camera(
        np.array([[90.0, 0, 30], [0, 88, 26], [0, 0, 1]]), look_at((1, 2, 3), (0, 1, 0), (1, 1, 0)), (64, 48)
    )
    for kept in (path, CameraPath.through([0.0, 2.0], [tilted, orbit_camera((0, 1, 0), 2, 1, 0, SIZE)])):
        kept.write(tmp_path / "again.json")
        again = CameraPath.read(tmp_path / "again.json")
        for time in kept.seconds:
            a, b = kept.camera(time, SIZE), again.camera(time, SIZE)
            assert np.abs(a.K - b.K).max() < 1e-9
            assert np.abs(a.camera_from_world - b.camera_from_world).max() < 1e-12
    assert is_path(tmp_path / "again.json")


def test_eye_and_target_that_meet_keep_a_direction_and_what_is_no_json_is_refused(tmp_path):
    keys = [{"t": 0, "eye": [0, 1, 1], "target": [0, 1, 0]}, {"t": 1, "eye": [0, 1, -1], "target": [0, 1, 0]}]
    path = CameraPath.read(written(tmp_path, keys))
    for time in np.linspace(0, 1, 101):
        assert np.isfinite(path.camera(time, SIZE).camera_from_world).all()
    assert np.allclose(path.camera(0.5, SIZE).camera_from_world[2, :3], (0, 0, -1))
    (tmp_path / "x.json").write_text("[" * 10)
    with pytest.raises(AssetError, match=r"camera \(path\)"):
        is_path(tmp_path / "x.json")


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ([], "at least one key"),
        ([KEYS[1], KEYS[0]], "key 1: t should be after 1, is 0"),
        ([KEYS[0], KEYS[0]], "key 1: t should be after 0"),
        ([{"t": "now", "eye": [0, 0, 1], "target": [0, 0, 0]}], "key 0: t should be a number below 1e.09, is now"),
        ([{"t": 0, "eye": [0, 0], "target": [0, 0, 0]}], "eye: expected 3 numbers"),
        ([{"t": 0, "eye": [0, 0, 1], "target": [0, 0, 1]}], "target: expected another place"),
        ([{"t": 0, "eye": [0, 0, 1], "target": [0, 0, 0], "fov_deg": 180}], "fov_deg: expected at most 175"),
        ([{"t": 0, "eye": [0, 0, 1], "target": [0, 0, 0], "fov": 30}], "fov: unknown key in a key"),
        ([{"t": 0, "eye": [0, 0, 1], "target": [0, 0, 0], "up": [0, 0, 0]}], "up: expected a direction"),
        ([{"t": 0, "K": [[1]]}], "no .*camera_from_world"),
        ([5], "key 0: expected an object"),
    ],
)
def test_a_wrong_path_names_key_and_field(tmp_path, keys, message):
    with pytest.raises(AssetError, match=message):
        CameraPath.read(written(tmp_path, keys))


SIZES = [(640, 640), (360, 640), (640, 360), (480, 270), (200, 600)]


def margins(folder, size):
    """Pixels free at the left, right, top and bottom of all frames together."""
    seen = np.zeros((size[1], size[0]), bool)
    pictures = pictures_in(folder)
    assert pictures
    for picture in pictures:
        seen |= picture[..., 3] > 0
    rows, columns = np.flatnonzero(seen.any(1)), np.flatnonzero(seen.any(0))
    return columns[0], size[0] - 1 - columns[-1], rows[0], size[1] - 1 - rows[-1]


def filmed(avatar_path, folder, size, *options):
    plain = ["--view", "off", "--level", "9", "--background", "transparent", "--size", f"{size[0]}x{size[1]}"]
    assert render_main([avatar_path, *plain, *options, "-o", str(folder)]) == 0
    return margins(folder, size)


def check(found, size, *, play):
    """6 % in the direction that decides, no less in the other, both sides alike within `play` of the picture."""
    left, right, top, bottom = found
    width, height = size
    shares = (left / width, right / width, top / height, bottom / height)
    assert min(shares) > 0.06 - play, shares
    assert min(max(shares[:2]), max(shares[2:])) < 0.06 + play, shares
    assert abs(left - right) <= play * width and abs(top - bottom) <= play * height, found


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize(
    "motion, frames, play", [("counting", "60:61", 0.008), ("walking", "0:24", 0.012), ("counting", "0:40", 0.012)]
)
def test_front_leaves_even_margins_round_a_picture_and_a_film(avatar_path, tmp_path, size, motion, frames, play):
    check(filmed(avatar_path, tmp_path / "f", size, "--motion", motion, "--frames", frames), size, play=play)


@pytest.mark.parametrize("size", SIZES[:3])
@pytest.mark.parametrize("camera", ["orbit", "turntable"])
def test_a_camera_that_goes_round_leaves_even_margins(avatar_path, tmp_path, size, camera):
    seconds = ("--seconds", "1.5") if camera == "turntable" else ()
    found = filmed(
        avatar_path, tmp_path / "f", size, "--motion", "counting", "--frames", "0:45", "--camera", camera, *seconds
    )
    check(found, size, play=0.02)
