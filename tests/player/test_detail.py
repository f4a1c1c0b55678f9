"""Levels of detail by size on screen, the numbers of a rung, and avatars with twist joints beside others."""

from dataclasses import replace

import numpy as np
import pytest
from limb_sections import posed, turned

from avatar.camera import orbit_camera, project
from avatar.gltf.avatar_file import write_avatar
from avatar.skeleton import BIG_POSE
from bake.bend import with_room
from bake.twist import with_twist
from player.budget.rung import Rung, rung_of, strongest_joints, with_strongest_joints
from player.draw.detail import DENSITY, MARGIN, WAIT, BySize, DetailBySize, level_for
from player.draw.mesh import VERTEX
from player.draw.posing import Poser, screen_bounds
from player.effects.contact import Contact
from player.effects.ground import Ground
from player.effects.outline import Outline
from player.film.render import detail_by_size
from player.film.shot import Shot, ShotRenderer
from player.film.stage import Stage
from player.gl.tiles import Patches
from player.play_command import PlayCommand, scene_of
from player.scene.effects import PLAIN
from player.scene.mannequin import mannequin
from player.scene.renderer import Renderer
from player.scene.scene import Scene, SceneAvatar
from player.web.packing import packed_avatar
from selfscan.__main__ import main

SIZE = (640, 480)
CAMERA = orbit_camera(np.zeros(3), 2.6, 0.0, 0.05, SIZE)


def clustered(level, cell):
    """The level with one vertex in each cell of a grid, metres."""
    _, first, place = np.unique(np.floor(level.positions / cell), axis=0, return_index=True, return_inverse=True)
    faces = place.reshape(-1)[level.faces]
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(1)]
    used, renumbered = np.unique(faces, return_inverse=True)
    names = ("positions", "normals", "uv", "joints", "weights", "view_dir", "view_q", "view_seen")
    vertices = {name: getattr(level, name)[first[used]] for name in names}
    return replace(level, faces=renumbered.reshape(faces.shape).astype(np.uint32), **vertices)


@pytest.fixture(scope="module")
def body(avatar):
    """Of 27,000, a third of that, and 1,400 triangles."""
    fine = avatar.levels[0]
    return replace(avatar, levels=(fine, clustered(fine, 0.02), clustered(fine, 0.06)))


def poses_at(*depths):
    still = np.zeros((52, 3))
    return [(still, np.array([0.8 * (k - 1), 0.0, -depth])) for k, depth in enumerate(depths)]


def tallest(body, number):
    """The height for which a level just does."""
    return np.sqrt(len(body.levels[number].faces) / DENSITY)


def test_the_coarsest_level_that_does_is_taken_and_about_a_limit_nothing_changes(body):
    for number in (1, 2):
        assert level_for(body, 0.99 * tallest(body, number)) == number
        assert level_for(body, 1.01 * tallest(body, number)) == number - 1
    assert level_for(body, 1e6) == 0 and level_for(body, np.inf) == 0
    assert level_for(body, 1.0, finest=1) == 2 and level_for(body, 1e6, finest=1) == 1
    choice, limit = DetailBySize([body]), tallest(body, 1)
    rng, detail, seen = np.random.default_rng(0), (0,), []
    for _ in range(400):
        detail = choice.chosen(detail, (0,), [limit * rng.uniform(0.92, 1.08)])
        seen.append(detail[0])
    # the first frame may begin with any; then at most the one change to the finer
    assert np.count_nonzero(np.diff(seen)) <= 1 and seen[-1] == 0


def test_finer_at_once_coarser_after_a_while_and_out_of_sight_at_once(body):
    choice = DetailBySize([body])
    near, far = 1.1 * tallest(body, 1), 0.99 * tallest(body, 1) / MARGIN
    detail = choice.chosen((0,), (0,), [near])
    frames = 0
    while detail == (0,):
        detail = choice.chosen(detail, (0,), [far])
        frames += 1
    assert (detail, frames) == ((1,), WAIT)
    assert choice.chosen(detail, (0,), [near]) == (0,)
    # one near frame begins the wait anew
    detail = (0,)
    for height in (*[far] * (WAIT - 1), near, *[far] * (WAIT - 1)):
        detail = choice.chosen(detail, (0,), [height])
    assert detail == (0,)
    assert choice.chosen(choice.chosen((0,), (0,), [None]), (0,), [far]) == (1,)
    assert DetailBySize([body]).chosen((0,), (0,), [1.0], still={0}) == (0,)


