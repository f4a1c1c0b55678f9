import json
from dataclasses import replace
from importlib.resources import files

import numpy as np
import pytest
from pictures import pixels
from PIL import Image

from avatar import read_avatar
from avatar.camera import orbit_camera, write_camera
from avatar.motion.amass import write_amass
from avatar.motion.read import builtin_motion
from command.errors import AssetError
from player.effects.background import Background
from player.effects.ground import Ground
from player.film.command import render_main
from player.play_command import PlayCommand, scene_of
from player.scene.framing import facing, pelvis_height
from selfscan.__main__ import main


def test_a_range_of_frames_goes_to_a_folder_and_a_camera_file_decides_view_and_size(avatar_path, tmp_path, capsys):
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
        (["--camera", "none.json"], r"none\.json"),
    ],
)
def test_bad_input_is_one_line_and_leaves_nothing(avatar_path, tmp_path, arguments, message):
    with pytest.raises(AssetError, match=message):
        render_main([avatar_path, *arguments, "-o", str(tmp_path / "frames")])
    assert list(tmp_path.iterdir()) == []


WRONG = {
    "": "required: -o/--output",
    "-o a.avi": "should end in .gif, .mov, .mp4, .png, .webm, .webp or be a folder; ends in .avi",
    "--glitter -o a.png": "unrecognized arguments: --glitter",
    "--size 4by4 -o a.png": "--size: expected WIDTHxHEIGHT, as 640x640, found '4by4'",
    "--frames 9:3 -o f": "--frames: expected a first frame before the end, found '9:3'",
    "--frames 0:2 -o a.png": "a .png holds one frame: give --frame N, or another OUT",
    "--json x -o a.png": "--json writes what --explain finds: give both",
    "--background red -o a.png": "--background: expected #rrggbb, transparent or a file that is there, found 'red'",
    "--scene a.toml -o a.mp4": "give AVATAR or --scene, one of them",
    "--gpu -1 -o a.png": "--gpu: expected a number from 0 or a DRM node as /dev/dri/renderD128, found '-1'",
    "--workers 2 --explain -o a.mp4": "--explain asks the context that drew: leave --workers out",
    "--workers 0 -o a.mp4": "--workers: expected 1 to 256 processes, or an address, found '0'",
    "--budget 8ms --workers 2 -o a.mp4": "--budget asks this machine",
    "--budget 8ms --quality draft -o a.mp4": "give --budget or --quality",
    "--budget fast -o a.mp4": "--budget: expected milliseconds or frames a second, as 8ms or 120fps, found 'fast'",
}


@pytest.mark.parametrize("words", WRONG)
def test_wrong_usage_exits_2_and_says_why(avatar_path, words, capsys):
    with pytest.raises(SystemExit) as stopped:
        render_main([avatar_path, *words.split()])
    assert stopped.value.code == 2 and WRONG[words] in capsys.readouterr().err


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


def test_a_picture_says_which_frame_it_shows_and_a_film_its_size(avatar_path, tmp_path, capsys):
    base = [avatar_path, "--motion", "walking", "--size", "32x40", "--view", "off", "-o", str(tmp_path / "a.png")]
    render_main(base)
    assert "frame 0 of" in (said := capsys.readouterr().out) and "--frame N draws another" in said
    assert "view off" in said and pixels(tmp_path / "a.png").shape == (40, 32, 3)
    render_main([*base, "--frame", "7"])
    assert "frame 7 of" in (said := capsys.readouterr().out) and "draws another" not in said
    render_main([*base, "--frame", "7", "--camera", "turntable"])
    assert "frame 7 of" in (said := capsys.readouterr().out) and "draws another" not in said
    base = [avatar_path, "--motion", "walking", "--frames", "0:1", "--size", "33x41"]
    render_main([*base, "-o", str(tmp_path / "a.mp4")])
    assert "a.mp4: 1 frame, 34x42" in capsys.readouterr().out


def test_builtin_is_a_baked_person_and_the_woman_is_to_be_filmed_first():
    avatar = read_avatar("builtin")
    faces = [len(level.faces) for level in avatar.levels]
    assert faces == sorted(faces, reverse=True)
    assert 30_000 <= faces[0] < 36_000 and avatar.levels[0].face is not None and len(avatar.joint_positions) == 52
    assert avatar.provenance["subject"] == "builtin:male" and avatar.provenance["baked"]["missed"] == []
    assert (files("avatar") / "data" / "avatar" / "man.glb").stat().st_size < 7e6
    with pytest.raises(AssetError, match="builtin:female: a person to film, no avatar yet"):
        read_avatar("builtin:female")
    scene = scene_of(PlayCommand())
    assert [actor.path for actor in scene.avatars] == ["builtin"]


def test_the_window_has_a_floor_unless_it_would_hide_what_is_behind():
    def ground(**given):
        effects = scene_of(PlayCommand(avatar=("me.glb",), **given)).effects
        assert (effects.ground is None) == (effects.contact is None)
        return effects.ground

    assert ground() == Ground() and ground(background=Background(color=(0.0, 0.0, 0.0, 1.0))) == Ground()
    assert ground(background=Background("video", path="a.mp4")) == Ground(kind="shadow")
    assert ground(floor=False) is None and ground(capture="folder") is None


def test_builtin_is_rendered_by_name_and_the_front_is_where_the_chest_looks(tmp_path, avatar):
    out = tmp_path / "man.png"
    assert main(["render", "builtin", "--motion", "walking", "--frame", "40", "--size", "96x96", "-o", str(out)]) == 0
    with Image.open(out) as picture:
        pixels = np.asarray(picture.convert("RGB")).astype(int)
    person = np.abs(pixels - pixels[0, 0]).max(-1) > 20
    assert 0.03 < person.mean() < 0.4 and pixels[person].std(0).min() > 10
    turned = np.zeros((52, 3))
    turned[0, 1] = 0.7
    assert abs(facing(turned, avatar.joint_positions) - 0.7) < 1e-9
    lying = np.zeros((52, 3))
    lying[0, 0] = np.pi / 2
    assert facing(lying, avatar.joint_positions) == 0.0
    assert 0.8 < pelvis_height(avatar) < 1.1
