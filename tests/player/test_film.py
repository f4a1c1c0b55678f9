from dataclasses import replace

import av
import numpy as np
import pytest
from pictures import pixels
from PIL import Image

from avatar.camera import orbit_camera
from avatar.motion.read import builtin_motion
from command.errors import AssetError
from player.film.film import WAITING, Film, straight
from player.scene.renderer import Renderer


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


def test_pictures_hold_exact_pixels(tmp_path):
    filmed(tmp_path / "one.png", [frame(0)], transparent=True)
    assert np.array_equal(pixels(tmp_path / "one.png"), frame(0))
    filmed(tmp_path / "frames", map(frame, range(3)))
    names = sorted(path.name for path in (tmp_path / "frames").glob("*.png"))
    assert names == ["000000.png", "000001.png", "000002.png"]
    assert np.array_equal(pixels(tmp_path / "frames" / names[2]), frame(2)[..., :3])


@pytest.mark.parametrize("name", ["a.gif", "a.webp"])
def test_moving_pictures_have_every_frame(tmp_path, name):
    filmed(tmp_path / name, map(frame, range(5)), 20.0)
    with Image.open(tmp_path / name) as image:
        assert getattr(image, "n_frames", 1) == 5


def test_colours_are_divided_by_alpha():
    image = np.array([[[64, 32, 0, 128], [0, 0, 0, 0], [255, 1, 2, 255]]], np.uint8)
    assert straight(image).tolist() == [[[128, 64, 0, 128], [0, 0, 0, 0], [255, 1, 2, 255]]]


@pytest.mark.parametrize("name", ["a.mp4", "a.gif", "frames"])
def test_an_error_while_drawing_leaves_nothing(tmp_path, name):
    with pytest.raises(ZeroDivisionError), Film(tmp_path / name, 30.0) as film:
        film.add(frame(0))
        raise ZeroDivisionError
    assert list(tmp_path.iterdir()) == []


def test_an_error_of_the_encoder_reaches_the_drawing_side(tmp_path):
    with pytest.raises(AssetError, match="holds one frame"):
        filmed(tmp_path / "a.png", [frame(0)] * 100)
    assert list(tmp_path.iterdir()) == []


def test_a_size_the_encoder_refuses_is_one_line(tmp_path):
    with pytest.raises(AssetError, match=r"a\.mp4: cannot be written as \.mp4"):
        filmed(tmp_path / "a.mp4", [np.zeros((2, 40_000, 4), np.uint8)] * 20)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["a.mp4", "a.webm", "a.mov", "a.gif", "a.webp"])
def test_a_film_of_one_pixel_is_written(tmp_path, name):
    filmed(tmp_path / name, [np.full((1, 1, 4), 255, np.uint8)])
    assert (tmp_path / name).stat().st_size > 30


def test_a_film_without_frames_or_without_a_rate_is_refused(tmp_path):
    with pytest.raises(ValueError, match="rate"):
        Film(tmp_path / "a.mp4", 0.0)
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


def test_drawing_into_kept_arrays_needs_few_of_them(drawn, tmp_path):
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


def test_an_odd_size_is_padded_with_its_edge_not_scaled(tmp_path):
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
