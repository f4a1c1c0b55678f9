"""Faces over the wire: each protocol's own form, sides that are not mixed up, and packets that lie."""

import struct
import time

import numpy as np
import pytest

from avatar.body import builtin_body
from avatar.face import REST, SHAPES, FaceFrame
from avatar.gaze import YAW, gaze_of, turned_head
from avatar.motion.clip import Clip
from avatar.motion.read import read_motion
from avatar.rotation import quaternion_from_axis_angle, quaternion_inverse, quaternion_product
from avatar.skeleton import JOINT_NUMBERS as J
from player.draw.drawing import Pose
from player.live.command import encoder, timed_poses
from player.live.face_sender import with_head
from player.live.frame import MalformedError
from player.live.gains import Gains
from player.live.inbox import Inbox
from player.live.json_pose import build_pose, parse_pose
from player.live.openseeface import FEATURES, HEAD, SIZE
from player.live.osc import build_bundle, build_message
from player.live.playback import LivePlayback
from player.live.take import Take
from player.scene.address import Address

# a face whose sides and neighbors differ
WEIGHTS = {name: 0.01 * (1 + number) for number, name in enumerate(SHAPES)}


def ifacialmocap(weights=WEIGHTS, mark="-", tail="=head#-10,20,5,0,0,0|rightEye#3,4,0|leftEye#3,-2,0|"):
    named = {
        name.replace("Left", "_L").replace("Right", "_R") if len(name) > 9 else name: v for name, v in weights.items()
    }
    return ("".join(f"{name}{mark}{round(100 * value)}|" for name, value in named.items()) + tail).encode()


def livelinkface(weights=WEIGHTS, frame=60, head=(0.3, 0.1, -0.2)):
    values = [*weights.values(), *head, *[0.0] * 6]
    name = b"phone"
    start = struct.pack("<i37s", 6, b"$" + b"a" * 36) + struct.pack("!i", len(name)) + name
    return start + struct.pack("!if2i", frame, 0.5, 60, 1) + struct.pack("!B61f", 61, *values)


def openseeface(seconds=1.0, right=0.2, left=1.0, euler=(170.0, 15.0, 95.0), found=1, **features):
    values = [features.get(f"f{k}", 0.0) for k in range(14)]
    head = HEAD.pack(seconds, 0, 640, 480, right, left, found, 0.1, 0, 0, 0, 1, *euler, 0, 0, 0)
    return head + bytes(SIZE - HEAD.size - FEATURES.size) + FEATURES.pack(*values)


def vmc(weights=WEIGHTS, apply=True):
    values = [build_message("/VMC/Ext/Blend/Val", name[0].upper() + name[1:], v) for name, v in weights.items()]
    return build_bundle([*values, *[build_message("/VMC/Ext/Blend/Apply")] * apply])


def json_pose(weights=WEIGHTS, sequence=0):
    pose = parse_pose(build_pose(Pose(np.zeros((52, 3)), np.zeros(3)), time=0.0, sequence=sequence)).pose
    text = build_pose(pose, time=0.0, sequence=sequence).decode()
    return text.replace("{", '{"face":' + str(weights).replace("'", '"') + ",", 1).encode()


MADE = {"ifacialmocap": ifacialmocap, "livelinkface": livelinkface, "vmc": vmc, "udp": json_pose}


def received(kind, *packets):
    inbox = Inbox(kind)
    for k, packet in enumerate(packets):
        inbox.feed(packet, k / 60)
    found = inbox.sample()
    return inbox, None if found is None else found[1]


@pytest.mark.parametrize("kind", MADE)
def test_every_shape_arrives_under_its_own_name(kind):
    inbox, pose = received(kind, MADE[kind]())
    assert np.allclose(pose.face.weights, list(WEIGHTS.values()), atol=1e-6)
    assert inbox.counters.frames == 1 and inbox.counters.malformed == 0
    if kind != "ifacialmocap":  # which sends angles of its own
        assert np.allclose(pose.face.gaze[0, 0], YAW * (WEIGHTS["eyeLookOutLeft"] - WEIGHTS["eyeLookInLeft"]))


