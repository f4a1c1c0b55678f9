"""What `check` says of eyes on a painted head, and of videos as they were filmed."""

import json
from dataclasses import replace

import numpy as np
import pytest
from filmed_figure import film_anew
from painted_capture import free_subject
from turning_capture import with_video

from avatar.camera import Camera, look_at, pinhole
from capture.check.face import IRIS, SIDE, close_ups, face_line, face_report
from capture.check.options import main
from capture.check.report import CaptureReport
from capture.check.verdict import verdict
from capture.folder import Capture, PartVideo
from capture.raw.four_videos import find_videos
from capture.template.eyes import body_sockets
from command.errors import AssetError
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
    assert [TURNS[frame] for frame in report.shown] == [0, -35, 35]
    line = face_line(report)
    assert line.startswith("face: 6 frames see the eyes") and "lids look closed in frames 4" in line


def test_a_blurred_head_video_has_wide_edges_and_close_ups_are_squares_beside_each_other(capture):
    from scipy import ndimage

    video = capture.videos["head"]
    soft = ndimage.gaussian_filter(video.images, (0, 2.5, 2.5, 0))
    sharp, blurred = face_report(capture), face_report(with_video(capture, "head", images=soft))
    assert sharp is not None and blurred is not None and blurred.edge > 1.8 * sharp.edge
    report = face_report(capture)
    assert report is not None
    picture = close_ups(capture, report)
    assert picture.shape == (SIDE, 3 * SIDE, 3)
    # skin in the middle of each
    assert (picture[SIDE // 2, SIDE // 2 :: SIDE] > 100).all()


def test_a_template_without_eyes_says_nothing_and_a_back_no_face(capture):
    assert face_report(replace(capture, subject=replace(capture.subject, faces=capture.subject.faces[:, ::-1]))) is None
    video = capture.videos["head"]
    behind = replace(video, images=video.images[-1:], masks=video.masks[-1:], cameras=video.cameras[-1:])
    report = face_report(replace(capture, videos={"head": behind}))
    assert report is not None and report.frames == 0 and report.shown == ()
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


def test_good_videos_are_usable_as_a_folder_and_as_four_files(filmed_four, tmp_path, capsys):
    assert main([str(filmed_four), "-o", str(tmp_path / "out")]) == 0
    text = capsys.readouterr().out
    assert "body.mp4   240 x 180, 30 frames/s, 3.0 s; empty room 0." in text
    assert text.splitlines()[5].startswith("usable")
    facts = json.loads((tmp_path / "out" / "check.json").read_text())
    assert facts["usable"] and facts["videos"]["body"]["frames"] == 90
    files = [filmed_four / f"{name}.mp4" for name in ("body", "head", "left", "right")]
    assert find_videos(files) == find_videos([filmed_four])


def test_a_hand_that_leaves_the_picture_is_said_with_the_time_and_the_body_alone_is_enough(
    filmed_four, tmp_path, capsys
):
    film_anew(filmed_four, tmp_path / "me", "hand_left", shift=(0, -66))
    assert main([str(tmp_path / "me")]) == 1
    text = capsys.readouterr().out
    assert "not usable because left.mp4: the left hand leaves the picture at the top from" in text
    assert "film again with it in the middle" in text
    assert main([str(filmed_four / "body.mp4")]) == 0
    text = capsys.readouterr().out
    assert "head: no film of its own; body.mp4 shows it about" in text and "hand_right: no film" in text


def test_films_are_told_apart_by_name_or_order_and_none_is_given_twice(tmp_path):
    names = ("body", "left", "head")
    files = [tmp_path / f"{name}.mp4" for name in names]
    for file in files:
        file.write_bytes(file.name.encode())
    assert find_videos(files) == find_videos([tmp_path]) == dict(zip(("body", "hand_left", "head"), files))
    assert find_videos(files[:1]) == {"body": files[0]}
    with pytest.raises(AssetError, match=r"called body, head, left, right; found body.mp4, IMG_7.mov"):
        find_videos([files[0], tmp_path / "IMG_7.mov"])
    files[2].write_bytes(files[0].read_bytes())
    with pytest.raises(AssetError, match=r"is the same film as .*body.mp4; leave it out"):
        find_videos(files)
    files[0].unlink()
    with pytest.raises(AssetError, match=r"expected body.mp4, and head.mp4, .* found .*left.mp4"):
        find_videos([tmp_path])


def test_without_keypoints_it_says_which_are_needed(filmed_four, tmp_path):
    for name in ("body", "head", "left", "right"):
        (tmp_path / f"{name}.mp4").symlink_to(filmed_four / f"{name}.mp4")
    with pytest.raises(Exception, match=r"keypoints: expected keypoints .*--keypoints DIR says where"):
        main([str(tmp_path)])
    assert main([str(tmp_path), "--keypoints", str(filmed_four / "keypoints")]) == 0
