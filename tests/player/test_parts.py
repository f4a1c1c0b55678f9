"""Films in parts: stopped and gone on with, drawn by workers; always the film made in one go."""

import hashlib
import re
import signal
from dataclasses import replace
from pathlib import Path

import av
import numpy as np
import pytest
from pictures import pictures_in, pixels
from PIL import Image
from refusals import refused

import player.film.parts
import player.film.render
from avatar.camera import orbit_camera, write_camera
from command.errors import AssetError
from player.film.command import render_main
from player.film.film import join_pieces
from player.film.parts import Parts, fingerprint
from player.film.shot import ShotRenderer
from player.scene.camera_path import CameraPath

FRAMES = 50  # from 5 to 55: parts 5:20, 20:40, 40:55


@pytest.fixture(scope="module", autouse=True)
def short_parts():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(player.film.parts, "LENGTH", 20)
        patch.setattr(player.film.render, "LENGTH", 20)
        yield


@pytest.fixture(scope="module")
def arguments(tiny_path):
    return [tiny_path, "--motion", "walking", "--frames", "5:55", "--size", "49x48", "--camera", "orbit"]


@pytest.fixture(scope="module")
def films(arguments, tmp_path_factory):
    """Each kind of film, made in one go."""
    folder = tmp_path_factory.mktemp("films")
    for name in ("film.mp4", "frames"):
        render_main([*arguments, "-o", str(folder / name)])
    return folder


def decoded(path: Path) -> list[str]:
    """A digest of every frame, in order."""
    if path.is_dir():
        return [hashlib.md5(file.read_bytes()).hexdigest() for file in sorted(path.glob("*.png"))]
    if path.suffix == ".gif":
        with Image.open(path) as image:
            pictures = []
            for frame in range(getattr(image, "n_frames", 1)):
                image.seek(frame)
                pictures.append(hashlib.md5(image.convert("RGBA").tobytes()).hexdigest())
            return pictures
    with av.open(str(path)) as container:
        return [hashlib.md5(frame.to_ndarray().tobytes()).hexdigest() for frame in container.decode(video=0)]


@pytest.fixture
def stopping(monkeypatch):
    """Stops the drawing at a frame, as Ctrl-C does."""
    draw = ShotRenderer.draw

    def stop_at(number, error=KeyboardInterrupt):
        def stopped(self, frame, out=None):
            if frame == number:
                raise error
            return draw(self, frame, out)

        monkeypatch.setattr(ShotRenderer, "draw", stopped)
        return lambda: monkeypatch.setattr(ShotRenderer, "draw", draw)

    return stop_at


@pytest.mark.parametrize("name", ["film.mp4", "frames"])
def test_a_stopped_film_goes_on_and_is_the_film_in_one_go(arguments, films, tmp_path, stopping, name, capsys):
    out, go_on = tmp_path / name, stopping(45)
    with pytest.raises(KeyboardInterrupt):
        render_main([*arguments, "-o", str(out)])
    # the encoder may not be through with the second part when the drawing is stopped in the third
    assert re.search("[12] of 3 parts kept", capsys.readouterr().err)
    kept = sorted(path.name for path in (tmp_path / f"{name}.parts").iterdir())
    ending = Path(name).suffix
    assert kept == [f"00000005-00000020{ending}", f"00000020-00000040{ending}", "film.json"]
    go_on()
    drawn = []
    with pytest.MonkeyPatch.context() as patch:
        draw = ShotRenderer.draw
        patch.setattr(ShotRenderer, "draw", lambda self, frame, out=None: drawn.append(frame) or draw(self, frame, out))
        render_main([*arguments, "-o", str(out), "--resume"])
    assert drawn == list(range(40, 55))  # what was there is not drawn again
    assert sorted(path.name for path in tmp_path.iterdir()) == [name]
    frames = decoded(out)
    assert len(frames) == FRAMES and len(set(frames)) > 30 and frames == decoded(films / name)


def test_ctrl_c_waits_for_the_frame_and_a_second_one_does_not(arguments, tmp_path, monkeypatch):
    """OpenGL calls back into Python, where an exception would be dropped, and the call with it."""
    draw, before = ShotRenderer.draw, signal.getsignal(signal.SIGINT)
    for signals, whole in ((1, True), (2, False)):
        drawn = []

        def drawing(self, frame, out=None, signals=signals, drawn=drawn):
            if frame == 30:
                for _ in range(signals):
                    signal.raise_signal(signal.SIGINT)
            image = draw(self, frame, out)
            drawn.append(frame)
            return image

        monkeypatch.setattr(ShotRenderer, "draw", drawing)
        with pytest.raises(KeyboardInterrupt):
            render_main([*arguments, "-o", str(tmp_path / "film.mp4")])
        assert drawn == list(range(5, 31 if whole else 30))
        assert signal.getsignal(signal.SIGINT) is before
    assert (tmp_path / "film.mp4.parts" / "00000005-00000020.mp4").exists()


