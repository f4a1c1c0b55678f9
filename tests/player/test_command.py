import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from avatar.camera import orbit_camera, write_camera
from avatar.gltf.avatar_file import write_avatar
from avatar.hull import outermost
from avatar.motion.amass import write_amass
from avatar.motion.read import builtin_motion
from command.errors import AssetError
from player.film.command import render_main
from player.scene.framing import extent, facing, fitted_camera, orbit, pelvis_height


def pixels(path):
    with Image.open(path) as image:
        return np.asarray(image)


@pytest.fixture(scope="module")
def avatar_path(avatar, tmp_path_factory):
    path = tmp_path_factory.mktemp("avatar") / "a.glb"
    write_avatar(path, avatar)
    return str(path)


def test_one_frame_of_the_counting_clip(avatar_path, tmp_path, capsys):
    out = tmp_path / "a.png"
    arguments = [avatar_path, "--motion", "counting", "--frame", "60", "--size", "120x160", "--view", "off"]
    assert render_main([*arguments, "--background", "transparent", "-o", str(out)]) == 0
    image = pixels(out)
    assert image.shape == (160, 120, 4)
    rows, columns = np.nonzero(image[..., 3])
    margin = min(rows.min(), 159 - rows.max(), columns.min(), 119 - columns.max())
    assert margin >= 1 and rows.max() - rows.min() > 100  # the whole avatar, and large
    assert "view off" in capsys.readouterr().out


def test_the_same_frame_is_drawn_again_to_the_byte(avatar_path, tmp_path):
    files = [tmp_path / name for name in ("a.png", "b.png")]
    for file in files:
        render_main([avatar_path, "--motion", "walking", "--frame", "7", "--size", "64x64", "-o", str(file)])
    assert files[0].read_bytes() == files[1].read_bytes()


def test_a_range_of_frames_goes_to_a_folder_and_explain_to_json(avatar_path, tmp_path, capsys):
    out, explained = tmp_path / "frames", tmp_path / "explain.json"
    arguments = [avatar_path, "--motion", "walking", "--frames", "3:6", "--size", "48x64", "--camera", "orbit"]
    render_main([*arguments, "--view", "linear", "--explain", "--json", str(explained), "-o", str(out)])
    assert len(list(out.glob("*.png"))) == 3
    passes = json.loads(explained.read_text())["passes"]
    assert all({"name", "runs", "why", "ms", "bytes"} <= row.keys() for row in passes)
    runs = {row["name"]: row["runs"] for row in passes}
    assert runs["avatar: view linear"] and not runs["avatar: paper"] and sum(runs.values()) == 2
    assert runs["antialiasing: fxaa"] or runs["antialiasing: msaa"]
    assert "skipped" in capsys.readouterr().out


def test_a_camera_file_decides_view_and_size(avatar_path, tmp_path):
    write_camera(tmp_path / "camera.json", orbit_camera((0, 1, 0), 3.0, 0.2, 0.0, (50, 70)))
    base = [avatar_path, "--camera", str(tmp_path / "camera.json"), "--motion", "counting", "--frame", "0"]
    render_main([*base, "-o", str(tmp_path / "a.png")])
    render_main([*base, "--size", "25x35", "-o", str(tmp_path / "b.png")])
    assert pixels(tmp_path / "a.png").shape == (70, 50, 3) and pixels(tmp_path / "b.png").shape == (35, 25, 3)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--motion", "none.npz"], r"none\.npz: no such file"),
        (["--motion", "counting", "--frame", "100000"], r"frame 100000 asked for, it has \d+"),
        (["--motion", "counting", "--frames", "5:100000"], r"frames 5:100000 asked for"),
        (["--gpu", "9"], "--gpu 9: not among"),
        (["--camera", "none.json"], r"none\.json"),
    ],
)
def test_bad_input_is_one_line_and_leaves_nothing(avatar_path, tmp_path, arguments, message):
    with pytest.raises(AssetError, match=message):
        render_main([avatar_path, *arguments, "-o", str(tmp_path / "frames")])
    assert list(tmp_path.iterdir()) == []


def test_a_cut_avatar_file_is_refused(avatar_path, tmp_path):
    cut = tmp_path / "cut.glb"
    with open(avatar_path, "rb") as file:
        cut.write_bytes(file.read()[:5000])
    with pytest.raises(AssetError, match=r"cut\.glb"):
        render_main([str(cut), "-o", str(tmp_path / "a.png")])


@pytest.mark.parametrize(
    "arguments",
    [["-o", "a.avi"], ["--size", "4by4", "-o", "a.png"], ["--frames", "9:3", "-o", "f"], ["--json", "x", "-o", "a.png"],
     ["--background", "red", "-o", "a.png"], ["--frames", "0:2", "-o", "a.png"], ["--glitter", "-o", "a.png"], []],
)  # fmt: skip
def test_wrong_usage_exits_2(avatar_path, arguments, capsys):
    with pytest.raises(SystemExit) as stopped:
        render_main([avatar_path, *arguments])
    assert stopped.value.code == 2 and capsys.readouterr().err


