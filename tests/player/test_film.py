"""Films and pictures in every format, their encoders, and what a shutter and a lens make of a film."""

from dataclasses import replace

import av
import numpy as np
import pytest
from pictures import pixels
from PIL import Image

from avatar.camera import orbit_camera
from avatar.motion.clip import Clip
from avatar.motion.read import builtin_motion
from command.errors import AssetError
from player.effects.ground import Ground
from player.effects.lens import SHARP, STILL, DepthOfField, MotionBlur
from player.film import exposure
from player.film.exposure import exposures, lens_point, through
from player.film.film import WAITING, Film, straight
from player.film.shot import Shot, ShotRenderer
from player.film.stage import Stage
from player.scene.effects import PLAIN, Effects
from player.scene.renderer import Renderer
from player.scene.scene import Scene, SceneAvatar, SceneCamera
from player.scene.track import Track


def frame(i, width=101, height=75):
    image = np.zeros((height, width, 4), np.uint8)
    image[20:50, 10 + i : 60 + i] = (200, 50, 100, 255)
    image[60:72] = (30, 200, 20, 255)
    return image


def filmed(path, frames, rate=30.0, **more):
    """The film of these frames, written."""
    with Film(path, rate, **more) as film:
        for image in frames:
            film.add(image)
    return film


@pytest.mark.parametrize(("name", "rate"), [("a.mp4", 29.97), ("a.webm", 25.0), ("a.mov", 120.00004)])
def test_video_is_tagged_bt709_padded_and_shows_the_colours(tmp_path, name, rate):
    film = filmed(tmp_path / name, map(frame, range(12)), rate)
    assert film.frames == 12 and "padded" in film.notes[0]
    with av.open(str(tmp_path / name)) as container:
        stream = container.streams.video[0]
        frames = list(container.decode(stream))
        assert len(frames) == 12 and (frames[0].width, frames[0].height) == (102, 76)
        assert abs(float(stream.average_rate or 0) - rate) < 0.01
        assert int(frames[0].colorspace) == 1 and stream.codec_context.color_primaries == 1
        assert name != "a.mp4" or stream.codec_context.pix_fmt == "yuv420p"
        picture = frames[6].to_ndarray(format="rgb24").astype(int)
    assert np.abs(picture[35, 40] - (200, 50, 100)).max() <= 6
    assert np.abs(picture[66, 80] - (30, 200, 20)).max() <= 6


def test_pictures_hold_exact_pixels_and_colours_are_divided_by_alpha(tmp_path):
    filmed(tmp_path / "one.png", [frame(0)], transparent=True)
    assert np.array_equal(pixels(tmp_path / "one.png"), frame(0))
    filmed(tmp_path / "frames", map(frame, range(3)))
    names = sorted(path.name for path in (tmp_path / "frames").glob("*.png"))
    assert names == ["000000.png", "000001.png", "000002.png"]
    assert np.array_equal(pixels(tmp_path / "frames" / names[2]), frame(2)[..., :3])
    image = np.array([[[64, 32, 0, 128], [0, 0, 0, 0], [255, 1, 2, 255]]], np.uint8)
    assert straight(image).tolist() == [[[128, 64, 0, 128], [0, 0, 0, 0], [255, 1, 2, 255]]]


@pytest.mark.parametrize("name", ["a.gif", "a.webp"])
def test_moving_pictures_have_every_frame(tmp_path, name):
    filmed(tmp_path / name, map(frame, range(5)), 20.0)
    with Image.open(tmp_path / name) as image:
        assert getattr(image, "n_frames", 1) == 5


@pytest.mark.parametrize("name", ["a.mp4", "a.gif", "frames"])
def test_an_error_while_drawing_leaves_nothing(tmp_path, name):
    with pytest.raises(ZeroDivisionError), Film(tmp_path / name, 30.0) as film:
        film.add(frame(0))
        raise ZeroDivisionError
    assert list(tmp_path.iterdir()) == []


