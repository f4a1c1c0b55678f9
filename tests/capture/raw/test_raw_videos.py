"""Videos of a painted figure: read, judged, frames chosen, masks against the truth."""

import pickle
import re
from dataclasses import replace
from fractions import Fraction

import av
import numpy as np
import pytest
from filmed_figure import ABSENT, FRAMES, SIZE, film, wall
from pictures import film as small_film
from PIL import Image
from refusals import refused

from capture.keypoints.record import Keypoints
from capture.raw import masks as own
from capture.raw.four_videos import part_keypoints
from capture.raw.glance import glance
from capture.raw.judge import judge
from capture.raw.limbs import hull, lines
from capture.raw.masks import soft_mask
from capture.raw.plate import Plate, plate_of_empty, plate_of_free
from capture.raw.scan import RawScan, RawVideo
from capture.raw.selection import movement, select
from capture.raw.video_file import EQUIVALENT, open_video, read_frames
from command.errors import AssetError
from command.progress import Progress


def judged(folder, part="body", name="body", keypoints_of=None):
    video = open_video(folder / f"{name}.mp4")
    points = part_keypoints(folder / "keypoints", keypoints_of or part, video)
    return judge(glance(video, part, points, Progress("looking", 9)))


@pytest.fixture(scope="module")
def body(tmp_path_factory):
    folder = tmp_path_factory.mktemp("body")
    masks = film(folder, "body", "body", blurred=(40, 41))
    return folder, masks, judged(folder)


def test_frames_come_with_their_numbers_and_only_those_asked_for(body):
    video = open_video(body[0] / "body.mp4")
    assert (video.size, round(video.rate)) == (SIZE, 30)
    every = list(read_frames(video, 90, grey=True))
    assert len(every) == FRAMES and every[0].picture.shape == (90, 120)
    assert every[-1].time == pytest.approx((FRAMES - 1) / 30, abs=1e-3)
    few = list(read_frames(video, only=frozenset((3, 50))))
    assert [frame.number for frame in few] == [3, 50]
    assert few[0].picture.shape == (180, 240, 3)


def test_a_video_held_upright_is_turned_as_its_file_says(tmp_path):
    """A display matrix in the track's header, as phones write it."""
    path = tmp_path / "upright.mp4"
    picture = np.zeros((48, 64, 3), np.uint8)
    picture[:24, :32] = 255
    small_film(path, [picture] * 3)
    data = bytearray(path.read_bytes())
    fixed = lambda *numbers: b"".join(int(n).to_bytes(4, "big", signed=True) for n in numbers)
    plain = fixed(65536, 0, 0, 0, 65536, 0, 0, 0, 1 << 30)
    place = data.index(plain, data.index(b"tkhd"))
    # a quarter turn clockwise when shown
    data[place : place + 36] = fixed(0, 65536, 0, -65536, 0, 0, 48 << 16, 0, 1 << 30)
    path.write_bytes(bytes(data))
    video = open_video(path)
    assert video.size == (48, 64)
    (frame, *_) = read_frames(video)
    assert frame.picture.shape == (64, 48, 3)
    # what was above on the left is above on the right
    assert frame.picture[:30, 26:].mean() > 240 and frame.picture[:30, :22].mean() < 15
    # as front cameras write it
    data[place : place + 36] = fixed(-65536, 0, 0, 0, 65536, 0, 64 << 16, 0, 1 << 30)
    path.write_bytes(bytes(data))
    refused(AssetError, "as others see the person, found one that is to be shown mirrored", open_video, path)


def test_a_film_that_does_not_say_its_colors_has_those_of_hd(tmp_path):
    picture = np.full((720, 960, 3), (200, 60, 40), np.uint8)
    path = tmp_path / "body.mkv"
    with av.open(path, "w") as container:
        stream = container.add_stream("ffv1", 30, width=960, height=720, pix_fmt="yuv444p")
        frame = av.VideoFrame.from_ndarray(picture, format="rgb24").reformat(format="yuv444p", dst_colorspace=1)
        frame.colorspace = 2
        container.mux([*stream.encode(frame), *stream.encode(None)])
    (shown,) = read_frames(open_video(path))
    assert np.abs(shown.picture - np.float32(picture)).max() < 4


