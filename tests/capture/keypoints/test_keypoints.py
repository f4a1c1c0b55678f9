"""Keypoints of detectors: written as they write them, read back as one record; what is wrong is named."""

import importlib.util
import json
import re
from types import SimpleNamespace

import numpy as np
import pytest
from filmed_figure import BODY, points_of
from pose_twins import estimated, from_text
from refusals import refused

from capture.keypoints import mediapipe, openpose
from capture.keypoints.detect import frame_json, model_files
from capture.keypoints.orders import COCO_WHOLEBODY, ORDERS, described
from capture.keypoints.read import read_keypoints
from capture.keypoints.record import FACE, hand_points
from command.errors import AssetError

FRAMES, SIZE = 3, (640, 480)
POSE = [{"x": 0.5, "y": 0.5, "z": 0, "visibility": 1}] * 33
EVERY = sorted({*openpose.NAMES, *COCO_WHOLEBODY, *mediapipe.NAMES})


def truth(seed=0):
    """Places of every point in every frame, one of them unseen, in our pixels."""
    rng = np.random.default_rng(seed)
    return {name: rng.uniform(5, 470, (FRAMES, 2)) for name in EVERY}, {("left_knee", 1), ("right_index2", 0)}


def rows(names, points, unseen, frame, half=0.5):
    """x, y, confidence as a detector whose pixels count from the first one's middle has them."""
    out = np.array([[*(points[name][frame] - half), 0.8] for name in names])
    for k, name in enumerate(names):
        if (name, frame) in unseen:
            out[k] = 0
    return out


def write_openpose(folder, points, unseen, people=1):
    folder.mkdir()
    for frame in range(FRAMES):
        flat = rows(openpose.NAMES, points, unseen, frame)
        parts = np.split(flat, [25, 46, 67])
        parts[3] = np.concatenate([parts[3], np.zeros((2, 3))])
        keys = [f"{part}_keypoints_2d" for part in ("pose", "hand_left", "hand_right", "face")]
        small, person = ({key: (size * part).ravel().tolist() for key, part in zip(keys, parts)} for size in (0.1, 1))
        content = {"version": 1.3, "people": [small] * (people - 1) + [person]}
        (folder / f"me_{frame:012d}_keypoints.json").write_text(json.dumps(content))
    return folder


def write_mmpose(path, points, unseen):
    infos = []
    for frame, flat in wholebody(points, unseen):
        person = {"keypoints": flat[:, :2].tolist(), "keypoint_scores": flat[:, 2].tolist(), "bbox": [[0, 0, 9, 9]]}
        infos.append({"frame_id": frame + 1, "instances": [person]})
    path.write_text(json.dumps({"meta_info": {"dataset_name": "coco_wholebody"}, "instance_info": infos}))
    return path


def wholebody(points, unseen):
    """Each frame's number, and its rows of COCO-WholeBody."""
    return [(frame, rows(COCO_WHOLEBODY, points, unseen, frame)) for frame in range(FRAMES)]


def write_results(path, points, unseen):
    people = [{"image_id": 10 + frame, "category_id": 1, "keypoints": flat.ravel().tolist(), "score": 0.9}
              for frame, flat in wholebody(points, unseen)]  # fmt: skip
    path.write_text(json.dumps([people[2], *people[:2]]))
    return path


def write_mediapipe(path, points, unseen, told=True):
    frames = []
    for frame in range(FRAMES):
        pose = np.zeros((33, 4))
        for k, name in enumerate(mediapipe.POSE):
            if name:
                seen = (name, frame) not in unseen
                pose[k] = [*(points[name][frame] / SIZE), 0.0, 0.8 * seen]
        named = lambda side: np.array([[*(points[name][frame] / SIZE), 0.0] for name in hand_points(side)])
        as_json = lambda array: [dict(zip(("x", "y", "z", "visibility"), row)) for row in array.tolist()]
        one = {"pose_landmarks": as_json(pose)}
        one |= {f"{side}_hand_landmarks": as_json(named(side)) for side in ("left", "right")}
        face = np.zeros((478, 3))
        for k, name in zip(mediapipe.MESH, FACE, strict=True):
            face[k, :2] = points[name][frame] / SIZE
        one["face_landmarks"] = as_json(face)
        frames.append(one)
    size = {"image_width": SIZE[0], "image_height": SIZE[1]} if told else {}
    path.write_text(json.dumps({**size, "frames": frames}))
    return path


