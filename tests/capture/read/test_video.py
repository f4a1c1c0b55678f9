"""Four videos of a painted figure become a capture folder; one of the body alone gives head and hands."""

import json
import os
import shutil
from dataclasses import replace

import numpy as np
import pytest
from filmed_figure import NAMES_OF_FILES, film_anew
from PIL import Image
from refusals import refused

from avatar.body import builtin_body
from avatar.camera import Camera, look_at, pinhole, project
from avatar.skeleton import PARTS, skin_transforms
from avatar.skinning import skin_points
from capture.fit.points import body_points
from capture.fit.scan import LANDMARKS, carried, posed_video, template_of
from capture.folder import read_capture
from capture.keypoints.record import Keypoints
from capture.raw.four_videos import face_film, find_videos
from capture.raw.scan import FittedScan, FittedVideo, RawVideo
from capture.read.close_up import UNKNOWN, PartMasks
from capture.read.command import _detect
from capture.read.folder import SourceVideo, check_distance
from capture.read.from_body import LEAST, cut_close_up
from capture.read.places import landmark_vertices
from capture.read.template import body_template
from capture.read.video import VideoImport, import_video
from command.errors import AssetError
from files.picture import read_picture
from selfscan.__main__ import main
from tests.turning_twin import in_clothes, turned_hand, turning_twin


def given(folder, **changed):
    paths = {part: folder / f"{name}.mp4" for part, name in NAMES_OF_FILES.items()}
    return VideoImport(paths, folder / "keypoints", **({"frames": 8} | changed))


TEMPLATE = body_template(builtin_body("male"))
PLACES = landmark_vertices(TEMPLATE.vertices, TEMPLATE.part == 1)
MARKS = {name: (TEMPLATE.vertices[v], v) for name, v in PLACES.items()}


def before(part, size, fov, count=1, left_out=()):
    """The T-pose before a camera that looks at the part, in so many frames."""
    middle = TEMPLATE.vertices[TEMPLATE.part == PARTS.index(part)].mean(0) if part != "body" else np.zeros(3)
    camera = Camera(pinhole(size, fov), look_at(middle + [0, 0, 3.0 if part == "body" else 0.6], middle), size)
    poses = (None, None) if part == "head" else (np.zeros((count, 52, 3)), np.zeros((count, 3)))
    # each frame's own number stands for its pose
    trunk = np.broadcast_to(np.arange(count, dtype=float)[:, None, None], (count, 52, 3)) if part == "head" else None
    return FittedVideo((camera,) * count, *poses, ~np.isin(np.arange(count), left_out), trunk)


def stand_in(scan, left_out=()):
    """A template and cameras of the right kind."""
    videos = {part: before(part, raw.size, 0.6, len(raw.frames), left_out) for part, raw in scan.videos.items()}
    return FittedScan(TEMPLATE, videos, MARKS, ("fitted by a stand-in",))


@pytest.mark.slow
def test_a_capture_is_written_whole_with_soft_rims_and_its_origin(filmed_four, tmp_path):
    out = tmp_path / "capture"
    notes = import_video(given(filmed_four), out, lambda scan: stand_in(scan, left_out=(2,)))
    capture = read_capture(out)
    assert capture.facts["input"] == "from_pixels" and capture.facts["body_licence"].startswith("CC0")
    for part in PARTS:
        video = capture.videos[part]
        # 8 chosen, one left out by the fit
        assert 6 <= len(video.images) == len(capture.facts["frame_numbers"][part]) <= 7
        assert video.unsure is not None and 0 < video.unsure.mean() < (0.1 if part == "body" else 0.6)
        assert 0.01 < video.masks.mean() < 0.7
    trunk = capture.videos["head"].trunk
    assert trunk is not None and trunk[:, 0, 0].tolist() == [i for i in range(len(trunk) + 1) if i != 2]
    assert any("body.mp4: 8 frames kept" in note for note in notes) and notes[-1] == "fitted by a stand-in"
    assert not out.with_name("capture.partial").exists()