def test_stopped_before_its_first_part_is_whole_nothing_is_left(arguments, tmp_path, stopping):
    stopping(12)
    with pytest.raises(KeyboardInterrupt):
        render_main([*arguments, "-o", str(tmp_path / "film.mp4")])
    assert list(tmp_path.iterdir()) == []


def test_a_gif_in_parts_is_the_gif_in_one_go(arguments, tmp_path):
    for name, more in (("a.gif", []), ("b.gif", ["--resume"])):
        render_main([*arguments, "-o", str(tmp_path / name), *more])
    assert decoded(tmp_path / "a.gif") == decoded(tmp_path / "b.gif")
    assert len(decoded(tmp_path / "a.gif")) > 40  # equal neighbours may be one


@pytest.mark.parametrize("name", ["film.webm", "film.mov"])
def test_transparent_films_are_joined_with_their_alpha(arguments, tmp_path, name):
    render_main([*arguments, "--background", "transparent", "-o", str(tmp_path / name)])
    render_main([*arguments, "--background", "transparent", "-o", str(tmp_path / "frames")])
    with av.open(str(tmp_path / name)) as container:
        context = av.CodecContext.create("libvpx-vp9", "r") if name.endswith("webm") else None
        packets = list(container.demux(video=0))
        frames = [f for p in packets for f in (context.decode(p) if context else p.decode())]
    assert len(frames) == FRAMES
    for number in (0, 16, 49):  # one in each part
        alpha = frames[number].to_ndarray(format="rgba")[:48, :49, 3].astype(int)
        expected = pixels(tmp_path / "frames" / f"{number:06d}.png")[..., 3]
        assert expected.min() == 0 and expected.max() == 255
        assert np.abs(alpha - expected).mean() < 4


def test_parts_of_another_film_are_not_gone_on_with(arguments, tmp_path, stopping):
    out, go_on = tmp_path / "film.mp4", stopping(45)
    with pytest.raises(KeyboardInterrupt):
        render_main([*arguments, "-o", str(out)])
    go_on()
    with pytest.raises(AssetError, match=r"parts of another film \(scene differ\)"):
        render_main([*arguments, "--background", "#ffffff", "-o", str(out), "--resume"])
    with pytest.raises(AssetError, match=r"\(frames differ\)"):
        render_main([*arguments[:3], "--frames", "5:56", *arguments[5:], "-o", str(out), "--resume"])
    render_main([*arguments, "--background", "#ffffff", "-o", str(out)])  # begins anew
    assert sorted(path.name for path in tmp_path.iterdir()) == ["film.mp4"]


def test_a_file_that_changed_is_another_film_and_a_folder_not_ours_is_left_alone(tmp_path):
    (tmp_path / "a").write_bytes(b"1")
    before = fingerprint(tmp_path / "a"), fingerprint(tmp_path)
    (tmp_path / "a").write_bytes(b"2")
    assert before[0] != fingerprint(tmp_path / "a") and before[1] != fingerprint(tmp_path)
    refused(AssetError, "cannot be read", fingerprint, tmp_path / "none.glb")
    parts = Parts(tmp_path / "film.mp4", 0, 50, {})
    parts.folder.mkdir()
    (parts.folder / "thesis.txt").write_text("years of work")
    for content in (None, "[1]", "{}"):
        if content is not None:
            (parts.folder / "film.json").write_text(content)
        for resume in (True, False):
            refused(AssetError, "move it away", parts.begin, resume=resume)
    assert (parts.folder / "thesis.txt").exists()


def test_a_part_that_lost_frames_is_noticed(arguments, tmp_path, films):
    with pytest.raises(AssetError, match="expected 51 frames, found 50"):
        join_pieces([(films / "film.mp4", 51)], tmp_path / "a.mp4", 30.0)
    refused(AssetError, "expected 51 frames, found 50", join_pieces, [(films / "frames", 51)], tmp_path / "a", 30.0)
    (tmp_path / "no.mp4").write_bytes(b"\0" * 100)
    refused(AssetError, r"no\.mp4: expected a part", join_pieces, [(tmp_path / "no.mp4", 1)], tmp_path / "a.mp4", 30.0)