@pytest.mark.parametrize("view", ["off", "network"])
def test_a_crowd_costs_fewer_triangles_and_looks_nearly_the_same(render, body, view):
    other = replace(body)
    crowd = [body, body, other, body]
    poses = poses_at(0.0, 5.0, 12.0, 40.0)
    before = render(crowd, SIZE, view=view).draw(poses, CAMERA).astype(int)
    drawn = render(crowd, SIZE, view=view, level=BySize())
    picture = drawn.draw(poses, CAMERA).astype(int)
    assert drawn.detail[0] < drawn.detail[1] <= drawn.detail[2] <= drawn.detail[3] == 2
    triangles = [sum(len(who.level(k).faces) for who, k in zip(crowd, d)) for d in ((0,) * 4, drawn.detail)]
    assert triangles[1] < 0.5 * triangles[0]
    if view == "off":
        # those far away cover little, and change by less than a level does that is seen from near
        change = np.abs(picture - before)[..., :3].max(-1)
        covered = before[..., 3] > 0
        assert change.any() and change[covered].mean() < 2.0 and np.percentile(change[covered], 95) < 12
    again = render(crowd, SIZE, view=view, level=drawn.detail)
    assert np.array_equal(again.draw(poses, CAMERA), picture)


def test_a_change_of_level_makes_no_mesh_texture_or_program(context, render, body):
    drawn = render([body, body, replace(body)], SIZE, view="off", level=BySize())
    drawn.draw(poses_at(0.0, 12.0, 12.0), CAMERA)
    first, made, sent = drawn.detail, context.counts.objects(), context.counts.uploaded
    drawn.draw(poses_at(12.0, 0.0, 0.0), CAMERA)
    sent = context.counts.uploaded - sent
    assert drawn.detail != first and drawn.detail[1:] == (0, 0)
    assert all(context.counts.objects()[kind] == made[kind] for kind in ("program", "buffer", "vertex_array"))
    # bones alone: less than a tenth of the coarsest mesh and of all textures
    assert sent < min(VERTEX.itemsize * len(body.levels[2].positions), body.levels[0].base_color.nbytes)


def test_a_film_keeps_one_level_and_any_share_of_it_shows_the_same(tmp_path, body, capsys):
    path = str(tmp_path / "body.glb")
    write_avatar(tmp_path / "body.glb", body)
    for size, triangles in (("64x64", len(body.levels[2].faces)), ("900x900", len(body.levels[0].faces))):
        words = ["render", path, "--motion", "counting", "--size", size, "--level-by-size", "--view", "off"]
        assert main([*words, "-o", str(tmp_path / "one.png")]) == 0
        told = f"levels of detail by size: {triangles} triangles of {len(body.levels[0].faces)}"
        assert told in capsys.readouterr().out
    (tmp_path / "crowd.toml").write_text(
        'size = [64, 64]\nlevel_by_size = true\n[[avatar]]\npath = "body.glb"\nmotion = "counting"\n'
    )
    words = ["render", "--scene", str(tmp_path / "crowd.toml"), "--view", "off"]
    assert main([*words, "-o", str(tmp_path / "s.png")]) == 0
    assert f"levels of detail by size: {len(body.levels[2].faces)} triangles" in capsys.readouterr().out
    for scene_file, flag in ((str(tmp_path / "crowd.toml"), False), (None, True)):
        window = PlayCommand(() if scene_file else (path,), scene=scene_file, level_by_size=flag)
        assert scene_of(window).level_by_size
    scene = Scene((SceneAvatar(path, "counting"),), size=(64, 64))
    stage = Stage(scene)
    fit = stage.fit(0, 12)
    shot = Shot(scene, 0, 12, (64, 64), stage.rate, fit, detail=detail_by_size(stage, fit, 0, 12, 0))
    assert shot.detail == (2,) and shot.identity() != replace(shot, detail=None).identity()
    whole, share = ShotRenderer(shot, stage), ShotRenderer(shot)
    pictures = [whole.draw(frame).copy() for frame in range(4)]
    assert np.array_equal(share.draw(3), pictures[3])
    assert whole.renderer.detail == share.renderer.detail == (2,)
    whole.release()
    share.release()


