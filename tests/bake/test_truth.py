"""The default view mode is the one nearest to true pictures; here the truth is the avatar itself in each mode."""

import json

import numpy as np
import pytest
from PIL import Image

from avatar.camera import orbit_camera
from bake.bake import chosen_view
from bake.network import Distilled
from bake.truth import better_mode, halves, measured_default, mode_errors, modes_of, pose_numbers, read_true_views
from command.errors import AssetError
from player.scene.mannequin import mannequin
from player.scene.renderer import Renderer

SIZE = (96, 96)


def write_truth(context, capture, avatar, view):
    """Two poses and two views of the avatar drawn in one mode, as `selfscan synth` writes the truth."""
    facts = {"format": "selfscan-capture", "version": 1, "subject": "mannequin", "light": "even", "sheen": 0.5}
    capture.mkdir()
    (capture / "capture.json").write_text(json.dumps(facts))
    renderer = Renderer(context, [avatar], SIZE, view=view)
    for name in ("novel_pose", "novel_view"):
        folder = capture / "truth" / name
        for kind in ("images", "masks", "parts"):
            (folder / kind).mkdir(parents=True)
        poses, cameras = np.zeros((2, 52, 3)), []
        for index in range(2):
            poses[index, 18 + index] = 0, -0.6, 0
            camera = orbit_camera((0, 0, 0), 2.6, 0.9 * index - 0.4, 0.1, SIZE)
            image = renderer.draw([(poses[index], np.zeros(3))], camera)
            stem = f"{index:06d}_body.png"
            Image.fromarray(np.ascontiguousarray(image[..., :3])).save(folder / "images" / stem)
            Image.fromarray(image[..., 3]).save(folder / "masks" / stem)
            Image.fromarray((image[..., 3] > 0).astype(np.uint8)).save(folder / "parts" / stem)
            cameras.append(camera)
        np.savez(
            folder / "views.npz",
            pose=np.arange(2),
            view=np.array(["body", "body"]),
            poses=poses,
            root=np.zeros((2, 3)),
            K=np.stack([c.K for c in cameras]),
            camera_from_world=np.stack([c.camera_from_world for c in cameras]),
            size=np.array(SIZE),
        )
    renderer.release()


def distilled(avatar):
    return Distilled(avatar.network, avatar.linear, "network", None, {"network": 40.0}, "the field said so")


@pytest.mark.parametrize("truth", ["off", "linear", "network"])
def test_the_mode_that_made_the_true_pictures_becomes_the_default_and_the_file_says_so(context, tmp_path, truth):
    avatar = mannequin()
    write_truth(context, tmp_path / "capture", avatar, truth)
    mode, facts = chosen_view(avatar, distilled(avatar), read_true_views(tmp_path / "capture"))
    assert mode == facts["mode"] == truth and facts["by"] == "truth" and facts["light"] == "even"
    # the same program drew both, so nothing at all differs
    assert facts["psnr_db"]["all"][truth] is None or facts["psnr_db"]["all"][truth] > 60
    others = {"off", "linear", "network"} - {truth}
    assert all(facts["psnr_db"]["all"][other] < 40 for other in others)
    assert facts["pictures"] == {"novel_pose": 1, "novel_view": 1}
    assert facts["chosen_on"]["poses"] == {"novel_pose": [0], "novel_view": [0]}
    assert facts["richest"] == "the field said so" and truth in facts["reason"]


def test_the_mode_is_chosen_on_one_half_and_reported_on_the_other(context, tmp_path):
    """Pose 0 was drawn with the network, pose 1 with the paper's color: the first chooses, the second is reported."""
    avatar = mannequin()
    for view in ("network", "off"):
        write_truth(context, tmp_path / view, avatar, view)
    network, off = (read_true_views(tmp_path / view) for view in ("network", "off"))
    mixed = {
        name: [one for one in network.sets[name] if one.pose_index == 0]
        + [one for one in off.sets[name] if one.pose_index == 1]
        for name in network.sets
    }
    mode, facts = measured_default(avatar, network._replace(sets=mixed))
    assert mode == "network"
    assert facts["psnr_db"]["all"]["network"] < 40
    assert facts["psnr_db"]["all"]["off"] is None or facts["psnr_db"]["all"]["off"] > 60


def test_halves_share_no_picture_and_a_capture_without_truth_is_refused_before_the_bake(context, tmp_path):
    write_truth(context, tmp_path / "capture", mannequin(), "off")
    sets = read_true_views(tmp_path / "capture").sets
    choosing, reporting = halves(sets)
    for name, views in sets.items():
        assert not set(pose_numbers(choosing[name])) & set(pose_numbers(reporting[name]))
        assert len(choosing[name]) + len(reporting[name]) == len(views)
    (tmp_path / "capture.json").write_text('{"format": "selfscan-capture", "version": 1}')
    with pytest.raises(AssetError, match="truth/ with held-out pictures"):
        read_true_views(tmp_path)


def test_without_truth_the_field_decides_and_modes_are_those_of_the_file(context, tmp_path):
    avatar = mannequin()
    assert chosen_view(avatar, distilled(avatar), None) == (
        "network",
        {"mode": "network", "by": "field", "reason": "the field said so"},
    )
    assert modes_of(avatar) == ["off", "vertex", "linear", "network"]
    from dataclasses import replace

    assert modes_of(replace(avatar, network=None, linear=None, default_view="off")) == ["off"]


def test_errors_are_those_of_the_pixels_inside_the_person(context, tmp_path):
    avatar = mannequin()
    write_truth(context, tmp_path / "capture", avatar, "off")
    views = read_true_views(tmp_path / "capture").sets["novel_view"]
    image = views[0].folder / "images" / f"{views[0].name}.png"
    pixels = np.asarray(Image.open(image)).astype(int)
    Image.fromarray(np.where(pixels > 127, pixels - 51, pixels + 51).astype(np.uint8)).save(image)  # .2 beside
    found = mode_errors(context, avatar, views[:1], ["off"])["off"]
    assert found["total"].count > 300 and found["head"].count == 0 and found["head"].rounded(1) is None
    assert found["total"].square / found["total"].count == pytest.approx(0.04, rel=1e-4)
    assert found["total"].psnr() == pytest.approx(-20 * np.log10(0.2), abs=1e-3)


@pytest.mark.parametrize(
    "scores, mode",
    [
        ({"off": 24.0, "network": 24.004}, "off"),  # nobody can tell them apart: the simpler one
        ({"off": 24.0, "network": 24.02}, "network"),
        ({"off": 24.0, "linear": 24.5, "network": 24.503, "vertex": 30.0}, "linear"),
        ({"off": 24.3, "linear": 24.0, "network": 23.9}, "off"),
        ({"off": None}, "off"),
    ],
)
def test_the_best_mode_wins_and_a_simpler_one_ties(scores, mode):
    assert better_mode(scores)[0] == mode