@pytest.mark.parametrize(("start", "stop"), [(0, 1), (0, 20), (0, 21), (5, 55), (20, 40), (19, 21), (39, 120), (7, 8)])
def test_every_frame_is_in_one_part(start, stop):
    parts = Parts(Path("film.mp4"), start, stop, {})
    frames = [frame for part in parts.ranges for frame in range(*part)]
    assert frames == list(range(start, stop))
    assert all(first % 20 == 0 for first, _ in parts.ranges[1:])  # wherever the film begins


def test_a_turntable_and_a_camera_path_are_films(arguments, tmp_path):
    base = [arguments[0], "--motion", "walking", "--size", "33x48"]
    render_main([*base, "--frame", "7", "--camera", "turntable", "--seconds", "0.5", "-o", str(tmp_path / "turn")])
    pictures = pictures_in(tmp_path / "turn")
    assert len(pictures) == 15  # half a second at the motion's 30
    around = [np.abs(a - b).mean() for a, b in zip(pictures, [*pictures[1:], pictures[0]], strict=True)]
    assert min(around) > 0 and around[-1] < 2 * np.median(around)  # turns, and the end meets the start
    camera, other = (orbit_camera((0, 2, 1), 9.0, *angles, (33, 48)) for angles in ((0.2, 0.0), (1.2, 0.3)))
    CameraPath.through([0.0, 1.0], [camera, other]).write(tmp_path / "path.json")
    write_camera(tmp_path / "camera.json", camera)
    for name in ("path", "camera"):
        arguments_ = [*base, "--frames", "0:31", "--camera", str(tmp_path / f"{name}.json")]
        render_main([*arguments_, "-o", str(tmp_path / name)])
    path, still = decoded(tmp_path / "path"), decoded(tmp_path / "camera")
    assert len(set(still)) == 31  # the avatar walks, and is seen in every frame
    assert path[0] == still[0] and sum(a == b for a, b in zip(path, still, strict=True)) == 1


@pytest.mark.slow
def test_two_local_workers_draw_the_same_film(arguments, films, tmp_path, capsys):
    pytest.importorskip("distributed", reason="needs the extra [cluster]")
    render_main([*arguments, "-o", str(tmp_path / "film.mp4"), "--workers", "2"])
    assert decoded(tmp_path / "film.mp4") == decoded(films / "film.mp4")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["film.mp4"]
    assert "in 3 parts" in capsys.readouterr().out


def test_a_scheduler_that_is_not_there_is_one_line(arguments, tmp_path, monkeypatch):
    distributed = pytest.importorskip("distributed", reason="needs the extra [cluster]")

    def absent(*_arguments, **_options):
        raise OSError("Timed out trying to connect to tcp://127.0.0.1:9")

    monkeypatch.setattr(distributed, "Client", absent)
    with pytest.raises(AssetError, match=r"--workers tcp://127\.0\.0\.1:9: no scheduler answers"):
        render_main([*arguments, "-o", str(tmp_path / "film.mp4"), "--workers", "tcp://127.0.0.1:9"])
    assert list(tmp_path.iterdir()) == []


def test_what_a_worker_draws_is_what_is_asked_for(arguments, films, tmp_path, monkeypatch):
    """The task itself, without a cluster: the same frames, and no file that differs."""
    from player.film.cluster import draw_part, store_part
    from player.film.stage import Stage

    orders = []
    monkeypatch.setattr(
        player.film.render, "draw_on_cluster", lambda _a, shot, parts: orders.append((shot, parts)) or []
    )
    folder, name = Path(arguments[0]).parent, Path(arguments[0]).name
    monkeypatch.chdir(folder)
    with pytest.raises(AssetError, match="expected 15 frames, found 0"):
        render_main([name, *arguments[1:], "-o", str(tmp_path / "frames"), "--workers", "1"])
    monkeypatch.chdir(tmp_path)  # a worker stands elsewhere
    [(shot, parts)] = orders
    assert Stage(shot.scene).frames > 55
    drawn = draw_part(shot, (20, 23), "", parts.identity["files"])
    store_part(tmp_path / "part", drawn.files)
    assert decoded(tmp_path / "part") == decoded(films / "frames")[15:18]
    wrong = dict.fromkeys(parts.identity["files"], "0" * 64)
    with pytest.raises(AssetError, match=r"tiny\.glb: differs on this worker"):
        # of another film: nothing that is open serves it
        draw_part(replace(shot, rate=31.0), (20, 23), "", wrong)