SMALL = (160, 160)
NEAR = orbit_camera(np.zeros(3), 2.4, 0.3, 0.1, SMALL)


@pytest.fixture(scope="module")
def pose():
    bent = np.random.default_rng(3).normal(0, 0.25, (52, 3))
    return bent, np.zeros(3)


def test_the_strongest_joints_are_kept_and_who_follows_no_more_is_left_alone(avatar):
    assert with_strongest_joints(avatar, 4) is avatar
    weaker = with_strongest_joints(avatar, 2)
    assert [level.influences for level in weaker.levels] == [2]
    assert with_strongest_joints(weaker, 2) is weaker
    assert Rung("all", "off").prepared([avatar, avatar])[1] is avatar
    first, second = Rung("fewer", "off", joints=1, halvings=1).prepared([avatar, avatar])
    assert first is second and first is not avatar
    joints = np.array([[4, 7, 9, 2], [1, 0, 0, 0]], np.uint8)
    weights = np.array([[30, 100, 25, 100], [255, 0, 0, 0]], np.uint8)
    named, kept = strongest_joints(joints, weights, 3)
    assert named.tolist() == [[7, 2, 4, 0], [1, 0, 0, 0]]
    assert kept.sum(1).tolist() == [255, 255] and kept[0].tolist() == [112, 110, 33, 0]
    assert strongest_joints(joints, weights, 1)[1].tolist() == [[255, 0, 0, 0], [255, 0, 0, 0]]


@pytest.mark.parametrize("skinning", ["lbs", "dual_quaternion"])
@pytest.mark.parametrize("joints", [1, 2])
def test_shaders_that_read_fewer_joints_draw_what_those_that_read_four_do(render, pose, joints, skinning, avatar):
    weaker = with_strongest_joints(avatar, joints)
    far = (pose[0], np.array([0.0, 0.0, 50.0]))
    pictures = []
    for avatars in ([weaker], [weaker, avatar]):
        # beside one that follows four, programs read four; behind the eye it is not seen
        drawn = render(avatars, SMALL, effects=replace(PLAIN, view="network", skinning=skinning))
        pictures.append(drawn.draw([pose, far][: len(avatars)], NEAR))
    # compilers round sums of two and of four in their own ways
    fewer, four = (picture.astype(np.float32) for picture in pictures)
    assert np.abs(fewer - four).mean() < 0.02
    whole = render(avatar, SMALL, view="network")
    assert np.abs(whole.draw([pose], NEAR) - fewer).mean() > 0.1


def test_each_number_of_a_rung_costs_picture_and_some_cost_memory(context, pose, avatar):
    best = rung_of(avatar, "off")

    def drawn(rung):
        renderer = rung.renderer(context, [avatar], SMALL)
        picture = renderer.draw([pose], NEAR).astype(np.float32)
        renderer.release()
        return picture, renderer.plan.bytes, renderer.size

    picture, size, pixels = drawn(best)
    assert pixels == SMALL
    two, one = (np.abs(drawn(replace(best, joints=joints))[0] - picture).mean() for joints in (2, 1))
    assert 0 < two < one
    smaller = drawn(replace(best, halvings=2))
    # three quarters, then fifteen sixteenths of its texels are gone
    texels = 4 * np.prod(avatar.levels[0].base_color.shape[:2])
    assert size - smaller[1] > 0.9 * texels and not np.array_equal(smaller[0], picture)
    assert drawn(replace(best, share=0.25))[2] == (40, 40)


ORIGIN = np.zeros(3)
BARE = replace(PLAIN, view="off")
SHOULDER = orbit_camera((0.35, 0.3, 0.0), 1.2, 0.3, 0.2, (200, 200))


@pytest.fixture(scope="module")
def twisted():
    return with_twist(mannequin())


def picture(context, avatars, poses, effects=BARE, camera=SHOULDER):
    renderer = Renderer(context, avatars, camera.size, effects=effects)
    image = renderer.draw(poses, camera)
    renderer.release()
    return image.astype(int)


