"""An avatar's file that is replaced while the window shows it (`selfscan play --follow`)."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("imgui_bundle", reason="the extra gui is not installed")

from avatar.gltf.avatar_file import write_avatar
from tests.window_script import run


def test_a_replaced_file_is_shown_where_the_old_one_stood_and_a_broken_one_is_named(
    open_window, avatar, tmp_path, capsys
):
    file = tmp_path / "me.glb"
    write_avatar(file, avatar)
    window = open_window(str(file), "--follow", "--no-gui", script="space home wait")
    parts = window.parts

    def shown(words="wait"):
        left, top, width, height = parts.state.layout.area
        return run(window, words)[top + height // 2 : top + height - 60, left : left + width]  # no text

    before = shown("right right wait")
    camera, frame = parts.state.last.camera, parts.state.timeline.frame
    parts.state.playback.tracks[1].at = np.array([0.3, 0, -0.4])
    moved = shown()
    assert (moved != before).any()

    levels = tuple(replace(level, base_color=255 - level.base_color) for level in avatar.levels)
    write_avatar(file, replace(avatar, levels=levels))
    other = shown()
    assert "a new one is shown" in capsys.readouterr().out
    assert (other != moved).any(-1).mean() > 0.005
    assert (parts.state.playback.tracks[1].at == [0.3, 0, -0.4]).all() and parts.state.timeline.frame == frame
    assert np.array_equal(parts.state.last.camera.camera_from_world, camera.camera_from_world)
    assert np.array_equal(shown(), other)

    file.write_bytes(b"nothing")
    assert np.array_equal(shown(), other) and "me.glb" in capsys.readouterr().out
    file.unlink()
    assert np.array_equal(shown(), other)