def test_a_film_in_hdr_has_the_white_and_the_colors_of_others(tmp_path):
    """HLG's 75 % is white (ITU-R BT.2408), .265 of the brightest light; half as bright, sRGB's red in BT.2020."""
    red = np.sqrt(3 * 0.5 * 0.265 * np.array([0.6274, 0.0691, 0.0164]))
    picture = np.repeat(np.repeat([[(0.75, 0.75, 0.75), red]], 48, 0), 32, 1)
    path = tmp_path / "body.mkv"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("ffv1", rate=30)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv444p10le"
        tagged = stream.codec_context
        tagged.colorspace, tagged.color_range, tagged.color_primaries, tagged.color_trc = 9, 1, 9, 18
        frame = av.VideoFrame.from_ndarray((65535 * picture).astype(np.uint16), format="rgb48le")
        frame = frame.reformat(format="yuv444p10le", dst_colorspace=9, dst_color_range=1)
        frame.pts, frame.time_base = 0, Fraction(1, 30)
        container.mux([*stream.encode(frame), *stream.encode(None)])
    (frame,) = read_frames(open_video(path))
    assert frame.picture[10:40, 4:28].min() >= 253
    red = frame.picture[10:40, 36:60].mean((0, 1))
    assert red[0] > 150 and red[1:].max() < 20


def test_pixels_that_are_not_square_are_refused(tmp_path):
    path = tmp_path / "body.mp4"
    small_film(path, aspect=Fraction(4, 3))
    refused(AssetError, r"body\.mp4: expected square pixels, found them 1\.33 times as wide as high", open_video, path)


@pytest.mark.parametrize(("written", "focal"), [("26", 26 / 43.27 * 80), (None, None), ("wide", None), ("0", None)])
def test_the_lens_is_read_from_what_the_phone_wrote(tmp_path, written, focal):
    path = tmp_path / "body.mp4"
    small_film(path, metadata={EQUIVALENT: written} if written else {})
    assert open_video(path).focal == (None if focal is None else pytest.approx(focal))


def test_the_empty_second_is_found_and_chosen_frames_are_even_over_the_turn_and_sharp(body):
    at = body[2]
    assert at.empty[: ABSENT - 12].all() and not at.empty[ABSENT - 5 :].any()
    assert not [problem for problem in at.problems if problem.fatal], at.problems
    chosen = select(at, 20)
    assert 15 <= len(chosen.frames) <= 20
    assert chosen.frames.min() >= ABSENT and not {40, 41} & set(chosen.frames.tolist())
    assert chosen.left_out["blurred"] == 2 and "2 blurred" in chosen.line("body.mp4")
    steps = np.diff(movement(at.glance)[chosen.frames])
    assert steps.max() < 3.5 * np.median(steps)


def test_frames_of_stepping_in_are_left_out(body):
    at = body[2]
    points = at.glance.keypoints
    pixels = points.pixels.copy()
    walking = np.arange(ABSENT, ABSENT + 6)
    pixels[walking, :, 0] -= np.linspace(90, 40, 6)[:, None]
    beside = replace(at, glance=replace(at.glance, keypoints=replace(points, pixels=pixels)))
    chosen = select(beside, 20)
    assert chosen.left_out["of stepping in"] == np.count_nonzero(at.usable[walking]) > 0
    assert not set(walking.tolist()) & set(chosen.frames.tolist())
    assert select(at, 20).left_out["of stepping in"] == 0


@pytest.mark.parametrize("plate", ["empty", "free", "cut"])
def test_masks_are_those_of_the_figure(body, plate, monkeypatch):
    """From the empty room; from what is seen beside the figure; the same, the rest by GrabCut."""
    folder, masks, at = body
    if plate == "cut":
        pytest.importorskip("cv2", reason="OpenCV is not installed")
    else:
        monkeypatch.setattr(own, "can_cut", lambda: False)
    empty = at.empty if plate == "empty" else np.zeros_like(at.empty)
    assert ("empty room" in own.masked_by(empty)) == (plate == "empty")
    assert ("the rest by GrabCut" in own.masked_by(empty)) == (plate == "cut")
    video = at.glance.video
    numbers = [30, 45, 60, 75]
    pictures = {frame.number: frame.picture for frame in read_frames(video)}
    if plate == "empty":
        room = plate_of_empty(video, np.flatnonzero(at.empty))
        assert np.abs(room.color - wall()).mean() < 4
    else:
        spread = np.arange(ABSENT, FRAMES, 3)
        room = plate_of_free([pictures[i] for i in spread], at.glance.keypoints.of_frames(spread))
        assert 0.4 < room.known.mean() < 1
    for number in numbers:
        mask = soft_mask(pictures[number], room, at.glance.keypoints, number)
        found, true = mask > 127, masks[number]
        iou = (found & true).sum() / (found | true).sum()
        assert iou > {"empty": 0.93, "free": 0.8, "cut": 0.88}[plate], (number, iou)
        # soft at the rim and nowhere else
        soft = (mask > 12) & (mask < 243)
        assert 0 < soft.sum() < 0.4 * true.sum()


