"""Training rays that miss, graze, begin inside or have no direction; masks with a pixel or none."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from filmed_part import filmed_part, rays_of, untrained
from tiny import TINY
from turning_capture import with_video

from avatar.camera import Camera, look_at, pinhole, pixel_rays
from capture.template.parts import Box
from capture.template.surface import surface_cloud
from command.errors import AssetError
from train.deform import canonical_directions
from train.objective import Batch, losses
from train.rays import Band, Samples, StillSamples, march
from train.trainer import FieldTraining, train_field

BAND = Band(0.03, 0.02, 0.005)
RADIUS = 0.1


@pytest.fixture(scope="module", params=["tree", "look-up"])
def ball(request):
    """Points 3 mm apart on a sphere, with normals and spacing; the nearest is sought, or looked up."""
    i = np.arange(12000) + 0.5
    polar, turn = np.arccos(1 - 2 * i / len(i)), np.pi * (1 + 5**0.5) * i
    d = np.stack([np.cos(turn) * np.sin(polar), np.sin(turn) * np.sin(polar), np.cos(polar)], 1)
    still = StillSamples.of(RADIUS * d, 0.003) if request.param == "look-up" else None
    return Samples(RADIUS * d, d, np.full(len(d), 0.004), still)


def _march(ball, origin, direction):
    origins, directions = np.array([origin], float), np.array([direction], float)
    return march(origins, directions, ball, BAND), origins, directions


@pytest.mark.parametrize(
    "origin, direction",
    [
        ([0, 0, -1], [0, 0, -1]),  # away from it
        ([0, 1, -1], [0, 0, 1]),  # past the box
        ([0.14, 0.14, -1], [0, 0, 1]),  # past the box's edge
        ([0.12, 0.12, -1], [0, 0, 1]),  # through the box, past the band
        ([0, 0, 1e6], [0, 1, 0]),
    ],
)
def test_a_ray_that_misses_has_no_steps(ball, origin, direction):
    (ray, t, distance, sample), *_ = _march(ball, origin, direction)
    assert len(ray) == len(t) == len(distance) == len(sample) == 0


@pytest.mark.parametrize("origin", [[0, 0, -0.11], [0, 0, -0.1], [0, 0, -0.09], [0.02, -0.03, -0.09]])
def test_a_ray_that_starts_inside_the_band_begins_where_it_is(ball, origin, within):
    (ray, t, distance, _), origins, directions = _march(ball, origin, [0, 0, 1])
    assert len(ray) > 0 and t[0] == 0 and (np.diff(t) > 0).all()
    points = origins + t[:, None] * directions
    within(distance - (np.linalg.norm(points, axis=1) - RADIUS), 1e-3, "m off the true distance")
    assert (distance >= -BAND.inside - BAND.step).all() and (distance <= BAND.outside).all()


def test_a_ray_that_starts_deep_inside_has_no_surface_before_it(ball):
    (ray, *_), *_ = _march(ball, [0, 0, 0], [0, 0, 1])
    assert len(ray) == 0


@pytest.mark.parametrize("miss", [-1e-3, -1e-6, 0.0, 1e-6, 1e-3])
@pytest.mark.parametrize("layer", [RADIUS, RADIUS + BAND.outside])
def test_a_ray_that_grazes_surface_or_band_has_steps_in_the_band_or_none(ball, layer, miss, within):
    (ray, t, distance, _), origins, directions = _march(ball, [layer + miss, 0, -1], [0, 0, 1])
    assert np.isfinite(t).all() and np.isfinite(distance).all()
    if len(ray) == 0:
        assert layer > RADIUS
        return
    points = origins + t[:, None] * directions
    within(distance - (np.linalg.norm(points, axis=1) - RADIUS), 1e-3, "m off the true distance")
    assert (distance <= BAND.outside * 1.002).all()


def test_a_ray_along_a_limb_is_followed_to_what_it_meets():
    """A metre over a strip, 2 cm off it, onto a wall."""
    across, along, up = np.arange(-0.03, 0.03, 0.004), np.arange(0, 1, 0.004), np.arange(-0.1, 0.1, 0.004)
    strip, wall = (np.stack(np.meshgrid(across, other), -1).reshape(-1, 2) for other in (along, up))
    points = np.concatenate([np.insert(strip, 1, -0.02, 1), np.insert(wall, 2, 1.0, 1)])
    normals = np.concatenate([np.tile([0.0, 1, 0], (len(strip), 1)), np.tile([0.0, 0, -1], (len(wall), 1))])
    (_, t, distance, _), *_ = _march(Samples(points, normals, np.full(len(points), 0.004)), [0, 0, -1], [0, 0, 1])
    np.testing.assert_allclose(np.diff(t), BAND.step)
    assert len(t) > 200 and distance[-1] <= -BAND.inside


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("side", [-1, 1])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_ray_in_a_face_of_the_box_is_finite(ball, axis, side, sign):
    """It touches the band in one point at most."""
    low, high = ball[0].min(0) - BAND.outside, ball[0].max(0) + BAND.outside
    origin, direction = np.zeros(3), np.zeros(3)
    origin[axis] = low[axis] if side < 0 else high[axis]
    direction[(axis + 1) % 3] = sign
    origin[(axis + 1) % 3] = -sign
    (ray, t, distance, _), *_ = _march(ball, origin, direction)
    assert np.isfinite(t).all() and (np.abs(distance) <= BAND.outside * 1.002).all() and len(ray) <= 12


def test_points_in_a_face_of_a_part_box_belong_to_it():
    box = Box(np.zeros(3), np.ones(3))
    assert box.contains(np.array([[0, 0.5, 0.5], [1, 1, 1], [0, 0, 0]])).all()
    assert not box.contains(np.array([[0.5, 0.5, 1 + 1e-12], [np.nan, 0.5, 0.5]])).any()


@pytest.mark.parametrize("direction", [[0, 0, 0], [np.nan, 0, 1], [0, 0, np.inf], [0, 0, 2], [0, 0, 1e-30]])
def test_a_ray_without_a_direction_is_refused_by_number(ball, direction):
    origins, directions = np.tile([0, 0, -1.0], (3, 1)), np.tile([0, 0, 1.0], (3, 1))
    directions[1] = direction
    with pytest.raises(ValueError, match="ray 1: expected a finite origin and a unit direction"):
        march(origins, directions, ball, BAND)
    with pytest.raises(ValueError, match="ray 0"):
        march(np.full((1, 3), np.nan), np.array([[0, 0, 1.0]]), ball, BAND)


@pytest.mark.parametrize("fov", [1e-3, 0.6, 3.0])
@pytest.mark.parametrize("distortion", [[0.0] * 5, [0.1, -0.05, 1e-3, -1e-3, 0.01]])
def test_cameras_give_unit_directions_whatever_the_lens(fov, distortion, within):
    """So no training ray is without a direction: cameras are checked where they are read."""
    if fov > 2:
        distortion = [0.0] * 5  # no such lens: the polynomial folds over
    camera = Camera(pinhole((33, 17), fov), look_at([1, 2, 3], [0, 0, 0]), (33, 17), np.array(distortion))
    origins, directions = pixel_rays(camera)
    within(np.linalg.norm(directions, axis=1) - 1, 1e-12)
    assert np.isfinite(origins).all()


@pytest.mark.parametrize("direction", [[0.0, 0, 0], [0, 0, 1], [1e-30, 0, 0]])
def test_directions_of_any_length_keep_it_in_the_canonical_frame(direction, within):
    d = torch.tensor([direction], dtype=torch.double)
    bones = torch.nn.functional.normalize(
        torch.randn(1, 4, 4, generator=torch.Generator().manual_seed(0)).double(), dim=-1
    )
    turned = canonical_directions(d, torch.tensor([[0.4, 0.3, 0.2, 0.1]]).double(), bones)
    within(turned.norm() - d.norm(), 1e-15)


@pytest.fixture(scope="module")
def cloud(turning):
    return surface_cloud(turning.subject, 2, np.ones(len(turning.subject.faces), bool), 0.006)


TRAINING = FieldTraining(part=TINY.parts[2], preset=TINY, seed=3)


def _rays(turning, cloud):
    return rays_of(filmed_part(turning, cloud=cloud), TINY.parts[2], ends=18, per_frame=60)


def _field(turning, cloud):
    return untrained(filmed_part(turning, cloud=cloud), TINY.parts[2], len(turning.videos["hand_left"].masks))


def _masked(turning, kind):
    masks = turning.videos["hand_left"].masks.copy()
    if kind == "a frame without a person":
        masks[4] = False
    elif kind == "one pixel":
        keep = np.argwhere(masks[3])[40]
        masks[:] = False
        masks[3, keep[0], keep[1]] = True
    elif kind == "only one frame":
        masks[1:] = False
    elif kind == "the whole picture":
        masks[:] = True
    return with_video(turning, "hand_left", masks=masks)


@pytest.mark.parametrize("kind", ["a frame without a person", "one pixel", "only one frame", "the whole picture"])
def test_odd_masks_train_to_finite_numbers(turning, cloud, kind):
    rays = _rays(_masked(turning, kind), cloud)
    assert torch.isfinite(rays.ends).all() and torch.isfinite(rays.color).all()
    if kind == "a frame without a person":
        assert 4 not in rays.frame and len(rays.frame.unique()) == 11
    if kind == "one pixel":
        assert rays.mask.sum() <= 1 and rays.frame.unique().tolist() == [3]
    _trains(_field(turning, cloud), rays)


def test_masks_without_a_person_are_refused_by_the_video(turning, cloud):
    nobody = with_video(turning, "hand_left", masks=np.zeros_like(turning.videos["hand_left"].masks))
    with pytest.raises(AssetError, match=r"the hand_left video: no ray meets the template .* `selfscan check`"):
        _rays(nobody, cloud)


@pytest.mark.slow
@pytest.mark.parametrize("level", [0, 128, 255])
def test_constant_pictures_train_to_finite_numbers(turning, cloud, level):
    flat = with_video(turning, "hand_left", images=np.full_like(turning.videos["hand_left"].images, level))
    rays = _rays(flat, cloud)
    assert set(np.unique(rays.color.numpy())) <= {np.float32(0), np.float32(level) / np.float32(255)}
    _trains(_field(turning, cloud), rays)


@pytest.mark.parametrize("mask", [0.0, 1.0])
def test_a_batch_of_background_or_person_alone_has_finite_gradients(turning, cloud, mask):
    rays = _rays(turning, cloud)
    rays = replace(rays, mask=torch.full_like(rays.mask, mask), color=mask * rays.color)
    field = _field(turning, cloud)
    loss, report = losses(field, rays, Batch(torch.arange(32), torch.rand(32), 0.001), TINY.parts[2], TINY)
    loss.backward()
    gradients = [p.grad for p in field.parameters() if p.grad is not None]
    assert torch.isfinite(loss) and np.isfinite(report().psnr) and len(gradients) > 4
    assert all(torch.isfinite(g).all() for g in gradients)


def _trains(field, rays) -> None:
    """Six steps, none of them skipped, all parameters finite."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        skipped = train_field(field, rays, TRAINING).skipped
    finally:
        torch.set_num_threads(threads)
    assert skipped == 0 and all(torch.isfinite(p).all() for p in field.parameters())
