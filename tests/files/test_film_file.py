"""Films of others: named containers, one file, and one line for everything else. All who read them ask `open_film`."""

import os
from pathlib import Path

import av
import numpy as np
import pytest
from PIL import Image
from tiny_film import film

from command.errors import AssetError
from files.input_file import open_film

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
        with pytest.raises(AssetError, match="no such file"):
            open_film(Path(name))
    film(tmp_path / "odd.mp4")
    os.rename("odd.mp4", "pipe:0.mp4")
    open_film("pipe:0.mp4").close()


@pytest.mark.parametrize("kind", ["mp4", "mov", "mkv", "webm", "avi"])
def test_a_film_is_read_whatever_its_name(tmp_path, kind):
    film(tmp_path / f"a.{'mkv' if kind == 'webm' else kind}")
    next(tmp_path.iterdir()).rename(tmp_path / "film.bin")
    with open_film(tmp_path / "film.bin") as container:
        assert sum(1 for _ in container.decode(video=0)) == 5


def test_a_list_under_the_first_bytes_of_a_film_is_refused_by_its_decoder(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "a.mp4").write_text("\0\0\0\x08ftypffconcat version 1.0\nfile pipe\n")
    with pytest.raises(AssetError, match=r"a\.mp4: expected a .*, found: "):
        open_film(tmp_path / "a.mp4")


def test_a_sound_is_no_film(tmp_path):
    with av.open(str(tmp_path / "a.mp4"), "w") as container:
        stream = container.add_stream("aac", rate=8000)
        sound = av.AudioFrame.from_ndarray(np.zeros((1, 1024), np.float32), "fltp", "mono")
        sound.sample_rate = 8000
        container.mux(stream.encode(sound))
        container.mux(stream.encode(None))
    with pytest.raises(AssetError, match=r"a\.mp4: expected a film, .*found a file without pictures"):
        open_film(tmp_path / "a.mp4")
