"""What is behind: pictures, films and panoramas as pixels, and the panorama in GLSL against NumPy."""

import numpy as np
import pytest
from pictures import film, greys, radiance_bytes, sky
from PIL import Image

from avatar.camera import Camera, look_at, orbit_camera, pinhole, pixel_rays
from command.errors import AssetError
from player.effects.background import Background, opened_source
from player.effects.background_source import _picture, fitted, laid, placed, read_panorama
from player.effects.radiance import read_radiance
from player.scene.effects import Effects

SIZE = (120, 90)


def test_where_a_picture_lies_and_contain_leaves_bars_of_the_colour():
    assert placed((200, 100), (100, 100), "cover") == (-50, 0, 200, 100)
    assert placed((200, 100), (100, 100), "contain") == (0, 25, 100, 50)
    assert placed((200, 100), (100, 100), "stretch") == (0, 0, 100, 100)
    assert placed((1, 5000), (100, 100), "contain") == (49, 0, 1, 100)
    white = np.full((10, 20, 4), 255, np.uint8)
    out = fitted(white, (20, 20), "contain", (0.0, 1.0, 0.0, 1.0))
    assert (out[5:15] == 255).all() and (out[[4, 15]] == (0, 255, 0, 255)).all()


def test_only_what_is_seen_of_a_picture_is_scaled_as_the_whole_would_be():
    nothing = (0.0, 0.0, 0.0, 0.0)
    picture = np.random.default_rng(1).integers(100, 150, (30, 7, 4), np.uint8)
    picture[..., 3] = 255
    for into in ((40, 21), (19, 90)):
        left, top, *size = placed((7, 30), into, "cover")
        whole = np.asarray(Image.fromarray(picture).resize(size, Image.Resampling.BICUBIC))
        gap = fitted(picture, into, "cover", nothing).astype(int) - laid(whole, left, top, into, nothing)
        assert np.abs(gap).max() <= 1
    strip = np.full((60_000, 1, 4), 255, np.uint8)
    assert (fitted(strip, (1280, 720), "cover", nothing) == 255).all()


def test_frames_of_a_folder_come_in_the_order_of_their_numbers(tmp_path):
    for number in (1, 2, 10):
        Image.new("RGB", (2, 2), (number,) * 3).save(tmp_path / f"{number}.png")
    (tmp_path / "._1.png").write_bytes(b"no picture")
    source = opened_source(Background("video", path=str(tmp_path), rate=1.0))
    assert [source.pixels(float(k), (2, 2))[0, 0, 0] for k in range(3)] == [1, 2, 10]


def test_a_picture_of_the_same_size_is_copied_and_alpha_lies_over_the_colour():
    picture = np.random.default_rng(0).integers(0, 256, (30, 40, 4), np.uint8)
    picture[..., 3] = 255
    assert np.array_equal(fitted(picture, (40, 30), "cover", (1.0, 0.0, 0.0, 1.0)), picture)
    picture[..., 3] = 128
    out = fitted(picture, (40, 30), "cover", (1.0, 0.0, 0.0, 1.0))
    expected = picture[..., :3] * (128 / 255) + np.array([255.0, 0, 0]) * (127 / 255)
    assert np.abs(out[..., :3] - expected).max() <= 0.51 and (out[..., 3] == 255).all()
    nothing = fitted(picture, (40, 30), "cover", (0.0, 0.0, 0.0, 0.0))
    assert (nothing[..., 3] == 128).all() and (nothing[..., :3] <= 128).all(), "premultiplied"


def test_a_camera_held_upright_is_seen_upright(tmp_path):
    image = Image.fromarray(np.array([[[255, 0, 0], [0, 0, 255]]], np.uint8))
    exif = Image.Exif()
    exif[0x0112] = 6  # turn by 90 degrees clockwise
    image.save(tmp_path / "phone.png", exif=exif)
    assert _picture(tmp_path / "phone.png").shape == (2, 1, 4)


def test_a_film_shows_the_frame_of_the_time_forwards_backwards_and_beyond(tmp_path):
    levels = list(range(20, 240, 2))
    film(tmp_path / "film.mp4", greys(levels))
    source = opened_source(Background("video", path=str(tmp_path / "film.mp4")))
    for frame in (0, 1, 2, 30, 31, 5, 109, 0, 60, 59, 108):
        pixels = source.pixels(frame / 25, SIZE)
        assert pixels.shape == (90, 120, 4) and (pixels[..., 3] == 255).all()
        assert abs(int(pixels[40, 60, 0]) - levels[frame]) <= 2, frame
    assert source.number(0.039) == source.number(0.0) != source.number(0.041)
    assert source.number(30 * 86400.0) == source.number(109 / 25) and source.number(-3.0) == source.number(0.0)
    source.close()


