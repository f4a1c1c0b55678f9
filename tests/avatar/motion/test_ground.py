"""The ground of a motion: soles of every avatar stand at 0, jumps and stairs stay what they are."""

from dataclasses import replace

import numpy as np
import pytest

from avatar.body import builtin_body
from avatar.hull import body_hull, hull_of, posed_hull
from avatar.motion.amass import write_amass
from avatar.motion.bvh import read_bvh
from avatar.motion.clip import Motion, RestSkeleton, fitted
from avatar.motion.ground import find_ground, on_ground
from avatar.motion.read import builtin_motion, read_motion
from avatar.skeleton import skin_transforms
from avatar.skinning import SkinWeights, skin_points
from command.errors import AssetError
from player.scene.framing import pelvis_height
from player.scene.mannequin import mannequin
from player.scene.motions import motion_for

MAN = body_hull(builtin_body("male"))


def walking(lift=0.0, *, heights=None, grounded=False):
    """The built-in walk repeated, moved up by `lift` and by a height of each frame."""
    clip = builtin_motion("walking").read()
    count = len(clip.root) if heights is None else len(heights)
    index = np.arange(count) % len(clip.root)
    root = clip.root[index] + [0, lift, 0]
    if heights is not None:
        root = root + np.stack([0 * heights, heights, 0 * heights], -1)

    def block(start, stop):
        return clip.axis_angle[index[start:stop]], root[start:stop]

    return Motion("walk", count, 30.0, (), block, clip.pelvis_height, grounded=grounded)


def soles(motion, hull):
    clip = motion.read()
    return posed_hull(hull, clip.axis_angle, clip.root)[..., 1].min(1)


def test_the_outer_points_end_where_the_mesh_ends(within):
    avatar, clip = mannequin("female"), builtin_motion("counting").read(200, 212)
    level, points = avatar.levels[0], posed_hull(hull_of(avatar), clip.axis_angle, clip.root)
    skin = SkinWeights(level.joints.astype(np.int64), level.weights.astype(np.float32) / 255)
    for frame in range(0, 12, 4):
        at = skin_transforms(clip.axis_angle[frame], avatar.joint_positions, clip.root[frame], avatar.canonical_pose)
        mesh = skin_points(level.positions.astype(np.float64), skin, at)
        within(points[frame].max(0) - mesh.max(0), 0.004, "m")
        within(points[frame].min(0) - mesh.min(0), 0.004, "m")


@pytest.mark.parametrize("lift", [-0.13, -0.002, 0.0, 0.056, 3.0, -40.0])
def test_a_walk_is_put_back_on_the_ground_whatever_its_height(lift, within):
    moved = on_ground(walking(lift), MAN)
    heights = soles(moved, MAN)
    within(np.median(heights), 0.005, "m")
    within(np.percentile(heights, [5, 95]), 0.02, "m")
    same = walking(0.0).read().root + [0, moved.read().root[0, 1] - walking(0.0).read().root[0, 1], 0]
    np.testing.assert_allclose(moved.read().root, same, atol=1e-12)


@pytest.mark.parametrize(
    "lift, said", [(0.056, "lowered by 5.6 cm so that the soles touch it"), (-0.12, "raised by 12.0 cm"), (2, "2.00 m")]
)
def test_what_was_done_is_said_in_english(lift, said):
    standing = builtin_motion("counting")
    moved = replace(
        standing, grounded=False, block=lambda a, b: (standing.block(a, b)[0], standing.block(a, b)[1] + [0, lift, 0])
    )
    assert said in find_ground(moved, MAN).note and "-" not in find_ground(moved, MAN).note


