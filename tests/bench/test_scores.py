"""Scores of pictures, LPIPS, eyes, outlines, surfaces, hair and skeletons against closed forms."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from capsules import icosphere
from mesh_distance import mesh_distance
from painted_capture import free_subject
from refusals import refused

from avatar.body import builtin_body
from avatar.camera import Camera, look_at, orbit_camera, pinhole
from avatar.rotation import axis_angle_from_matrix, matrix_from_axis_angle
from avatar.skeleton import BIG_POSE, JOINTS, PARTS
from avatar.skinning import SkinWeights
from bench.field.posed_field import MaskedPicture, PosableSurface
from bench.score.lpips import CONVOLUTIONS, read_perceptual
from bench.score.metrics import flip
from bench.score.picture_scores import PictureJudge, eye_region, score_images
from bench.score.posed_geometry import geometry_case, posed_pair, skin_beside_hair
from bench.score.quality import evaluate
from bench.score.region_scores import without_eyes
from bench.score.skeleton_distance import BODY, LIMBS, joints_off, posed_skeletons, turned_off
from bench.score.standing import FOV, INNER, face_landmarks_mm, outline_scores
from bench.score.true_mesh import TrueMesh
from capture.fit.points import body_points
from capture.held_out import HeldOutView
from command.errors import AssetError

RADIUS = 0.2  # metres
HEAD = JOINTS.index("head")


def head(vertices, faces) -> TrueMesh:
    """A bald head that follows the head bone, all of it visible."""
    count = len(vertices)
    skin = SkinWeights(np.full((count, 4), HEAD), np.eye(1, 4, dtype=np.float32).repeat(count, 0))
    part = np.full(count, PARTS.index("head"))
    return TrueMesh(vertices, faces, skin, np.zeros((52, 3)), part, np.zeros(count, bool), np.ones(len(faces), bool))


def scores(rasteriser, radius: float, shift: float = 0.0, T=None):
    """A head of RADIUS, and ours: another ball, moved to a side."""
    (true, faces), (ours, own) = icosphere(RADIUS, subdivisions=4), icosphere(radius, (shift, 0, 0), 4)
    truth = head(true, faces)
    surface = PosableSurface(ours, own, truth.skin, np.zeros((52, 3)), np.zeros((52, 3)))
    case = geometry_case(truth, surface, truth.visible)
    return outline_scores(rasteriser, case, posed_pair(case, true, ours), T)


def test_balls_within_and_beside_each_other_cover_what_their_circles_share(rasteriser):
    found = scores(rasteriser, 0.8 * RADIUS)
    assert found.keys() == {"total", "head"}
    # as a camera near the ball sees them
    away = 1.1 * RADIUS / np.tan(FOV / 2)
    share = 0.64 * (away**2 - RADIUS**2) / (away**2 - (0.8 * RADIUS) ** 2)
    for score in found.values():
        assert score["outline_iou"] == pytest.approx(share, abs=0.01)
        assert score["outline_worst"] == pytest.approx(share, abs=0.02)
    found = scores(rasteriser, RADIUS, shift=RADIUS)["total"]
    # two circles whose middles lie a radius apart share .391 of either
    assert found["outline_worst"] == pytest.approx(0.391 / (2 - 0.391), abs=0.04)
    assert found["outline_worst"] + 0.1 < found["outline_iou"] < 0.9
    back = np.eye(4)
    back[0, 3] = -RADIUS
    assert scores(rasteriser, RADIUS, shift=RADIUS, T=back)["total"]["outline_worst"] > 0.99


def test_a_trunk_behind_a_missing_head_is_no_outline_of_it(rasteriser):
    (ball, faces), (trunk, more) = icosphere(RADIUS, subdivisions=3), icosphere(0.5, (0, 0, -1), 3)
    truth = head(np.concatenate([ball, trunk]), np.concatenate([faces, more + len(ball)]))
    truth.part[len(ball) :] = PARTS.index("body")
    surface = PosableSurface(trunk, more, SkinWeights(*(a[len(ball) :] for a in truth.skin)), *np.zeros((2, 52, 3)))
    case = geometry_case(truth, surface, np.ones(len(more), bool))
    found = outline_scores(rasteriser, case, posed_pair(case, truth.vertices, trunk))
    assert found["head"]["outline_iou"] == 0 < found["total"]["outline_worst"]


def test_features_of_the_face_are_as_far_off_as_they_are_true_elsewhere():
    body, subject = builtin_body("male"), free_subject("male")
    points = body_points()
    places = np.stack([points[f"face_{k:02d}"].place(body.vertices, body.joints) for k in range(17, 68)])
    face = np.zeros((68, 3))
    face[INNER] = places + (0.0, 0.003, 0.0)
    truth = TrueMesh(body.vertices, body.faces, body.skin, body.joints, subject.part, subject.hair,
                     np.ones(len(body.faces), bool), None, face)  # fmt: skip
    surface = PosableSurface(subject.vertices, body.faces, body.skin, body.joints, BIG_POSE)
    case = geometry_case(truth, surface, truth.visible)
    standing = surface.posed(np.zeros((52, 3)), body.joints[0])
    pair = posed_pair(case, body.vertices, standing)
    found = face_landmarks_mm(subject, case, pair)
    assert found["face_mm"] == pytest.approx(0.0, abs=0.3)
    assert found["face_on_head_mm"] == pytest.approx(3.0, abs=0.3)
    assert face_landmarks_mm(subject, replace(case, truth=replace(truth, face=None)), pair) == {}


REST = builtin_body("male").joints


@pytest.fixture
def views(tmp_path):
    rng = np.random.default_rng(0)
    camera = orbit_camera(np.zeros(3), 3.0, 0.0, 0.0, (64, 64))
    return [HeldOutView(tmp_path, "", "body", i, 0.3 * rng.standard_normal((52, 3)), rng.standard_normal(3), camera)
            for i in range(7)]  # fmt: skip


def turned(view, joint, vector):
    axis_angle = view.axis_angle.copy()
    k = JOINTS.index(joint)
    axis_angle[k] = axis_angle_from_matrix(matrix_from_axis_angle(axis_angle[k]) @ matrix_from_axis_angle(vector))
    return replace(view, axis_angle=axis_angle)


def test_shifts_are_off_in_place_alone_and_turns_the_same_in_all_frames_no_error_of_poses(views, within):
    posed = posed_skeletons([replace(v, root=v.root + [0, 0.03, 0.04]) for v in views], views, REST, REST)
    within(abs(joints_off(posed, LIMBS, aligned=False) - 5.0), 1e-9, "cm")
    within(joints_off(posed, LIMBS, aligned=True), 1e-9, "cm")
    same = posed_skeletons([turned(v, "left_elbow", np.array([0, 0, 0.1])) for v in views], views, REST, REST)
    within(turned_off(same, BODY), 1e-9, "degrees")
    assert joints_off(same, LIMBS, aligned=False) > 0.1  # a wrist of the twelve joints moved
    swinging = [turned(v, "left_elbow", np.array([np.radians(6.0) * (-1) ** i, 0, 0])) for i, v in enumerate(views)]
    posed = posed_skeletons(swinging, views, REST, REST)
    # seven frames: mean 6 / 7 of a degree, (3 x 48 / 7 + 4 x 36 / 7) / 7, of one joint in 21
    assert turned_off(posed, BODY) == pytest.approx((3 * 48 + 4 * 36) / 49 / 21, abs=1e-6)


def test_a_moved_sphere_half_a_sphere_and_a_larger_one_have_the_distances_of_closed_forms():
    # |x + s| - r averaged over the sphere, both directions: s/2 in the limit of a small shift s
    shift = 0.002
    measured = mesh_distance(icosphere(0.3, subdivisions=5), icosphere(0.3, (shift, 0, 0), 5), count=20_000)
    assert measured.chamfer == pytest.approx(100 * shift / 2, rel=0.02)
    vertices, faces = icosphere(0.3, subdivisions=5)
    upper = faces[(vertices[faces][:, :, 1] > 0).all(1)]
    measured = mesh_distance((vertices, faces), (vertices, upper))
    assert measured.p2s == pytest.approx(0, abs=1e-6)
    assert measured.back is not None and measured.back_95 is not None
    # the farthest true sample is the other pole, sqrt(2) r off the rim
    assert 5 < measured.back < measured.back_95 < 100 * 2**0.5 * 0.3
    # all of ours is on the truth, half of the truth is on ours
    assert measured.f_5mm is not None and measured.f_1cm is not None
    assert measured.f_5mm == pytest.approx(2 / 3, abs=0.02) and measured.f_5mm < measured.f_1cm < 1
    measured = mesh_distance(icosphere(0.3, subdivisions=5), icosphere(0.307, subdivisions=5))
    assert measured.f_5mm == 0 and measured.f_1cm == 1


RNG = np.random.default_rng(7)


def test_shared_black_ground_is_left_out():
    small = np.zeros((2, 90, 90, 3), np.float32)
    small[:, 30:60, 30:60] = RNG.random((2, 30, 30, 3))
    wide = np.pad(small, ((0, 0), (100, 100), (100, 100), (0, 0)))
    ink = wide.copy()
    ink[:, 0, 0] = ink[:, -1, -1] = 1e-6  # nothing to see, yet nothing can be left out
    assert flip(*wide).value == pytest.approx(flip(*ink).value, rel=1e-4)
    assert flip(*wide).value == pytest.approx(flip(*small).value * 90**2 / 290**2, rel=1e-4)


SIZE = 64


def quad(x, y, z, half):
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * half + [x, y, z]
    return corners, np.array([[0, 1, 2], [0, 2, 3]])


def truth(*quads, eye):
    vertices = np.concatenate([q[0] for q in quads])
    faces = np.concatenate([q[1] + 4 * i for i, q in enumerate(quads)])
    of_eye = None if eye is None else np.repeat([i in eye for i in range(len(quads))], 4)
    return replace(head(vertices, faces), eye=of_eye)


CAMERA = Camera(pinhole((SIZE, SIZE), 0.1), look_at((0, 0, 1.0), (0, 0, 0)), (SIZE, SIZE))
FACE, EYE = quad(0, 0, 0, 0.04), quad(0.01, 0, 0.001, 0.004)


def test_the_region_is_what_shows_of_the_eye_and_three_millimetres_round_it(rasteriser):
    mesh = truth(FACE, EYE, eye=[1])
    region = eye_region(rasteriser, mesh, mesh.vertices, CAMERA)
    pixel = 1 / CAMERA.K[0, 0]  # metres, at one metre
    rows, columns = np.nonzero(region)
    across = 0.008 + 2 * 0.003
    # a pixel more or less at each side
    assert abs(np.ptp(rows) + 1 - across / pixel) <= 2 and abs(np.ptp(columns) + 1 - across / pixel) <= 2
    assert abs(columns.mean() - (SIZE / 2 + 0.01 / pixel - 0.5)) < 1
    open_eye, covered = truth(FACE, EYE, eye=[1]), truth(FACE, EYE, quad(0.01, 0, 0.002, 0.005), eye=[1])
    assert eye_region(rasteriser, open_eye, open_eye.vertices, CAMERA).any()
    assert not eye_region(rasteriser, covered, covered.vertices, CAMERA).any()
    mesh = truth(FACE, EYE, eye=None)
    assert not eye_region(rasteriser, mesh, mesh.vertices, CAMERA).any()
    assert without_eyes("why")["psnr_db"] is None and without_eyes("why")["reasons"]["psnr_db"] == "why"


class Painted(HeldOutView):
    """A picture that is grey all over."""

    def mask(self):
        return np.pad(np.ones((8, 8), bool), SIZE // 2 - 4)

    def image(self):
        return np.full((SIZE, SIZE, 3), 0.5, np.float32)

    def parts(self):
        return np.full((SIZE, SIZE), 2, np.uint8)


def test_a_wrong_eye_costs_the_eyes_what_it_costs_and_the_head_little(rasteriser, tmp_path):
    mesh = truth(FACE, EYE, eye=[1])
    pose = np.zeros((52, 3))
    pose[1] = 0.3  # no T-pose
    view = Painted(tmp_path, "000000_head", "head", 0, pose, np.zeros(3), CAMERA)
    posed = mesh.posed(pose, np.zeros(3))
    region = eye_region(rasteriser, mesh, posed, CAMERA)
    assert region.any()

    def draw(axis_angle, root, camera, samples, where):
        color = np.full((SIZE, SIZE, 3), 0.5, np.float32)
        color[region] += 0.1
        return MaskedPicture(color, np.ones((SIZE, SIZE), bool))

    scores = score_images(PictureJudge(mesh, draw, raster=rasteriser), [view], "test")
    assert scores["eyes"].scores()["psnr_db"].value == pytest.approx(20.0, abs=1e-4)  # -10 log10(.1²)
    head = scores["head"].scores()["psnr_db"].value
    assert head is not None and head > 25
    assert "eyes" not in score_images(PictureJudge(mesh, draw), [view], "test")


def test_what_stands_far_off_the_person_counts_to_its_outline(tmp_path):
    view = Painted(tmp_path, "000000_body", "body", 0, np.zeros((52, 3)), np.zeros(3), CAMERA)
    # a field, which fills all that it is asked for
    draw = lambda pose, root, camera, samples, where: MaskedPicture(np.zeros((SIZE, SIZE, 3), np.float32), where)
    scores = score_images(PictureJudge(truth(EYE, eye=None), draw), [view], "test")["total"].scores()
    assert scores["outline_iou"].value == pytest.approx(8**2 / SIZE**2)


def plate(hair_columns: int) -> TrueMesh:
    """An upright plate of 1 cm squares, 15 columns along x, 5 rows; it follows the head bone."""
    x, y = np.meshgrid(np.arange(16), np.arange(6), indexing="ij")
    vertices = np.stack([x.ravel() * 0.01, y.ravel() * 0.01, np.zeros(x.size)], 1)
    a = (np.arange(15)[:, None] * 6 + np.arange(5)).ravel()
    faces = np.concatenate([np.stack([a, a + 6, a + 7], 1), np.stack([a, a + 7, a + 1], 1)])
    hair = x.ravel() <= hair_columns if hair_columns else np.zeros(96, bool)
    return replace(head(vertices, faces), hair=hair)


def test_skin_beside_hair_ends_four_centimetres_from_it():
    truth = plate(5)
    columns = truth.vertices[truth.faces].mean(1)[:, 0]
    beside = columns[skin_beside_hair(truth)]
    assert beside.min() > 0.05  # none of it is hair
    # the last hair face's middle lies at 4.67 cm
    assert 0.083 < beside.max() < 0.0868


def test_without_hair_seen_nothing_is_beside_it_nor_on_the_trunk():
    truth = plate(0)
    assert not skin_beside_hair(truth).any()
    truth = plate(5)
    truth.visible[truth.hair[truth.faces].any(1)] = False
    assert not skin_beside_hair(truth).any()
    truth = plate(5)
    truth.part[:] = PARTS.index("body")
    truth.skin.joints[:] = JOINTS.index("spine3")
    assert not skin_beside_hair(truth).any()


LATER = np.random.default_rng(11)


def random_weights():
    """AlexNet's and the linear layers' state dictionaries, as torchvision and the lpips package name them."""
    generator = torch.Generator().manual_seed(4)
    alexnet, linear = {}, {}
    for layer, (index, into, out, kernel, *_) in enumerate(CONVOLUTIONS):
        shape = (out, into, kernel, kernel)
        spread = (into * kernel * kernel) ** -0.5
        alexnet[f"features.{index}.weight"] = torch.randn(shape, generator=generator) * spread
        alexnet[f"features.{index}.bias"] = torch.randn(out, generator=generator) * 0.1
        linear[f"lin{layer}.model.1.weight"] = torch.rand((1, out, 1, 1), generator=generator)
    return alexnet, linear


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("lpips")
    alexnet, linear = random_weights()
    torch.save(alexnet | {"classifier.6.bias": torch.zeros(1000)}, folder / "alexnet.pth")
    torch.save(linear, folder / "alex.pth")
    whole = dict(linear)
    for layer, (index, *_) in enumerate(CONVOLUTIONS, start=1):
        for name in ("weight", "bias"):
            whole[f"net.slice{layer}.{index}.{name}"] = alexnet[f"features.{index}.{name}"]
    torch.save(whole, folder / "whole.pth")
    return folder


def correlate(image, weight, bias, stride, padding):
    """A convolution layer by its definition, double precision: channels first."""
    image = np.pad(image, ((0, 0), (padding, padding), (padding, padding)))
    kernel = weight.shape[-1]
    windows = np.lib.stride_tricks.sliding_window_view(image, (kernel, kernel), axis=(1, 2))
    return np.einsum("chwij,ocij->ohw", windows[:, ::stride, ::stride], weight) + bias[:, None, None]


def pooled(image):
    windows = np.lib.stride_tricks.sliding_window_view(image, (3, 3), axis=(1, 2))[:, ::2, ::2]
    return windows.max((-1, -2))


def lpips_by_definition(truth, image):
    alexnet, linear = random_weights()
    shift, scale = np.array([-0.03, -0.088, -0.188]), np.array([0.458, 0.448, 0.45])
    a, b = (((2 * x - 1 - shift) / scale).transpose(2, 0, 1) for x in (truth, image))
    total = 0.0
    for layer, (index, _, _, _, stride, padding, pool_first) in enumerate(CONVOLUTIONS):
        weight = alexnet[f"features.{index}.weight"].double().numpy()
        bias = alexnet[f"features.{index}.bias"].double().numpy()
        if pool_first:
            a, b = pooled(a), pooled(b)
        a, b = (np.maximum(correlate(x, weight, bias, stride, padding), 0) for x in (a, b))
        apart = a / np.linalg.norm(a, axis=0) - b / np.linalg.norm(b, axis=0)
        w = linear[f"lin{layer}.model.1.weight"].double().numpy().reshape(-1, 1, 1)
        total += (w * apart**2).sum(0).mean()
    return total


@pytest.mark.parametrize("names", [["alexnet.pth", "alex.pth"], ["whole.pth"]])
def test_lpips_is_its_formula(files, names):
    truth, image = LATER.random((2, 63, 70, 3))
    expected = lpips_by_definition(truth, image)
    network = read_perceptual([files / name for name in names])
    assert network.score(truth, image).value == pytest.approx(expected, rel=1e-4)
    assert expected > 0.01
    assert network.score(truth, truth).value == 0.0


def test_an_image_too_small_for_lpips_says_so_and_weights_that_are_none_are_refused(files, tmp_path):
    score = read_perceptual([files / "whole.pth"]).score(*LATER.random((2, 30, 90, 3)))
    assert score.value is None and "90 x 30 px" in score.reason
    refused(AssetError, r"alexnet\.pth: no weight lin0\.model\.1\.weight", read_perceptual, [files / "alexnet.pth"])
    content = torch.load(files / "whole.pth", weights_only=True)
    torch.save(content | {"net.slice2.3.bias": torch.zeros(7)}, tmp_path / "short.pth")
    refused(AssetError, r"slice2\.3\.bias should be \(192,\), is \(7,\)", read_perceptual, [tmp_path / "short.pth"])
    (tmp_path / "text.pth").write_text("no weights")
    refused(AssetError, r"text\.pth: expected a state dictionary", read_perceptual, [tmp_path / "text.pth"])


@pytest.mark.slow
def test_evaluation_gives_lpips_of_every_region_when_it_has_weights(oracle, files, monkeypatch):
    capture, avatar, _ = oracle
    result = evaluate(avatar, capture, lpips=[files / "whole.pth"])
    for region in ("head", "hands", "total"):
        scores = result["novel_pose"][region]
        assert 0 <= scores["lpips"] < 0.2 and "lpips" not in scores.get("reasons", {})
