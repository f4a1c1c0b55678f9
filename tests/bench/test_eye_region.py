"""The eye region of a picture, on a subject whose eyes are known patches."""

import numpy as np
import pytest

from avatar.camera import Camera, look_at, pinhole
from avatar.skinning import SkinWeights
from bench.score.picture_scores import PictureJudge, eye_region, score_images
from bench.score.region_scores import without_eyes
from bench.score.true_mesh import TrueMesh
from capture.held_out import HeldOutView

SIZE = 64


def quad(x, y, z, half):
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * half + [x, y, z]
    return corners, np.array([[0, 1, 2], [0, 2, 3]])


def truth(*quads, eye):
    vertices = np.concatenate([q[0] for q in quads])
    faces = np.concatenate([q[1] + 4 * i for i, q in enumerate(quads)])
    count = len(vertices)
    of_eye = None if eye is None else np.repeat([i in eye for i in range(len(quads))], 4)
    skin = SkinWeights(np.zeros((count, 4), np.int64), np.eye(1, 4, dtype=np.float32).repeat(count, 0))
    return TrueMesh(vertices, faces, skin, np.zeros((52, 3)), np.ones(count, np.int64), np.zeros(count, bool),
                    np.ones(len(faces), bool), of_eye)  # fmt: skip


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
