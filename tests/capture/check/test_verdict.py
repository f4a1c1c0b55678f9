"""Spoilt captures: what is wrong is found, named with its frames, and nothing else is."""

import json
import re
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from painted_capture import write_capture
from PIL import Image
from scipy import ndimage
from turning_capture import TURN, with_video

from avatar.similarity import similarity_from_landmarks
from capture.check.coverage import largest_gap, turn_angles
from capture.check.pictures import blurred, exposure, repeated, sharpness
from capture.check.report import examine, examine_part, report_facts
from capture.check.verdict import verdict
from selfscan.__main__ import main


@pytest.fixture(scope="module")
def good(turning):
    return examine(turning)


def _news(capture, turning, good) -> dict[str, bool]:
    """What is found in a spoilt capture and not in the good one; whether it is fatal."""
    head, subject = capture.videos["head"], capture.subject
    fit = similarity_from_landmarks(head.landmarks, subject.vertices[head.landmark_vertices])
    visible = np.ones(len(subject.faces), bool)
    changed = [part for part, video in capture.videos.items() if video is not turning.videos[part]]
    parts = good.parts | {part: examine_part(capture, part, good.head_scale, visible) for part in changed}
    after = verdict(replace(good, parts=parts, landmark_residual=fit.residual)).findings
    before = {(f.part, f.what) for f in verdict(good).findings}
    return {f"{f.part}: {f.what}": f.fatal for f in after if (f.part, f.what) not in before}


def test_a_sound_capture_is_usable_and_measured(good):
    judged = verdict(good)
    assert judged.usable and judged.line().startswith("usable, but ")
    kinds = {re.sub(r"\d+", "N", f.what) for f in judged.findings}
    assert kinds == {"N frames only", "a pixel is N mm wide"}, judged.findings
    assert good.height == pytest.approx(1.7, abs=0.3)
    assert good.head_scale == pytest.approx(0.5, rel=1e-6)  # painted in half metres
    for name, distance in (("body", 3.3), ("head", 0.7), ("hand_left", 0.5)):
        part = good.parts[name]
        assert part.distance == pytest.approx(distance, rel=0.01)
        assert part.mean.iou == 1 and part.mean.edge == 0 and part.outside == 0
        assert part.coverage.gap == pytest.approx(30, abs=3) and part.coverage.seen > 0.85
    json.dumps(report_facts(good), allow_nan=False)


def _masks(change):
    def spoil(capture):
        for part, video in capture.videos.items():
            capture = with_video(capture, part, masks=np.stack([change(m) for m in video.masks]))
        return capture

    return spoil


def _exchanged(capture):
    left, right = capture.videos["hand_left"], capture.videos["hand_right"]
    return replace(capture, videos={**capture.videos, "hand_left": replace(right, part="hand_left"),
                                    "hand_right": replace(left, part="hand_right")})  # fmt: skip


def _pictures_exchanged(capture):
    left, right = capture.videos["hand_left"], capture.videos["hand_right"]
    capture = with_video(capture, "hand_left", images=right.images, masks=right.masks)
    return with_video(capture, "hand_right", images=left.images, masks=left.masks)


def _put(part, field, where, value, add=False):
    """A video's array with a value put into it, or added."""

    def spoil(capture):
        array = getattr(capture.videos[part], field).copy()
        array[where] = array[where] + value if add else value
        return with_video(capture, part, **{field: array})

    return spoil


def _nobody(frames):
    return _put("body", "masks", frames, False)


def _one_side(capture):
    video = capture.videos["body"]
    same = np.repeat(video.masks[:1], TURN, 0)
    return with_video(capture, "body", cameras=video.cameras[:1] * TURN, masks=same)


def _stuck(capture):
    images = capture.videos["body"].images
    return with_video(capture, "body", images=images[[0, 1, 2, 2, *range(4, TURN)]])


def _head_elsewhere(capture):
    return with_video(capture, "head", masks=np.roll(capture.videos["head"].masks, 32, 2))


