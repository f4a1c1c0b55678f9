"""Filming with a webcam, in whose place a film is shown again and again."""

import errno

import av
import numpy as np
import pytest

from capture.raw import filming, webcam
from capture.raw.filming import Step, film_parts
from capture.raw.outline import outline
from capture.raw.video_file import open_video, read_frames
from capture.raw.webcam import Webcam, open_camera
from command.errors import AssetError
from command.interrupt import Stopped

# red on the left, blue on the right
HALVES = "color=red:size=160x90:rate=30[r];color=blue:size=80x90:rate=30[b];[r][b]overlay=80:0"


class Keys:
    """A viewer that presses keys at pictures, and keeps what it was shown."""

    def __init__(self, **keys: str):
        self.keys, self.shown = {int(at[1:]): key for at, key in keys.items()}, []

    def show(self, picture):
        self.shown.append(picture)
        assert len(self.shown) < 200, "it waits for a key"
        return [self.keys[len(self.shown)]] if len(self.shown) in self.keys else []


@pytest.fixture
def camera(monkeypatch):
    monkeypatch.setattr(filming, "COUNTDOWN", Step(0.19, "wait"))
    monkeypatch.setattr(filming, "STEPS", dict.fromkeys(filming.PARTS, (Step(0.3, "in"), Step(0.69, "turn", True))))
    camera = Webcam(av.open(HALVES, format="lavfi"))
    yield camera
    camera.close()


@pytest.mark.slow
def test_films_are_made_one_after_the_other_as_long_as_their_steps(camera, tmp_path):
    (tmp_path / "left.mp4").write_text("there already")
    viewer = Keys(_3="space", _45="n", _50="n")
    film_parts(tmp_path, camera, viewer.show)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["body.mp4", "left.mp4"]
    assert len(viewer.shown) == 50
    film = open_video(tmp_path / "body.mp4")
    frames = list(read_frames(film))
    assert film.size == (160, 90) and len(frames) == 30 and frames[-1].time == pytest.approx(29 / 30, abs=1e-3)
    # shown as in a mirror, filmed as it is
    assert frames[0].picture[45, 20, 0] > 200 and frames[0].picture[45, 140, 2] > 200
    assert viewer.shown[0][400, 100, 2] > 200 and viewer.shown[0][400, -100, 0] > 200


def test_escape_begins_a_film_again_and_a_closed_window_keeps_those_that_are_there(camera, tmp_path):
    viewer = Keys(_2="space", _20="escape", _25="space", _70="close")
    with pytest.raises(Stopped):
        film_parts(tmp_path, camera, viewer.show)
    assert [path.name for path in tmp_path.iterdir()] == ["body.mp4"]
    assert open_video(tmp_path / "body.mp4").frames == 30


@pytest.mark.slow
def test_the_ring_fills_and_outlines_fit_into_the_picture(camera, tmp_path):
    viewer = Keys(_1="space", _38="close")
    with pytest.raises(Stopped):
        film_parts(tmp_path, camera, viewer.show)
    yellow = [
        (np.abs(picture.astype(int) - filming.COLOR).max(-1) < 12)[50:260, -200:].sum() for picture in viewer.shown
    ]
    assert yellow[10] == 0 and 0 < yellow[18] < yellow[25] < yellow[36]
    for part in filming.PARTS:
        inside = np.asarray(outline(part, (640, 360)))[..., 3] > 0
        assert inside.any() and not inside[:5].any() and not inside[:, [0, -1]].any()
    left, right = (np.asarray(outline(f"hand_{side}", (640, 360)))[..., 3].astype(int) for side in ("left", "right"))
    # a mirror shows a left hand, palm to it, with its thumb on the right, and lower than the little finger
    columns = np.flatnonzero(left.any(0))
    assert left[:, columns[-1]].argmax() > left[:, columns[0]].argmax() + 10
    assert np.abs(left[:, ::-1] - right).mean() < 3


def test_no_camera_and_one_in_use_are_one_line(monkeypatch):
    class Device:
        name, description, media_types = "/dev/video3", "Front", ["video"]

    def busy(*_place, **_options):
        raise OSError(errno.EBUSY, "busy")

    monkeypatch.setattr(webcam.av, "open", busy)
    for devices, said in (([], "no camera 3 found; there are none"), ([Device] * 4, "Front cannot be opened: ano")):
        monkeypatch.setattr(webcam.av, "enumerate_input_devices", lambda _system, devices=devices: devices)
        with pytest.raises(AssetError, match=said):
            open_camera("3")
