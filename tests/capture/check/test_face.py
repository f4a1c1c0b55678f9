"""What `check` says of the eyes: a painted head of the free body, eyes open and shut."""

from dataclasses import replace

import numpy as np
import pytest
from painted_capture import free_subject
from turning_capture import with_video

from avatar.camera import Camera, look_at, pinhole
from capture.check.face import IRIS, face_line, face_report
from capture.check.report import CaptureReport
from capture.check.verdict import verdict
from capture.folder import Capture, PartVideo
from capture.template.eyes import body_sockets
from geometry.rasterise import rasterise

UNITS = 2.0  # of the head frame a metre
TURNS = (-80, -35, -18, 0, 3, 18, 35, 180)  # degrees to the head's left
SHUT = 4


@pytest.fixture(scope="module")
def capture(tmp_path_factory) -> Capture:
    subject = free_subject("male")
    canonical, part = subject.vertices, subject.part
    eyes = canonical[np.concatenate([socket.rim for socket in body_sockets()])].mean(0)
    color = np.full(len(canonical), 170.0)
    for socket in body_sockets():
        inside = socket.inside
        across = canonical[inside, 0] - canonical[socket.rim, 0].mean()
        color[inside] = np.where(np.abs(across) < 0.006, 20, 240)
    K, size = pinhole((160, 160), np.radians(22)), (160, 160)
    images, masks, cameras = [], [], []
    for frame, turn in enumerate(np.radians(TURNS)):
        away = UNITS * 0.6 * np.array([np.sin(turn), 0, np.cos(turn)])
        camera = Camera(K, look_at(UNITS * eyes + away, UNITS * eyes, (0, 1, 0)), size)
        drawn = rasterise(UNITS * canonical, subject.faces, camera)
        shown = np.full(len(color), 170.0) if frame == SHUT else color
        grey = np.where(drawn.face >= 0, shown[subject.faces[drawn.face]].mean(-1), 0)
        images.append(np.repeat(np.uint8(grey)[..., None], 3, 2))
        masks.append(drawn.face >= 0)
        cameras.append(camera)
    marks = np.flatnonzero(part == 1)[::200]
    video = PartVideo("head", np.stack(images), np.stack(masks), tuple(cameras), None, None, UNITS * canonical[marks],
                      marks)  # fmt: skip
    return Capture(tmp_path_factory.mktemp("face"), {}, subject, {"head": video})


def test_eyes_are_measured_in_the_frames_that_see_them_and_shut_lids_are_named(capture):
    report = face_report(capture)
    assert report is not None
    # 35 degrees and less
    assert report.frames == 6 and report.closed == (SHUT,)
    K = capture.videos["head"].cameras[0].K
    assert report.metres_per_pixel == pytest.approx(0.6 / K[1, 1], rel=0.05)
    assert report.iris == pytest.approx(IRIS / report.metres_per_pixel)
    assert report.edge < 2.5
    line = face_line(report)
    assert line.startswith("face: 6 frames see the eyes") and "lids look closed in frames 4" in line


def test_a_blurred_head_video_has_wide_edges(capture):
    from scipy import ndimage

    video = capture.videos["head"]
    soft = ndimage.gaussian_filter(video.images, (0, 2.5, 2.5, 0))
    sharp, blurred = face_report(capture), face_report(with_video(capture, "head", images=soft))
    assert sharp is not None and blurred is not None and blurred.edge > 1.8 * sharp.edge


def test_a_template_without_eyes_says_nothing_and_a_back_no_face(capture):
    assert face_report(replace(capture, subject=replace(capture.subject, faces=capture.subject.faces[:, ::-1]))) is None
    video = capture.videos["head"]
    behind = replace(video, images=video.images[-1:], masks=video.masks[-1:], cameras=video.cameras[-1:])
    report = face_report(replace(capture, videos={"head": behind}))
    assert report is not None and report.frames == 0
    assert "no frame" in face_line(report)


def test_the_verdict_names_small_irises_shut_lids_and_no_face(capture):
    report = face_report(capture)
    assert report is not None
    whole = CaptureReport(1.7, 9, 0.0, 0.5, {})

    def kinds(face):
        return [finding.what for finding in verdict(replace(whole, face=face)).findings]

    assert kinds(None) == [] and kinds(replace(report, closed=(), iris=9.0)) == []
    assert kinds(replace(report, iris=4.0)) == ["an iris is 4 pixels wide", "lids look closed in frames 4"]
    assert kinds(replace(report, frames=0)) == ["no frame shows the eyes from the front"]
