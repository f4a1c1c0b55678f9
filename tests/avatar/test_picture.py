"""Pictures of others: named formats, a size that is known before decoding, and one line for everything else."""

import ast
import io
import os
import struct
import tracemalloc
import zlib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from avatar.errors import AssetError
from avatar.picture import WITH_WEBP, decode_picture, picture_size, read_picture
from capture.folder import _read_frames
from capture.imports.folder import read_frame, read_mask
from player.passes.background import Background, opened_source

ROOT = Path(__file__).parent.parent.parent
EPS = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n%%EndComments\n(%pipe%id) (w) file\nshowpage\n%%EOF\n"


def png(width, height, rows=b""):
    parts = [(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)), (b"IDAT", zlib.compress(rows))]
    chunks = [
        struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
        for kind, body in [*parts, (b"IEND", b"")]
    ]
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunks)


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
    "nothing": b"",
    "text": b"no picture",
    "a PNG of 13,000 x 13,000": png(13000, 13000),
    "a PNG of 2^31": png(2**31 - 1, 2**31 - 1),
    "a PNG without pixels": png(0, 0),
    "a PNG header": png(8, 8)[:40],
    "half a PNG": saved("PNG", (64, 64))[:3000],
    "half a JPEG": saved("JPEG", (64, 64))[:900],
    "a JPEG header": saved("JPEG")[:4],
}


def readers(path):
    """Every way by which a picture file reaches a decoder, the file at `path`."""
    yield lambda: read_picture(path)
    yield lambda: read_picture(path, None)
    yield lambda: _read_frames(path.parent, "RGB")
    yield lambda: read_frame(path, (6, 4))
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
    tracemalloc.start()
    try:
        for read in readers(path):
            with pytest.raises(AssetError, match=r"000000\.png: ") as error:
                read()
            assert "\n" not in str(error.value) and "0x" not in str(error.value)
        assert tracemalloc.get_traced_memory()[1] < 16 << 20
    finally:
        tracemalloc.stop()
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


@pytest.mark.parametrize("place", ["absent.png", "", "pipe.png", "/dev/zero"])
def test_no_file_a_folder_a_pipe_and_a_device_are_refused_at_once(tmp_path, place):
    os.mkfifo(tmp_path / "pipe.png")
    for read in (read_picture, picture_size):
        with pytest.raises(AssetError, match=r"no such file|a folder|a device, pipe or socket"):
            read(tmp_path / place)


def test_pictures_come_back_as_they_are(tmp_path):
    for kind in ("PNG", "WEBP"):
        pixels = np.random.default_rng(1).integers(0, 256, (5, 7, 3), np.uint8)
        Image.fromarray(pixels).save(tmp_path / f"a.{kind.lower()}", lossless=True)
        found = read_picture(tmp_path / f"a.{kind.lower()}", formats=WITH_WEBP)
        np.testing.assert_array_equal(found, pixels)
        assert picture_size(tmp_path / f"a.{kind.lower()}", formats=WITH_WEBP) == (7, 5)
    with pytest.raises(AssetError, match=r"a\.webp: expected a picture \(PNG or JPEG\), it begins with b'RIFF"):
        read_picture(tmp_path / "a.webp")


@pytest.mark.parametrize("kind", WITH_WEBP)
def test_cut_and_flipped_pictures_are_read_or_one_line(tmp_path, kind):
    whole, rng = saved(kind, (40, 30)), np.random.default_rng(2)
    path = tmp_path / "a.bin"
    refused = 0
    for n in range(150):
        data = bytearray(whole)
        for place in rng.integers(0, len(whole), rng.integers(0, 4)):
            data[place] = rng.integers(256)
        path.write_bytes(data[: rng.integers(len(whole))] if n % 2 else data)
        try:
            read_picture(path, formats=WITH_WEBP)
        except AssetError as error:
            refused += 1
            assert str(path) in str(error) and "\n" not in str(error)
    assert refused > 50


def film(path):
    import av

    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=25)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        for level in range(0, 250, 10):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(np.full((48, 64, 3), level, np.uint8), "rgb24")))
        container.mux(stream.encode(None))


def test_broken_films_are_shown_or_one_line(tmp_path):
    film(tmp_path / "whole.mp4")
    whole, rng = (tmp_path / "whole.mp4").read_bytes(), np.random.default_rng(3)
    path, refused = tmp_path / "a.mp4", 0
    for n in range(80):
        data = bytearray(whole)
        for place in rng.integers(0, len(whole), rng.integers(1, 30)):
            data[place] = rng.integers(256)
        path.write_bytes(data[: rng.integers(len(whole))] if n % 2 else data)
        try:
            source = opened_source(Background("video", path=str(path)))
            for seconds in (0.0, 0.9, 0.2, 1e9):
                source.pixels(seconds, (16, 12))
            source.close()
        except AssetError as error:
            refused += 1
            assert str(path) in str(error) and "\n" not in str(error)
    assert refused > 10


@pytest.mark.parametrize(
    "script", ["ffconcat version 1.0\nfile whole.mp4\n", "#EXTM3U\n#EXTINF:1,\nwhole.mp4\n#EXT-X-ENDLIST\n"]
)
def test_a_film_that_is_a_list_of_other_files_is_refused(tmp_path, script):
    film(tmp_path / "whole.mp4")
    (tmp_path / "a.mp4").write_text(script)
    with pytest.raises(AssetError, match=r"a\.mp4: cannot be read as a film"):
        opened_source(Background("video", path=str(tmp_path / "a.mp4")))


def test_pictures_are_opened_in_one_place_only():
    found = []
    packages = ("avatar", "capture", "synth", "player", "bench", "bake", "train", "geometry", "selfscan")
    for path in (path for package in packages for path in (ROOT / package).rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.Attribute) and ast.unparse(node) in ("Image.open", "PIL.Image.open"):
                found.append(path.relative_to(ROOT).as_posix())
    assert found == ["avatar/picture.py"]
