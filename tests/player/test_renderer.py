from dataclasses import replace

import numpy as np
import pytest
from dual_quaternions import skin_points_dual_quaternion

from avatar.camera import orbit_camera
from avatar.skeleton import BIG_POSE, skin_transforms
from avatar.skinning import skin_points
from avatar.texture import sample_texture
from player.draw.plan import Absent, Canvas, Stage
from player.draw.posing import posed_vertices
from player.scene.effects import PLAIN, Effects, resolve
from player.scene.renderer import Renderer

SIZE = (200, 240)
CAMERA = orbit_camera((0.1, 0, -0.2), 2.6, 0.5, 0.1, SIZE)
VIEWS = ["off", "vertex", "linear", "network"]


def planned(avatar, view, software=True):
    return resolve([avatar], Canvas(SIZE, software=software), Effects(view, antialiasing="none"))


@pytest.mark.parametrize(
    ("skinning", "posed"), [("lbs", skin_points), ("dual_quaternion", skin_points_dual_quaternion)]
)
def test_the_picture_is_the_posed_surface_with_its_texture(rasteriser, render, avatar, pose, skinning, posed):
    fine = replace(avatar.levels[0], base_color=np.full((4, 4, 3), (200, 90, 30), np.uint8))
    effects = Effects("off", skinning, "none")
    image = render([replace(avatar, levels=(fine,))], SIZE, effects=effects).draw([pose], CAMERA)
    level = avatar.levels[0]
    transforms = skin_transforms(pose[0], avatar.joint_positions.astype(float), pose[1], rest=BIG_POSE)
    vertices = posed(level.positions.astype(float), level.skin, transforms)
    expected = rasteriser.draw(vertices, level.faces.astype(int), CAMERA, cull=True).face >= 0
    assert expected.sum() > 4000
    assert (expected != (image[..., 3] > 0)).sum() <= 3  # rounding at edges that pass a pixel centre
    assert (image[image[..., 3] > 0] == (200, 90, 30, 255)).all()


def test_texture_rows_run_downwards(render, avatar, pose, rasteriser):
    color = np.zeros((256, 256, 3), np.uint8)
    color[..., 0], color[..., 1] = np.arange(256), np.arange(256)[:, None]
    level = replace(avatar.levels[0], base_color=color)
    image = render([replace(avatar, levels=(level,))], SIZE, view="off").draw([pose], CAMERA)
    hit = rasteriser.draw(posed_vertices(avatar, level, pose), level.faces.astype(int), CAMERA, cull=True)
    inside = (hit.face >= 0) & (image[..., 3] > 0)
    uv = (level.uv[level.faces[hit.face[inside]]] * hit.barycentric[inside][..., None]).sum(1)
    expected = sample_texture(color, uv.astype(np.float64))
    close = np.abs(image[inside][:, :2] - expected[:, :2]).max(1) <= 6  # texture seams and coarser mips aside
    assert close.mean() > 0.97


@pytest.mark.parametrize("view", VIEWS)
def test_both_skinnings_are_one_where_no_joint_bends(render, avatar, view):
    pose = np.array(BIG_POSE), np.array([0.0, 0.1, 0.0])
    images = [render(avatar, SIZE, effects=Effects(view, skinning, "none")).draw([pose], CAMERA).astype(int)
              for skinning in ("lbs", "dual_quaternion")]  # fmt: skip
    away = np.abs(images[0] - images[1]).max(-1)
    assert (away > 1).sum() <= 3  # rounding at edges that pass a pixel centre


@pytest.mark.parametrize("view", ["off", "network"])
def test_an_avatar_named_twice_is_drawn_twice_and_shares_mesh_and_textures(context, avatar, pose, view):
    aside = (pose[0], pose[1] + [0.7, 0, -0.4])
    images, made = [], []
    for avatars in ([avatar, avatar], [avatar, replace(avatar)], [avatar]):
        renderer = Renderer(context, avatars, SIZE, view=view)
        images.append(renderer.draw([pose, aside][: len(avatars)], CAMERA))
        made.append(context.counts.objects())
        renderer.release()
    assert np.array_equal(images[0], images[1]) and (images[0] != images[2]).any()
    assert made[0]["texture"] == made[2]["texture"] < made[1]["texture"]
    assert made[0]["program"] == made[2]["program"]


