"""The place and height of a head by its own and by the body's video, and the eyeball's flat front."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from painted_ball import filmed, head
from painted_capture import FORWARD, write_capture
from painted_capture import filmed as filmed_eyes
from scipy import ndimage

from avatar.rotation import fibonacci_sphere, matrix_from_axis_angle
from avatar.skeleton import skin_transforms
from avatar.skinning import skin_points
from capture.folder import CaptureSubject, PartVideo, read_capture
from capture.register.head_consistency import place_by_consistency
from capture.register.head_height import height_by_outline
from capture.register.iris import ANGLES, FlatIris, disagreement, eye_front
from capture.register.photometric import ColoredHead, refine_on_video
from capture.template.eyes import EyeSpheres
from capture.template.parts import part_boxes, with_rigid_head
from geometry.icp import Anchors
from geometry.rasterise import rasterise
from train.compose import place_on_surfaces
from train.fused import part_weight

IN_PLACE = np.eye(4)


def lifted(millimetres: float) -> np.ndarray:
    out = np.eye(4)
    out[1, 3] = millimetres / 1000
    return out


def anchors(subject: CaptureSubject, spread: float, start: np.ndarray = IN_PLACE) -> Anchors:
    target = subject.vertices[::1200]
    return Anchors(target @ start[:3, :3].T + start[:3, 3], target, spread)


@pytest.mark.parametrize("millimetres", [-3.0, 2.0])
@pytest.mark.parametrize("thinner", [0, 1])
def test_a_head_too_high_or_low_comes_back_also_when_its_masks_are_too_narrow(case, millimetres, thinner):
    subject, video = case
    if thinner:
        video = replace(video, masks=np.stack([ndimage.binary_erosion(m, iterations=thinner) for m in video.masks]))
    found = height_by_outline(subject, video, lifted(millimetres), anchors(subject, 0.01))
    # a pixel is 3.3 mm
    assert found.canonical_from_head[1, 3] == pytest.approx(0, abs=3e-4)
    assert found.shift == pytest.approx(millimetres / 1000, abs=3e-4)
    assert found.thickness == pytest.approx(-thinner, abs=0.5)
    np.testing.assert_array_equal(np.delete(found.canonical_from_head.ravel(), 7), np.delete(np.eye(4).ravel(), 7))


def test_landmarks_that_are_exact_keep_their_height_where_the_template_is_not_the_person(case):
    subject, video = case
    bumps = 1 + 0.04 * np.sin(300 * subject.vertices[:, :1])
    other = replace(subject, vertices=subject.vertices * bumps)
    trusting, doubting = (
        height_by_outline(other, video, lifted(2.0), anchors(subject, spread)).shift for spread in (1e-5, 1e-2)
    )
    assert abs(trusting) < 5e-5 < 1e-3 < doubting


def test_too_little_skin_a_head_a_finger_off_and_one_that_no_frame_shows_are_refused(case):
    subject, video = case
    covered = replace(subject, hair=subject.vertices[:, 1] > -0.105)
    with pytest.raises(ValueError, match=r"only \d+ places of bare skin"):
        height_by_outline(covered, video, IN_PLACE, anchors(subject, 0.01))
    with pytest.raises(ValueError, match=r"more than 0\.01"):
        height_by_outline(subject, video, lifted(25.0), anchors(subject, 0.1))
    dark = PartVideo("head", video.images, np.zeros_like(video.masks), video.cameras, None, None, None, None)
    with pytest.raises(ValueError, match="hardly any"):
        place_by_consistency(subject, dark, IN_PLACE, anchors(subject, 0.003))


@pytest.fixture(scope="module")
def case() -> tuple[CaptureSubject, PartVideo]:
    """A painted ball for a head, and its video."""
    subject = head()
    return subject, filmed(subject)


def off(transform: np.ndarray, points: np.ndarray) -> float:
    """Metres, mean."""
    return float(np.linalg.norm(points @ transform[:3, :3].T + transform[:3, 3] - points, axis=1).mean())


def disturbed(scale: float, degrees: float, shift: float) -> np.ndarray:
    out = np.eye(4)
    out[:3, :3] = (1 + scale) * matrix_from_axis_angle(np.radians(degrees) * np.array([0.6, 0.8, 0.0]))
    out[:3, 3] = shift * np.array([0.5, -0.5, 0.7])
    return out


def test_a_head_two_degrees_and_two_per_cent_off_comes_back_and_one_in_its_place_stays(case):
    subject, video = case
    start = disturbed(0.02, 2.0, 0.002)
    found = place_by_consistency(subject, video, start, anchors(subject, 0.003, start))
    assert off(found.canonical_from_head, subject.vertices) < 0.4 * off(start, subject.vertices)
    assert found.after < found.before
    found = place_by_consistency(subject, video, IN_PLACE, anchors(subject, 0.003))
    assert off(found.canonical_from_head, subject.vertices) < 0.0015


CENTRE, RADIUS = np.array([0.03, 0.01, 0.02]), 0.012


def best_angle(views: list) -> float:
    directions = fibonacci_sphere(3000)
    directions = directions[directions @ FORWARD > np.cos(np.radians(40))]
    nothing = np.zeros((0, 3, 3))
    sums = [disagreement(CENTRE, RADIUS, eye_front(directions, FORWARD, a), nothing, views) for a in ANGLES]
    return float(np.degrees(ANGLES[np.argmin([total / weight for total, weight in sums])]))


@pytest.mark.parametrize("angle", [20, 25, 30])
def test_the_disc_of_an_iris_is_found_where_it_lies(angle):
    assert best_angle(filmed_eyes([CENTRE], [RADIUS], np.radians(angle))) == pytest.approx(angle, abs=2)


def test_a_round_eye_stays_round_and_a_hidden_eye_tells_nothing():
    assert best_angle(filmed_eyes([CENTRE], [RADIUS], 0.0)) == 0
    lid = CENTRE + np.array([[[-1.0, -1, 0.05], [1, -1, 0.05], [0, 1, 0.05]]])
    surface = eye_front(np.array([FORWARD]), FORWARD, 0.0)
    assert disagreement(CENTRE, RADIUS, surface, lid, filmed_eyes([CENTRE], [RADIUS], 0.0))[1] == 0
    assert disagreement(CENTRE, RADIUS, surface, np.zeros((0, 3, 3)), filmed_eyes([CENTRE], [RADIUS], 0.0))[1] > 0


def test_a_cut_ball_is_a_ball_with_a_flat_front():
    spheres = EyeSpheres(np.array([CENTRE, -CENTRE]), np.array([RADIUS, RADIUS]))
    angle = np.radians(25)
    cut = FlatIris(FORWARD, float(angle))
    directions = fibonacci_sphere(500)
    for middle in spheres.centres:
        surface = eye_front(directions, FORWARD, float(angle))
        np.testing.assert_allclose(cut.distance(spheres, middle + RADIUS * surface.points), 0, atol=1e-12)
    front = CENTRE + RADIUS * FORWARD
    assert spheres.distance(front[None])[0] == pytest.approx(0, abs=1e-12)
    assert cut.distance(spheres, front[None])[0] == pytest.approx(RADIUS * (1 - np.cos(angle)))


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
