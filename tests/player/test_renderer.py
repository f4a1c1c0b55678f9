"""Pictures and fragments against the posed surface, and what the ray under the pointer meets there."""

from dataclasses import replace

import numpy as np
import pytest
from dual_quaternions import skin_points_dual_quaternion
from refusals import refused

from avatar.body import builtin_body
from avatar.camera import Camera, look_at, orbit_camera, pinhole, project
from avatar.skeleton import BIG_POSE, JOINTS, joint_transforms, skin_transforms
from avatar.skinning import skin_points
from avatar.texture import sample_texture
from player.draw.plan import Absent, Canvas, Stage
from player.draw.posing import posed_vertices
from player.scene.effects import PLAIN, Effects, resolve
from player.scene.renderer import Renderer
from player.window.pointer import pick

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


def test_texture_rows_run_downwards_and_a_picture_needs_no_warming(
    render, avatar, pose, rasteriser, context, monkeypatch
):
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
    warmed = render(avatar, SIZE, effects=Effects())
    monkeypatch.setattr(context, "warms", False)
    assert np.array_equal(*(one.draw([pose], CAMERA) for one in (warmed, render(avatar, SIZE, effects=Effects()))))


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


def test_view_modes_are_asked_for_chosen_by_device_or_refused(avatar):
    off, vertex = (planned(avatar, view) for view in ("off", "vertex"))
    named = [{handle.name for handle in plan.handles} for plan in (off, vertex)]
    assert off.objects()["program"] == off.objects()["texture"] == 1
    assert not [name for name in named[0] if "view" in name or "turns" in name or "features" in name]
    assert {"avatar view vertices", "avatar turns", "avatar features"} <= named[1]

    def modes(plan):
        return [item.name for item in plan.passes if not isinstance(item, Absent)]

    assert modes(planned(avatar, "auto")) == ["avatar: paper", "avatar: view vertex"]
    assert modes(planned(avatar, "auto", software=False)) == ["avatar: paper", "avatar: view network"]
    plain = replace(avatar, default_view="off")
    assert modes(planned(plain, "auto", software=False)) == ["avatar: paper"]
    with pytest.raises(ValueError, match="view network is not in avatar mannequin male; it has linear, vertex, off"):
        planned(replace(avatar, network=None), "network")
    refused(ValueError, "'shiny'", planned, avatar, "shiny")


def test_explain_lists_every_pass_with_why_time_and_bytes(render, avatar, pose):
    renderer = render(avatar, SIZE, view="linear")
    refused(ValueError, "no frame", renderer.explain)
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


def test_two_avatars_lie_over_nothing_and_a_pose_not_finite_is_refused(render, avatar, pose):
    single, double = render(avatar, SIZE, view="off"), render([avatar, avatar], SIZE, view="off")
    away = (pose[0], pose[1] + [1000.0, 0, 0])
    assert np.array_equal(single.draw([pose], CAMERA), double.draw([pose, away], CAMERA))
    image = double.draw([pose, (pose[0], pose[1] + [0.5, 0, 0])], CAMERA)
    assert set(np.unique(image[..., 3])) == {0, 255} and (image[image[..., 3] == 0] == 0).all()
    refused(ValueError, "2 avatars need as many poses, found 1", double.draw, [pose], CAMERA)
    bad = pose[0].copy()
    bad[7, 1] = np.nan
    refused(ValueError, "not finite", lambda: render(avatar, SIZE, view="off").draw([(bad, pose[1])], CAMERA))


@pytest.fixture(scope="module")
def body():
    body = builtin_body("female")
    return body.vertices.astype(np.float64), body.faces


def surface_pixels(fragments, vertices, faces, camera):
    """Where avatar.camera.project puts the surface points found, and the pixel centres they were found at."""
    hit = fragments.face >= 0
    rows, columns = np.nonzero(hit)
    points = (vertices[faces[fragments.face[hit]]] * fragments.barycentric[hit][:, :, None].astype(float)).sum(1)
    pixels, depth = project(camera, points)
    return pixels, np.stack([columns + 0.5, rows + 0.5], 1), depth, fragments.depth[hit]