def test_errors_of_the_encoder_its_sizes_and_films_without_frames_leave_nothing(tmp_path):
    with pytest.raises(AssetError, match="holds one frame"):
        filmed(tmp_path / "a.png", [frame(0)] * 100)
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(AssetError, match=r"a\.mp4: cannot be written as \.mp4"):
        filmed(tmp_path / "a.mp4", [np.zeros((2, 40_000, 4), np.uint8)] * 20)
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(AssetError, match="no frames"):
        filmed(tmp_path / "a.mp4", [])
    assert list(tmp_path.iterdir()) == []


@pytest.fixture(scope="module")
def drawn(context, avatar):
    """A few frames of the built-in body, walking, on a studio background; detail is in its brightness,
    as in photographs.
    """
    y, x = np.mgrid[:256, :256] / 256
    detail = 40 * ((np.floor(40 * x) + np.floor(40 * y)) % 2)[..., None]
    skin = np.stack([180 + 20 * np.sin(5 * x), 130 + 30 * np.sin(7 * y), 110 + 20 * np.cos(6 * x)], -1)
    level = replace(avatar.levels[0], base_color=(skin - detail).astype(np.uint8))
    avatar = replace(avatar, levels=(level,))
    renderer = Renderer(context, [avatar], (320, 321), view="off", background=(0.17, 0.18, 0.2, 1.0))
    clip = builtin_motion("walking").read(0, 12)
    camera = orbit_camera((0, 0.9, 0), 2.6, 0.4, 0.1, (320, 321))
    frames = [renderer.draw([pose], camera) for pose in zip(clip.axis_angle, clip.root, strict=True)]
    renderer.release()
    return frames


@pytest.mark.parametrize(("quality", "most", "psnr"), [("draft", 3.0, 32.0), ("good", 2.0, 35.0), ("best", 1.8, 37.0)])
def test_a_decoded_frame_of_an_mp4_is_near_to_the_png(drawn, tmp_path, quality, most, psnr):
    """Within 2/255 on average, and no channel off on the whole: matrix and range are those of the tag."""
    filmed(tmp_path / "a.mp4", drawn, quality=quality)
    with av.open(str(tmp_path / "a.mp4")) as container:
        decoded = [f.to_ndarray(format="rgb24")[:321, :320] for f in container.decode(video=0)]
    gap = np.stack(decoded).astype(float) - np.stack(drawn)[..., :3]
    mean = np.abs(gap).mean((1, 2, 3)).max()
    ratio = 10 * np.log10(255**2 / (gap**2).mean())
    assert mean < most and ratio > psnr
    assert np.abs(gap.mean((0, 1, 2))).max() < 2.0


def test_kept_arrays_are_few_and_an_odd_size_is_padded_with_its_edge(drawn, tmp_path):
    """A canvas comes back when its frame is written, never before: the film is that of frames kept apart."""
    with Film(tmp_path / "kept.mp4", 30.0) as film:
        arrays = set()
        for number in range(60):
            canvas = film.canvas((320, 321))
            arrays.add(id(canvas))
            canvas[:] = drawn[number % 12]
            film.add(canvas)
    filmed(tmp_path / "apart.mp4", (drawn[number % 12].copy() for number in range(60)))
    assert len(arrays) <= WAITING + 3
    assert (tmp_path / "kept.mp4").read_bytes() == (tmp_path / "apart.mp4").read_bytes()
    image = np.zeros((31, 33, 4), np.uint8)
    image[..., 3], image[:, 32, 0], image[30, :, 2] = 255, 240, 240
    filmed(tmp_path / "a.mov", [image])
    with av.open(str(tmp_path / "a.mov")) as container:
        decoded = next(container.decode(video=0)).to_ndarray(format="rgb24").astype(int)
    assert decoded.shape == (32, 34, 3)
    assert np.abs(decoded[:31, :33] - image[..., :3]).max() <= 8
    assert np.abs(decoded[:31, 33] - image[:, 32, :3]).max() <= 8
    assert np.abs(decoded[31, :33] - image[30, :, :3]).max() <= 8