def test_a_panorama_is_twice_as_wide_as_high_lies_about_nothing_and_is_halved_if_wide(tmp_path, monkeypatch):
    (tmp_path / "square.hdr").write_bytes(radiance_bytes(sky(32)[:, :16]))
    with pytest.raises(AssetError, match=r"square\.hdr: a panorama should be twice as wide as high, is 16x16"):
        read_panorama(tmp_path / "square.hdr")
    data = radiance_bytes(sky(32))
    path = tmp_path / "sky.hdr"
    for wrong, complaint in (
        (b"-Y 99999 +X 99999", "expected 1 to"), (b"+X 32 -Y 16", "size should read"), (b"-Y 0 +X 32", "expected 1 to"),
        (b"-Y 16 +X 33", "should begin with 2, 2 and its width"), (b"-Y 17 +X 32", "ends before"),
    ):  # fmt: skip
        with pytest.raises(AssetError, match=complaint):
            read_radiance(_written(path, data.replace(b"-Y 16 +X 32", wrong)))
    with pytest.raises(AssetError, match="FORMAT should be"):
        read_radiance(_written(path, data.replace(b"rle_rgbe", b"rle_xyze")))
    import player.effects.background_source

    monkeypatch.setattr(player.effects.background_source, "PANORAMA_WIDTH", 32)
    (tmp_path / "sky.hdr").write_bytes(radiance_bytes(np.full((50, 100, 3), 0.5)))
    assert read_panorama(tmp_path / "sky.hdr").shape == (12, 24, 3)


# -- Radiance


@pytest.mark.parametrize("flat", [False, True])
def test_radiance_comes_back_within_its_mantissa(tmp_path, flat):
    light = sky(64) * 10.0 ** np.linspace(-6, 6, 64)[None, :, None]
    light[0, 0] = 0
    (tmp_path / "sky.hdr").write_bytes(radiance_bytes(light, flat=flat, magic=b"#?RGBE" if flat else b"#?RADIANCE"))
    found = read_radiance(tmp_path / "sky.hdr")
    assert found.shape == (32, 64, 3) and (found[0, 0] == 0).all()
    assert np.abs(found - light).max(where=light > 0, initial=0) > 0
    assert (np.abs(found - light) <= light.max(-1, keepdims=True) / 255).all()


def _written(path, data):
    path.write_bytes(data)
    return path


# -- the panorama as the camera sees it


def tone(light):
    """shaders/tone.glsl."""
    x = np.minimum(light * (1 + light / 16) / (1 + light), 1)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)


CAMERAS = {
    "front": orbit_camera((0, 0, 0), 3.0, 0.0, 0.05, SIZE),
    "where it closes": orbit_camera((0, 0, 0), 3.0, np.pi, 0.1, SIZE),
    "straight up": Camera(pinhole(SIZE, 1.2), look_at((0, 5, 0), (0, 9, 0)), SIZE),
}


@pytest.mark.parametrize("name", CAMERAS)
@pytest.mark.parametrize(("exposure", "turn"), [(0.0, 0.0), (-1.5, 70.0)])
def test_the_panorama_is_looked_up_along_each_ray(context, render, avatar, tmp_path, name, exposure, turn):
    light = sky(512)
    (tmp_path / "sky.hdr").write_bytes(radiance_bytes(light))
    light = read_radiance(tmp_path / "sky.hdr")
    background = Background("hdr", path=str(tmp_path / "sky.hdr"), exposure=exposure, turn_deg=turn)
    renderer = render(avatar, SIZE, effects=Effects("off", antialiasing="none"), background=background)
    away = (np.zeros((52, 3)), np.array([0.0, 0.0, 900.0]) @ CAMERAS[name].camera_from_world[:3, :3] * -1)
    image = renderer.draw([away], CAMERAS[name])

    _, d = pixel_rays(CAMERAS[name])
    around = np.arctan2(d[:, 0], -d[:, 2]) + np.radians(turn)
    u, v = (0.5 + around / (2 * np.pi)) % 1 * 512 - 0.5, (0.5 - np.arcsin(d[:, 1]) / np.pi) * 256 - 0.5
    x, y = np.floor(u).astype(int), np.floor(v).astype(int)
    p, q = (u - x)[:, None], (v - y)[:, None]

    def texel(i, j):
        return light[np.clip(y + j, 0, 255), (x + i) % 512].astype(float)

    seen = (texel(0, 0) * (1 - p) + texel(1, 0) * p) * (1 - q) + (texel(0, 1) * (1 - p) + texel(1, 1) * p) * q
    expected = 255 * tone(seen * 2.0**exposure).reshape(SIZE[1], SIZE[0], 3)
    assert expected.std() > 8, "a picture, not one colour"
    assert np.abs(image[..., :3] - expected).max() <= 2.5 and (image[..., 3] == 255).all()


def test_a_wide_view_of_a_large_panorama_does_not_flicker_between_texels(context, render, avatar, tmp_path):
    """Stripes finer than a pixel become their mean, by the mip that the camera asks for."""
    light = np.zeros((512, 1024, 3))
    light[:, ::2] = 0.4
    (tmp_path / "stripes.hdr").write_bytes(radiance_bytes(light))
    background = Background("hdr", path=str(tmp_path / "stripes.hdr"))
    renderer = render(avatar, (40, 30), effects=Effects("off", antialiasing="none"), background=background)
    camera = orbit_camera((0, 0, 0), 3.0, 0.0, 0.0, (40, 30), 1.2)
    image = renderer.draw([(np.zeros((52, 3)), np.array([0.0, 0.0, 9.0]))], camera)
    assert np.abs(image[..., :3] - 255 * tone(np.array(0.2))).max() <= 2