@pytest.mark.parametrize("skew", [0.0, 12.0])
def test_every_fragment_lies_on_its_pixel_as_project_says(rasteriser, body, skew):
    camera = orbit_camera((0.1, 0, 0), 2.5, 0.7, 0.3, (211, 160))
    K = camera.K + np.array([[0, skew, -17.3], [0, 31.0, 9.1], [0, 0, 0]])  # off-centre, oblong pixels
    camera = Camera(K, camera.camera_from_world, camera.size)
    pixels, centers, depth, found = surface_pixels(rasteriser.draw(*body, camera), *body, camera)
    assert len(pixels) > 1500
    assert np.abs(pixels - centers).max() < 5e-3  # vertices snap to 1/256 pixel
    assert np.abs(depth - found).max() < 1e-4


def test_every_triangle_covers_the_centres_inside_it_and_the_nearer_wins(rasteriser):
    camera = Camera(np.array([[8.0, 0, 4], [0, 8, 4], [0, 0, 1]]), np.eye(4), (8, 8))
    corners = np.array([[0.6, 0.6], [6.9, 0.6], [0.6, 6.9]])  # pixels
    vertices = np.concatenate([(corners - 4) / 8, np.ones((3, 1))], 1)
    fragments = rasteriser.draw(vertices, np.array([[0, 1, 2]]), camera)
    y, x = np.mgrid[:8, :8] + 0.5
    inside = (x > 0.6) & (y > 0.6) & (x + y < 7.5)
    assert np.array_equal(fragments.face == 0, inside)
    assert np.isinf(fragments.depth[~inside]).all() and (fragments.barycentric[~inside] == 0).all()
    weights = fragments.barycentric[inside]
    assert np.abs(weights.sum(1) - 1).max() < 1e-6
    assert np.abs(weights @ corners - np.stack([x, y], -1)[inside]).max() < 0.05  # corners snap to 1/256
    camera = Camera(np.array([[50.0, 0, 32], [0, 50, 32], [0, 0, 1]]), np.eye(4), (64, 64))
    vertices = np.array([[-0.5, -0.5, 1.0], [5.0, -5.0, 10.0], [-5.0, 5.0, 10.0]])
    fragments = rasteriser.draw(vertices, np.array([[0, 1, 2]]), camera)
    hit = fragments.face == 0
    depth = fragments.barycentric[hit].astype(float) @ vertices[:, 2]
    assert np.abs(depth / fragments.depth[hit] - 1).max() < 1e-4
    assert depth.min() < 1.2 and depth.max() > 8
    camera = Camera(np.array([[50.0, 0, 8], [0, 50, 8], [0, 0, 1]]), np.eye(4), (16, 16))
    triangle = np.array([[-1, -1, 0], [1, -1, 0], [0, 1, 0]]) * 0.1
    vertices = np.concatenate([triangle + [0, 0, 1], triangle + [0, 0, 1.001]])
    faces = np.array([[0, 1, 2], [3, 4, 5]])
    near_first = rasteriser.draw(vertices, faces, camera).face
    near_last = rasteriser.draw(vertices, faces[::-1], camera).face
    assert set(np.unique(near_first)) <= {-1, 0} and set(np.unique(near_last)) <= {-1, 1}