WRITERS = {
    "openpose": (write_openpose, openpose.NAMES),
    "mmpose": (write_mmpose, COCO_WHOLEBODY),
    "results": (write_results, COCO_WHOLEBODY),
    "mediapipe": (write_mediapipe, mediapipe.NAMES),
}


@pytest.mark.parametrize("kind", WRITERS)
def test_what_a_detector_wrote_is_read_back(tmp_path, kind, within):
    points, unseen = truth()
    write, names = WRITERS[kind]
    found = read_keypoints(write(tmp_path / f"{kind}.json" if kind != "openpose" else tmp_path / kind, points, unseen))
    assert found.names == names and len(set(names)) == len(names)
    for name in names:
        seen = found.seen(name)
        for frame in range(FRAMES):
            if (name, frame) in unseen and kind != "mediapipe":
                assert seen[frame, 2] == 0 and np.isnan(seen[frame, :2]).all()
            elif (name, frame) not in unseen:
                within(seen[frame, :2] - points[name][frame], 1e-3, "px")
                assert seen[frame, 2] == pytest.approx(1 if kind == "mediapipe" and name not in
                                                       mediapipe.POSE else 0.8)  # fmt: skip
    assert (found.seen("third_eye")[:, 2] == 0).all()


def test_left_is_the_persons_left_and_the_orders_are_the_published_ones():
    """A few numbers of the published tables: OpenPose's BODY_25, COCO-WholeBody, MediaPipe."""
    assert [openpose.NAMES[k] for k in (2, 7, 8, 12, 19, 24)] == [
        "right_shoulder", "left_wrist", "hips", "left_hip", "left_big_toe", "right_heel"]  # fmt: skip
    names = COCO_WHOLEBODY
    assert len(names) == 133 and names[23:91] == FACE and [names[k] for k in (5, 17, 22, 91, 112, 132)] == [
        "left_shoulder", "left_big_toe", "right_heel", "left_hand", "right_hand", "right_pinky_tip"]  # fmt: skip
    assert mediapipe.POSE[11] == "left_shoulder" and mediapipe.POSE[28] == "right_ankle" and len(mediapipe.POSE) == 33


def turning(order, frames=12):
    """A person who turns, in the order of a detector: x, y, confidence; places that the figure lacks are not found."""
    out = np.zeros((frames, len(ORDERS[order]), 3))
    for frame in range(frames):
        places = points_of("body", frame / frames) | {"upper_neck": (0, -36), "head_top": (0, -60)}
        middle = lambda name: tuple(np.mean([places[f"{side}_{name}"] for side in ("left", "right")], 0))
        places |= {"hips": middle("hip"), "shoulders": middle("shoulder")}
        for k, name in enumerate(ORDERS[order]):
            if name in places:
                out[frame, k] = [*(np.array(places[name]) + 100), 0.9]
    return out


@pytest.mark.parametrize("order", ORDERS)
def test_every_order_of_points_is_told_from_those_of_its_length(tmp_path, order):
    """As AlphaPose's results, which leave frames of nobody out, and as OpenPose's, whose zeros may be -1e-9."""
    film, path = turning(order), tmp_path / "body.json"
    people = [{"image_id": f"{3 + k}.jpg", "keypoints": rows.ravel().tolist()} for k, rows in enumerate(film)]
    path.write_text(json.dumps(people[::-1]))
    found = read_keypoints(path, frames=20)
    assert found.order == order and order in described(found)
    assert len(found.pixels) == 20 and found.confidence.any(1).tolist() == [2 < k < 15 for k in range(20)]
    names = [name for name in ORDERS[order] if name in BODY]
    for name in names:
        np.testing.assert_allclose(found.seen(name)[3:15, :2], film[:, ORDERS[order].index(name), :2] + 0.5)
    film[:, 0] = -1e-9
    (tmp_path / "body").mkdir()
    for k, rows in enumerate(film):
        content = {"people": [{"pose_keypoints_2d": rows.ravel().tolist()}]}
        (tmp_path / "body" / f"{k}.json").write_text(json.dumps(content))
    found = read_keypoints(tmp_path / "body")
    assert found.order == order and not found.seen(ORDERS[order][0])[:, 2].any()


