"""The ray under the pointer meets what the screen shows there."""

import numpy as np
import pytest

from avatar.body import builtin_body
from avatar.camera import Camera, look_at, orbit_camera, pinhole, project
from avatar.skeleton import JOINTS, joint_transforms
from player.draw.posing import posed_vertices
from player.window.pointer import pick
from player.window.pose_tool import on_plane_through, picked_joint

SIZE = (60, 80)


def test_the_triangle_picked_is_the_triangle_drawn(rasteriser, avatar, pose):
    camera = orbit_camera((0.1, 0, -0.2), 3.0, 0.4, 0.2, SIZE)
    level = avatar.levels[0]
    vertices = posed_vertices(avatar, level, pose)
    drawn = rasteriser.draw(vertices, level.faces.astype(np.int64), camera, cull=True)
    hits = 0
    for row in range(2, SIZE[1], 9):
        for column in range(1, SIZE[0], 7):
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
        camera = Camera(pinhole(SIZE, 0.6), look_at(middle + [0.3, 0.2, 1.5], middle), SIZE)
        found = pick([avatar], avatar.levels, [pose], camera, (SIZE[0] / 2, SIZE[1] / 2))
        assert found is not None and found.joint == a, joint


def test_the_nearer_of_two_avatars_is_picked_and_a_ray_beside_them_meets_nothing(avatar):
    still = np.zeros((52, 3))
    poses = [(still, np.array([0.0, 0, 0])), (still, np.array([0.0, 0, 1.0]))]
    camera = orbit_camera((0, 0, 0), 4.0, 0.0, 0.0, SIZE)
    chest, _ = project(camera, np.array([[0.0, 0.15, 0.0]]))
    for order, nearer in ((poses, 1), (poses[::-1], 0)):
        found = pick([avatar] * 2, [avatar.levels[0]] * 2, order, camera, tuple(chest[0].tolist()))
        assert found is not None and found.avatar == nearer and 2.5 < found.distance < 3.0
    assert pick([avatar], [avatar.levels[0]], poses[:1], camera, (1.0, 1.0)) is None
    behind = Camera(camera.K, look_at((0, 0, 4.0), (0, 0, 8.0)), SIZE)
    assert pick([avatar], [avatar.levels[0]], poses[:1], behind, tuple(chest[0].tolist())) is None


def test_the_joint_under_the_pointer_is_picked_nearest_first():
    places = builtin_body("male").joints.astype(float)
    camera = orbit_camera((0, 0, 0), 3.0, 0.0, 0.0, (640, 480))
    pixels, depth = project(camera, places)
    for joint in ("left_elbow", "right_knee", "head"):
        k = JOINTS.index(joint)
        assert picked_joint(places, camera, pixels[k] + [3, -2]) == k
    assert picked_joint(places, camera, np.array([5.0, 5.0])) is None
    # one behind the other, one behind the eye
    two = np.array([[0, 0, 0.5], [0, 0, -0.5], [0, 0, 9.0]])
    assert picked_joint(two, camera, np.array([320.0, 240.0])) == 0


@pytest.mark.parametrize("pixel", [(0.0, 0.0), (320.0, 240.0), (639.0, 17.0)])
def test_a_handle_is_dragged_to_the_pointer_at_its_own_depth(pixel):
    camera, place = orbit_camera((0.1, 0.2, 0), 2.0, 0.7, -0.4, (640, 480)), np.array([0.3, -0.2, 0.1])
    dragged = on_plane_through(camera, place, np.array(pixel))
    shown, depth = project(camera, np.stack([dragged, place]))
    np.testing.assert_allclose(shown[0], pixel, atol=1e-6)
    assert depth[0] == pytest.approx(depth[1], abs=1e-9)