_off = _put("hand_left", "axis_angle", np.s_[:, 16], np.radians([4, 2, 3]), add=True)
_background_in_mask = _put("hand_right", "masks", np.s_[2, 10:54, 5:59], True)
_burnt = _put("hand_left", "images", np.s_[:, ::2], 255)
_wrong_landmark = _put("head", "landmarks", 3, 0.1, add=True)  # half metres
SIDES = ("left", "right")
ERODED = partial(ndimage.binary_erosion, iterations=2, border_value=1)
DILATED = partial(ndimage.binary_dilation, iterations=2)
SPOILT = {
    "hand folders exchanged": (_exchanged, [f"hand_{side}: it shows the other hand" for side in SIDES], True),
    "hand pictures exchanged": (_pictures_exchanged, ["hand_left: it shows the other hand"], True),
    "hand poses off": (_off, [r"hand_left: poses are [\d.]+ px off the masks, most in \d"], False),
    "masks eroded": (_masks(ERODED), ["hand_left: masks are 2 px smaller than the template all along"], False),
    "masks dilated": (_masks(DILATED), ["hand_left: masks are 2 px larger than the template all along"], False),
    "one mask grown": (_background_in_mask, ["hand_right: masks change size in frames 2"], False),
    "nobody in one frame": (_nobody([1]), ["body: masks show no person in frames 1"], False),
    "nobody in a third": (_nobody([1, 5, 6, 9]), ["body: masks show no person in frames 1, 5, 6, 9"], True),
    "one direction": (
        _one_side,
        ["body: 360 degrees of the turn have no frame", r"body: [345]\d% of the surface is seen"],
        None,
    ),
    "a frame twice": (_stuck, ["body: frames repeat the one before: 3"], False),
    "burnt out": (_burnt, [r"hand_left: \d\d% of the person is burnt out"], False),
    "head masks elsewhere": (_head_elsewhere, [r"head: masks leave out \d+% of the head"], None),
    "a wrong landmark": (_wrong_landmark, [r"head: landmarks are \d+ mm off the template"], None),
}


@pytest.mark.parametrize("case", SPOILT)
def test_what_is_spoilt_is_found(turning, good, case):
    spoil, expected, fatal = SPOILT[case]
    news = _news(spoil(turning), turning, good)
    for pattern in expected:
        hits = [is_fatal for what, is_fatal in news.items() if re.search(pattern, what)]
        assert hits and (fatal is None or hits == [fatal]), (pattern, news)
    # masks of another size are not taken for wrong poses
    if case in ("masks eroded", "masks dilated"):
        assert not any("px off the masks" in what for what in news if what.startswith("hand")), news


@pytest.mark.parametrize("frame", [0, 7, 19])
def test_a_frame_blurred_by_a_pixel_is_named_and_no_other(frame):
    rng = np.random.default_rng(0)
    texture = ndimage.gaussian_filter(rng.random((64, 84, 3)) * 255, (0.6, 0.6, 0))
    images = np.stack([texture[:, i : i + 64] for i in range(20)])
    masks = np.ones((20, 64, 64), bool)
    assert blurred(sharpness(images.astype(np.uint8), masks)) == []
    images[frame] = ndimage.gaussian_filter(images[frame], (1.2, 1.2, 0))
    masks[3] = False  # a frame without a person has no sharpness
    sharp = sharpness(images.astype(np.uint8), masks)
    assert blurred(sharp) == [frame] and np.isnan(sharp[3])


def test_repeated_and_clipped():
    images = np.full((4, 8, 8, 3), 100, np.uint8)
    images[1] += 1
    assert repeated(images) == [3]
    masks = np.ones((4, 8, 8), bool)
    images[0], images[1, :4] = 255, 0
    assert exposure(images, masks) == (0.25, 0.125)
    assert exposure(images, ~masks) == (0, 0)


def test_gaps_of_the_turn():
    assert largest_gap(np.zeros(5)) == pytest.approx(360)
    assert largest_gap(np.radians([0.0, 90, 180, 270])) == pytest.approx(90)
    assert largest_gap(np.radians([350.0, 10, 100])) == pytest.approx(250)
    front, left = np.array([[0, 0, 1.0]]), np.array([[1.0, 0, 0]])
    assert turn_angles(front, "body") == 0 and turn_angles(left, "head") == pytest.approx(np.pi / 2)
    assert turn_angles(front, "hand_left") == 0


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return write_capture(tmp_path_factory.mktemp("folder") / "test", size=32, frames=2)


def test_the_command_writes_table_overlays_and_json(folder, tmp_path, capsys):
    code = main(["check", str(folder), "-o", str(tmp_path / "out"), "--json", str(tmp_path / "facts.json")])
    out = capsys.readouterr().out
    facts = json.loads((tmp_path / "facts.json").read_text())
    assert facts == json.loads((tmp_path / "out" / "check.json").read_text())
    assert code == (0 if facts["usable"] else 1) and facts["verdict"] in out
    assert out.count("\n  body:") + out.count("\n  head:") + out.count("\n  hand_") >= len(facts["findings"]) > 0
    assert len(facts["parts"]["body"]["per_frame"]) == 2
    with Image.open(tmp_path / "out" / "overlays.png") as sheet:
        assert sheet.size == (3 * 320, 4 * 336)  # two frames and the worst


def test_landmarks_that_determine_nothing_are_refused(folder, capsys):
    path = folder / "head" / "landmarks.json"
    content = json.loads(path.read_text())
    points = {name: [0.001 * i, 0, 0] for i, name in enumerate(content["points"])}
    path.write_text(json.dumps(content | {"points": points}))
    assert main(["check", str(folder), "--keypoints", "x"]) == 1
    assert "--keypoints: is for videos as filmed" in capsys.readouterr().err
    assert main(["check", str(folder)]) == 1
    assert "landmarks.json: landmarks: the source points lie on a line" in capsys.readouterr().err