def test_a_gap_that_shows_the_room_is_no_person_and_shadows_lie_on_the_floor_though_knees_are_hidden(body):
    points = judged(body[0]).glance.keypoints
    unseen = replace(points, confidence=np.zeros_like(points.confidence))
    noise = np.random.default_rng(0).normal(0, 1, (120, 160, 3))
    room = np.full((120, 160, 3), 150.0) + noise
    room[90:] -= 50
    picture = room.copy()
    picture[20:90, 60:100] = (40, 20, 15)
    gap = (slice(40, 70), slice(90, 96))
    picture[gap] = room[gap]
    plate = Plate(np.float32(room), np.ones((120, 160), bool), 1.2)
    mask = soft_mask(np.uint8(picture), plate, unseen, 0) > 127
    assert not mask[42:68, 92:94].any() and mask[22:88, 62:88].all() and mask[42:68, 97:99].all()
    # knees of other frames say where the floor may be dark
    picture[95:110, 60:100] *= 0.7
    rows = [points.names.index(f"{side}_knee") for side in ("left", "right")]
    hidden = replace(points, confidence=points.confidence * (np.arange(len(points.confidence)) > 0)[:, None])
    hidden.pixels[:, rows] = (80, 85)
    assert not soft_mask(np.uint8(picture), plate, hidden, 0)[97:].any()
    assert soft_mask(np.uint8(picture), plate, unseen, 0)[97:].any()


def said(at):
    (problem, *_) = [problem for problem in at.problems if problem.fatal]
    return problem.line("body.mp4")


def judged_with(at, **changed):
    """What is said of a video with other keypoints."""
    return judge(replace(at, keypoints=replace(at.keypoints, **changed)))


@pytest.mark.parametrize(
    ("changed", "expected"),
    [
        ({"shift": (90, 0)}, r"body\.mp4: the body leaves the picture at the right from .* s on; film again with it"),
        ({"second": True}, r"two people are in view from .* s on; film one person alone"),
        ({"still": False}, r"the camera moves, by [3-7] pixels from .* s on; put the phone on a tripod"),
        ({"upside_down": True}, r"the person stands on the head; turn the video"),
    ],
)  # fmt: skip
def test_what_spoils_a_video_is_said_with_what_to_do(tmp_path, changed, expected):
    film(tmp_path, "body", "body", **changed)
    assert re.search(expected, said(judged(tmp_path)))


def test_a_phone_that_is_knocked_over_a_large_way_is_a_moving_camera(body):
    """Least squares on brightness follow a few pixels alone."""
    at = body[2].glance
    small, pixels = at.small.copy(), at.keypoints.pixels.copy()
    small[60:], pixels[60:] = np.roll(small[60:], 16, axis=2), pixels[60:] + (18, 0)
    (problem,) = judge(replace(at, small=small, keypoints=replace(at.keypoints, pixels=pixels))).problems
    assert problem.fatal and re.match(r"the camera moves, by 18 pixels from 2\.\d s on", problem.what)


def test_a_cut_to_another_room_is_refused_and_black_is_no_empty_room(body):
    at = body[2].glance
    small = at.small.copy()
    small[60:] = np.where(np.abs(np.int16(small[60:]) - small[0]) < 12, 255 - small[0, ::-1], small[60:])
    (problem,) = judge(replace(at, small=small)).problems
    assert problem.fatal and re.match(r"from 2\.\d s on another room is seen than in the empty room", problem.what)
    black = at.small.copy()
    black[body[2].empty] = 3
    found = judge(replace(at, small=black))
    assert not found.empty.any() and not [problem for problem in found.problems if problem.fatal]


