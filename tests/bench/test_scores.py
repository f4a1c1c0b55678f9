"""Scores of pictures, eyes, outlines, surfaces, hair and skeletons against closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from icosphere import icosphere
from mesh_distance import mesh_distance

from avatar.body import builtin_body
from avatar.camera import Camera, look_at, orbit_camera, pinhole
from avatar.psnr import error_between
from avatar.rotation import axis_angle_from_matrix, matrix_from_axis_angle
from avatar.skeleton import JOINTS, PARTS
from avatar.skinning import SkinWeights
from bench.field.posed_field import PosableSurface
from bench.score.beside_hair import edges_at_hair, skin_beside_hair, skin_to_surface, stretched_edges
from bench.score.metrics import flip, ssim
from bench.score.outlines import FOV, outline_scores
from bench.score.picture_scores import PictureJudge, eye_region, score_images
from bench.score.posed_geometry import geometry_case, posed_pair
from bench.score.region_scores import without_eyes
from bench.score.skeleton_distance import BODY, LIMBS, joints_off, posed_skeletons, turned_off
from bench.score.true_mesh import TrueMesh
from capture.held_out import HeldOutView

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


def test_a_ball_within_a_ball_covers_the_square_of_its_share_from_every_side(rasteriser):
    found = scores(rasteriser, 0.8 * RADIUS)
    assert found.keys() == {"total", "head"}
    # as a camera near the ball sees them
    away = 1.1 * RADIUS / np.tan(FOV / 2)
    share = 0.64 * (away**2 - RADIUS**2) / (away**2 - (0.8 * RADIUS) ** 2)
    for score in found.values():
        assert score.mean == pytest.approx(share, abs=0.01) and score.worst == pytest.approx(share, abs=0.02)


def test_what_is_moved_to_a_side_shows_from_the_front_and_not_from_that_side(rasteriser):
    found = scores(rasteriser, RADIUS, shift=RADIUS)["total"]
    # two circles whose middles lie a radius apart share .391 of either
    assert found.worst == pytest.approx(0.391 / (2 - 0.391), abs=0.04) and found.worst + 0.1 < found.mean < 0.9
    back = np.eye(4)
    back[0, 3] = -RADIUS
    assert scores(rasteriser, RADIUS, shift=RADIUS, T=back)["total"].worst > 0.99


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


def test_a_shift_is_off_in_place_alone(views, within):
    posed = posed_skeletons([replace(v, root=v.root + [0, 0.03, 0.04]) for v in views], views, REST, REST)
    within(abs(joints_off(posed, LIMBS, aligned=False) - 5.0), 1e-9, "cm")
    within(joints_off(posed, LIMBS, aligned=True), 1e-9, "cm")


def test_a_turn_that_is_the_same_in_all_frames_is_no_error_of_poses(views, within):
    same = posed_skeletons([turned(v, "left_elbow", np.array([0, 0, 0.1])) for v in views], views, REST, REST)
    within(turned_off(same, BODY), 1e-9, "degrees")
    assert joints_off(same, LIMBS, aligned=False) > 0.1  # a wrist of the twelve joints moved
    swinging = [turned(v, "left_elbow", np.array([np.radians(6.0) * (-1) ** i, 0, 0])) for i, v in enumerate(views)]
    posed = posed_skeletons(swinging, views, REST, REST)
    # seven frames: mean 6 / 7 of a degree, (3 x 48 / 7 + 4 x 36 / 7) / 7, of one joint in 21
    assert turned_off(posed, BODY) == pytest.approx((3 * 48 + 4 * 36) / 49 / 21, abs=1e-6)


def test_a_moved_sphere_has_the_mean_distance_of_the_closed_form():
    # |x + s| - r averaged over the sphere, both directions: s/2 in the limit of a small shift s
    shift = 0.002
    measured = mesh_distance(icosphere(0.3, subdivisions=5), icosphere(0.3, (shift, 0, 0), 5), count=20_000)
    assert measured.chamfer == pytest.approx(100 * shift / 2, rel=0.02)


def test_half_a_sphere_is_exact_one_way_and_incomplete_the_other():
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


def test_f_counts_what_is_nearer_than_its_distance():
    measured = mesh_distance(icosphere(0.3, subdivisions=5), icosphere(0.307, subdivisions=5))
    assert measured.f_5mm == 0 and measured.f_1cm == 1


RNG = np.random.default_rng(7)


def noisy(image, sigma, seed=0):
    return np.clip(image + np.random.default_rng(seed).normal(0, sigma, image.shape), 0, 1)


def test_scores_order_images_by_their_noise():
    image = RNG.random((64, 64, 3))
    levels = [noisy(image, sigma) for sigma in (0.02, 0.08, 0.25)]
    assert np.all(np.diff([error_between(image, x).psnr() for x in levels]) < 0)
    assert np.all(np.diff([ssim(image, x).value for x in levels]) < 0)
    assert np.all(np.diff([flip(image, x).value for x in levels]) > 0)


def test_flip_leaves_shared_black_ground_out_of_the_work_but_not_of_the_mean():
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
FACE, EYE, LID = quad(0, 0, 0, 0.04), quad(0.01, 0, 0.001, 0.004), quad(0.012, 0, 0.002, 0.002)


def test_the_region_is_what_shows_of_the_eye_and_three_millimetres_round_it(rasteriser):
    mesh = truth(FACE, EYE, eye=[1])
    region = eye_region(rasteriser, mesh, mesh.vertices, CAMERA)
    pixel = 1 / CAMERA.K[0, 0]  # metres, at one metre
    rows, columns = np.nonzero(region)
    across = 0.008 + 2 * 0.003
    # a pixel more or less at each side
    assert abs(np.ptp(rows) + 1 - across / pixel) <= 2 and abs(np.ptp(columns) + 1 - across / pixel) <= 2
    assert abs(columns.mean() - (SIZE / 2 + 0.01 / pixel - 0.5)) < 1


def test_a_lid_hides_what_is_behind_it(rasteriser):
    open_eye, covered = truth(FACE, EYE, eye=[1]), truth(FACE, EYE, quad(0.01, 0, 0.002, 0.005), eye=[1])
    assert eye_region(rasteriser, open_eye, open_eye.vertices, CAMERA).any()
    assert not eye_region(rasteriser, covered, covered.vertices, CAMERA).any()


def test_a_truth_that_does_not_know_its_eyes_has_no_region(rasteriser):
    mesh = truth(FACE, EYE, eye=None)
    assert not eye_region(rasteriser, mesh, mesh.vertices, CAMERA).any()
    assert without_eyes("why")["psnr_db"] is None and without_eyes("why")["reasons"]["psnr_db"] == "why"


class Painted(HeldOutView):
    """A head's close-up that is grey all over."""

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
        from bench.field.posed_field import MaskedPicture

        color = np.full((SIZE, SIZE, 3), 0.5, np.float32)
        color[region] += 0.1
        return MaskedPicture(color, np.ones((SIZE, SIZE), bool))

    scores = score_images(PictureJudge(mesh, draw, raster=rasteriser), [view], "test", t_pose_apart=False).scored
    assert scores["eyes"].scores()["psnr_db"].value == pytest.approx(20.0, abs=1e-4)  # -10 log10(.1²)
    head = scores["head"].scores()["psnr_db"].value
    assert head is not None and head > 25
    assert "eyes" not in score_images(PictureJudge(mesh, draw), [view], "test", t_pose_apart=False).scored


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