def test_a_fitted_camera_holds_every_point_from_every_side():
    points = np.random.default_rng(0).normal(size=(500, 3)) * [0.3, 0.9, 0.2]
    turning = orbit(points[outermost(points)], 0.3, (300, 200))
    for azimuth in np.linspace(0, 2 * np.pi, 7):
        for camera in (fitted_camera(points, azimuth, (300, 200)), turning(azimuth / 7, np.zeros(3))):
            local = points @ camera.camera_from_world[:3, :3].T + camera.camera_from_world[:3, 3]
            pixels = local @ camera.K.T
            pixels = pixels[:, :2] / pixels[:, 2:]
            assert (local[:, 2] > 0).all() and (pixels > 0).all() and (pixels < (300, 200)).all()


def test_the_front_is_where_the_chest_looks(avatar):
    turned = np.zeros((52, 3))
    turned[0, 1] = 0.7
    assert abs(facing(turned, avatar.joint_positions) - 0.7) < 1e-9
    lying = np.zeros((52, 3))
    lying[0, 0] = np.pi / 2
    assert facing(lying, avatar.joint_positions) == 0.0
    assert 0.8 < pelvis_height(avatar) < 1.1
    assert extent is not None


@pytest.fixture
def fast_motion(tmp_path):
    """Half a second at 120 frames a second."""
    source = builtin_motion("walking").read(0, 60)
    write_amass(tmp_path / "fast.npz", replace(source, rate=120.0))
    return str(tmp_path / "fast.npz")


def test_a_fast_motion_is_filmed_at_60_or_at_the_rate_asked_for(avatar_path, fast_motion, tmp_path, capsys):
    # one that is not fitted to the frames that are drawn
    write_camera(tmp_path / "camera.json", orbit_camera((0, 1, 0), 3.0, 0.2, 0.0, (32, 40)))
    base = [avatar_path, "--motion", fast_motion, "--camera", str(tmp_path / "camera.json")]
    counts = {}
    for rate in (None, "120", "30", "48"):
        out = tmp_path / f"at{rate}"
        render_main([*base, *(["--rate", rate] if rate else []), "-o", str(out)])
        counts[rate] = len(list(out.glob("*.png")))
        said = capsys.readouterr().out
        assert ("filmed at 60 (--rate 120 takes all)" in said) == (rate is None)
    assert counts == {None: 30, "120": 60, "30": 15, "48": 24}
    for number in range(30):
        ours, theirs = tmp_path / f"atNone/{number:06d}.png", tmp_path / f"at120/{2 * number:06d}.png"
        assert ours.read_bytes() == theirs.read_bytes()
    render_main([*base, "--rate", "30", "--resume", "-o", str(tmp_path / "parts")])
    for number in range(15):
        assert (tmp_path / f"parts/{number:06d}.png").read_bytes() == (tmp_path / f"at30/{number:06d}.png").read_bytes()
    render_main([*base, "--frames", "10:21", "-o", str(tmp_path / "some")])
    assert len(list((tmp_path / "some").glob("*.png"))) == 6  # 10, 12 ... 20
    with pytest.raises(AssetError, match="shorter than one frame of the film"):
        render_main([*base, "--frames", "1:2", "--rate", "30", "-o", str(tmp_path / "none")])


def test_a_picture_says_which_frame_it_shows(avatar_path, tmp_path, capsys):
    base = [avatar_path, "--motion", "walking", "--size", "32x40", "-o", str(tmp_path / "a.png")]
    render_main(base)
    assert "frame 0 of" in (said := capsys.readouterr().out) and "--frame N draws another" in said
    render_main([*base, "--frame", "7"])
    assert "frame 7 of" in (said := capsys.readouterr().out) and "draws another" not in said


def test_the_size_that_is_said_is_the_one_that_is_written(avatar_path, tmp_path, capsys):
    base = [avatar_path, "--motion", "walking", "--frames", "0:1", "--size", "33x41", "--encoder", "software"]
    render_main([*base, "-o", str(tmp_path / "a.mp4")])
    assert "a.mp4: 1 frame, 34x42" in capsys.readouterr().out


@pytest.mark.parametrize("workers", ["0", "257", "9" * 5000])
def test_a_number_of_workers_is_refused_before_work_begins(avatar_path, tmp_path, capsys, workers):
    with pytest.raises(SystemExit) as stopped:
        render_main([avatar_path, "--workers", workers, "-o", str(tmp_path / "a.mp4")])
    assert stopped.value.code == 2 and "1 to 256 processes" in capsys.readouterr().err
