"""The built-in body as an avatar, and renderers and windows that are freed after each test."""

import pytest
from loose_avatar import dressed
from tiny_avatar import tiny_avatar

from avatar.gltf.avatar_file import write_avatar
from command.command_line import parse
from player.play_command import PLAY, PlayCommand, scene_of
from player.scene.mannequin import mannequin
from player.scene.opened import opened_avatars


@pytest.fixture(scope="session")
def avatar():
    return mannequin()


@pytest.fixture(scope="session")
def dressed_avatar():
    """In a skirt and with long hair."""
    return dressed()


@pytest.fixture(scope="session")
def tiny_path(tmp_path_factory):
    """The avatar of tests/tiny_avatar.py as a file."""
    path = tmp_path_factory.mktemp("avatar") / "tiny.glb"
    write_avatar(path, tiny_avatar())
    return str(path)


@pytest.fixture(scope="session")
def avatar_path(avatar, tmp_path_factory):
    """The avatar as a file."""
    path = tmp_path_factory.mktemp("avatar") / "someone.glb"
    write_avatar(path, avatar)
    return str(path)


@pytest.fixture
def open_window(osmesa, avatar_path, tmp_path, monkeypatch):
    """Opens windows with panels, without a display, from arguments of `selfscan play`; all files are the test's own."""
    pytest.importorskip("imgui_bundle", reason="the extra gui is not installed")
    from player.window.show import file_stamps, opened_show
    from player.window.window import Window

    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    windows = []

    def opened(*more, size=(900, 640), live=(), script=""):
        arguments = [avatar_path, *more, "--no-floor", *(("--live", "udp:1") if live else ())]
        scene = scene_of(parse(PlayCommand, arguments, PLAY))
        show = opened_show(scene, opened_avatars(scene), live, file_stamps(scene) if "--follow" in more else None)
        windows.append(Window(show, size=size, null=True))
        windows[-1].run(script.split(), keep=True)
        return windows[-1]

    yield opened
    for window in reversed(windows):
        assert len(windows) > 1 or window.screen.context.gl.error == "GL_NO_ERROR"
        window.close()
        assert window.screen.context.released


@pytest.fixture
def window(open_window):
    """One with panels, paused at its first frame."""
    return open_window(script="space home wait")
