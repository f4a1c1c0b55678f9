"""The person that travels with the program: an avatar by name, and what `selfscan play` shows without a word."""

from importlib.resources import files

import numpy as np
import pytest
from PIL import Image

from avatar import read_avatar
from command.errors import AssetError
from player.play_command import PlayCommand, scene_of
from selfscan.__main__ import main


def test_builtin_is_a_baked_person_of_a_few_megabytes():
    avatar = read_avatar("builtin")
    faces = [len(level.faces) for level in avatar.levels]
    assert faces == sorted(faces, reverse=True)
    assert abs(faces[0] - 30_000) < 100 and len(avatar.joint_positions) == 52
    assert avatar.provenance["subject"] == "builtin:male" and avatar.provenance["baked"]["missed"] == []
    assert (files("avatar") / "data" / "avatar" / "man.glb").stat().st_size < 6e6


def test_builtin_is_rendered_by_name(tmp_path):
    out = tmp_path / "man.png"
    assert main(["render", "builtin", "--motion", "walking", "--frame", "40", "--size", "96x96", "-o", str(out)]) == 0
    with Image.open(out) as picture:
        pixels = np.asarray(picture.convert("RGB")).astype(int)
    person = np.abs(pixels - pixels[0, 0]).max(-1) > 20
    assert 0.03 < person.mean() < 0.4 and pixels[person].std(0).min() > 10


def test_play_without_a_word_shows_builtin_on_a_floor():
    scene = scene_of(PlayCommand())
    assert [actor.path for actor in scene.avatars] == ["builtin"] and scene.effects.ground is not None
    own = scene_of(PlayCommand(avatar=("me.glb",)))
    assert [actor.path for actor in own.avatars] == ["me.glb"] and own.effects.ground is None


def test_the_woman_is_to_be_filmed_first():
    with pytest.raises(AssetError, match="builtin:female: a person to film, no avatar yet"):
        read_avatar("builtin:female")
