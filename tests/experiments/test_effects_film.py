"""A film of two scenes: their texts call for what they say, and the motion goes on without a jump."""

import numpy as np

from avatar.rotation import matrix_from_axis_angle
from experiments.effects_film import BETWEEN, SCENES, scene_text, walk_and_count
from player.scene.effects import PLAIN
from player.scene.scene_file import read_scene


def test_one_scene_calls_for_nothing_and_one_for_all(tmp_path):
    scenes = {}
    (tmp_path / "motion.npz").touch()
    for name in SCENES:
        (tmp_path / "me.glb").touch()
        file = tmp_path / f"{name}.toml"
        file.write_text(scene_text(name, tmp_path / "me.glb", (48, 64), 12.0, 6))
        scenes[name] = read_scene(file)
    nothing, everything = (scenes[name] for name in SCENES)
    assert vars(nothing.effects) | {"view": "auto"} == vars(PLAIN) | {"view": "auto"}
    assert everything.effects.motion_blur.samples == everything.effects.depth_of_field.samples == 6
    for scene in scenes.values():
        assert scene.avatars[0].path.endswith("me.glb") and scene.avatars[0].motion.endswith("motion.npz")
        assert scene.cameras[0].kind == "orbit" and scene.size == (48, 64) and scene.rate == 12


def test_the_walk_becomes_the_counting_without_a_jump():
    clip = walk_and_count()
    assert len(clip.root) / clip.rate == 18 + BETWEEN
    # metres and radians from frame to frame are those of the motions themselves
    assert np.linalg.norm(np.diff(clip.root, axis=0), axis=1).max() < 0.08
    turns = matrix_from_axis_angle(clip.axis_angle)
    cosine = ((turns[1:] * turns[:-1]).sum((-2, -1)) - 1) / 2
    assert np.arccos(np.clip(cosine, -1, 1)).max() < 0.5
