"""Pictures and films of others: named formats, sizes known before decoding, one line for everything else."""

import io
import os
import struct
from pathlib import Path

import av
import numpy as np
import pytest
from memory_use import at_most
from pictures import film, png
from PIL import Image
from refusals import refused

from capture.folder import _read_frames
from capture.frame_files import sized_picture
from capture.read.folder import read_mask
from command.errors import AssetError
from files.input_file import open_film
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
    refused(ValueError, r"at most 67108864 pixels, found 1638. x 1638.", decode_picture, data, "RGB", formats=WITH_WEBP)


def test_pictures_come_back_as_they_are(tmp_path):
    for kind in ("PNG", "WEBP"):
        pixels = np.random.default_rng(1).integers(0, 256, (5, 7, 3), np.uint8)
        Image.fromarray(pixels).save(tmp_path / f"a.{kind.lower()}", lossless=True)
        found = read_picture(tmp_path / f"a.{kind.lower()}", formats=WITH_WEBP)
        np.testing.assert_array_equal(found, pixels)
        assert picture_size(tmp_path / f"a.{kind.lower()}", formats=WITH_WEBP) == (7, 5)
    with pytest.raises(AssetError, match=r"a\.webp: expected a picture \(PNG or JPEG\), it begins with b'RIFF"):
        read_picture(tmp_path / "a.webp")


LISTS = {
    "ffconcat": "ffconcat version 1.0\nfile whole.mp4\n",
    "endless ffconcat": "ffconcat version 1.0\n" + "file pipe\n" * 9999,
    "HLS": "#EXTM3U\n#EXT-X-TARGETDURATION:9\n#EXTINF:1,\nwhole.mp4\n#EXT-X-ENDLIST\n",
    "DASH": '<?xml version="1.0"?>\n<MPD xmlns="urn:mpeg:dash:schema:mpd:2011" type="static"><Period>'
    '<AdaptationSet mimeType="video/mp4"><Representation id="1"><BaseURL>whole.mp4</BaseURL></Representation>'
    "</AdaptationSet></Period></MPD>",
    "subtitles": "1\n00:00:00,000 --> 00:00:09,000\nHello\n",
    "SDP": "v=0\no=- 0 0 IN IP4 127.0.0.1\nc=IN IP4 127.0.0.1\nm=video 5004 RTP/AVP 96\na=rtpmap:96 H264/90000\n",
}


def refused_unopened(path: Path, monkeypatch) -> None:
    """Refused in one line that names the file, before FFmpeg has seen it."""
    with monkeypatch.context() as patch:
        patch.setattr(av, "open", lambda *_, **__: pytest.fail("FFmpeg was asked to open it"))
        with pytest.raises(AssetError) as error:
            open_film(path)
    assert str(error.value).startswith(f"{path}: ") and "\n" not in str(error.value)


@pytest.mark.parametrize("name", LISTS)
def test_a_list_of_other_files_is_refused_and_none_of_them_is_opened(tmp_path, monkeypatch, name):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "a.mp4").write_text(LISTS[name])
    refused_unopened(tmp_path / "a.mp4", monkeypatch)


def test_names_that_are_patterns_or_addresses_are_files(tmp_path, monkeypatch):
    Image.new("RGB", (8, 8)).save(tmp_path / "img001.png")
    (tmp_path / "img%03d.png").write_bytes((tmp_path / "img001.png").read_bytes())
    (tmp_path / "img%03d.png").rename(tmp_path / "img%03d.mp4")
    refused_unopened(tmp_path / "img%03d.mp4", monkeypatch)
    monkeypatch.chdir(tmp_path)
    for name in ("concat:whole.mp4|whole.mp4", "subfile,,start,0,end,0,,:whole.mp4", "pipe:0", "http:"):
        refused(AssetError, "no such file", open_film, Path(name))
    film(tmp_path / "odd.mp4")
    os.rename("odd.mp4", "pipe:0.mp4")
    open_film("pipe:0.mp4").close()


@pytest.mark.parametrize("kind", ["mp4", "mov", "mkv", "webm", "avi"])
def test_a_film_is_read_whatever_its_name(tmp_path, kind):
    film(tmp_path / f"a.{'mkv' if kind == 'webm' else kind}")
    next(tmp_path.iterdir()).rename(tmp_path / "film.bin")
    with open_film(tmp_path / "film.bin") as container:
        assert sum(1 for _ in container.decode(video=0)) == 5


def test_a_list_under_the_first_bytes_of_a_film_and_a_sound_are_refused_by_the_decoder(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "a.mp4").write_text("\0\0\0\x08ftypffconcat version 1.0\nfile pipe\n")
    refused(AssetError, r"a\.mp4: expected a .*, found: ", open_film, tmp_path / "a.mp4")
    with av.open(str(tmp_path / "a.mp4"), "w") as container:
        stream = container.add_stream("aac", rate=8000)
        sound = av.AudioFrame.from_ndarray(np.zeros((1, 1024), np.float32), "fltp", "mono")
        sound.sample_rate = 8000
        container.mux(stream.encode(sound))
        container.mux(stream.encode(None))
    refused(AssetError, r"a\.mp4: expected a film, .*found a file without pictures", open_film, tmp_path / "a.mp4")