def test_full_names_ampersands_and_angles_of_ifacialmocap_are_read():
    text = "".join(f"{name}&{round(100 * value)}|" for name, value in WEIGHTS.items())
    _, pose = received("ifacialmocap", (text + "=head#-10,20,5,0,0,0|rightEye#3,4,0|leftEye#3,-2,0").encode())
    assert np.allclose(pose.face.weights, list(WEIGHTS.values()))
    assert np.allclose(np.degrees(pose.face.gaze), [[-2, -3], [4, -3]])
    turn = np.degrees(pose.axis_angle[J["neck"]] + pose.axis_angle[J["head"]])
    assert np.allclose(turn, [-10, 20, 5], atol=2) and np.linalg.norm(pose.axis_angle[J["pelvis"]]) == 0


def test_heads_of_the_engine_turn_to_their_own_right_and_nod_up():
    _, pose = received("livelinkface", livelinkface())
    turn = pose.axis_angle[J["neck"]] + pose.axis_angle[J["head"]]
    assert (np.sign(turn) == [-1, -1, -1]).all() and abs(turn[1] + 0.3) < 0.05


def test_eyes_of_openseeface_are_open_and_its_features_have_sides():
    _, pose = received("openseeface", openseeface(f8=1.0, f3=-0.5, f12=1.0))
    by_name = dict(zip(SHAPES, pose.face.weights, strict=True))
    assert by_name["eyeBlinkRight"] == pytest.approx(0.8) and by_name["eyeBlinkLeft"] == 0
    assert by_name["mouthSmileLeft"] > 0.8 and by_name["mouthSmileRight"] == by_name["mouthFrownLeft"] == 0
    assert by_name["browDownLeft"] > 0.4 and by_name["jawOpen"] > 0.5
    assert received("openseeface", openseeface(found=0))[1] is None
    assert np.isclose(pose.axis_angle[[J["neck"], J["head"]], 1].sum(), -np.radians(15), atol=0.03)


def test_values_of_vmc_hold_until_the_next_apply_and_come_with_or_without_bones():
    bone = build_message("/VMC/Ext/Bone/Pos", "Head", *[0.0] * 6, 1.0)
    inbox, pose = received("vmc", vmc({"Joy": 1.0, "Blink_L": 0.5, "tail": 1.0}, apply=False))
    assert pose is None
    inbox.feed(vmc({"A": 0.5, "Joy": 0.0}), 0.1)
    by_name = dict(zip(SHAPES, inbox.sample()[1].face.weights, strict=True))
    assert by_name["eyeBlinkLeft"] == 0.5 and by_name["mouthSmileLeft"] == 0 and by_name["jawOpen"] == 0.225
    frames = inbox.counters.frames
    inbox.feed(bone, 0.2)
    inbox.feed(vmc({"Blink_L": 1.0}), 0.2)  # belongs to the bones before it
    assert inbox.counters.frames == frames + 1
    assert inbox.sample()[1].face.weights[SHAPES.index("eyeBlinkLeft")] == 1
    assert inbox.sample()[1].face.weights[SHAPES.index("jawOpen")] == 0.225
    inbox.feed(vmc({"A": float("nan")}), 0.3)
    assert inbox.counters.malformed == 1 and np.isfinite(inbox.sample()[1].face.weights).all()


@pytest.mark.parametrize(
    "face", ["[1]", '{"jawOpen": 1.5}', '{"jawOpen": true}', '{"jawOpen": "1"}', '{"jawOpen": NaN}']
)
def test_a_face_in_json_that_is_none_is_refused(face):
    with pytest.raises(MalformedError):
        parse_pose(json_pose({}).replace(b'"face":{}', b'"face":' + face.encode()))
    assert parse_pose(json_pose({"what": 1.0})).pose.face.weights.max() == 0
    assert parse_pose(json_pose({}).replace(b'"face":{}', b'"face":null')).pose.face is None


