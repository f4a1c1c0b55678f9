"""Poses learned with the field: small increments of every frame, first order in the canonical frame."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from filmed_part import filmed_part, rays_of, untrained

from avatar.rotation import matrix_from_axis_angle
from avatar.skeleton import PARTS, skin_transforms
from capture.fit.refine import copy_refined, poses_refined, refined_path, with_learned, with_refined, write_learned
from train.objective import Batch, losses
from train.part_job import PartJob, _keep_poses
from train.pose_correction import PoseCorrection
from train.preset import DEMO
from train.trainer import Checkpoints, FieldTraining, train_field
from train.union import read_rays

ONE = torch.tensor([1.0, 0, 0, 0])  # weights: the first bone alone


def planted(video, subject, degrees, seed=0):
    """A correction with random increments whose mean is zero."""
    poses = PoseCorrection(video, subject)
    size = poses.increments.shape
    draw = torch.randn(size, generator=torch.Generator().manual_seed(seed)) * np.radians(degrees)
    poses.increments.data = draw - draw.mean(0)
    return poses


def exact(video, corrected, subject, f):
    """Template vertices on their heaviest bones, taken to the world by one pose and back by the other."""
    bone = subject.skin.joints[:, 0]
    there, back = (skin_transforms(v.axis_angle[f], subject.joints, v.root[f])[bone] for v in (video, corrected))
    world = np.einsum("nij,nj->ni", there[:, :3, :3], subject.vertices) + there[:, :3, 3]
    return np.einsum("nji,nj->ni", back[:, :3, :3], world - back[:, :3, 3])


def moved(poses, subject, f):
    points = torch.as_tensor(subject.vertices, dtype=torch.float32)[None]
    joints = torch.as_tensor(subject.skin.joints[:, :1].astype(np.int64)).expand(-1, 4)[None]
    weights = ONE.expand(1, points.shape[1], 4)
    return poses(points, torch.tensor([f]), joints, weights)[0].detach().numpy()


@pytest.mark.parametrize("part", ["body", "hand_left"])
def test_points_move_as_the_kinematic_chain_moves_them_to_first_order(capture, part):
    """Half the increments leave a quarter of the error."""
    video, subject = capture.videos[part], capture.subject
    wrong, size = [], []
    for degrees in (0.4, 0.2):
        poses = planted(video, subject, degrees)
        target = exact(video, poses.corrected(video), subject, 1)
        wrong.append(np.abs(moved(poses, subject, 1) - target).max())
        size.append(np.abs(target - subject.vertices).max())
    assert size[0] > 0.01
    assert wrong[0] < 0.05 * size[0]
    assert wrong[1] / wrong[0] == pytest.approx(0.25, abs=0.05)


def test_what_is_the_same_in_all_frames_moves_nothing_and_blends_move_between_their_bones(capture):
    video, subject = capture.videos["body"], capture.subject
    poses = planted(video, subject, 0.0)
    poses.increments.data += torch.linspace(-0.1, 0.1, poses.increments.shape[1])
    np.testing.assert_allclose(moved(poses, subject, 2), subject.vertices, atol=1e-6)
    turns = [matrix_from_axis_angle(v.axis_angle) for v in (poses.corrected(video), video)]
    np.testing.assert_allclose(*turns, atol=1e-6)
    assert poses.prior().item() < 1e-8
    poses = planted(video, subject, 0.5)
    point = torch.as_tensor(subject.vertices[:1], dtype=torch.float32)[None]
    joints = torch.tensor([[[18, 20, 0, 0]]])
    at = lambda *w: poses(point, torch.tensor([1]), joints, torch.tensor([[list(w)]])).detach()
    half = at(0.5, 0.5, 0.0, 0.0)
    torch.testing.assert_close(half, 0.5 * (at(1.0, 0, 0, 0) + at(0, 1.0, 0, 0)), rtol=0, atol=1e-6)


def test_a_planted_error_is_learned_from_where_points_should_be(capture):
    """The gradient reaches every increment that shows: poses found are the poses planted."""
    video, subject = capture.videos["body"], capture.subject
    truth = planted(video, subject, 1.0)
    poses = PoseCorrection(video, subject)
    chosen = np.arange(0, len(subject.vertices), 7)
    points = torch.as_tensor(subject.vertices[chosen], dtype=torch.float32).expand(4, -1, 3)
    joints = torch.as_tensor(subject.skin.joints[chosen].astype(np.int64)).expand(4, -1, 4)
    weights = torch.as_tensor(subject.skin.weights[chosen], dtype=torch.float32).expand(4, -1, 4)
    target = truth(points, torch.arange(4), joints, weights).detach()
    before = (points - target).norm(dim=-1).mean().item()
    optimiser = torch.optim.LBFGS(poses.parameters(), max_iter=60, line_search_fn="strong_wolfe")

    def error():
        optimiser.zero_grad()
        off = (poses(points, torch.arange(4), joints, weights) - target).square().sum(-1).mean()
        off.backward()
        return 1e4 * off

    optimiser.step(error)
    after = (poses(points, torch.arange(4), joints, weights) - target).norm(dim=-1).mean().item()
    assert before > 0.005
    assert after < 0.1 * before


def test_cached_rays_are_moved_as_single_points_are(capture):
    video, subject = capture.videos["hand_left"], capture.subject
    field, rays = hand(capture)
    poses = planted(video, subject, 0.5)
    ends = poses.moved(rays.ends, rays.frame, rays.row, rays.joints, rays.weights)
    some = torch.arange(0, len(ends), 17)
    row = rays.row[some]
    torch.testing.assert_close(
        ends[some], poses(rays.ends[some], rays.frame[some], rays.joints[row], rays.weights[row])
    )
    assert (ends - rays.ends).norm(dim=-1).max() > 1e-4


def hand(capture):
    """The left hand's untrained field and its rays."""
    filmed, settings = filmed_part(capture), DEMO.parts[2]
    rays = rays_of(filmed, settings, ends=14, per_frame=400)
    return untrained(filmed, settings, 4, seed=2), rays