@pytest.mark.parametrize(("quarter", "side"), [(1, "right"), (-1, "left")])
def test_a_film_on_its_side_is_called_so_and_nothing_else(body, quarter, side):
    at = body[2].glance
    x, y = (at.keypoints.pixels - np.array(SIZE) / 2).transpose(2, 0, 1)
    turned = np.stack([-quarter * y, quarter * x], -1) + np.array(SIZE) / 2
    (problem,) = judged_with(at, pixels=turned).problems
    assert problem.fatal and problem.what == f"the film lies on its side, with the head to the {side}"


def test_a_part_that_is_lost_beyond_the_border_counts_as_cut_off(body):
    """Detectors find nothing there; before that, points came near the border."""
    at = body[2].glance
    pixels, confidence = at.keypoints.pixels.copy(), at.keypoints.confidence.copy()
    pixels[60:, :, 0] += np.linspace(0, 200, 30)[:, None]
    confidence[60:][pixels[60:, :, 0] > SIZE[0] - 4] = 0
    found = judged_with(at, pixels=pixels, confidence=confidence)
    (what,) = [problem.what for problem in found.problems if "leaves" in problem.what]
    assert "at the right from 2." in what and what.endswith("s on"), what


@pytest.mark.slow
def test_the_other_hand_and_keypoints_of_other_videos_are_found(tmp_path):
    film(tmp_path, "hand_right", "left")
    at = judged(tmp_path, "hand_left", "left", keypoints_of="hand_right")
    assert "the left hand is confidently found in 0 of" in said(at) and "exchange LEFT and RIGHT" in said(at)
    film(tmp_path, "body", "body")
    film(tmp_path, "body", "other", shift=(-95, 0))
    at = judged(tmp_path)
    assert "of the keypoints lie where the picture differs" in said(at) or "leaves the picture" in said(at)
    film(tmp_path, "body", "body", empty=False)
    at = judged(tmp_path)
    assert not at.empty.any()
    assert [(problem.fatal, problem.what) for problem in at.problems] == [(False, "the empty room is in no frame")]


def test_keypoints_of_another_length_are_refused_and_a_frame_without_points_may_show_anyone(body, tmp_path):
    at = body[2]
    points = at.glance.keypoints.of_frames(np.arange(50))
    with pytest.raises(AssetError, match="the video has 90 frames, its keypoints 50"):
        glance(at.glance.video, "body", points, Progress("looking", 9))
    points = body[2].glance.keypoints.of_frames(np.arange(2))
    assert hull(points, 0, (90, 120)).all() and hull(points, 0, (90, 120)).shape == (90, 120)
    assert not lines(points, 0, (90, 120)).any()


def video(folder, frames=3, size=(32, 24), part="body"):
    """Frames whose red counts them."""
    pictures = []
    for i in range(frames):
        pictures.append(folder / f"{i:06d}.png")
        Image.fromarray(np.full((size[1], size[0], 3), (i, 0, 7), np.uint8)).save(pictures[-1])
    keypoints = Keypoints(("nose",), np.full((frames, 1, 2), np.nan), np.zeros((frames, 1)), size)
    masks = np.zeros((frames, size[1], size[0]), np.uint8)
    return RawVideo(part, size, 30.0, 10 * np.arange(frames), tuple(pictures), masks, keypoints, None)


def test_a_scan_has_the_bodys_video_and_reads_pictures_of_its_size_when_asked_for(tmp_path):
    raw = video(tmp_path)
    assert [raw.picture(i)[0, 0].tolist() for i in (2, 0)] == [[2, 0, 7], [0, 0, 7]]
    # none is held: what travels to a worker is names, masks and points
    assert len(pickle.dumps(raw)) < raw.masks.nbytes + 3000
    Image.new("RGB", (24, 32)).save(raw.pictures[1])
    refused(AssetError, r"000001\.png: should be \(32, 24\) pixels as the video, is \(24, 32\)", raw.picture, 1)
    assert set(RawScan({"body": raw}).videos) == {"body"}
    refused(ValueError, "the body's among them", lambda: RawScan(dict.fromkeys(("head", "hand_left"), raw)))


@pytest.mark.parametrize(
    ("field", "value", "said"),
    [
        ("part", "left_hand", "part should be one of"),
        ("pictures", (), "should be 3 as frames, are .0, 3, 3."),
        ("size", (24, 32), r"masks should be \(24, 32\) pixels"),
    ],
)
def test_fields_that_disagree_are_refused(tmp_path, field, value, said):
    raw = video(tmp_path)
    refused(ValueError, said, lambda: RawVideo(**(vars(raw) | {field: value})))
