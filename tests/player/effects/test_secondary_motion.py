"""Secondary motion as it is drawn: where it is, and nothing where nothing is loose."""

import json
from dataclasses import replace

import numpy as np
import pytest
from glsl_probe import probe
from loose_avatar import dressed
from loose_paths import dance, danced

from avatar.camera import orbit_camera
from avatar.gltf.avatar_file import read_avatar, write_avatar
from avatar.skeleton import skin_transforms
from avatar.skinning import skin_points
from player.effects.contact import Contact
from player.effects.ground import Ground
from player.effects.outline import Outline
from player.effects.secondary_motion import SecondaryMotion
from player.gl.blocks import LOOSE
from player.scene.effects import PLAIN

SIZE = (150, 170)
CAMERA = orbit_camera((0, 1.0, 0), 3.0, 0.6, 0.1, SIZE)
MOVING = replace(PLAIN, view="off", secondary_motion=SecondaryMotion())
STILL = replace(PLAIN, view="off")


def decision(renderer):
    return next(one.decision for one in renderer.drawn if "secondary motion" in one.item.name)


@pytest.mark.parametrize("skinning", ["lbs", "dual_quaternion"])
def test_loose_parts_are_drawn_where_the_simulation_has_them_and_skin_stays(render, dressed_avatar, skinning):
    moving = render(dressed_avatar, SIZE, effects=replace(MOVING, skinning=skinning))
    still = render(dressed_avatar, SIZE, effects=replace(STILL, skinning=skinning))
    pose = danced(moving)
    image, plain = moving.draw([pose], CAMERA), still.draw([pose], CAMERA)
    assert (image != plain).any(-1).mean() > 0.005
    assert decision(moving).runs and "particles" in decision(moving).why
    # the offsets added by hand to the canonical vertices, each turned back by its skin: the same picture
    level = dressed_avatar.levels[0]
    motion = next(item.offsets.motion.found for item in moving.plan.passes if "secondary motion" in item.name)
    if skinning == "lbs":
        added = np.einsum("vk,vkc->vc", motion.parts.follows, motion.offsets[motion.parts.near])
        transforms = skin_transforms(pose[0], dressed_avatar.joint_positions, pose[1])
        blended = np.einsum("vk,vkij->vij", level.skin.weights, transforms[level.skin.joints])[:, :3, :3]
        canonical = level.positions + np.linalg.solve(blended, added[..., None])[..., 0]
        before, after = (skin_points(points, level.skin, transforms) for points in (level.positions, canonical))
        assert np.abs(after - before - added).max() < 1e-6
        by_hand = replace(dressed_avatar, levels=(replace(level, positions=canonical.astype(np.float32)),))
        expected = render(by_hand, SIZE, effects=STILL).draw([pose], CAMERA)
        assert (image != expected).any(-1).mean() < 0.002


def test_the_shader_adds_what_the_vertex_follows(context):
    rng = np.random.default_rng(3)
    block = np.zeros((), LOOSE)
    block["loose_offset"][:, :3] = rng.normal(size=(300, 3))
    near, follows = rng.integers(0, 300, (200, 4)), rng.random((200, 4)).astype(np.float32)
    values, call = {"near": near, "follows": follows}, "vec4(loosened(near, follows), 0.0)"
    out = probe(context, ["loose.glsl"], call, values, blocks={"Loose": block}, ints=("near",), stage="vertex")
    expected = np.einsum("vk,vkc->vc", follows, block["loose_offset"][near][..., :3])
    assert np.abs(out[:, :3] - expected).max() < 1e-5


