"""The rotate gizmo: what is under the pointer, and how far a drag turns, from every side."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from avatar.body import builtin_body
from avatar.camera import orbit_camera, project
from avatar.limits import joint_angles, limits, with_angle
from avatar.rotation import matrix_from_axis_angle
from avatar.skeleton import JOINTS, joint_transforms
from player.pose.gizmo import (
    PIXELS,
    VIEW_RING,
    Gizmo,
    drag_angle,
    gizmo_at,
    grabbed,
    on_plane_through,
    picked_joint,
    picked_ring,
    ring_front,
    ring_points,
    turned,
)

SOME = settings(max_examples=15, deadline=None, derandomize=True)
seeds = st.integers(0, 2**32 - 1)
JOINTS_AT = builtin_body("male").joints.astype(float)
SIZE = (640, 480)


def some_gizmo(seed=0, frame="local"):
    rng = np.random.default_rng(seed)
    pose, root = rng.normal(size=(52, 3)) * 0.4, rng.normal(size=3) * 0.2
    joint = int(rng.integers(0, 52))
    place = joint_transforms(pose, JOINTS_AT, root)[joint, :3, 3]
    camera = orbit_camera(place + rng.normal(size=3) * 0.1, 2.0, rng.uniform(-3, 3), rng.uniform(-1.2, 1.2), SIZE)
    gizmo = gizmo_at(pose, root, JOINTS_AT, joint, camera, frame=frame)
    assert gizmo is not None
    return gizmo, camera, pose, root, joint


@SOME
@given(seeds)
def test_a_gizmo_is_as_large_on_the_screen_wherever_the_joint_is(seed):
    gizmo, camera, *_ = some_gizmo(seed)
    center, _ = project(camera, gizmo.center[None])
    points, _ = project(camera, ring_points(gizmo, VIEW_RING))
    radius = np.linalg.norm(points - center, axis=1)
    assert np.abs(radius / (1.2 * PIXELS) - 1).max() < 0.12  # a wide picture shows spheres as ellipses
    np.testing.assert_allclose(gizmo.axes[:3] @ gizmo.axes[:3].T, np.eye(3), atol=1e-12)
    for ring in range(4):
        points = ring_points(gizmo, ring) - gizmo.center
        np.testing.assert_allclose(np.linalg.norm(points, axis=1), gizmo.radii[ring], atol=1e-12)
        np.testing.assert_allclose(points @ gizmo.axes[ring], 0, atol=1e-12)
        assert np.array_equal(points[0], points[-1]) or np.allclose(points[0], points[-1], atol=1e-12)


def test_axes_are_the_joint_s_own_or_the_world_s():
    gizmo, camera, pose, root, joint = some_gizmo(4)
    world = joint_transforms(pose, JOINTS_AT, root)[joint, :3, :3]
    np.testing.assert_allclose(gizmo.axes[2], world @ limits().axes[joint, 2], atol=1e-12)  # along the bone
    angles = joint_angles(pose)[joint]
    after = joint_angles(turned(pose, root, JOINTS_AT, joint, gizmo.axes[2], 0.2))[joint]
    np.testing.assert_allclose(after, angles + [0, 0, 0.2], atol=1e-9)
    hinge = with_angle(pose, joint, 1, 0.0, limited=False)
    camera = orbit_camera(gizmo.center + [0.0, 0.1, 0.2], 2.0, 0.3, 0.2, SIZE)
    gizmo = gizmo_at(hinge, root, JOINTS_AT, joint, camera)
    assert gizmo is not None
    angles = joint_angles(hinge)[joint]
    after = joint_angles(turned(hinge, root, JOINTS_AT, joint, gizmo.axes[0], 0.2))[joint]
    np.testing.assert_allclose(after, angles + [0.2, 0, 0], atol=1e-9)
    other = gizmo_at(pose, root, JOINTS_AT, joint, camera, frame="world")
    assert other is not None and np.array_equal(other.axes[:3], np.eye(3))
    behind = orbit_camera(other.center + [0, 0, 5.0], 1.0, np.pi, 0.0, SIZE)
    assert gizmo_at(pose, root, JOINTS_AT, joint, behind) is None


@SOME
@given(seeds, st.integers(0, 3), st.integers(0, 95))
def test_the_ring_under_the_pointer_is_picked_and_the_far_half_is_not(seed, ring, k):
    gizmo, camera, *_ = some_gizmo(seed)
    points = ring_points(gizmo, ring)
    pixels, _ = project(camera, points)
    found = picked_ring(gizmo, camera, pixels[k])
    if ring == VIEW_RING or ring_front(gizmo, points, camera)[k]:
        # another ring may cross there, and is as good an answer
        others = [
            np.linalg.norm(project(camera, ring_points(gizmo, r, 2000))[0] - pixels[k], axis=1).min() for r in range(4)
        ]
        assert found is not None and others[found] <= others[ring] + 2.1
        if all(distance > 12 for r, distance in enumerate(others) if r != ring):
            assert found == ring
    center, _ = project(camera, gizmo.center[None])
    assert picked_ring(gizmo, camera, center[0] + [1.2 * PIXELS + 40, 0]) is None


@SOME
@given(seeds, st.integers(0, 3), st.floats(-9, 9))
def test_a_ring_follows_the_pointer_to_any_angle_through_whole_turns(seed, ring, goal):
    """The pointer goes round the ring by `goal`: the point that was seized stays under it."""
    gizmo, camera, *_ = some_gizmo(seed)
    start = ring_points(gizmo, ring)[0] - gizmo.center
    axis = gizmo.axes[ring]
    first, _ = project(camera, (gizmo.center + start)[None])
    grab = grabbed(gizmo, ring, camera, first[0])
    if grab.rolled is not None:
        return  # nearly edge-on: another test
    assert drag_angle(grab, camera, first[0]) == pytest.approx(0, abs=1e-9)
    angle = 0.0
    for part in np.linspace(0, goal, 40)[1:]:
        point = gizmo.center + matrix_from_axis_angle(axis * part) @ start
        angle = drag_angle(grab, camera, project(camera, point[None])[0][0], angle)
    assert angle == pytest.approx(goal, abs=1e-6)


@pytest.mark.parametrize("tilt", [0.0, 1e-9, 1e-4, 0.01, 0.1, 0.2, -0.2, 0.3, 0.5])
def test_edge_on_a_drag_is_finite_even_and_goes_with_the_pointer(tilt):
    """A ring about y seen from the side, then more and more from above: 80 pixels are about a radian, no jumps."""
    camera = orbit_camera((0.0, 0.0, 0.0), 2.0, 0.0, tilt, SIZE)
    radius = PIXELS * 2.0 / camera.K[1, 1]
    eye = -camera.eye / np.linalg.norm(camera.eye)
    gizmo = Gizmo(np.zeros(3), np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1], eye]), radius * np.array([1, 1, 1, 1.2]))
    seized, _ = project(camera, np.array([[0.0, 0.0, radius]]))
    grab = grabbed(gizmo, 1, camera, seized[0])
    assert (grab.rolled is not None) == (abs(np.sin(tilt)) < 0.2)
    angles, last = [], 0.0
    for dx in range(0, 61, 2):
        last = drag_angle(grab, camera, seized[0] + [dx, 0.0], last)
        angles.append(last)
    steps = np.diff(angles)
    assert (steps > 0).all() and steps.max() < 0.12  # the front of the ring goes right: +y turns +z to +x
    assert 0.5 < angles[-1] < 1.6
    # across the ring it hardly turns
    assert abs(drag_angle(grab, camera, seized[0] + [0.0, 3.0])) < 0.3
    far = [drag_angle(grab, camera, seized[0] + np.array([x, y]), 0.0) for x, y in ((1e4, 0), (0, 1e4), (0, -1e4))]
    assert np.isfinite(far).all()


@SOME
@given(seeds, st.floats(-3, 3))
def test_a_turn_turns_the_joint_and_what_hangs_on_it_about_the_axis(seed, angle):
    gizmo, _, pose, root, joint = some_gizmo(seed, "world")
    before = joint_transforms(pose, JOINTS_AT, root)
    axis = np.random.default_rng(seed).normal(size=3)
    axis /= np.linalg.norm(axis)
    out = turned(pose, root, JOINTS_AT, joint, axis, angle)
    after = joint_transforms(out, JOINTS_AT, root)
    turn = matrix_from_axis_angle(axis * angle)
    np.testing.assert_allclose(after[joint, :3, :3], turn @ before[joint, :3, :3], atol=1e-9)
    np.testing.assert_allclose(after[joint, :3, 3], before[joint, :3, 3], atol=1e-12)
    assert np.array_equal(np.delete(out, joint, 0), np.delete(pose, joint, 0))
    back = turned(out, root, JOINTS_AT, joint, axis, -angle)
    np.testing.assert_allclose(joint_transforms(back, JOINTS_AT, root), before, atol=1e-9)
    assert np.array_equal(turned(pose, root, JOINTS_AT, joint, axis, 0.0), pose)


def test_the_joint_under_the_pointer_is_picked_nearest_first():
    places = JOINTS_AT
    camera = orbit_camera((0, 0, 0), 3.0, 0.0, 0.0, SIZE)
    pixels, depth = project(camera, places)
    for joint in ("left_elbow", "right_knee", "head"):
        k = JOINTS.index(joint)
        assert picked_joint(places, camera, pixels[k] + [3, -2]) == k
    assert picked_joint(places, camera, np.array([5.0, 5.0])) is None
    two = np.array([[0, 0, 0.5], [0, 0, -0.5], [0, 0, 9.0]])  # one behind the other, one behind the eye
    assert picked_joint(two, camera, np.array([320.0, 240.0])) == 0


@SOME
@given(seeds, st.floats(0, 640), st.floats(0, 480))
def test_a_handle_is_dragged_to_the_pointer_at_its_own_depth(seed, x, y):
    gizmo, camera, *_ = some_gizmo(seed)
    place = on_plane_through(camera, gizmo.center, np.array([x, y]))
    pixel, depth = project(camera, place[None])
    np.testing.assert_allclose(pixel[0], [x, y], atol=1e-6)
    assert depth[0] == pytest.approx(project(camera, gizmo.center[None])[1][0], abs=1e-9)
