from dataclasses import replace

import numpy as np
import pytest

from avatar.camera import Camera, orbit_camera
from avatar.skeleton import BIG_POSE, skin_transforms
from avatar.skinning import skin_points, skin_points_dual_quaternion
from avatar.texture import sample_texture
from player.doctor import difference
from player.draw.plan import Absent, Canvas, Stage
from player.draw.posing import Poser, screen_bounds
from player.draw.raster import Rasteriser
from player.gl.context import open_context
from player.scene.effects import PLAIN, Effects, resolve
from player.scene.renderer import Renderer

SIZE = (200, 240)
CAMERA = orbit_camera((0.1, 0, -0.2), 2.6, 0.5, 0.1, SIZE)
VIEWS = ["off", "vertex", "linear", "network"]


def planned(avatar, view, software=True):
    return resolve([avatar], Canvas(SIZE, software=software), Effects(view, antialiasing="none"))


@pytest.fixture
def render(context):
    """Makes renderers and frees them after the test."""
    made = []

    def make(avatars, size=SIZE, **options):
        made.append(Renderer(context, avatars, size, **options))
        return made[-1]

    yield make
    for renderer in made:
        renderer.release()


def posed_vertices(avatar, pose, posed=skin_points):
    level = avatar.levels[0]
    skin = level.skin
    joints = avatar.joint_positions.astype(float)
    return posed(level.positions.astype(float), skin, skin_transforms(pose[0], joints, pose[1], rest=BIG_POSE))


@pytest.mark.parametrize(
    ("skinning", "posed"), [("lbs", skin_points), ("dual_quaternion", skin_points_dual_quaternion)]
)
def test_the_picture_is_the_posed_surface_with_its_texture(context, render, avatar, pose, skinning, posed):
    fine = replace(avatar.levels[0], base_color=np.full((4, 4, 3), (200, 90, 30), np.uint8))
    effects = Effects("off", skinning, "none")
    image = render([replace(avatar, levels=(fine,))], effects=effects).draw([pose], CAMERA)
    rasteriser = Rasteriser(context)
    vertices = posed_vertices(avatar, pose, posed)
    expected = rasteriser.draw(vertices, avatar.levels[0].faces.astype(int), CAMERA, cull=True).face >= 0
    rasteriser.release()
    assert expected.sum() > 4000
    assert (expected != (image[..., 3] > 0)).sum() <= 3  # rounding at edges that pass a pixel centre
    assert (image[image[..., 3] > 0] == (200, 90, 30, 255)).all()


def test_texture_rows_run_downwards(render, avatar, pose, context):
    color = np.zeros((256, 256, 3), np.uint8)
    color[..., 0], color[..., 1] = np.arange(256), np.arange(256)[:, None]
    level = replace(avatar.levels[0], base_color=color)
    image = render([replace(avatar, levels=(level,))], view="off").draw([pose], CAMERA)
    rasteriser = Rasteriser(context)
    hit = rasteriser.draw(posed_vertices(avatar, pose), level.faces.astype(int), CAMERA, cull=True)
    rasteriser.release()
    inside = (hit.face >= 0) & (image[..., 3] > 0)
    uv = (level.uv[level.faces[hit.face[inside]]] * hit.barycentric[inside][..., None]).sum(1)
    expected = sample_texture(color, uv.astype(np.float64))
    close = np.abs(image[inside][:, :2] - expected[:, :2]).max(1) <= 6  # texture seams and coarser mips aside
    assert close.mean() > 0.97


@pytest.mark.parametrize("view", VIEWS)
def test_both_skinnings_are_one_where_no_joint_bends(render, avatar, view):
    pose = np.array(BIG_POSE), np.array([0.0, 0.1, 0.0])
    images = [render([avatar], effects=Effects(view, skinning, "none")).draw([pose], CAMERA).astype(int)
              for skinning in ("lbs", "dual_quaternion")]  # fmt: skip
    away = np.abs(images[0] - images[1]).max(-1)
    assert (away > 1).sum() <= 3  # rounding at edges that pass a pixel centre


def test_row_0_is_the_top(render, avatar):
    head_up = (np.zeros((52, 3)), np.zeros(3))
    alpha = render([avatar], view="off").draw([head_up], orbit_camera((0, 0, 0), 3.2, 0, 0, SIZE))[..., 3] > 0
    arms = np.argmax(alpha.sum(1))  # the widest row of a T-pose
    assert arms < SIZE[1] // 2 and alpha[: SIZE[1] // 4].any()