def stiff(avatar, points):
    """A statue of an avatar: its posed surface, which no pose bends."""
    level = avatar.levels[0]
    ones = np.tile(np.uint8([255, 0, 0, 0]), (len(level.positions), 1))
    statue = replace(
        level, positions=points.astype(np.float32), joints=np.zeros_like(level.joints), weights=ones, twist=None
    )
    return replace(avatar, levels=(statue,))


@pytest.mark.parametrize("degrees", [90.0, 179.0])
def test_a_twisted_arm_is_drawn_as_the_reference_bends_it(context, twisted, degrees):
    pose, _ = turned(twisted, "left", degrees)
    pose[16, 2], pose[18, 1] = -0.3, -0.4
    drawn = picture(context, [twisted], [(pose, ORIGIN)])
    statue = picture(context, [stiff(twisted, posed(twisted, pose, "twist"))], [(np.zeros((52, 3)), ORIGIN)])
    assert (np.abs(drawn - statue).max(-1) > 2).mean() < 1e-3
    plain = picture(context, [stiff(twisted, posed(twisted, pose, "lbs"))], [(np.zeros((52, 3)), ORIGIN)])
    # and the measure tells linear blending without them
    assert (np.abs(drawn - plain).max(-1) > 2).mean() > 1e-2


@pytest.mark.parametrize("copy", [False, True])
def test_avatars_with_and_without_twist_joints_stand_in_one_scene(context, twisted, copy):
    """Programs count the bones of the one that has most; the other, or a copy, is drawn as alone."""
    second = twisted if copy else mannequin("female")
    pose, _ = turned(twisted, "left", 150.0)
    here, away = (pose, ORIGIN), (pose if copy else np.array(BIG_POSE), np.array([0.0, 0.0, -0.8]))
    together = picture(context, [twisted, second], [here, away])
    alone, other = picture(context, [twisted], [here]), picture(context, [second], [away])
    front, behind = alone[..., 3] > 0, (alone[..., 3] == 0) & (other[..., 3] > 0)
    np.testing.assert_array_equal(together[front], alone[front])
    np.testing.assert_array_equal(together[behind], other[behind])


@pytest.mark.parametrize("skinning", ["lbs", "dual_quaternion"])
def test_effects_take_twist_joints_as_they_take_others(context, twisted, skinning):
    """In the pose of the mesh an avatar with them looks as without, whatever the scene calls for."""
    effects = replace(
        BARE, skinning=skinning, antialiasing="fxaa", ground=Ground(height=-0.9), contact=Contact(height=-0.9),
        outline=Outline(), view="network",
    )  # fmt: skip
    pose, camera = (np.array(BIG_POSE), ORIGIN), orbit_camera((0, -0.1, 0), 3.0, 0.3, 0.2, (160, 160))
    with_them = picture(context, [twisted], [pose], effects, camera)
    without = picture(context, [mannequin()], [pose], effects, camera)
    assert (np.abs(with_them - without).max(-1) > 2).mean() < 2e-3


@pytest.mark.parametrize("dual", [False, True])
def test_the_balls_that_hold_the_surface_hold_a_twisted_arm(twisted, dual):
    pose, _ = turned(twisted, "left", 179.0)
    bones = Poser(twisted, twisted.levels[0]).posed(pose, ORIGIN, SHOULDER)
    boxes = Patches(twisted.levels[0]).boxes(bones.view_from_canonical, SHOULDER, dual=dual)
    pixels, _ = project(SHOULDER, posed(twisted, pose, "twist"))
    inside = ((pixels[:, None] >= boxes[None, :, :2] - 1e-6) & (pixels[:, None] <= boxes[None, :, 2:] + 1e-6)).all(-1)
    assert inside.any(1).all()
    box = screen_bounds(bones, SHOULDER).box
    assert (pixels >= box[:2]).all() and (pixels <= box[2:]).all()


def test_a_page_holds_the_skin_of_the_52_joints(twisted):
    plain = mannequin()
    plain = replace(plain, levels=tuple(map(with_room, plain.levels)))
    assert packed_avatar(twisted).blobs == packed_avatar(plain).blobs