def test_losses_of_colour_and_mask_reach_the_poses_and_wait_until_somebody_shows(capture):
    field, rays = hand(capture)
    field.poses = PoseCorrection(capture.videos["hand_left"], capture.subject)
    chosen = torch.arange(0, len(rays.ends), 5)
    part, preset = replace(DEMO.parts[2], iterations=10), replace(DEMO, rays=64, pose_begin=0.5)
    training = FieldTraining(part=part, preset=preset, seed=1)
    loss, _ = losses(field, rays, Batch(chosen, torch.full((len(chosen),), 0.5), 0.003), part, preset)
    loss.backward()
    gradient = field.poses.increments.grad
    assert torch.isfinite(gradient).all() and gradient.abs().sum(1).min() > 0  # every frame
    field.poses.increments.grad = None
    train_field(field, rays, training, checkpoints=Checkpoints(stop_after=5))
    assert field.poses.increments.abs().max() == 0
    train_field(field, rays, training, checkpoints=Checkpoints(stop_after=8))
    assert field.poses.increments.abs().max() > 0


def test_a_run_holds_the_poses_that_training_ended_with_and_going_on_those_it_began_with(capture, tmp_path):
    """Else a training that is resumed after its last step would correct its poses twice."""
    video = capture.videos["body"]
    begun = replace(video, axis_angle=video.axis_angle + 0.01)
    np.savez(refined_path(tmp_path, "body"), frames=np.arange(4), masks_off=np.array(0.0),
             axis_angle=begun.axis_angle, root=begun.root)  # fmt: skip
    np.savez(refined_path(tmp_path, "head"), frames=np.arange(4), masks_off=np.array(0.0))
    assert poses_refined(tmp_path, "body")
    assert not poses_refined(tmp_path, "head") and not poses_refined(tmp_path, "hand_left")

    ended = planted(begun, capture.subject, 1.0).corrected(begun)
    write_learned(tmp_path, "body", ended)
    partial = with_refined(capture, tmp_path)
    np.testing.assert_array_equal(partial.videos["body"].axis_angle, begun.axis_angle)
    composed = with_learned(partial, tmp_path)
    np.testing.assert_array_equal(composed.videos["body"].axis_angle, ended.axis_angle)
    for one in ("axis_angle", "root", "images"):
        np.testing.assert_array_equal(
            getattr(composed.videos["hand_left"], one), getattr(partial.videos["hand_left"], one)
        )

    run = tmp_path / "run"
    run.mkdir()
    copy_refined(tmp_path, run)
    final = with_refined(capture, run)
    np.testing.assert_array_equal(final.videos["body"].axis_angle, ended.axis_angle)
    np.testing.assert_array_equal(final.videos["body"].root, ended.root)
    assert sorted(path.name for path in run.iterdir()) == ["refined_body.npz", "refined_head.npz"]
    assert set(PARTS) == set(final.videos)


def test_after_the_body_stage_2_gets_the_rays_of_the_poses_that_were_learned(capture, tmp_path):
    """And composition their poses; the field itself forgets them, so that PART.pt is as of any other training."""
    video, subject = capture.videos["body"], capture.subject
    field, rays = hand(capture)  # which rays they are does not matter
    poses = field.poses = planted(video, subject, 0.5)
    job = PartJob(capture=str(capture.path), index=0, preset=DEMO, canonical_from_head=np.eye(4), folder=str(tmp_path),
                  device="cpu", threads=1)  # fmt: skip
    _keep_poses(job, field, rays, video)
    assert field.poses is None
    kept = read_rays(tmp_path / "body.rays", torch.device("cpu"))
    assert torch.equal(kept.ends, poses.moved(rays.ends, rays.frame, rays.row, rays.joints, rays.weights))
    assert not torch.equal(kept.ends, rays.ends) and torch.equal(kept.color, rays.color)
    composed = with_learned(capture, tmp_path).videos["body"]
    np.testing.assert_array_equal(composed.axis_angle, poses.corrected(video).axis_angle)