def test_culling_other_grids_nothing_in_front_and_broken_faces(rasteriser, body):
    camera = orbit_camera((0, 0, 0), 0.01, 0, 0, (16, 16))  # inside the belly
    assert (rasteriser.draw(*body, camera).face >= 0).all()
    assert (rasteriser.draw(*body, camera, cull=True).face >= 0).mean() < 0.5
    inside_out = body[1][:, ::-1]
    assert (rasteriser.draw(body[0], inside_out, camera, cull=True).face >= 0).all()
    camera = orbit_camera((0, 0, 0), 2.5, 0.2, 0.1, (200, 200))
    small = rasteriser.draw(*body, camera, (50, 100))
    assert small.face.shape == (100, 50)
    same = rasteriser.draw(*body, camera.resized((50, 100)))
    assert np.array_equal(small.face, same.face)
    behind = Camera(np.array([[50.0, 0, 8], [0, 50, 8], [0, 0, 1]]), look_at((0, 0, -9), (0, 0, -10)), (16, 12))
    fragments = rasteriser.draw(*body, behind)
    assert (fragments.face == -1).all() and fragments.depth.shape == (12, 16)
    camera = orbit_camera((0, 0, 0), 2, 0, 0, (8, 8))
    refused(ValueError, r"0\.\.2 of 2 vertices", rasteriser.draw, np.zeros((2, 3)), np.array([[0, 1, 2]]), camera)


SMALL = (60, 80)


def test_the_triangle_picked_is_the_triangle_drawn(rasteriser, avatar, pose):
    camera = orbit_camera((0.1, 0, -0.2), 3.0, 0.4, 0.2, SMALL)
    level = avatar.levels[0]
    vertices = posed_vertices(avatar, level, pose)
    drawn = rasteriser.draw(vertices, level.faces.astype(np.int64), camera, cull=True)
    hits = 0
    for row in range(2, SMALL[1], 9):
        for column in range(1, SMALL[0], 7):
            found = pick([avatar], [level], [pose], camera, (column + 0.5, row + 0.5))
            face = drawn.face[row, column]
            assert (found is None) == (face < 0), (row, column)
            if found is not None:
                hits += 1
                assert found.face == face
                depth = camera.camera_from_world[2] @ [*found.point, 1.0]
                assert abs(depth - drawn.depth[row, column]) < 1e-4
    assert hits > 5


def test_joints_are_picked_where_they_are_seen(avatar, pose):
    """In the middle of forearm, shin and head the bone is the one that moves them."""
    joints = avatar.joint_positions.astype(float)
    places = joint_transforms(pose[0], joints, pose[1])[:, :3, 3]
    for joint, end in (("left_elbow", "left_wrist"), ("right_knee", "right_ankle"), ("right_elbow", "right_wrist")):
        a, b = JOINTS.index(joint), JOINTS.index(end)
        middle = 0.5 * (places[a] + places[b])
        camera = Camera(pinhole(SMALL, 0.6), look_at(middle + [0.3, 0.2, 1.5], middle), SMALL)
        found = pick([avatar], avatar.levels, [pose], camera, (SMALL[0] / 2, SMALL[1] / 2))
        assert found is not None and found.joint == a, joint


def test_the_nearer_of_two_avatars_is_picked_and_a_ray_beside_them_meets_nothing(avatar):
    still = np.zeros((52, 3))
    poses = [(still, np.array([0.0, 0, 0])), (still, np.array([0.0, 0, 1.0]))]
    camera = orbit_camera((0, 0, 0), 4.0, 0.0, 0.0, SMALL)
    chest, _ = project(camera, np.array([[0.0, 0.15, 0.0]]))
    for order, nearer in ((poses, 1), (poses[::-1], 0)):
        found = pick([avatar] * 2, [avatar.levels[0]] * 2, order, camera, tuple(chest[0].tolist()))
        assert found is not None and found.avatar == nearer and 2.5 < found.distance < 3.0
    assert pick([avatar], [avatar.levels[0]], poses[:1], camera, (1.0, 1.0)) is None
    behind = Camera(camera.K, look_at((0, 0, 4.0), (0, 0, 8.0)), SMALL)
    assert pick([avatar], [avatar.levels[0]], poses[:1], behind, tuple(chest[0].tolist())) is None
