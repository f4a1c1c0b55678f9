"""Pictures of others: named formats, a size that is known before decoding, and one line for everything else."""

import io
import struct

import numpy as np
import pytest
from memory_use import at_most
from pictures import png
from PIL import Image

from capture.folder import _read_frames
from capture.frame_files import sized_picture
from capture.read.folder import read_mask
from command.errors import AssetError
from files.picture import WITH_WEBP, decode_picture, picture_size, read_picture
from player.effects.background import Background, opened_source

EPS = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n%%EndComments\n(%pipe%id) (w) file\nshowpage\n%%EOF\n"


def saved(kind, size=(6, 4)):
    out = io.BytesIO()
    Image.fromarray(np.random.default_rng(0).integers(0, 256, (size[1], size[0], 3), np.uint8)).save(out, kind)
    return out.getvalue()


def webp_header(chunk, body):
    return b"RIFF" + struct.pack("<I", 200) + b"WEBP" + chunk + struct.pack("<I", 100) + body + bytes(100)


HOSTILE = {
    "EPS": EPS,
    "DDS": b"DDS " + struct.pack("<IIIII", 124, 0x1007, 20000, 20000, 0) + bytes(104),
    "TIFF": saved("TIFF"),
    "BMP": saved("BMP"),
    "GIF": saved("GIF"),
    "PPM": b"P6 30000 30000 255\n",
    "a PNG of 13,000 x 13,000": png(13000, 13000, color=2),
    "a PNG of 2^31": png(2**31 - 1, 2**31 - 1, color=2),
    "a PNG without pixels": png(0, 0, color=2),
}


def readers(path):
    """Every way by which a picture file reaches a decoder, the file at `path`."""
    yield lambda: read_picture(path)
    yield lambda: read_picture(path, None)
    yield lambda: _read_frames(path.parent, "RGB")
    yield lambda: sized_picture(path, (6, 4), "as its camera")
    yield lambda: read_mask(path, (6, 4), any_value=True)
    yield lambda: opened_source(Background("image", path=str(path)))
    yield lambda: opened_source(Background("video", path=str(path.parent))).pixels(0.0, (8, 8))


@pytest.mark.parametrize("name", HOSTILE)
def test_what_is_no_picture_of_ours_is_one_line_soon_and_starts_no_program(tmp_path, monkeypatch, name):
    tools = tmp_path / "tools"
    tools.mkdir()
    (tools / "gs").write_text(f"#!/bin/sh\ntouch {tmp_path}/started\n")
    (tools / "gs").chmod(0o755)
    monkeypatch.setenv("PATH", str(tools), prepend=":")
    folder = tmp_path / "frames"
    folder.mkdir()
    path = folder / "000000.png"
    path.write_bytes(HOSTILE[name])
    with at_most(16 << 20):
        for read in readers(path):
            with pytest.raises(AssetError, match=r"000000\.png: ") as error:
                read()
            assert "\n" not in str(error.value) and "0x" not in str(error.value)
    assert not (tmp_path / "started").exists()


@pytest.mark.parametrize(
    "data",
    [
        webp_header(b"VP8X", bytes(4) + b"\xfe\x3f\0" * 2),
        webp_header(b"VP8L", b"\x2f" + b"\xff\xff\xff\x0f"),
        webp_header(b"VP8 ", b"\0\0\0\x9d\x01\x2a" + b"\xff\x3f\xff\x3f"),
    ],
)
def test_a_webp_of_many_pixels_is_refused_by_its_header(data):
    with pytest.raises(ValueError, match=r"at most 67108864 pixels, found 1638. x 1638."):
        decode_picture(data, "RGB", formats=WITH_WEBP)


def test_pictures_come_back_as_they_are(tmp_path):
    for kind in ("PNG", "WEBP"):
        pixels = np.random.default_rng(1).integers(0, 256, (5, 7, 3), np.uint8)
        Image.fromarray(pixels).save(tmp_path / f"a.{kind.lower()}", lossless=True)
        found = read_picture(tmp_path / f"a.{kind.lower()}", formats=WITH_WEBP)
        np.testing.assert_array_equal(found, pixels)
        assert picture_size(tmp_path / f"a.{kind.lower()}", formats=WITH_WEBP) == (7, 5)
    with pytest.raises(AssetError, match=r"a\.webp: expected a picture \(PNG or JPEG\), it begins with b'RIFF"):
        read_picture(tmp_path / "a.webp")
