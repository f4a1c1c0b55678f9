"""Head and hands of a person of whom the body alone was filmed."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from avatar.camera import project
from avatar.skeleton import skin_transforms
from avatar.skinning import skin_points
from capture.fit.points import body_points
from capture.fit.scan import LANDMARKS, carried, posed_video, template_of
from capture.keypoints.record import Keypoints
from capture.raw.scan import FittedScan, RawVideo
from capture.read.from_body import LEAST, cut_close_up
from command.errors import AssetError
from files.picture import read_picture
from tests.turning_twin import in_clothes, turning_twin

FRAMES, SIZE = 12, 128


@pytest.fixture(scope="module")
def turning(tmp_path_factory):
    """A body's video whose pictures hold the place of each pixel, and its fit: all parts as the body holds them."""
    truth, footage = turning_twin(FRAMES, SIZE)
    template = template_of(truth)
    y, x = np.mgrid[:SIZE, :SIZE]
    path = tmp_path_factory.mktemp("turning") / "places.png"
    Image.fromarray(np.stack([x, y, 0 * x], -1).astype(np.uint8)).save(path)
    points = Keypoints(footage.names, footage.pixels, footage.sure, (SIZE, SIZE))
    masks = in_clothes(truth, footage, 0.0).masks
    raw = RawVideo("body", (SIZE, SIZE), 30.0, 10 * np.arange(FRAMES), (path,) * FRAMES, masks, points, None)
    body = posed_video(truth, footage, np.ones(FRAMES, bool), level=True)
    vertices = {name: int(body_points()[point].vertices[0]) for name, point in LANDMARKS.items()}
    places = {name: (template.vertices[vertex], vertex) for name, vertex in vertices.items()}
    videos = {part: carried(part, body, template.joints) for part in ("body", "head", "hand_left", "hand_right")}
    return raw, FittedScan(template, videos, places)


def test_a_head_is_cut_out_where_it_is_and_its_cameras_go_round_it(turning, tmp_path):
    body, fitted = turning
    raw, fit = cut_close_up("head", body, fitted, tmp_path)
    assert len(fit.cameras) == FRAMES and fit.axis_angle is None and fit.usable.all()
    assert raw.size[0] < SIZE / 2 and raw.size[1] < SIZE / 2
    template, of_body = fitted.template, fitted.videos["body"]
    nose, vertex = fitted.landmarks["nose_tip"]
    for i, camera in enumerate(fit.cameras):
        B = skin_transforms(of_body.axis_angle[i], template.joints, of_body.root[i], rest=np.zeros((52, 3)))
        posed = skin_points(template.vertices, template.skin, B)[[vertex]]
        there, here = project(of_body.cameras[i], posed)[0][0], project(camera, nose[None])[0][0]
        # the crop's pixels say where they were
        column, row = (int(n) for n in here)
        assert read_picture(raw.pictures[i])[row, column, :2].tolist() == [int(n) for n in there]
    assert raw.masks.any((1, 2)).all()
    seen = raw.keypoints.seen("nose")
    np.testing.assert_allclose(seen[0, :2], project(fit.cameras[0], nose[None])[0][0], atol=4)


def test_a_hand_counts_where_it_is_seen_alone(turning, tmp_path):
    body, fitted = turning
    raw, fit = cut_close_up("hand_left", body, fitted, tmp_path)
    kept = (raw.frames // 10).tolist()
    # arms point to the camera and away from it in profile: there the trunk is behind or before the hand
    assert LEAST <= len(kept) < FRAMES and not {3, 9} & set(kept) and {0, 6} <= set(kept)
    np.testing.assert_array_equal(fit.axis_angle, fitted.videos["body"].axis_angle[kept])


def test_a_part_that_is_hardly_seen_is_to_be_filmed(turning, tmp_path):
    body, fitted = turning
    seen = np.arange(FRAMES) < LEAST - 1
    videos = fitted.videos | {"head": replace(fitted.videos["head"], usable=seen)}
    with pytest.raises(AssetError, match=r"shows the head alone in 3 frames, expected 4: film it too"):
        cut_close_up("head", body, replace(fitted, videos=videos), tmp_path)
