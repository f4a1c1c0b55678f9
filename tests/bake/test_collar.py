"""Neck and collar, which the head's video shows where it is known how the person sat under the head."""

from dataclasses import replace

import numpy as np
import pytest

from avatar.skeleton import BIG_POSE, PARTS, skin_transforms
from avatar.skinning import SkinWeights, blended_transforms
from bake.bake import bake_run
from bake.texture.pixel_reads import (
    COLLAR,
    FAR_VIDEO,
    Belief,
    atlas_mesh,
    drawn_finer,
    frame_reads,
    part_of_corners,
    posed_frames,
    vertex_importance,
    video_reads,
)


def test_the_heads_video_is_not_believed_under_the_chin_of_estimated_people(painted):
    mesh = atlas_mesh(painted.levels[0], painted.joint_positions)
    height = mesh.positions[:, 1]
    chin = float(mesh.positions[mesh.share[:, 15] == 1, 1].mean())
    made, low = vertex_importance(mesh, "head"), mesh._replace(chin=chin)
    estimated = vertex_importance(low, "head")
    assert (estimated[height < chin] == 0).all() and made[height < chin].max() == 1
    np.testing.assert_array_equal(estimated[height > chin + 0.011], made[height > chin + 0.011])
    # what the head's video does not tell, the body's does
    assert vertex_importance(low, "body")[(height < chin) & (made == 1)].min() == 1


def test_neck_and_collar_are_the_heads_videos_where_the_trunk_under_it_is_known(painted):
    mesh = atlas_mesh(painted.levels[0], painted.joint_positions)
    chin = float(mesh.positions[mesh.share[:, 15] == 1, 1].min())
    mesh = mesh._replace(chin=chin, trunk=True)
    importance, under = vertex_importance(mesh, "head"), chin - mesh.positions[:, 1]
    neck = (mesh.share[:, [9, 12, 13, 14, 15]].sum(1) > 0.99) & (under < COLLAR[0])
    assert (importance[neck] == 1).all() and (under[neck] > 0.5 * COLLAR[0]).any()
    assert (importance[under > COLLAR[1]] == 0).all() and (importance[mesh.share[:, [16, 17]].sum(1) > 0.7] == 0).all()
    np.testing.assert_allclose(vertex_importance(mesh, "body")[neck], FAR_VIDEO)


def test_a_trunk_goes_under_the_head_as_it_stood(painted, videos):
    """Of somebody who bows: the head where its cameras have it, the rest beside it as in the whole pose."""
    mesh = atlas_mesh(painted.levels[0], painted.joint_positions)
    bow = np.asarray(BIG_POSE, np.float64).copy()
    bow[[12, 15], 0] = 0.2, 0.3
    filmed = videos.video("head")
    stiff = next(posed_frames(mesh, filmed, videos.head_from_canonical))
    bowed = next(posed_frames(mesh, replace(filmed, trunk=np.tile(bow, (8, 1, 1))), videos.head_from_canonical))
    transforms = skin_transforms(bow, mesh.joints, np.zeros(3))
    M = np.linalg.inv(transforms[15]) @ blended_transforms(mesh.skin, transforms)
    beside = np.einsum("vij,vj->vi", M[:, :3, :3], mesh.positions) + M[:, :3, 3]
    np.testing.assert_allclose(bowed.vertices, beside, atol=1e-6)
    still = mesh.share[:, 15] == 1
    for name in ("vertices", "normals", "along"):
        np.testing.assert_allclose(getattr(bowed, name)[still], getattr(stiff, name)[still], atol=1e-6)
    assert np.linalg.norm(bowed.vertices - stiff.vertices, axis=1).max() > 0.1
    assert bowed.camera.camera_from_world.tolist() == stiff.camera.camera_from_world.tolist()