@pytest.mark.parametrize("view", VIEWS)
def test_live_objects_are_exactly_the_plan_and_release_frees_them(avatar, pose, view):
    context = open_context()
    renderer = Renderer(context, [avatar], SIZE, view=view)
    assert context.counts.objects() == renderer.plan.objects()
    renderer.draw([pose], CAMERA)
    assert context.counts.objects() == renderer.plan.objects()
    assert context.counts.live_bytes == renderer.plan.bytes
    renderer.release()
    assert context.counts.objects() == {} and context.gl.error == "GL_NO_ERROR"
    context.release()


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


def test_a_leaked_texture_is_noticed(avatar):
    context = open_context()
    renderer = Renderer(context, [avatar], SIZE, view="off")
    context.gl.texture((2, 2), 4)  # nobody's
    with pytest.raises(AssertionError):
        assert context.counts.objects() == renderer.plan.objects()
    context.release()


@pytest.mark.parametrize("view", VIEWS)
def test_drawing_makes_nothing(context, render, avatar, pose, view):
    renderer = render([avatar], view=view)
    renderer.draw([pose], CAMERA)
    made, live = context.counts.calls["create"], context.counts.objects()
    draws = context.counts.calls["draw"]
    for step in range(3):
        renderer.draw([(pose[0] * (1 + 0.1 * step), pose[1])], CAMERA)
    assert context.counts.calls["create"] == made and context.counts.objects() == live
    assert context.counts.calls["draw"] == draws + 3


def test_a_single_picture_is_the_same_without_warming(context, render, avatar, pose, monkeypatch):
    warmed = render([avatar], effects=Effects())
    monkeypatch.setattr(context, "warms", False)
    assert np.array_equal(*(one.draw([pose], CAMERA) for one in (warmed, render([avatar], effects=Effects()))))


def test_what_is_not_asked_for_is_not_compiled_nor_allocated(avatar):
    off, vertex = (planned(avatar, view) for view in ("off", "vertex"))
    named = [{handle.name for handle in plan.handles} for plan in (off, vertex)]
    assert off.objects()["program"] == 1
    assert not [name for name in named[0] if "view" in name or "turns" in name or "features" in name]
    assert {"avatar view vertices", "avatar turns", "avatar features"} <= named[1]
    context = open_context()
    renderer = Renderer(context, [avatar], SIZE, view="off")
    assert context.counts.objects()["program"] == 1 and context.counts.objects()["texture"] == 1
    renderer.release()
    context.release()


def test_auto_is_per_vertex_on_software_and_the_files_own_on_a_gpu(avatar):
    def modes(plan):
        return [item.name for item in plan.passes if not isinstance(item, Absent)]

    assert modes(planned(avatar, "auto")) == ["avatar: paper", "avatar: view vertex"]
    assert modes(planned(avatar, "auto", software=False)) == ["avatar: paper", "avatar: view network"]
    plain = replace(avatar, default_view="off")
    assert modes(planned(plain, "auto", software=False)) == ["avatar: paper"]


def test_a_view_mode_the_avatar_lacks_is_refused(avatar):
    with pytest.raises(ValueError, match="view network is not in avatar mannequin male; it has off, linear"):
        planned(replace(avatar, network=None), "network")
    with pytest.raises(ValueError, match="'shiny'"):
        planned(avatar, "shiny")


def test_view_dependence_of_a_tiny_avatar_is_skipped_and_equals_paper_mode(context, render, avatar, pose):
    far = orbit_camera((0, 0, 0), 60.0, 0.4, 0.1, SIZE)
    paper, full = render([avatar], view="off"), render([avatar], view="network")
    draws = context.counts.calls["draw"]
    assert np.array_equal(paper.draw([pose], far), full.draw([pose], far))
    assert context.counts.calls["draw"] == draws + 2
    passes = {row["name"]: row for row in full.explain(1)}
    assert passes["avatar: paper"]["runs"] and not passes["avatar: view network"]["runs"]
    assert passes["avatar: view network"]["why"] == "the avatar is less than 40 pixels tall"


def test_an_avatar_out_of_view_is_not_drawn(context, render, avatar, pose):
    renderer = render([avatar], view="off", background=(0.2, 0.4, 0.6, 1.0))
    away = orbit_camera((0, 0, 10), 2.0, np.pi, 0, SIZE)
    draws = context.counts.calls["draw"]
    image = renderer.draw([pose], away)
    assert context.counts.calls["draw"] == draws
    assert (image == (51, 102, 153, 255)).all()
    paper = next(row for row in renderer.explain() if row["name"] == "avatar: paper")
    assert paper["why"] == "out of view" and paper["state"] == "skipped" and paper["ms"] == 0