def test_where_bones_say_nothing_the_order_of_the_other_films_holds(tmp_path):
    rows = np.zeros((25, 3))
    rows[ORDERS["BODY_25B"].index("left_wrist")] = 50, 60, 0.9
    path = tmp_path / "left.json"
    path.write_text(json.dumps([{"keypoints": rows.ravel().tolist()}] * 2))
    assert read_keypoints(path, like="BODY_25B").seen("left_wrist")[0, 2] == 0.9
    assert "not of BODY_25" in described(read_keypoints(path, like="BODY_25B"))
    assert read_keypoints(path, like="COCO").order == "BODY_25"


def test_of_several_people_the_largest_is_taken_and_an_empty_frame_is_unseen(tmp_path):
    alone = read_keypoints(write_openpose(tmp_path / "one", *truth()))
    found = read_keypoints(write_openpose(tmp_path / "three", *truth(), people=3))
    np.testing.assert_allclose(found.pixels, alone.pixels)
    assert (found.others > 0).all() and not alone.others.any()
    (tmp_path / "one" / "me_000000000001_keypoints.json").write_text('{"people": []}')
    found = read_keypoints(tmp_path / "one")
    assert (found.confidence[1] == 0).all() and np.isnan(found.pixels[1]).all() and (found.confidence[0] > 0).any()


def test_parts_of_a_picture_need_its_size_and_a_folder_of_nothing_is_refused(tmp_path):
    refused(AssetError, r"expected keypoints .*found none", read_keypoints, tmp_path)
    write_mediapipe(tmp_path / "0.json", *truth())
    assert len(read_keypoints(tmp_path).pixels) == FRAMES
    write_mediapipe(tmp_path / "1.json", *truth())
    refused(AssetError, "expected all frames of MediaPipe in one file, found 2 files", read_keypoints, tmp_path)
    path = write_mediapipe(tmp_path / "a.json", *truth(), told=False)
    refused(AssetError, "a picture of unknown size", read_keypoints, path)
    given = read_keypoints(path, size=SIZE)
    np.testing.assert_allclose(given.seen("nose")[:, :2], truth()[0]["nose"], atol=1e-9)


def spoilt(change):
    def apply(content):
        change(content["people"])
        return content

    return apply


@pytest.mark.parametrize(
    "spoil, match",
    [
        (spoilt(lambda c: c[0]["pose_keypoints_2d"].pop()), "pose_keypoints_2d should be 17, .*, 135 or 136 times x"),
        (spoilt(lambda c: c[0]["pose_keypoints_2d"].__setitem__(4, "x")), "should be finite numbers"),
        (spoilt(lambda c: c[0]["pose_keypoints_2d"].__setitem__(5, -1.0)), "confidence should not be negative"),
        (spoilt(lambda c: c.append(5)), r"people\[1\] should be an object"),
        (lambda c: {"people": []}, "no person in any of 1 frames"),
        (lambda c: {"who": 1}, "expected keypoints"),
        (lambda c: [{"keypoints": [[1, 2]] * 17, "keypoint_scores": [1] * 18}], "keypoint_scores should be 17 numbers"),
        (lambda c: [{"keypoints": [[1, 2, 1]] * 16}], "17, 18, 25, 26, 133, 135 or 136 points, are 16 entries"),
        (lambda c: [{"keypoints": [1.0] * 51}, {"keypoints": [1.0] * 54}], "found people of 17 and 18"),
        (lambda c: [{"keypoints": [[1]] * 133}], r"keypoints\[0\] should be \[x, y\]"),
        (lambda c: {"instance_info": [7]}, r"instance_info\[0\] should be an object"),
        (lambda c: {"instance_info": []}, "no person in any of 0 frames"),
        (lambda c: [{"keypoints": [1.0] * 399, "image_id": []}], "image_id should be a number or a name"),
        (lambda c: {"frames": [{"pose_world_landmarks": [{"x": 0, "y": 0, "z": 0}] * 33}]}, "of unknown size"),
    ],
)
def test_bad_keypoints_are_refused_by_name(tmp_path, spoil, match):
    source = write_openpose(tmp_path / "op", *truth()) / "me_000000000000_keypoints.json"
    path = tmp_path / "bad.json"
    path.write_text(json.dumps(spoil(json.loads(source.read_text()))))
    with pytest.raises(AssetError, match=match) as error:
        read_keypoints(path)
    assert "\n" not in str(error.value)


