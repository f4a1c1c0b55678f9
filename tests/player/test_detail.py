"""Levels of detail by size on screen, and rungs: what each number of theirs makes of an avatar."""

from dataclasses import replace

import numpy as np
import pytest

from avatar.camera import orbit_camera
from avatar.gltf.avatar_file import write_avatar
from player.budget.rung import Rung, rung_of, strongest_joints, with_strongest_joints
from player.draw.detail import DENSITY, MARGIN, WAIT, BySize, DetailBySize, level_for
from player.draw.mesh import VERTEX
from player.film.render import detail_by_size
from player.film.shot import Shot, ShotRenderer
from player.film.stage import Stage
from player.play_command import PlayCommand, scene_of
from player.scene.effects import PLAIN
from player.scene.scene import Scene, SceneAvatar
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


def test_the_coarsest_level_that_does_is_taken(body):
    for number in (1, 2):
        assert level_for(body, 0.99 * tallest(body, number)) == number
        assert level_for(body, 1.01 * tallest(body, number)) == number - 1
    assert level_for(body, 1e6) == 0 and level_for(body, np.inf) == 0
    assert level_for(body, 1.0, finest=1) == 2 and level_for(body, 1e6, finest=1) == 1


def test_a_size_about_a_limit_changes_nothing_to_and_fro(body):
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


def test_the_strongest_joints_are_kept_and_sum_to_one():
    joints = np.array([[4, 7, 9, 2], [1, 0, 0, 0]], np.uint8)
    weights = np.array([[30, 100, 25, 100], [255, 0, 0, 0]], np.uint8)
    named, kept = strongest_joints(joints, weights, 3)
    assert named.tolist() == [[7, 2, 4, 0], [1, 0, 0, 0]]
    assert kept.sum(1).tolist() == [255, 255] and kept[0].tolist() == [112, 110, 33, 0]
    assert strongest_joints(joints, weights, 1)[1].tolist() == [[255, 0, 0, 0], [255, 0, 0, 0]]


def test_an_avatar_that_follows_no_more_is_left_as_it_is(avatar):
    assert with_strongest_joints(avatar, 4) is avatar
    weaker = with_strongest_joints(avatar, 2)
    assert [level.influences for level in weaker.levels] == [2]
    assert with_strongest_joints(weaker, 2) is weaker
    assert Rung("all", "off").prepared([avatar, avatar])[1] is avatar
    first, second = Rung("fewer", "off", joints=1, halvings=1).prepared([avatar, avatar])
    assert first is second and first is not avatar


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
