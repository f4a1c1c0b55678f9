"""Laws that need no reference: what must not change when the question is put in another way.

Each row of LAWS draws a case, asks twice, and gives the difference; its bound stands beside it.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from avatar.body import builtin_body
from avatar.camera import Camera, look_at, pinhole, project
from avatar.motion.clip import Clip, resample
from avatar.psnr import error_between, pooled
from avatar.rotation import axis_angle_from_matrix, matrix_from_axis_angle
from avatar.similarity import similarity_from_landmarks
from avatar.skeleton import joint_transforms, skin_transforms
from avatar.skinning import SkinWeights, blended_rotations, skin_points, unskin_points
from geometry.closest import closest_points, triangle_index
from player.pose.mirror import PARTNER, mirrored
from train.render import density_weights, section_weights

FLIP = np.array([-1.0, 1, 1])
BODY = builtin_body("male")
# a sample of its points
REST, SKIN = BODY.vertices[::40], SkinWeights(BODY.skin.joints[::40], BODY.skin.weights[::40])
Rng = np.random.Generator


def drawn_pose(rng: Rng) -> tuple[np.ndarray, np.ndarray]:
    return rng.normal(0, 0.5, (52, 3)), rng.normal(0, 2, 3)


def drawn_points(pose: np.ndarray, root: np.ndarray, joints: np.ndarray = BODY.joints) -> np.ndarray:
    return skin_points(REST, SKIN, skin_transforms(pose, joints, root, np.zeros((52, 3))))


def drawn_camera(rng: Rng, at: np.ndarray) -> Camera:
    eye = at + rng.normal(0, 1, 3) + [0, 0, 4]
    return Camera(pinhole((640, 480), rng.uniform(0.2, 1.5)), look_at(eye, at), (640, 480))


def world_turned(rng: Rng) -> np.ndarray:
    """Person and camera turned and moved together: the same pixels."""
    pose, root = drawn_pose(rng)
    camera, turn, shift = drawn_camera(rng, root), matrix_from_axis_angle(rng.normal(size=3)), rng.normal(0, 5, 3)
    moved = np.eye(4)
    moved[:3, :3], moved[:3, 3] = turn.T, -turn.T @ shift
    other = pose.copy()
    other[0] = axis_angle_from_matrix(turn @ matrix_from_axis_angle(pose[0]))
    again = replace(camera, camera_from_world=camera.camera_from_world @ moved)
    return project(again, drawn_points(other, turn @ root + shift))[0] - project(camera, drawn_points(pose, root))[0]


def mirror(rng: Rng) -> np.ndarray:
    """Pose and skeleton mirrored, left and right exchanged: every joint where the mirror shows it."""
    pose, root = drawn_pose(rng)
    there = joint_transforms(mirrored(pose), BODY.joints[PARTNER] * FLIP, root * FLIP)[:, :3, 3]
    return there[PARTNER] * FLIP - joint_transforms(pose, BODY.joints, root)[:, :3, 3]


def mirrored_twice(rng: Rng) -> np.ndarray:
    pose, _ = drawn_pose(rng)
    return mirrored(mirrored(pose)) - pose


def other_units(rng: Rng) -> np.ndarray:
    """Scene and camera in millimetres: the same pixels."""
    pose, root = drawn_pose(rng)
    camera, points = drawn_camera(rng, root), drawn_points(pose, root)
    larger = camera.camera_from_world.copy()
    larger[:3, 3] *= 1000
    return project(replace(camera, camera_from_world=larger), 1000 * points)[0] - project(camera, points)[0]


def field_in_other_units(rng: Rng) -> np.ndarray:
    """Distances, widths and lengths times 1000: what a ray sees is the same."""
    distance = torch.tensor(rng.normal(0, 0.02, (30, 12)))
    lengths, beta = torch.full((30, 12), 0.01, dtype=torch.float64), 0.004
    neus = section_weights(1000 * distance, 1000 * beta).weights - section_weights(distance, beta).weights
    volsdf = density_weights(1000 * distance, 1000 * lengths, 1000 * beta).weights
    return np.hstack([neus.numpy(), (volsdf - density_weights(distance, lengths, beta).weights).numpy()])


def sections_halved(rng: Rng) -> np.ndarray:
    """A density that is constant in its sections, each cut in two: the same light passes."""
    distance, lengths = torch.tensor(rng.normal(0, 0.02, (30, 12))), torch.full((30, 12), 0.01, dtype=torch.float64)
    twice = density_weights(distance.repeat_interleave(2, 1), lengths.repeat_interleave(2, 1) / 2, 0.004)
    once = density_weights(distance, lengths, 0.004)
    return (twice.weights.view(30, 12, 2).sum(2) - once.weights).numpy()


def points_permuted(rng: Rng) -> np.ndarray:
    """Points in another order, bones of a point in another order: each where it was."""
    pose, root = drawn_pose(rng)
    order, slots = rng.permutation(len(REST)), rng.permutation(4)
    transforms = skin_transforms(pose, BODY.joints, root, np.zeros((52, 3)))
    skin = SkinWeights(SKIN.joints[order][:, slots], SKIN.weights[order][:, slots])
    placed = skin_points(REST[order], skin, transforms) - skin_points(REST, SKIN, transforms)[order]
    turned = blended_rotations(skin, transforms) - blended_rotations(SKIN, transforms)[order]
    # of two bones of one weight either may be the heaviest
    unique = np.sort(skin.weights, 1)[:, -1] > np.sort(skin.weights, 1)[:, -2]
    return np.concatenate([placed.ravel(), turned[unique].ravel()])


def bones_renumbered(rng: Rng) -> np.ndarray:
    """Bones in another order: every point where it was."""
    pose, root = drawn_pose(rng)
    order = rng.permutation(52)
    transforms = skin_transforms(pose, BODY.joints, root, np.zeros((52, 3)))
    skin = SkinWeights(np.argsort(order)[SKIN.joints], SKIN.weights)
    return skin_points(REST, skin, transforms[order]) - skin_points(REST, SKIN, transforms)


def there_and_back(rng: Rng) -> np.ndarray:
    pose, root = drawn_pose(rng)
    transforms = skin_transforms(pose, BODY.joints, root, np.zeros((52, 3)))
    back, ok = unskin_points(skin_points(REST, SKIN, transforms), SKIN, transforms)
    assert ok.mean() > 0.98
    # where space is nearly flat its inverse is steep
    det = np.abs(np.linalg.det(np.einsum("ps,psij->pij", SKIN.weights, transforms[SKIN.joints][..., :3, :3])))
    return (back - REST)[ok & (det > 0.1)]


def triangles_permuted(rng: Rng) -> np.ndarray:
    """Triangles in another order, each from another corner: the same closest points."""
    vertices, asked = rng.normal(size=(30, 3)), rng.normal(size=(40, 3))
    faces = np.array([rng.choice(30, 3, replace=False) for _ in range(50)])
    other = np.roll(faces, 1, 1)[rng.permutation(50)]
    once, again = (closest_points(asked, triangle_index(vertices, f)).point for f in (faces, other))
    return np.linalg.norm(once - asked, axis=1) - np.linalg.norm(again - asked, axis=1)


def landmarks_permuted(rng: Rng) -> np.ndarray:
    source, order = rng.normal(size=(9, 3)), rng.permutation(9)
    target = source @ matrix_from_axis_angle(rng.normal(size=3)).T * 1.3 + rng.normal(size=3)
    target += rng.normal(0, 0.01, target.shape)
    once, again = similarity_from_landmarks(source, target), similarity_from_landmarks(source[order], target[order])
    return once.transform - again.transform


def drawn_clip(rng: Rng) -> Clip:
    return Clip(np.cumsum(rng.normal(0, 0.1, (9, 52, 3)), 0), np.cumsum(rng.normal(0, 0.1, (9, 3)), 0), 30.0)


def rotations_apart(a: Clip, b: Clip) -> np.ndarray:
    """Rotations and places of two clips; vectors may differ by whole turns."""
    turns = matrix_from_axis_angle(a.axis_angle) - matrix_from_axis_angle(b.axis_angle)
    return np.concatenate([turns.ravel(), (a.root - b.root).ravel()])


def resampled_and_back(rng: Rng) -> np.ndarray:
    """At three times the rate, then every third frame: the clip."""
    clip = drawn_clip(rng)
    return rotations_apart(resample(resample(clip, 90.0), 30.0), clip)


def reversed_clip(rng: Rng) -> np.ndarray:
    """Resampled backwards is backwards what it is forwards."""
    clip = drawn_clip(rng)
    back = lambda c: replace(c, axis_angle=c.axis_angle[::-1], root=c.root[::-1])
    return rotations_apart(back(resample(back(clip), 60.0)), resample(clip, 60.0))


def cut_and_joined(rng: Rng) -> np.ndarray:
    """Two parts of a clip that share a frame, resampled each, joined: the whole, resampled."""
    clip, at = drawn_clip(rng), int(rng.integers(1, 8))
    first = resample(replace(clip, axis_angle=clip.axis_angle[: at + 1], root=clip.root[: at + 1]), 60.0)
    rest = resample(replace(clip, axis_angle=clip.axis_angle[at:], root=clip.root[at:]), 60.0)
    joined = replace(
        first, axis_angle=np.concatenate([first.axis_angle, rest.axis_angle[1:]]),
        root=np.concatenate([first.root, rest.root[1:]]),
    )  # fmt: skip
    return rotations_apart(joined, resample(clip, 60.0))


def scored_in_tiles(rng: Rng) -> np.ndarray:
    """The error of a picture is that of its tiles, pooled, in any order."""
    a, b = rng.random((2, 24, 36, 3))
    tiles = [np.s_[y : y + 8, x : x + 12] for y in range(0, 24, 8) for x in range(0, 36, 12)]
    parts = [error_between(a[tiles[k]], b[tiles[k]]) for k in rng.permutation(len(tiles))]
    return np.array([pooled(parts).psnr() - error_between(a, b).psnr()])


def brighter_pictures(rng: Rng) -> np.ndarray:
    """Both pictures 1.2 times as bright: so many decibels less."""
    a, b = rng.uniform(0, 0.8, (2, 24, 36, 3))
    return np.array([error_between(1.2 * a, 1.2 * b).psnr() + 20 * np.log10(1.2) - error_between(a, b).psnr()])


def surface_in_other_units(rng: Rng) -> np.ndarray:
    """Mesh and points in millimetres: the closest points are the same."""
    vertices, asked = rng.normal(size=(30, 3)), rng.normal(size=(40, 3))
    faces = np.array([rng.choice(30, 3, replace=False) for _ in range(50)])
    once, larger = (closest_points(k * asked, triangle_index(k * vertices, faces)).point for k in (1, 1000))
    return np.linalg.norm(once - asked, axis=1) - np.linalg.norm(larger / 1000 - asked, axis=1)


def larger_and_cut(rng: Rng) -> np.ndarray:
    """A picture of twice the size, and a part of one: pixels are where they were, twice as far, or as much less."""
    pose, root = drawn_pose(rng)
    camera, points = drawn_camera(rng, root), drawn_points(pose, root)
    once = project(camera, points)[0]
    twice, part = (project(c, points)[0] for c in (camera.resized((1280, 960)), camera.cropped(30, 50, (99, 80))))
    return np.hstack([twice - 2 * once, part + [30, 50] - once])


class Law(NamedTuple):
    """The difference of two answers, and what it may be at most."""

    difference: Callable[[Rng], np.ndarray]
    bound: float
    unit: str


LAWS = {
    "person and camera turned together": Law(world_turned, 1e-8, "pixel, turned together"),
    "person mirrored, sides exchanged": Law(mirror, 1e-12, "m, mirrored"),
    "mirrored twice": Law(mirrored_twice, 0, "rad, mirrored twice"),
    "scene in millimetres": Law(other_units, 1e-8, "pixel, in millimetres"),
    "field in millimetres": Law(field_in_other_units, 1e-12, "of a weight, in millimetres"),
    "sections halved": Law(sections_halved, 1e-12, "of a weight, halved sections"),
    "points permuted": Law(points_permuted, 1e-12, "m, points permuted"),
    "bones renumbered": Law(bones_renumbered, 1e-12, "m, bones renumbered"),
    "posed and back": Law(there_and_back, 1e-10, "m, posed and back"),
    "triangles permuted": Law(triangles_permuted, 1e-12, "m, triangles permuted"),
    "landmarks permuted": Law(landmarks_permuted, 1e-12, "landmarks permuted"),
    "resampled and back": Law(resampled_and_back, 1e-10, "resampled and back"),
    "clip reversed": Law(reversed_clip, 1e-10, "clip reversed"),
    "clip cut and joined": Law(cut_and_joined, 1e-10, "clip cut and joined"),
    "pictures 1.2 times as bright": Law(brighter_pictures, 1e-9, "dB, 1.2 times as bright"),
    "surface in millimetres": Law(surface_in_other_units, 1e-10, "m, surface in millimetres"),
    "picture larger and cut": Law(larger_and_cut, 1e-8, "pixel, larger and cut"),
    "picture scored in tiles": Law(scored_in_tiles, 1e-9, "dB, scored in tiles"),
}


@pytest.mark.rows
@pytest.mark.parametrize("name", LAWS)
def test_a_law_that_needs_no_reference_holds(within, name):
    law, worst = LAWS[name], [0.0]

    @settings(derandomize=True, max_examples=25, deadline=None, database=None)
    @given(st.integers(0, 2**32))
    def asked(seed):
        found = np.abs(law.difference(np.random.default_rng(seed)))
        assert found.size and np.isfinite(found).all()
        worst.append(float(found.max()))
        assert worst[-1] <= law.bound, seed

    asked()
    within(worst, law.bound, law.unit)


SIZE = (96, 96)
CAMERA = Camera(pinhole(SIZE, 0.6), look_at((0.4, 1.0, 4.0), (0.2, 0.9, 0.0)), SIZE)


@pytest.fixture
def stage(pose):
    """Two people of whom one stands half before the other, and their poses."""
    from player.scene.mannequin import mannequin

    aside = (pose[0] * 0.5, pose[1] + [0.3, 0, -0.6])
    return [mannequin(), mannequin("female")], [pose, aside]


def test_a_picture_is_the_same_bits_drawn_twice_and_whoever_is_named_first(render, stage, within):
    people, poses = stage
    renderer = render(people, SIZE)
    once = renderer.draw(poses, CAMERA)
    assert (once[..., 3] > 0).mean() > 0.05
    assert np.array_equal(renderer.draw(poses, CAMERA), once)
    swapped = render(people[::-1], SIZE).draw(poses[::-1], CAMERA).astype(int)
    within(np.abs(swapped - once).max(), 0, "/255, avatars exchanged")


def test_triangles_and_vertices_in_another_order_draw_the_same_picture(render, stage, within):
    (person, _), (pose, _) = stage
    once, rng = render(person, SIZE).draw([pose], CAMERA).astype(int), np.random.default_rng(4)
    level = person.levels[0]
    order, count = rng.permutation(len(level.positions)), len(level.positions)
    fields = {
        n: v[order] for n, v in vars(level).items() if isinstance(v, np.ndarray) and len(v) == count and v.ndim < 3
    }
    faces = np.argsort(order).astype(np.uint32)[level.faces][rng.permutation(len(level.faces))]
    other = replace(level, **(fields | {"faces": faces}))
    again = render(replace(person, levels=(other, *person.levels[1:])), SIZE).draw([pose], CAMERA).astype(int)
    # what lies at one depth may be either: a pixel on an edge
    within((np.abs(again - once).max(2) > 1).mean(), 0.002, "of the pixels differ, triangles in another order")


def test_a_picture_in_tiles_is_the_picture(render, stage, within):
    people, poses = stage
    whole, tiles = render(people, SIZE).draw(poses, CAMERA).astype(int), np.zeros((*SIZE, 4), int)
    renderer = render(people, (48, 32))
    for x in range(0, SIZE[0], 48):
        for y in range(0, SIZE[1], 32):
            tiles[y : y + 32, x : x + 48] = renderer.draw(poses, CAMERA.cropped(x, y, (48, 32)))
    within((np.abs(tiles - whole).max(2) > 1).mean(), 0.01, "of the pixels differ, in tiles")


def test_a_person_covers_as_much_of_a_picture_of_twice_the_size(render, stage, within):
    people, poses = stage
    once = render(people, SIZE).draw(poses, CAMERA)[..., 3].mean()
    twice = render(people, (192, 192)).draw(poses, CAMERA.resized((192, 192)))[..., 3].mean()
    within(twice / once - 1, 0.01, "of the area, twice the size")