def test_without_hair_nothing_is_beside_it():
    truth = plate(0)
    assert not skin_beside_hair(truth).any()
    assert len(edges_at_hair(truth, truth.vertices, truth.faces)) == 0


def test_hair_that_nobody_sees_has_nothing_beside_it():
    truth = plate(5)
    truth.visible[truth.hair[truth.faces].any(1)] = False
    assert not skin_beside_hair(truth).any()


def test_skin_of_the_trunk_is_not_beside_hair_though_its_edges_are():
    truth = plate(5)
    truth.part[:] = PARTS.index("body")
    truth.skin.joints[:] = JOINTS.index("spine3")
    assert not skin_beside_hair(truth).any()
    assert len(edges_at_hair(truth, truth.vertices, truth.faces)) > 0


def test_skin_beside_hair_is_as_far_as_the_surface_lies_off_it():
    truth = plate(5)
    # in the canonical pose: the plate follows the head, which the big pose leaves alone
    canonical = truth.canonical()
    assert skin_to_surface(truth, canonical, truth.faces) == pytest.approx(0, abs=1e-9)
    assert skin_to_surface(truth, canonical + [0, 0, 0.007], truth.faces) == pytest.approx(0.007, abs=1e-6)
    assert skin_to_surface(plate(0), canonical, truth.faces) is None


def test_edges_are_counted_once_however_many_poses_stretch_them():
    truth = plate(5)
    rest = truth.vertices
    edges = edges_at_hair(truth, rest, truth.faces)
    assert len(np.unique(edges, axis=0)) == len(edges)
    opened = rest + [0.03, 0, 0] * (rest[:, :1] > 0.045)
    # the squares between the fourth and fifth centimetre: 6 edges across and 5 diagonals
    assert stretched_edges(edges, rest, [rest, opened, opened]) == 11
    # between skin and skin it is no matter of hair
    assert stretched_edges(edges, rest, [rest + [0.03, 0, 0] * (rest[:, :1] > 0.085)]) == 0
    assert stretched_edges(edges, rest, [rest, rest * 1.9]) == 0
    # a plate of tenths of a millimetre: three times as long is not to be seen
    assert stretched_edges(edges, rest * 0.01, [rest * 0.03]) == 0