@pytest.mark.parametrize(("rate", "frames"), [(30.0, 60), (29.97, 40), (25.0, 50), (60.0, 120), (120.0, 240), (7.0, 1)])
def test_a_gif_plays_as_long_as_the_film(tmp_path, rate, frames):
    filmed(tmp_path / "a.gif", (frame(i % 40) for i in range(frames)), rate)
    lengths = []
    with Image.open(tmp_path / "a.gif") as image:
        for number in range(getattr(image, "n_frames", 1)):
            image.seek(number)
            lengths.append(image.info["duration"])
    assert abs(sum(lengths) - 1000 * frames / rate) <= 10 and min(lengths) >= 20


SIZE = (96, 96)
OFF = replace(PLAIN, view="off")


@pytest.fixture
def shot_of(request):
    """Makes renderers of shots of the walking built-in body, and frees them."""
    made = []

    def make(effects: Effects, motion: str | None = "walking", kind: str = "front") -> ShotRenderer:
        scene = Scene(
            (SceneAvatar("mannequin", motion),), (SceneCamera(kind, seconds=2.0),), effects=effects, size=SIZE
        )
        stage = Stage(scene, 1)
        shot = Shot(scene, 0, stage.frames, SIZE, stage.rate, stage.fit(0, min(stage.frames, 60)))
        made.append(ShotRenderer(shot, stage))
        return made[-1]

    yield make
    for drawn in made:
        drawn.release()


def test_a_blurred_frame_is_the_mean_of_its_moments(shot_of):
    blurred, plain = shot_of(replace(OFF, motion_blur=MotionBlur(1.0, 6))), shot_of(OFF)
    image, frame = blurred.draw(33), 33
    camera = plain.camera_at(frame, plain.stage.poses(frame)[0][1])
    moments = [
        plain.renderer.draw(plain.stage.poses_beside(frame, (i + 0.5) / 6 - 0.5), camera).astype(float)
        for i in range(6)
    ]
    assert np.abs(image - np.mean(moments, 0)).max() <= 0.5
    assert (image != plain.draw(33)).any()
    (row,) = [row for row in blurred.renderer.explain(1) if row["name"] == "motion blur"]
    assert (row["state"], row["why"], row["bytes"]) == ("runs", "the mean of 6 frames", 0) and row["ms"] > 0


def test_what_is_in_focus_stays_sharp_and_the_rest_spreads(shot_of):
    """The circle of confusion of a point at depth z is f lens |1 / focus - 1 / z| pixels wide."""
    camera, focus, diameter = orbit_camera((0, 0.9, 0), 3.0, 0.3, 0.1, SIZE), 2.7, 0.1
    points = np.array([[0.1, -0.2, z, 1.0] for z in (1.5, focus, 6.0)])
    to_world = np.linalg.inv(camera.camera_from_world)
    spread = []
    for point in points:
        at = []
        for index in range(64):
            seen = through(camera, 0.5 * diameter * lens_point(index, 64), focus)
            pixel = seen.K @ (seen.camera_from_world @ (to_world @ point))[:3]
            at.append(pixel[:2] / pixel[2])
        spread.append(2 * np.linalg.norm(np.array(at) - np.mean(at, 0), axis=1).max())
    expected = camera.K[0, 0] * diameter * np.abs(1 / focus - 1 / points[:, 2])
    np.testing.assert_allclose(spread, expected, rtol=0.03, atol=1e-9)
    deep, plain = shot_of(replace(OFF, depth_of_field=DepthOfField(0.2, samples=12))), shot_of(OFF)
    assert (deep.draw(20) != plain.draw(20)).any()


