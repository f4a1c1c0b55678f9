import av
import numpy as np
import pytest
from PIL import Image

from avatar.errors import AssetError
from player.film import Film, film_kind, straight


def pixels(path):
    with Image.open(path) as image:
        return np.asarray(image)


def frame(i, width=101, height=75):
    image = np.zeros((height, width, 4), np.uint8)
    image[20:50, 10 + i : 60 + i] = (200, 50, 100, 255)
    image[60:72] = (30, 200, 20, 255)
    return image


@pytest.mark.parametrize(("name", "rate"), [("a.mp4", 29.97), ("a.webm", 25.0), ("a.mov", 120.00004)])
def test_video_is_tagged_bt709_padded_and_shows_the_colours(tmp_path, name, rate):
    with Film(tmp_path / name, rate) as film:
        for i in range(12):
            film.add(frame(i))
    assert film.frames == 12 and "padded" in film.notes[0]
    with av.open(str(tmp_path / name)) as container:
        stream = container.streams.video[0]
        frames = list(container.decode(stream))
        assert len(frames) == 12 and (frames[0].width, frames[0].height) == (102, 76)
        assert abs(float(stream.average_rate or 0) - rate) < 0.01
        assert int(frames[0].colorspace) == 1 and stream.codec_context.color_primaries == 1
        picture = frames[6].to_ndarray(format="rgb24").astype(int)
    assert np.abs(picture[35, 40] - (200, 50, 100)).max() <= 6
    assert np.abs(picture[66, 80] - (30, 200, 20)).max() <= 6


def test_mp4_is_yuv420p(tmp_path):
    with Film(tmp_path / "a.mp4", 30.0) as film:
        film.add(frame(0))
    with av.open(str(tmp_path / "a.mp4")) as container:
        assert container.streams.video[0].codec_context.pix_fmt == "yuv420p"


def test_transparent_webm_keeps_its_alpha(tmp_path):
    with Film(tmp_path / "a.webm", 30.0, transparent=True) as film:
        for i in range(3):
            film.add(frame(i))
    with av.open(str(tmp_path / "a.webm")) as container:
        context = av.CodecContext.create("libvpx-vp9", "r")
        packets = list(container.demux(video=0))
        frames = [f for p in packets for f in context.decode(p)]
    alpha = frames[0].to_ndarray(format="rgba")[..., 3]
    assert alpha[35, 40] > 240 and alpha[5, 5] < 15


def test_pictures_hold_exact_pixels(tmp_path):
    with Film(tmp_path / "one.png", 30.0, transparent=True) as film:
        film.add(frame(0))
    assert np.array_equal(pixels(tmp_path / "one.png"), frame(0))
    with Film(tmp_path / "frames", 30.0) as film:
        for i in range(3):
            film.add(frame(i))
    names = sorted(path.name for path in (tmp_path / "frames").glob("*.png"))
    assert names == ["000000.png", "000001.png", "000002.png"]
    assert np.array_equal(pixels(tmp_path / "frames" / names[2]), frame(2)[..., :3])


@pytest.mark.parametrize("name", ["a.gif", "a.webp"])
def test_moving_pictures_have_every_frame(tmp_path, name):
    with Film(tmp_path / name, 20.0) as film:
        for i in range(5):
            film.add(frame(i))
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
    with pytest.raises(AssetError, match="holds one frame"), Film(tmp_path / "a.png", 30.0) as film:
        for _ in range(100):
            film.add(frame(0))
    assert list(tmp_path.iterdir()) == []


def test_a_size_the_encoder_refuses_is_one_line(tmp_path):
    with (
        pytest.raises(AssetError, match=r"a\.mp4: cannot be written as \.mp4"),
        Film(tmp_path / "a.mp4", 30.0) as film,
    ):
        for _ in range(20):
            film.add(np.zeros((2, 40_000, 4), np.uint8))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["a.mp4", "a.webm", "a.mov", "a.gif", "a.webp"])
def test_a_film_of_one_pixel_is_written(tmp_path, name):
    with Film(tmp_path / name, 30.0) as film:
        film.add(np.full((1, 1, 4), 255, np.uint8))
    assert (tmp_path / name).stat().st_size > 30


def test_a_film_without_frames_is_refused(tmp_path):
    with pytest.raises(AssetError, match="no frames"), Film(tmp_path / "a.mp4", 30.0):
        pass
    assert list(tmp_path.iterdir()) == []


def test_an_unknown_ending_and_a_bad_rate_are_refused(tmp_path):
    with pytest.raises(ValueError, match=r"ends in \.avi"):
        film_kind("a.avi")
    with pytest.raises(ValueError, match="rate"):
        Film(tmp_path / "a.mp4", 0.0)
