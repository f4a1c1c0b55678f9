"""The head's place read off the body's video, on a painted body that turns round."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from painted_capture import write_capture

from avatar.rotation import matrix_from_axis_angle
from avatar.skeleton import skin_transforms
from avatar.skinning import skin_points
from capture.folder import read_capture
from capture.register.photometric import ColoredHead, refine_on_video
from capture.template.parts import part_boxes, with_rigid_head
from geometry.icp import Anchors
from geometry.rasterise import rasterise
from train.compose import place_on_surfaces
from train.fused import part_weight

SIZE, FINER = 256, 3


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    """A capture whose body video is drawn anew, finer: 4 frames of the painted template turning round."""
    capture = read_capture(write_capture(tmp_path_factory.mktemp("capture") / "c", size=24, frames=4))
    subject = with_rigid_head(capture.subject)
    video = capture.videos["body"]
    cameras, images, masks = [], [], []
    for frame, small in enumerate(video.cameras):
        camera = small.resized((SIZE, SIZE))
        K = camera.K.copy()
        K[:2] *= FINER
        B = skin_transforms(video.axis_angle[frame], subject.joints, video.root[frame])
        posed = skin_points(subject.vertices, subject.skin, B)
        drawn = rasterise(posed, subject.faces, replace(camera, K=K, size=(FINER * SIZE, FINER * SIZE)))
        hit = drawn.face >= 0
        color = np.where(hit[..., None], paint(subject.vertices[subject.faces].mean(1))[drawn.face], 0)
        blocks = (SIZE, FINER, SIZE, FINER)
        images.append((255 * color.reshape(*blocks, 3).mean((1, 3))).round().astype(np.uint8))
        masks.append(hit.reshape(blocks).mean((1, 3)) > 0.5)
        cameras.append(camera)
    video = replace(video, cameras=tuple(cameras), images=np.stack(images), masks=np.stack(masks))
    return replace(capture, subject=subject, videos={**capture.videos, "body": video})


def paint(points):
    return 0.5 + 0.4 * np.sin(20 * points)


def moved(transform, points):
    return points @ transform[:3, :3].T + transform[:3, 3]


def head_of(subject, away):
    """The head as a field shows it that stands `away` from its place, painted as the videos are."""
    own = part_weight(torch.as_tensor(subject.vertices), part_boxes(subject)[1]).numpy() > 0.5
    vertices = np.flatnonzero(own & (subject.part == 1))
    points = subject.vertices[vertices]
    return ColoredHead(vertices, moved(away, points), paint(points)), points


def loose_anchors(head, points):
    """Landmarks as uncertain as they can be: the pixels have to say it."""
    return Anchors(head.points[::200], points[::200], 0.05)


def similarity(turn, shift, scale, centre):
    out = np.eye(4)
    out[:3, :3] = scale * matrix_from_axis_angle(np.radians(turn))
    out[:3, 3] = centre - out[:3, :3] @ centre + shift
    return out


def test_pixels_find_turn_shift_and_scale_of_a_head_that_landmarks_misplaced(capture):
    centre = capture.subject.vertices[capture.subject.part == 1].mean(0)
    away = similarity([1.5, -1.0, 1.0], [0.002, -0.001, 0.002], 0.98, centre)
    head, points = head_of(capture.subject, away)
    before = np.linalg.norm(head.points - points, axis=1).mean()
    fit = refine_on_video(capture.subject, head, capture.videos["body"], np.eye(4), loose_anchors(head, points))
    error = np.linalg.norm(moved(fit.transform, head.points) - points, axis=1).mean()
    assert fit.after < fit.before
    assert before > 0.003 and error < 0.25 * before  # a pixel of this video is 9 mm
    assert abs(np.cbrt(np.linalg.det(fit.transform[:3, :3])) * 0.98 - 1) < 0.004


@pytest.mark.parametrize(("light", "mean"), [(1.0, 0.001), (0.9, 0.002)])
def test_a_head_that_stands_right_stays_also_in_another_light(capture, light, mean):
    head, points = head_of(capture.subject, np.eye(4))
    video = replace(capture.videos["body"], images=(capture.videos["body"].images * light).astype(np.uint8))
    fit = refine_on_video(capture.subject, head, video, np.eye(4), loose_anchors(head, points))
    away = np.linalg.norm(moved(fit.transform, points) - points, axis=1)
    assert away.mean() < mean and away.max() < 0.002  # four frames of 9 mm pixels


def test_a_video_without_the_head_is_said(capture):
    head, points = head_of(capture.subject, np.eye(4))
    video = capture.videos["body"]
    away = replace(video, root=video.root + [0.0, 50.0, 0.0])
    with pytest.raises(ValueError, match="shows no head"):
        refine_on_video(capture.subject, head, away, np.eye(4), loose_anchors(head, points))


def test_where_the_surfaces_give_no_answer_the_landmarks_place_stays(capture, monkeypatch):
    """Every part is trained by then: the run goes on, and says so."""

    def nothing_near(*_arguments):
        raise ValueError("head registration: 7% of the surface within 0.02 m of the body's, under 10 %")

    monkeypatch.setattr("train.compose.register_head", nothing_near)
    head, points = head_of(capture.subject, np.eye(4))
    said = []
    placed, distance = place_on_surfaces(capture.subject, [], loose_anchors(head, points), said.append)
    assert np.array_equal(placed.transform, np.eye(4)) and distance is None
    assert said == [
        "head registration: 7% of the surface within 0.02 m of the body's, under 10 %: "
        "the place by landmarks stays (Eq. 6)"
    ]