def test_a_jump_stays_a_jump_and_stairs_stand_on_the_floor_they_begin_on(within):
    """Half of the time in the air."""
    t = np.arange(300) / 30
    flight = np.maximum(0, 0.5 * np.sin(2 * np.pi * t))
    moved = on_ground(walking(0.2, heights=flight), MAN)
    within(np.median(soles(moved, MAN)[flight == 0]), 0.005, "m")
    assert soles(moved, MAN).max() > 0.45
    steps = 0.17 * np.clip((np.arange(600) - 150) // 30, 0, 12)
    moved = on_ground(walking(-0.1, heights=steps), MAN)
    within(np.median(soles(moved, MAN)[:150]), 0.006, "m")
    assert np.median(soles(moved, MAN)[-100:]) == pytest.approx(12 * 0.17, abs=0.02)


def test_who_never_stands_keeps_the_heights_and_a_long_motion_is_looked_at_in_part():
    """Up and down in the water, all the time."""
    swim = walking(heights=1.5 + np.cumsum(0.02 * np.cos(np.arange(900) / 40)))
    ground = find_ground(swim, MAN)
    assert ground.lift == 0 and ground.note == "ground: the body never stands, so the file's heights are kept"
    assert find_ground(walking(0.04, grounded=True), MAN).lift == pytest.approx(-0.037, abs=0.005)
    high = find_ground(walking(0.6, grounded=True), MAN)
    assert high.lift == 0 and "stays" in high.note
    read = []

    def block(start, stop):
        read.append(stop - start)
        return np.zeros((stop - start, 52, 3)), np.tile([0.0, 1.2, 0.0], (stop - start, 1))

    ground = find_ground(Motion("long", 10_000_000, 120.0, (), block), MAN)
    assert sum(read) <= 256 and max(read) <= 64 and ground.lift < -0.2


def test_frames_that_cannot_be_read_are_the_business_of_who_shows_them():
    def block(start, stop):
        if stop > 128:
            raise AssetError("broken.npz: frame 140, joint head is not finite")
        return walking(0.1).block(start, stop)

    motion = on_ground(replace(walking(0.1, heights=np.zeros(200)), block=block), MAN)
    assert motion.read(0, 10).root[0, 1] < walking(0.1).read(0, 1).root[0, 1] - 0.08
    with pytest.raises(AssetError, match="frame 140"):
        motion.read(130, 150)


def amass_file(path, hull, lift):
    """A file as AMASS has it: z up, trans of an unknown body."""
    clip = builtin_motion("walking").read()
    clip = replace(clip, root=clip.root + [0, lift, 0], pelvis_height=None)
    write_amass(path, clip, up="z")
    with np.load(path) as data:
        kept = {name: data[name] for name in data.files if name not in ("pelvis", "up_axis")}
    np.savez(path, **kept)


@pytest.mark.parametrize("sex", ["male", "female"])
@pytest.mark.parametrize("lift", [-0.13, 0.03])
def test_amass_files_stand_on_the_ground_on_every_avatar(tmp_path, sex, lift, within):
    amass_file(tmp_path / "a.npz", MAN, lift)
    avatar = mannequin(sex)
    found, kept = (
        motion_for(avatar, str(tmp_path / "a.npz")),
        motion_for(avatar, str(tmp_path / "a.npz"), ground="keep"),
    )
    hull = hull_of(avatar)
    within(np.median(soles(found, hull)), 0.006, "m")
    assert abs(np.median(soles(kept, hull))) > 0.02
    assert any(note.startswith("ground: the motion is") for note in found.notes)
    assert not any(note.startswith("ground") for note in kept.notes)


@pytest.mark.parametrize(
    "file", ["fairmotion_cmu_01_01", "pybvh_cmu_12_01_walk", "pymo_AV_8Walk_Meredith", "makehuman_walk1", "bvhjl_DAZ3D"]
)
@pytest.mark.parametrize("sex", ["male", "female"])
def test_bvh_files_stand_on_the_ground_on_every_avatar(file, sex, data, within):
    """3 to 6 cm above it before."""
    avatar = mannequin(sex)
    skeleton = RestSkeleton(avatar.joint_positions.astype(np.float64), pelvis_height(avatar))
    motion = fitted(read_bvh(data / "bvh" / f"{file}.bvh", skeleton), skeleton.pelvis_height)
    motion = on_ground(replace(motion, frames=min(motion.frames, 300)), hull_of(avatar))
    heights = soles(motion, hull_of(avatar))
    low = heights[heights < np.percentile(heights, 5) + 0.03]
    within(np.median(low), 0.01, "m")
    within(np.percentile(heights, 5), 0.03, "m")


def test_a_pose_made_for_an_avatar_stays_where_it_was_put(tmp_path):
    """Saved in the air by the window: it plays in the air."""
    avatar = mannequin()
    clip = replace(builtin_motion("walking").read(3, 4), pelvis_height=pelvis_height(avatar))
    clip = replace(clip, root=clip.root + [0, 0.35, 0])
    write_amass(tmp_path / "jump.npz", clip, up="y")
    np.testing.assert_allclose(motion_for(avatar, str(tmp_path / "jump.npz")).read().root, clip.root, atol=1e-12)
    assert read_motion(tmp_path / "jump.npz").grounded