def spoilt(rng, good):
    """Cut short, noise, or a number made NaN."""
    kind = rng.integers(3)
    if kind == 0:
        return good[: int(rng.integers(0, len(good) * 3 // 4))]
    if kind == 1:
        return rng.bytes(int(rng.integers(1, 300)))
    at = int(rng.integers(0, 52))
    return good[: -4 * (61 - at)] + struct.pack("!f", np.nan) + good[len(good) - 4 * (60 - at) :]


@pytest.mark.parametrize("kind", ["ifacialmocap", "livelinkface", "openseeface"])
def test_good_faces_come_through_ten_thousand_spoilt_packets_and_the_last_good_one_stays(kind, within):
    rng, inbox, thrown = np.random.default_rng(0), Inbox(kind), 0
    began = time.process_time()
    for n in range(100):
        weight = 0.004 * n
        good = {
            "ifacialmocap": lambda w=n: ifacialmocap(dict.fromkeys(SHAPES, w / 100)),
            "livelinkface": lambda w=weight, n=n: livelinkface(dict.fromkeys(SHAPES, w), frame=n),
            "openseeface": lambda w=weight, n=n: openseeface(n / 60, 1 - w, 1 - w),
        }[kind]()
        inbox.feed(good, n / 60)
        for _ in range(100):
            inbox.feed(spoilt(rng, good) if kind == "livelinkface" else spoilt(rng, good)[: len(good) - 1], n / 60)
            thrown += 1
        face = inbox.sample()[1].face
        within(face.weights[0] - (n / 100 if kind == "ifacialmocap" else weight), 1e-6, "")
    took = time.process_time() - began
    count = inbox.counters
    assert thrown == 10_000 and (count.frames, count.malformed) == (100, thrown)
    assert took < 20  # of processor time, far below a second a thousand
    inbox.feed(good, 99.0)
    assert inbox.counters.duplicate == (kind != "ifacialmocap")


def test_a_face_of_a_sender_that_goes_is_held_then_rests_and_the_body_stays_with_its_motion(avatar):
    inbox, now = Inbox("ifacialmocap"), [100.0]
    live = LivePlayback(inbox, Address("ifacialmocap", "127.0.0.1", 1), [avatar], clock=lambda: now[0])
    assert live.poses()[0].face is None and not live.moves_body
    inbox.feed(ifacialmocap(), 100.0)
    shares = []
    for now[0] in (100.0, 100.9, 101.25, 101.6):
        face = live.poses()[0].face
        shares.append(0.0 if face is None else face.weights[50] / WEIGHTS["noseSneerRight"])
    assert np.allclose(shares, [1, 1, 0.5, 0], atol=1e-6)
    turned = np.zeros((52, 3))
    turned[J["head"], 1] = turned[J["left_elbow"], 1] = 0.3
    found = with_head(Pose(turned, np.ones(3)), Pose(turned_head(np.array([0.2, 0.0, 0.0])), np.zeros(3), REST))
    assert np.allclose(found.axis_angle[[J["neck"], J["head"], J["left_elbow"]], 1], [0.08, 0.42, 0.3])
    assert found.face is REST and (found.root == 1).all()


@pytest.mark.parametrize("kind", ["vmc", "udp"])
def test_a_motion_with_a_face_streams_out_and_comes_in_again(kind):
    faces, still = np.random.default_rng(0).uniform(size=(3, 52)), np.zeros((3, 52, 3))
    motion = Clip(still, np.zeros((3, 3)), 30.0, face=faces, gaze=gaze_of(faces))
    encode, inbox = encoder(kind, builtin_body("male")), Inbox(kind)
    for number, (seconds, pose) in enumerate(timed_poses(motion, 60.0, loop=False)):
        inbox.feed(encode(number, seconds, pose), seconds)
        row = number / 2
        wanted = (faces[int(row)] + faces[int(row + 0.5)]) / 2
        assert np.allclose(inbox.sample()[1].face.weights, wanted, atol=1e-4)


def test_the_bones_of_eyes_turn_the_gaze_and_lids_follow():
    s, c = np.sin(0.1), np.cos(0.1)
    # left-handed, y up: down by 0.2 rad, and to the person's left, which is -x there
    down, left = (s, 0.0, 0.0, c), (0.0, -s, 0.0, c)
    for turn, wanted in ((down, [0, -0.2]), (left, [0.2, 0])):

        def bones(eye, head):
            turns = {"Head": head, "LeftEye": eye, "RightEye": eye}
            return build_bundle([build_message("/VMC/Ext/Bone/Pos", k, 0.0, 0.0, 0.0, *q) for k, q in turns.items()])

        straight = np.array([0.0, 0, 0, 1])
        inbox, pose = received("vmc", vmc({"jawOpen": 0.5}), bones(turn, straight))
        # raw bones: the head's axes turned at rest, and the eyes' in them
        head, rest = (quaternion_from_axis_angle(np.array(turned)) for turned in ([0.4, 0, 1.1], [-1.2, 0.3, 0]))
        inbox.feed(bones(rest, head), 2.0)
        assert inbox.calibrate() and np.abs(inbox.sample()[1].face.gaze).max() < 1e-6
        in_head = quaternion_product(quaternion_product(quaternion_inverse(head), np.array(turn)), head)
        inbox.feed(bones(quaternion_product(in_head, rest), head), 2.1)
        assert np.allclose(inbox.sample()[1].face.gaze, [wanted] * 2, atol=1e-6), "the same, whatever its axes"
        assert (
            np.allclose(pose.face.gaze, [wanted] * 2, atol=1e-6) and pose.face.weights[SHAPES.index("jawOpen")] == 0.5
        )
        assert (pose.face.weights[SHAPES.index("eyeLookDownLeft")] > 0.3) == (turn is down)
        assert np.linalg.norm(pose.axis_angle) == 0


def test_after_five_seconds_of_grimaces_every_shape_that_moved_goes_to_one():
    gains, weights = Gains(), np.zeros(52)
    for shape, value in ((6, 0.3), (17, 1.0), (20, 0.01), (30, 0.1)):
        weights[shape] = value
    assert np.array_equal(gains(FaceFrame(weights, np.zeros((2, 2))), 10.0).weights, weights) and gains.left(12.0) == 3
    found = gains(FaceFrame(0.5 * weights, np.full((2, 2), 0.1)), 15.1)
    assert np.allclose(found.weights[[6, 17, 20, 30]], [0.5, 0.5, 0.005, 0.2]) and np.allclose(found.gaze, 0.1)


def test_a_take_keeps_faces_and_one_without_has_none(tmp_path):
    for name, faces in (("a", True), ("b", False)):
        take = Take(tmp_path / f"{name}.npz")
        for n in (0, 1, 2, 4):
            face = FaceFrame(np.full(52, 0.1 * n), np.full((2, 2), 0.02 * n)) if faces and n else None
            take.add(n / 30, Pose(np.zeros((52, 3)), np.zeros(3), face))
        take.finish()
        clip = read_motion(tmp_path / f"{name}.npz").read()
        assert (clip.face is not None) == faces
        if faces:
            assert np.allclose(clip.face[:, 7], [0, 0.1, 0.2, 0.3, 0.4], atol=1e-4)
            assert np.allclose(clip.gaze[:, 1, 0], [0, 0.02, 0.04, 0.06, 0.08], atol=1e-4)
    with np.load(tmp_path / "a.npz") as file:  # what AMASS's tools look for is where it was
        assert file["poses"].shape == (5, 156) and file["face"].shape == (5, 52)
