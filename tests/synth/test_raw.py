"""Raw videos: what a phone would have written, and a truth that lies apart."""

import json

import av
import numpy as np
import pytest
from PIL import Image

from avatar.camera import Camera, project
from avatar.skeleton import JOINTS, PARTS, joint_transforms
from capture.keypoints.read import read_keypoints
from synth.command import SynthConfig, load_subject, synth_raw
from synth.options import RawConfig
from synth.raw.backdrop import backdrop
from synth.raw.film import FILES
from synth.raw.phone import phone_of

SIZE, SECONDS = 96, 1.0
COUNT = 102


@pytest.fixture(scope="module")
def raw(tmp_path_factory):
    out = tmp_path_factory.mktemp("raw") / "me"
    config = SynthConfig(size=SIZE, light="soft", truth=False, seed=5)
    synth_raw("builtin", out, config, RawConfig(raw=True, keypoints=True, seconds=SECONDS))
    return out


def frames_of(path):
    with av.open(str(path)) as container:
        return np.stack([frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)])


def test_videos_are_as_a_phone_writes_them_and_begin_empty(raw):
    for part, name in FILES.items():
        with av.open(str(raw / name)) as container:
            stream = container.streams.video[0]
            assert (stream.codec_context.name, stream.average_rate, stream.frames) == ("h264", 30, COUNT)
            assert (stream.width, stream.height) == (170, 96)
        frames = frames_of(raw / name).astype(float)
        empty = frames[:29]
        masks = [np.asarray(Image.open(raw / "truth" / part / "masks" / f"{i:06d}.png")) for i in (20, 100)]
        assert not masks[0].any() and masks[1].max() == 255
        # noise is there, and smaller than what the person changes
        assert 0.3 < empty.std(0).mean() < 4
        # a striped shirt and a face before a wall
        changed = np.abs(frames[100] - empty.mean(0)).max(-1)
        person = masks[1] > 250
        assert np.median(changed[person]) > 40 > 16 > np.median(changed[masks[1] == 0])


def test_keypoints_lie_at_the_true_joints_but_for_a_detectors_mistakes(raw):
    subject = load_subject("builtin")
    for part in PARTS:
        found = read_keypoints(raw / "keypoints" / part)
        with np.load(raw / "truth" / part / "video.npz") as truth:
            truth = dict(truth)
        assert len(found.pixels) == COUNT and not found.confidence[:30].any()
        camera = Camera(truth["K"], truth["camera_from_world"], tuple(int(n) for n in truth["size"]))
        names = [name for name in found.names if name in JOINTS]
        off = []
        for i in range(75, COUNT):
            joints = joint_transforms(truth["poses"][i], subject.joints.astype(float), truth["root"][i])[:, :3, 3]
            pixels = project(camera, joints)[0]
            for name in names:
                x, y, confidence = found.seen(name)[i]
                if confidence > 0.6:
                    off.append(np.hypot(*(pixels[JOINTS.index(name)] - (x, y))))
        # 4 px of 1080 are .36 of 96; 1 cm is .5 px in the body video and 3 px before the nearest camera
        assert len(off) > (300 if part == "body" else 20) and 0.2 < np.median(off) < (1.2 if part == "body" else 3)


def test_hidden_points_are_less_sure(raw):
    # at the start the person looks at the camera; half a turn later the face is turned away
    found = read_keypoints(raw / "keypoints" / "body")
    nose = found.seen("nose")[:, 2]
    assert np.median(nose[73:77]) > 0.7 and np.median(nose[85:90]) < 0.4


def test_the_person_turns_once_and_sways(raw):
    with np.load(raw / "truth" / "body" / "video.npz") as truth:
        poses, root = truth["poses"], truth["root"]
    elbow = poses[73:, JOINTS.index("left_elbow")]
    assert np.degrees(np.abs(elbow).max()) > 4 and np.degrees(elbow.std(0).max()) > 0.1
    assert 0.002 < root[80:, 0].std() < 0.03


def test_without_noise_and_sway_the_camera_stands_in_an_unchanging_room(tmp_path):
    phone = phone_of(np.arange(9) / 30, 0.0, 0.0, [1, 2])
    picture = np.full((4, 6, 3), 99.6, np.float32)
    assert (phone.shoot(8, picture) == 100).all()
    noisy = phone_of(np.arange(9) / 30, 1.0, 1.0, [1, 2])
    assert noisy.shoot(8, picture).std() > 0.5 and np.array_equal(noisy.shoot(8, picture), noisy.shoot(8, picture))


def test_shadow_darkens_the_floor_where_the_person_stands():
    from avatar.camera import look_at, pinhole

    camera = Camera(pinhole((64, 48), 0.9), look_at([0, 0.2, 3.2], [0, 0, 0]), (64, 48))
    room = backdrop(camera, -0.95, False, 0)
    shadow = room.with_shadow(0.0, 0.0) / room.picture
    assert shadow.min() == pytest.approx(0.65, abs=0.02)
    # the wall has none
    assert (shadow[:20] > 0.999).all()
    y, x = np.unravel_index(shadow[..., 0].argmin(), (48, 64))
    expected = project(camera, np.array([[0, -0.95, 0]]))[0][0]
    assert np.hypot(x + 0.5 - expected[0], y + 0.5 - expected[1]) < 1.5


def test_truth_is_one_folder_and_says_what_was_filmed(raw):
    assert RawConfig().held_out is False
    assert {path.name for path in raw.iterdir() if path.name[0] != "."} == {*FILES.values(), "keypoints", "truth"}
    facts = json.loads((raw / "truth" / "raw.json").read_text())
    assert (facts["subject"], facts["size"], facts["light"], facts["seed"]) == ("builtin:male", SIZE, "soft", 5)
