"""Whether an imported capture is its source: pictures, masks, cameras, poses, and every projected vertex."""

import numpy as np

from avatar.camera import project
from avatar.skeleton import skin_transforms
from avatar.skinning import skin_points
from capture.folder import Capture, read_capture


def posed(capture: Capture, part: str, frame: int) -> np.ndarray:
    subject, video = capture.subject, capture.videos[part]
    B = skin_transforms(video.axis_angle[frame], subject.joints, video.root[frame], np.zeros((52, 3)))
    return skin_points(subject.rest, subject.skin, B)


def assert_same_capture(
    out, source: Capture, *, metres: float = 1e-6, pixels: float = 1e-4, raw: bool = True
) -> Capture:
    found = read_capture(out)
    np.testing.assert_allclose(found.subject.rest, source.subject.rest, atol=metres)
    np.testing.assert_allclose(found.subject.joints, source.subject.joints, atol=metres)
    np.testing.assert_array_equal(found.subject.faces, source.subject.faces)
    np.testing.assert_array_equal(found.subject.part, source.subject.part)
    for part in ("body", "hand_left", "hand_right"):
        a, b = found.videos[part], source.videos[part]
        np.testing.assert_array_equal(a.images, b.images)
        np.testing.assert_array_equal(a.masks, b.masks)
        if raw:
            np.testing.assert_allclose(a.root, b.root, atol=metres)
            np.testing.assert_allclose(a.axis_angle[:, 1:], b.axis_angle[:, 1:], atol=1e-9)
        for frame, (mine, theirs) in enumerate(zip(a.cameras, b.cameras)):
            assert mine.size == theirs.size
            here, there = posed(found, part, frame), posed(source, part, frame)
            if raw:
                np.testing.assert_allclose(mine.camera_from_world, theirs.camera_from_world, atol=1e-9)
                np.testing.assert_allclose(here, there, atol=metres)
            seen, depth = project(mine, here)
            expected, expected_depth = project(theirs, there)
            np.testing.assert_allclose(depth, expected_depth, atol=metres)
            inside = (depth > 0) & (np.abs(expected) < 3 * mine.size[0]).all(1)  # the lens bends no farther
            assert inside.sum() > 500
            np.testing.assert_allclose(seen[inside], expected[inside], atol=pixels)
    return found


def head_pixels(capture: Capture, frame: int) -> np.ndarray:
    """The template's head as the frame's camera sees it, through the landmarks."""
    from avatar.similarity import similarity_from_landmarks

    video, subject = capture.videos["head"], capture.subject
    fit = similarity_from_landmarks(subject.vertices[video.landmark_vertices], video.landmarks)
    points = subject.vertices[subject.part == 1] @ fit.transform[:3, :3].T + fit.transform[:3, 3]
    return project(video.cameras[frame], points)[0]


def assert_same_head(found: Capture, source: Capture, *, pixels: float = 1e-4) -> None:
    a, b = found.videos["head"], source.videos["head"]
    np.testing.assert_array_equal(a.images, b.images)
    np.testing.assert_array_equal(a.masks, b.masks)
    for frame in range(len(b.images)):
        np.testing.assert_allclose(head_pixels(found, frame), head_pixels(source, frame), atol=pixels)