def test_an_avatar_without_loose_parts_costs_nothing(context, render):
    avatar = dressed(skirt=False, hair=False)
    renderer = render(avatar, SIZE, effects=STILL)
    pose = dance(0.7)
    before, objects, programs = renderer.draw([pose], CAMERA), context.counts.objects(), renderer.plan.handles
    renderer.change(effects=MOVING)
    assert not renderer.moves and renderer.plan.handles == programs and context.counts.objects() == objects
    danced(renderer)
    assert np.array_equal(renderer.draw([pose], CAMERA), before)
    assert "avatar: secondary motion" in {item.name for item in renderer.plan.passes}
    assert decision(renderer).why == "nothing of it is loose"


def test_shadow_outline_and_darkening_move_with_it(render, dressed_avatar):
    for effect in ({"outline": Outline(width=4.0)}, {"ground": Ground("shadow")}, {"contact": Contact()}):
        images = []
        for wish in (SecondaryMotion(), None):
            renderer = render(dressed_avatar, SIZE, effects=replace(STILL, secondary_motion=wish, **effect))
            pose = danced(renderer)
            with_it = renderer.draw([pose], CAMERA).astype(int)
            renderer.change(effects=replace(STILL, secondary_motion=wish))
            danced(renderer)
            images.append(with_it - renderer.draw([pose], CAMERA))
        assert (images[0] != images[1]).any(), effect


def test_a_shadow_is_thrown_anew_while_only_loose_parts_move(render, dressed_avatar):
    renderer = render(dressed_avatar, SIZE, effects=replace(MOVING, ground=Ground()))
    pose, states = danced(renderer), []
    for frame in range(240):
        renderer.move([pose], 0.7 + (frame + 1) / 60)
        if frame in (0, 1, 238, 239):
            renderer.draw([pose], CAMERA)
            states.append(next(str(one.decision.state) for one in renderer.drawn if one.item.name == "ground: mask"))
    assert states == ["runs", "runs", "runs", "kept"]


def test_a_pose_that_is_no_pose_is_refused(render, dressed_avatar):
    renderer = render(dressed_avatar, SIZE, effects=MOVING)
    with pytest.raises(ValueError, match="not finite"):
        renderer.move([(np.full((52, 3), np.nan), np.zeros(3))], 0.0)
    with pytest.raises(ValueError, match="1 avatars need as many poses, found 0"):
        renderer.move([], 0.0)


def test_a_file_tells_what_is_loose(tmp_path, dressed_avatar):
    from tiny_avatar import join_glb, split_glb

    path = tmp_path / "dressed.glb"
    write_avatar(path, dressed_avatar)
    assert np.array_equal(read_avatar(path).levels[0].loose, dressed_avatar.levels[0].loose)
    document, binary = split_glb(path.read_bytes())
    attributes = document["meshes"][0]["primitives"][0]["attributes"]
    accessor = document["accessors"][attributes["_LOOSE"]]
    start = document["bufferViews"][accessor["bufferView"]]["byteOffset"]
    binary[start : start + 4] = np.float32(1.5).tobytes()
    path.write_bytes(join_glb(json.loads(json.dumps(document)), bytes(binary)))
    with pytest.raises(Exception, match=r"levels\[0\].loose should be from 0 to 1"):
        read_avatar(path)
    del attributes["_LOOSE"]
    path.write_bytes(join_glb(document, bytes(binary)))
    assert read_avatar(path).levels[0].loose is None


def test_copies_of_an_avatar_swing_each_in_its_own_way(render, dressed_avatar):
    renderer = render(dressed_avatar, SIZE, effects=MOVING)
    pose = danced(renderer)
    alone = renderer.draw([pose], CAMERA)
    two = render([dressed_avatar, dressed_avatar], SIZE, effects=MOVING)
    still = (np.zeros((52, 3)), np.array([50.0, 0.95, 0]))
    for frame in range(43):
        two.move([dance(frame / 60), still], frame / 60)
    image = two.draw([pose, still], CAMERA)
    loose = [item.offsets.motion.found.reach for item in two.plan.passes if "secondary motion" in item.name]
    assert np.array_equal(image, alone) and loose[0] > 0.05 > loose[1]