@pytest.mark.parametrize(
    ("effects", "why"),
    [(replace(OFF, motion_blur=MotionBlur()), STILL), (replace(OFF, depth_of_field=DepthOfField(1e-4)), SHARP)],
)
def test_what_cannot_show_is_the_frame_and_its_calls(shot_of, effects, why):
    images, calls = [], []
    for wish in (effects, OFF):
        drawn = shot_of(wish, motion=None)
        drawn.draw(0)
        counts = drawn.context.counts
        before, objects = counts.calls.copy(), counts.objects()
        images.append(drawn.draw(0))
        calls.append((counts.calls - before, objects))
        rows = {one.item.name: one.decision for one in drawn.renderer.drawn}
        if wish is effects:
            assert [rows[name].why for name in ("motion blur", "depth of field") if rows[name].state == "skipped"] == [
                why
            ]
    assert np.array_equal(*images) and calls[0] == calls[1]


def test_moments_and_places_on_the_lens_each_come_once(shot_of):
    both = replace(OFF, motion_blur=MotionBlur(0.5, 8), depth_of_field=DepthOfField(0.3, 0.0, 24))
    drawn, seen = shot_of(both), []

    def view_at(share):
        seen.append(share)
        poses = drawn.stage.poses_beside(30, share) if share else drawn.stage.poses(30)
        return poses, drawn.camera_at(30, poses[0][1])

    views = exposures(both, view_at, drawn.renderer.posers)
    assert len(views) == 24
    np.testing.assert_allclose(sorted(seen[-24:]), ((np.arange(24) + 0.5) / 24 - 0.5) / 2)
    eyes = np.array([camera.eye for _, camera in views])
    assert len(np.unique(eyes.round(9), axis=0)) == 24
    assert np.linalg.norm(eyes.mean(0) - drawn.camera_at(30, np.zeros(3)).eye) < 0.01
    assert [exposure._stride(count) for count in (1, 2, 4, 24)] == [1, 1, 3, 17]


def moving(root: np.ndarray, rate: float = 30.0) -> Track:
    return Track(Clip(np.zeros((len(root), 52, 3)), root.astype(float), rate))


def test_a_teleport_is_not_smeared():
    root = np.zeros((20, 3))
    root[:, 0] = 0.01 * np.arange(20)
    root[10:, 2] = 5.0
    track = moving(root)
    for frame, z in ((9, 0.0), (10, 5.0)):
        for share in np.linspace(-0.99, 0.99, 7):
            pose = track.pose_beside(frame / 30, share / 30)
            assert pose[1][2] == z
    at = [track.pose_beside(5 / 30, share / 30)[1][0] for share in (-0.5, 0.0, 0.25, 1.0)]
    np.testing.assert_allclose(at, [0.045, 0.05, 0.0525, 0.06], atol=1e-12)
    # a motion faster than the film: several of its frames, and none beyond the jump
    fast = moving(root, 120.0)
    assert {fast.pose_beside(8 / 120, share / 120)[1][2] for share in np.linspace(-2, 4, 30)} == {0.0}
    turned = Track(Clip(half_turn(), np.zeros((4, 3)), 30.0))
    assert np.array_equal(turned.pose_beside(2 / 30, -0.3 / 30)[0], half_turn()[2])
    # before the first and after the last frame
    assert track.pose_beside(0.0, -0.01)[1][0] == 0.0 and track.pose_beside(19 / 30, 0.01)[1][0] == pytest.approx(0.19)


def half_turn() -> np.ndarray:
    """Two frames, a half turn, two frames."""
    out = np.zeros((4, 52, 3))
    out[2:, 0, 1] = np.pi
    return out


def test_a_window_draws_each_moment_once_and_a_floor_is_always_out_of_focus_somewhere(
    context, render, avatar, pose, shot_of
):
    window = render(avatar, None, effects=replace(OFF, motion_blur=MotionBlur(), depth_of_field=DepthOfField()))
    why = {item.name: item.why for item in window.plan.passes if item.name in ("motion blur", "depth of field")}
    assert set(why.values()) == {"for films: a window draws each moment once"} and len(why) == 2
    wish = replace(OFF, depth_of_field=DepthOfField(1e-3, samples=4), ground=Ground("checker"))
    drawn = shot_of(wish, motion=None)
    drawn.draw(0)
    assert drawn.renderer.last.exposures == 4