def test_a_single_picture_is_the_same_without_warming(context, render, avatar, pose, monkeypatch):
    warmed = render(avatar, SIZE, effects=Effects())
    monkeypatch.setattr(context, "warms", False)
    assert np.array_equal(*(one.draw([pose], CAMERA) for one in (warmed, render(avatar, SIZE, effects=Effects()))))


def test_what_is_not_asked_for_is_not_compiled_nor_allocated(avatar):
    off, vertex = (planned(avatar, view) for view in ("off", "vertex"))
    named = [{handle.name for handle in plan.handles} for plan in (off, vertex)]
    assert off.objects()["program"] == off.objects()["texture"] == 1
    assert not [name for name in named[0] if "view" in name or "turns" in name or "features" in name]
    assert {"avatar view vertices", "avatar turns", "avatar features"} <= named[1]


def test_auto_is_per_vertex_on_software_and_the_files_own_on_a_gpu(avatar):
    def modes(plan):
        return [item.name for item in plan.passes if not isinstance(item, Absent)]

    assert modes(planned(avatar, "auto")) == ["avatar: paper", "avatar: view vertex"]
    assert modes(planned(avatar, "auto", software=False)) == ["avatar: paper", "avatar: view network"]
    plain = replace(avatar, default_view="off")
    assert modes(planned(plain, "auto", software=False)) == ["avatar: paper"]


def test_a_view_mode_the_avatar_lacks_is_refused(avatar):
    with pytest.raises(ValueError, match="view network is not in avatar mannequin male; it has linear, vertex, off"):
        planned(replace(avatar, network=None), "network")
    with pytest.raises(ValueError, match="'shiny'"):
        planned(avatar, "shiny")


def test_explain_lists_every_pass_with_why_time_and_bytes(render, avatar, pose):
    renderer = render(avatar, SIZE, view="linear")
    with pytest.raises(ValueError, match="no frame"):
        renderer.explain()
    renderer.draw([pose], CAMERA)
    rows = renderer.explain(2)
    stages = {stage: [s.name.replace("_", " ") for s, at, _ in PLAIN.effects() if at is stage] for stage in Stage}
    before, after = stages[Stage.GROUND], [*stages[Stage.AVATARS], *stages[Stage.PICTURE]]
    names = ["background", *before, "avatar: paper", "avatar: view linear", *after]
    assert [row["name"] for row in rows] == names and {"ground", "light", "outline", "antialiasing"} <= set(names)
    states = {row["name"]: row["state"] for row in rows}
    assert (states.pop("avatar: paper"), states.pop("avatar: view linear")) == ("skipped", "runs")
    assert set(states.values()) == {"not asked for"}
    assert [row["runs"] for row in rows] == [row["state"] == "runs" for row in rows]
    paper, view = rows[1 + len(before) : 3 + len(before)]
    assert view["ms"] > 0 and view["bytes"] > paper["bytes"] > 0 and view["why"] == "asked for"


def test_transparent_background_and_two_avatars(render, avatar, pose):
    single, double = render(avatar, SIZE, view="off"), render([avatar, avatar], SIZE, view="off")
    away = (pose[0], pose[1] + [1000.0, 0, 0])
    assert np.array_equal(single.draw([pose], CAMERA), double.draw([pose, away], CAMERA))
    image = double.draw([pose, (pose[0], pose[1] + [0.5, 0, 0])], CAMERA)
    assert set(np.unique(image[..., 3])) == {0, 255} and (image[image[..., 3] == 0] == 0).all()
    with pytest.raises(ValueError, match="2 avatars need as many poses, found 1"):
        double.draw([pose], CAMERA)


def test_a_pose_that_is_not_finite_is_refused(render, avatar, pose):
    bad = pose[0].copy()
    bad[7, 1] = np.nan
    with pytest.raises(ValueError, match="not finite"):
        render(avatar, SIZE, view="off").draw([(bad, pose[1])], CAMERA)