def test_what_is_unknown_to_the_heads_mask_is_read_where_the_trunk_is_known(rasteriser, painted, videos):
    mesh = atlas_mesh(painted.levels[0], painted.joint_positions)
    mesh = mesh._replace(chin=float(mesh.positions[mesh.share[:, 15] == 1, 1].min()), trunk=True)
    filmed, stiff = videos.video("head"), np.tile(np.asarray(BIG_POSE, np.float64), (8, 1, 1))
    # as an import leaves it: nobody is surely there, all of the person is unsure
    masked = replace(filmed, masks=np.zeros_like(filmed.masks), unsure=filmed.masks)
    found = []
    for trunk in (None, stiff):
        reads = video_reads(mesh, replace(masked, trunk=trunk), videos.head_from_canonical, rasteriser, 1)
        found.append([own.place.of(mesh.positions)[:, 1] for own in reads])
    assert sum(map(len, found[0])) == 0
    assert np.concatenate(found[1]).min() < mesh.chin - 0.05 and np.concatenate(found[1]).max() > mesh.chin + 0.1
    # texels there are measured against the pixels of the head's video
    part = part_of_corners(mesh)
    assert (part[vertex_importance(mesh, "head") > 0.5] == PARTS.index("head")).all()
    assert (part_of_corners(mesh._replace(trunk=False)) != part).any()


def test_what_is_only_seen_at_a_slant_counts_by_the_frame_that_sees_it_best(rasteriser, painted, videos):
    mesh = atlas_mesh(painted.levels[0], painted.joint_positions)
    video, ones = videos.video("body"), np.ones(len(mesh.positions))
    frame = next(posed_frames(mesh, video, videos.head_from_canonical))
    drawn = drawn_finer(rasteriser, mesh, frame, 1)
    reads = frame_reads(mesh, frame, drawn, video.images[0], video.masks[0], Belief(ones, 0.6 * ones, 8))
    np.testing.assert_allclose(reads.weight, reads.visible * 0.6**2 * (reads.cosine / 0.6) ** 8, rtol=1e-4)
    # of the head's video, where a place that faces up is hardly seen straight on
    trunk = np.tile(np.asarray(BIG_POSE, np.float64), (8, 1, 1))
    low = mesh._replace(chin=float(mesh.positions[mesh.share[:, 15] == 1, 1].min()), trunk=True)
    shown = replace(videos.video("head"), trunk=trunk)
    share = [
        own.weight / own.visible / own.cosine**8
        for own in video_reads(low, shown, videos.head_from_canonical, rasteriser, 1)
    ]
    assert np.concatenate(share).min() > 0.9 and np.concatenate(share).max() > 4


@pytest.mark.slow
def test_a_collar_gets_the_texels_of_a_head(run, small, tmp_path):
    """The capsules with their body hung on the neck."""
    surface = run.surface
    body = surface.part == PARTS.index("body")
    joints = np.where(body[:, None], np.array([12, 0, 0, 0]), surface.skin.joints)
    weights = np.where(body[:, None], np.float32([1, 0, 0, 0]), surface.skin.weights)
    hung = replace(run, surface=replace(surface, skin=SkinWeights(joints, weights)))
    facts = [
        bake_run(hung, tmp_path / f"{density}.glb", replace(small, collar_density=density), lambda line: None)
        .provenance["baked"]["levels"][0]
        for density in (1.0, 2.5)
    ]  # fmt: skip
    assert facts[0]["faces_by_part"]["collar"] == 0 and "collar" not in facts[0]["texel_mm_by_part"]
    texel = facts[1]["texel_mm_by_part"]
    assert facts[1]["faces_by_part"]["collar"] > 100 and texel["collar"] == pytest.approx(texel["head"], rel=0.2)


class Begun(Exception):
    """A bake that began with these options."""


@pytest.mark.parametrize("trunk", [False, True])
def test_the_videos_say_whether_a_collar_is_as_fine_as_a_head(run, small, videos, tmp_path, monkeypatch, trunk):
    def begun(run, origin, options, clock, worse):
        raise Begun(options.collar_density)

    monkeypatch.setattr("bake.bake.extracted", begun)
    density = str(small.head_density if trunk else 1.0)
    with pytest.raises(Begun, match=density):
        bake_run(run, tmp_path / "one.glb", small, lambda line: None, replace(videos, trunk=trunk))