@pytest.mark.parametrize("part", PARTS[1:])
def test_the_rest_of_the_person_is_unknown_in_a_close_up(part):
    members = TEMPLATE.vertices[TEMPLATE.part == PARTS.index(part)]
    fit = before(part, (120, 90), 0.9)
    camera = fit.cameras[0]
    mask = np.full((90, 120), 255, np.uint8)
    mask[:, :20] = 0
    found = PartMasks(TEMPLATE, part, MARKS).mask(mask, camera, fit, 0)
    assert (found[:, :20] == 0).all()
    pixels, _ = project(camera, members)
    x, y = np.floor(pixels).astype(int).T
    inside = (x >= 20) & (x < 120) & (y >= 0) & (y < 90)
    assert inside.sum() > 100 and (found[y[inside], x[inside]] == 255).all()
    if part == "head":
        # 3 cm under the chin is the neck, which turns with the body
        below = found[int(pixels[:, 1].max() + 0.03 * camera.K[1, 1] / 0.6), 20:]
        assert (below == UNKNOWN).all()
    # a corner is far from it
    assert found[0, 119] == UNKNOWN and 0.1 < (found[:, 20:] == UNKNOWN).mean() < 0.95


def test_keypoints_are_found_again_where_the_film_is_another(filmed_four, tmp_path, monkeypatch):
    film, found = tmp_path / "body.mp4", []
    shutil.copy(filmed_four / "body.mp4", film)
    monkeypatch.setattr("capture.read.command.detect", lambda path, frames, models: found.append(path.write_text("{}")))
    for changed in (False, False, True, False):
        if changed:
            os.utime(film, ns=(1, 1))
        _detect(tmp_path / "points", {"body": film}, {})
    assert len(found) == 2


def test_a_hand_is_as_far_from_the_camera_as_its_wrist_wherever_its_body_hangs():
    truth, footage = turned_hand("left")
    fit = posed_video(truth, footage, np.ones(len(truth.root), bool), level=False)
    joints, near = truth.person.body.joints, [int(truth.root[:, 2].argmax())] * 4
    cameras = tuple(fit.cameras[i] for i in near)
    video = SourceVideo((), (), False, cameras, fit.axis_angle[near], fit.root[near], place="left.mp4")
    check_distance("hand_left", video, joints)
    far = replace(video, root=video.root - 1e3 * (cameras[0].eye - video.root))
    refused(
        AssetError, r"^left.mp4 should place .* from the person's left_wrist", check_distance, "hand_left", far, joints
    )


@pytest.mark.slow
def test_what_was_interrupted_goes_on_and_other_input_begins_anew(filmed_four, tmp_path, capsys):
    out = tmp_path / "capture"

    def stopped(scan):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        import_video(given(filmed_four), out, stopped)
    work = out.with_name("capture.partial")
    assert work.is_dir() and not out.exists()
    made = {path: path.stat().st_mtime_ns for path in work.rglob("*.png")}
    assert len(made) == 2 * 4 * 8
    with pytest.raises(KeyboardInterrupt):
        import_video(given(filmed_four), out, stopped)
    assert "goes on with what is done" in capsys.readouterr().out
    assert {path: path.stat().st_mtime_ns for path in work.rglob("*.png")} == made
    with pytest.raises(KeyboardInterrupt):
        import_video(given(filmed_four, frames=6), out, stopped)
    assert len(list(work.rglob("*.png"))) == 2 * 4 * 6
    # so do keypoints that were found again, in the same folder
    shutil.copytree(filmed_four, tmp_path / "me")
    for again in (False, True):
        with pytest.raises(KeyboardInterrupt):
            import_video(given(tmp_path / "me"), out, stopped)
        assert ("goes on" in capsys.readouterr().out) == again
    points = tmp_path / "me" / "keypoints" / "body.json"
    points.write_text(points.read_text() + " ")
    with pytest.raises(KeyboardInterrupt):
        import_video(given(tmp_path / "me"), out, stopped)
    assert "goes on" not in capsys.readouterr().out


@pytest.mark.slow
def test_folders_of_others_bad_videos_and_keypoints_of_three_stop_before_anything_is_fitted(filmed_four, tmp_path):
    film_anew(filmed_four, tmp_path / "me", "body", second=True)
    with pytest.raises(AssetError, match=r"body\.mp4: two people are in view"):
        import_video(given(tmp_path / "me"), tmp_path / "capture", lambda scan: pytest.fail("fitted"))
    assert not list(tmp_path.glob("capture*"))
    (tmp_path / "capture.partial").mkdir()
    (tmp_path / "capture.partial" / "diary.txt").write_text("mine")
    with pytest.raises(AssetError, match=r"capture\.partial: is in the way"):
        import_video(given(filmed_four), tmp_path / "capture", stand_in)
    assert (tmp_path / "capture.partial" / "diary.txt").read_text() == "mine"
    points = tmp_path / "keypoints"
    points.mkdir()
    for part in PARTS[:3]:
        (points / f"{part}.json").write_text((filmed_four / "keypoints" / f"{part}.json").read_text())
    with pytest.raises(AssetError, match=r"hand_right: expected keypoints .* found nothing of right\.mp4"):
        import_video(VideoImport(given(filmed_four).videos, points), tmp_path / "capture1", stand_in)