def test_the_real_holistic_result_has_its_points_where_the_photo_has_them(data, tmp_path):
    path = estimated(data, "mediapipe_male_full_height_hands_result_cpu.pbtxt")
    found = read_keypoints(from_text(path, tmp_path / "real.json"), size=(600, 900))
    assert (found.confidence > 0.5).all()
    # he faces the camera: his left is on the right
    assert found.seen("left_shoulder")[0, 0] > found.seen("right_shoulder")[0, 0]
    for side in ("left", "right"):
        apart = found.seen(f"{side}_wrist")[0, :2] - found.seen(f"{side}_hand")[0, :2]
        assert np.linalg.norm(apart) < 10


def test_a_face_of_mediapipe_gives_the_68_points(data, tmp_path):
    """A stored result of its own: a portrait seen from the front."""
    text = estimated(data, "mediapipe_portrait_expected_face_landmarks.pbtxt").read_text()
    points = [tuple(map(float, pair)) for pair in re.findall(r"x: (\S+)\s+y: (\S+)", text)]
    assert len(points) in (468, 478)
    path = tmp_path / "a.json"
    frame = {"pose_landmarks": POSE, "face_landmarks": [{"x": x, "y": y, "z": 0} for x, y in points]}
    path.write_text(json.dumps({"image_width": 1000, "image_height": 1200, "frames": [frame, {}]}))
    found = read_keypoints(path)
    face = np.stack([found.seen(f"face_{k:02d}")[0] for k in range(68)])
    assert (face[:, 2] == 1).all() and found.seen("face_08")[1, 2] == 0
    x, y = face[:, 0], face[:, 1]
    # the chin is lowest, jaw from the person's right ear to the left, brows above eyes above nose above mouth
    assert y.argmax() == 8 and (np.diff(x[2:15]) > 0).all()
    assert y[17:27].max() < y[36:48].min() and y[36:48].max() < y[30] < y[33] < y[48:].min()
    # eyes and lips go round: outer corners, and upper before lower
    assert x[36] < x[39] < x[42] < x[45] and y[37] < y[41] and y[43] < y[47]
    assert x[48] == x[48:].min() and x[54] == x[48:].max() and y[51] < y[62] < y[66] < y[57]


def test_results_of_mediapipes_tasks_are_written_as_its_files_and_read_back(tmp_path):
    point = lambda x, y: SimpleNamespace(x=x, y=y, z=0.0, visibility=0.7)
    pose = [point(0.1 + k / 100, 0.5) for k in range(33)]
    # near the right wrist (16), whatever its label says
    hand = [point(0.1 + 16 / 100 + k / 1000, 0.5) for k in range(21)]
    frames = [frame_json([pose], [hand], ["Right"], []), frame_json([], [], [], [])]
    path = tmp_path / "a.json"
    path.write_text(json.dumps({"image_width": 200, "image_height": 100, "frames": frames}))
    found = read_keypoints(path)
    assert found.seen("right_wrist")[0] == pytest.approx([52, 50, 0.7])
    assert found.seen("right_hand")[0] == pytest.approx([52, 50, 1]) and found.seen("left_hand")[0, 2] == 0
    assert not found.confidence[1].any()
    # alone, its fingers say which hand it is, and where they do not its label
    for label in ("Left", "Right"):
        path.write_text(
            json.dumps({"image_width": 200, "image_height": 100, "frames": [frame_json([], [hand], [label], [])]})
        )
        assert read_keypoints(path).seen(f"{label.lower()}_hand")[0, 2] == 1


def test_detecting_says_what_is_missing(tmp_path, monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    refused(AssetError, r"MediaPipe, which is not installed; pip install mediapipe", model_files, tmp_path)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: name)
    refused(AssetError, "--models DIR should hold", model_files, None)
    (tmp_path / "hand_landmarker.task").touch()
    refused(AssetError, r"found no pose_landmarker\*\.task, face_landmarker\*\.task", model_files, tmp_path)