def test_explain_lists_every_pass_with_why_time_and_bytes(render, avatar, pose):
    renderer = render([avatar], view="linear")
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


def test_the_bounds_hold_every_vertex(avatar, pose):
    vertices = posed_vertices(avatar, pose)
    bones = Poser(avatar, avatar.levels[0]).posed(*pose, CAMERA)
    bounds = screen_bounds(bones, CAMERA)
    local = vertices @ CAMERA.camera_from_world[:3, :3].T + CAMERA.camera_from_world[:3, 3]
    pixels = local @ CAMERA.K.T
    pixels = pixels[:, :2] / pixels[:, 2:]
    assert bounds.depth[0] <= local[:, 2].min() and local[:, 2].max() <= bounds.depth[1]
    assert (pixels >= bounds.box[:2]).all() and (pixels <= bounds.box[2:]).all()


@pytest.mark.parametrize("view", VIEWS)
def test_egl_and_osmesa_draw_the_same_frame(osmesa, avatar, pose, view):
    images = []
    for kind in ("egl", "osmesa"):
        context = open_context(kind)
        renderer = Renderer(context, [avatar], SIZE, view=view)
        images.append(renderer.draw([pose], CAMERA))
        context.release()
    worst, band = difference(*images)
    assert worst <= 1 and band < 0.1


def test_ten_kilometres_from_the_origin_the_picture_is_the_same(render, avatar, pose):
    renderer = render([avatar], view="vertex")
    here = renderer.draw([pose], CAMERA)
    shift = np.array([10_000.0, 300.0, -7_000.0])
    moved = CAMERA.camera_from_world.copy()
    moved[:3, 3] -= moved[:3, :3] @ shift
    there = renderer.draw([(pose[0], pose[1] + shift)], Camera(CAMERA.K, moved, CAMERA.size))
    assert (np.abs(here.astype(int) - there).max(-1) > 1).sum() <= 3


def test_transparent_background_and_two_avatars(render, avatar, pose):
    single, double = render([avatar], view="off"), render([avatar, avatar], view="off")
    away = (pose[0], pose[1] + [1000.0, 0, 0])
    assert np.array_equal(single.draw([pose], CAMERA), double.draw([pose, away], CAMERA))
    image = double.draw([pose, (pose[0], pose[1] + [0.5, 0, 0])], CAMERA)
    assert set(np.unique(image[..., 3])) == {0, 255} and (image[image[..., 3] == 0] == 0).all()
    with pytest.raises(ValueError, match="2 avatars need as many poses, found 1"):
        double.draw([pose], CAMERA)


def test_without_filters_a_framebuffer_of_any_size_will_do(context, render, avatar, pose):
    renderer, small = render([avatar], view="off"), (30, 40)
    attachments = context.gl.renderbuffer(small), context.gl.depth_renderbuffer(small)
    other = context.gl.framebuffer([attachments[0]], attachments[1])
    renderer.draw_into(other, [pose], CAMERA)
    assert any(other.read(components=4))
    for thing in (other, *attachments):
        thing.release()


def test_drawing_into_another_framebuffer_is_the_same_picture_upside_down(context, render, avatar, pose):
    renderer = render([avatar], view="off")
    image = renderer.draw([pose], CAMERA)
    attachments = context.gl.renderbuffer(SIZE), context.gl.depth_renderbuffer(SIZE)
    other = context.gl.framebuffer([attachments[0]], attachments[1])
    renderer.draw_into(other, [pose], CAMERA.resized((50, 60)))  # fitted to the framebuffer
    raw = np.frombuffer(other.read(components=4), np.uint8).reshape(*image.shape)[::-1]
    for thing in (other, *attachments):
        thing.release()
    renderer.draw_into(renderer.target, [pose], CAMERA)
    assert np.array_equal(np.frombuffer(renderer.target.read(components=4), np.uint8).reshape(image.shape), image)
    other = np.abs(image.astype(int) - raw).max(-1) > 1  # contours, outer and inner, round the other way
    assert other.sum() < 0.003 * (image[..., 3] > 0).sum()


def test_a_pose_that_is_not_finite_is_refused(render, avatar, pose):
    bad = pose[0].copy()
    bad[7, 1] = np.nan
    with pytest.raises(ValueError, match="not finite"):
        render([avatar], view="off").draw([(bad, pose[1])], CAMERA)