@pytest.mark.slow
def test_masks_of_another_tool_are_taken_as_they_are(filmed_four, tmp_path):
    masks = tmp_path / "masks"
    for part in PARTS:
        (masks / part).mkdir(parents=True)
        for i in range(90):
            pixels = np.zeros((180, 240), np.uint8)
            pixels[50:130, 60 + i // 3 : 180] = 255
            Image.fromarray(pixels).save(masks / part / f"{i:06d}.png")
    import_video(given(filmed_four, masks=masks), tmp_path / "capture", stand_in)
    capture = read_capture(tmp_path / "capture")
    numbers = json.loads((tmp_path / "capture" / "capture.json").read_text())["frame_numbers"]["body"]
    firsts = [int(np.flatnonzero(mask.any(0))[0]) for mask in capture.videos["body"].masks]
    assert firsts == [60 + number // 3 for number in numbers]
    Image.new("RGB", (240, 180), (0, 128, 0)).save(masks / "body" / f"{numbers[0]:06d}.png")
    with pytest.raises(AssetError, match=r"body/0000\d\d\.png: mask should be 255 where .*is a picture of labels"):
        import_video(given(filmed_four, masks=masks), tmp_path / "labels", stand_in)
    Image.fromarray(pixels).save(masks / "body" / f"{numbers[0]:06d}.png")
    (masks / "head" / "000000.png").unlink()
    with pytest.raises(AssetError, match=r"expected a mask for each of 90 frames of head\.mp4, found 89"):
        import_video(given(filmed_four, masks=masks), tmp_path / "again", stand_in)


def test_the_command_wants_films_whose_names_say_the_part(filmed_four, tmp_path, capsys):
    some = [str(filmed_four / "body.mp4"), str(filmed_four / "keypoints")]
    assert main(["import", "video", *some, "-o", str(tmp_path / "capture")]) == 1
    said = capsys.readouterr().err
    assert said.startswith("selfscan import: expected BODY HEAD LEFT RIGHT, or files called body, head, left, right")
    assert said.count("\n") == 1 and list(tmp_path.iterdir()) == []


def test_a_film_of_a_face_is_known_by_its_name_and_is_none_of_the_four(tmp_path):
    body, head, face = (tmp_path / name for name in ("body.mp4", "head.mp4", "Face.MOV"))
    (tmp_path / "phone").mkdir()
    others = [tmp_path / "phone" / f"IMG_{k}.mp4" for k in range(4)]
    for path in (body, head, face, *others):
        path.write_text(path.name)
    for paths in ((tmp_path,), (body, head, face), (face, body, head)):
        assert find_videos(paths) == {"body": body, "head": head} and face_film(paths) == face
    assert find_videos((others[0], face)) == {"body": others[0]}
    assert list(find_videos((face, *others)).values()) == others and face_film(others) is None
    with pytest.raises(AssetError, match="expected BODY HEAD LEFT RIGHT"):
        find_videos((face,))
    face.write_text("body.mp4")
    with pytest.raises(AssetError, match=r"Face.MOV: is the same film as .*body.mp4"):
        find_videos((body, head, face))


def test_a_film_of_a_face_without_keypoints_stops_before_anything_is_done(filmed_four, tmp_path):
    face = filmed_four / "head.mp4"
    with pytest.raises(AssetError, match=r"keypoints/face: expected keypoints .*, found nothing of head.mp4"):
        import_video(given(filmed_four, face=face), tmp_path / "capture", stand_in)
    assert list(tmp_path.iterdir()) == []


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


def test_a_hand_counts_where_it_is_seen_alone_and_a_part_hardly_seen_is_to_be_filmed(turning, tmp_path):
    body, fitted = turning
    raw, fit = cut_close_up("hand_left", body, fitted, tmp_path)
    kept = (raw.frames // 10).tolist()
    # arms point to the camera and away from it in profile: there the trunk is behind or before the hand
    assert LEAST <= len(kept) < FRAMES and not {3, 9} & set(kept) and {0, 6} <= set(kept)
    np.testing.assert_array_equal(fit.axis_angle, fitted.videos["body"].axis_angle[kept])
    seen = np.arange(FRAMES) < LEAST - 1
    videos = fitted.videos | {"head": replace(fitted.videos["head"], usable=seen)}
    with pytest.raises(AssetError, match=r"shows the head alone in 3 frames, expected 4: film it too"):
        cut_close_up("head", body, replace(fitted, videos=videos), tmp_path)
