"""VMC and OSC against python-osc, and against packets that lie."""

import numpy as np
import pytest
from pythonosc.osc_bundle import OscBundle
from pythonosc.osc_bundle_builder import IMMEDIATELY, OscBundleBuilder
from pythonosc.osc_message import OscMessage
from pythonosc.osc_message_builder import OscMessageBuilder

from avatar.rotation import matrix_from_axis_angle
from avatar.skeleton import JOINTS
from player.draw.drawing import Pose
from player.live.calibration import NORMALISED, pose_from_rig
from player.live.frame import Counters, MalformedError
from player.live.osc import LARGEST, MOST_MESSAGES, Message, build_bundle, build_message, parse_packet
from player.live.vmc import BONES, VmcDecoder, VmcEncoder, leg_length, rig_from_state
from player.scene.mannequin import builtin_body

BODY = builtin_body("male")


def bone(name, position=(0, 0, 0), rotation=(0, 0, 0, 1)):
    return build_message("/VMC/Ext/Bone/Pos", name, *map(float, (*position, *rotation)))


def decoded(*packets):
    decoder, counters = VmcDecoder(), Counters()
    arrival = None
    for packet in packets:
        arrival = decoder.decode(packet, 0.0, counters) or arrival
    return arrival, counters


def pose_of(*packets):
    return pose_from_rig(rig_from_state(decoded(*packets)[0].content), NORMALISED)


def random_pose(seed=0, scale=0.8):
    rng = np.random.default_rng(seed)
    return scale * rng.normal(size=(52, 3)), rng.normal(size=3)


def test_every_joint_has_its_bone_absent_ones_rest_and_unknown_ones_do_nothing():
    pairs = dict(zip(JOINTS, BONES, strict=True))
    assert len(set(BONES)) == 52
    assert pairs["pelvis"] == "Hips" and pairs["spine3"] == "UpperChest" and pairs["left_collar"] == "LeftShoulder"
    assert pairs["left_pinky1"] == "LeftLittleProximal" and pairs["right_ring3"] == "RightRingDistal"
    assert pairs["left_thumb2"] == "LeftThumbIntermediate" and pairs["right_wrist"] == "RightHand"
    names = ("Spine", "LeftEye", "Jaw", "LastBone", "Nonsense")
    pose = pose_of(build_bundle([bone(name, rotation=(1, 0, 0, 0)) for name in names]))
    assert np.flatnonzero(np.linalg.norm(pose.axis_angle, axis=1)).tolist() == [JOINTS.index("spine1")]


def test_the_arm_rises_the_root_moves_the_pelvis_and_the_leg_is_measured():
    # Unity, facing +z, left hand at -x: a turn of -90 degrees about +z lifts it (left-handed)
    s = np.sqrt(0.5)
    pose = pose_of(bone("LeftUpperArm", rotation=(0, 0, -s, s)))
    hand = matrix_from_axis_angle(pose.axis_angle[16]) @ [1.0, 0, 0]  # +x is our left
    assert np.allclose(hand, [0, 1, 0], atol=1e-6)
    forward = pose_of(bone("Hips", position=(1, 2, 3)))
    assert np.allclose(forward.root, [-1, 2, 3])
    root = build_message("/VMC/Ext/Root/Pos", "root", 1.0, 0.0, 0.0, 0.0, s, 0.0, s)  # +90 degrees about y, Unity
    pose = pose_of(build_bundle([root, bone("Hips", position=(0, 1, 2))]))
    # ours: -90 degrees about y takes +z to -x
    assert np.allclose(pose.root, [-1 - 2, 1, 0], atol=1e-6)
    assert np.allclose(pose.axis_angle[0], [0, -np.pi / 2, 0], atol=1e-6)
    packet = VmcEncoder(BODY.joints).encode(Pose(*random_pose()), 0.0)
    leg = rig_from_state(decoded(packet)[0].content).leg
    assert abs(leg - (-BODY.joints[[7, 8], 1].mean())) < 0.03 * leg  # legs of the rest pose are almost straight
    assert leg_length(np.zeros((52, 3))) is None


@pytest.mark.parametrize("side, first", [("left", 34), ("right", 49)])
def test_both_spellings_of_thumbs_and_camel_case_are_read(side, first):
    turns = [(np.sin(a), 0, 0, np.cos(a)) for a in (0.1, 0.2, 0.3)]
    angles = [pose_of(build_bundle([bone(side + part, rotation=turn) for part, turn in zip(names, turns, strict=True)]))
              for names in (("ThumbProximal", "ThumbIntermediate", "ThumbDistal"),
                            ("ThumbMetacarpal", "ThumbProximal", "ThumbDistal"))]  # fmt: skip
    for pose in angles:
        assert np.allclose(np.linalg.norm(pose.axis_angle[first : first + 3], axis=1), [0.2, 0.4, 0.6], atol=1e-6)
    assert np.array_equal(
        pose_of(bone("leftUpperLeg", rotation=turns[0])).axis_angle,
        pose_of(bone("LeftUpperLeg", rotation=turns[0])).axis_angle,
    )


@pytest.mark.parametrize("numbers", [[np.nan] * 7, [np.inf] + [0.0] * 5 + [1.0], [0.0] * 7, [0.0] * 6, [1e30] * 7])
def test_a_bone_with_impossible_numbers_is_counted_and_the_rest_used(numbers):
    bad = build_message("/VMC/Ext/Bone/Pos", "Head", *numbers)
    arrival, counters = decoded(build_bundle([bad, bone("Neck", rotation=(1, 0, 0, 0))]))
    assert counters.malformed == 1 and set(arrival.content.bones) == {"neck"}
    assert decoded(build_message("/VMC/Ext/Bone/Pos", "Head"))[1].malformed == 1


def test_datagrams_of_one_frame_belong_together_and_a_repeated_bone_begins_the_next():
    decoder, counters = VmcDecoder(), Counters()
    first = build_bundle(
        [build_message("/VMC/Ext/T", 1.0), build_message("/VMC/Ext/Root/Pos", "root", *[0.0] * 6, 1.0), bone("Hips")]
    )
    begins = [decoder.decode(first, 0.0, counters), decoder.decode(build_bundle([bone("Head")]), 0.0, counters)]
    second = build_bundle([build_message("/VMC/Ext/T", 1.5), bone("Hips", position=(0, 1, 0))])
    begins.append(decoder.decode(second, 0.0, counters))
    assert [a.begins for a in begins] == [True, False, True] and [a.sent for a in begins] == [1.0, 1.0, 1.5]
    assert "head" in begins[2].content.bones  # held until it is sent again
    assert decoder.decode(build_message("/VMC/Ext/Blend/Apply"), 0.0, counters) is None and counters == Counters()


def test_a_late_clock_belongs_to_its_bones_and_lost_tracking_is_said():
    decoder, counters = VmcDecoder(), Counters()
    for seconds in (1.0, 2.0, 3.0):
        packet = build_bundle([bone("Hips", position=(seconds, 0, 0)), build_message("/VMC/Ext/T", seconds)])
        assert decoder.decode(packet, 0.0, counters).sent == seconds
    decoder = VmcDecoder()
    for arguments, tracking in (((1,), True), ((0,), False), ((1, 3, 0, 0), False), ((1, 3, 0, 1), True)):
        decoder.decode(build_message("/VMC/Ext/OK", *arguments), 0.0, Counters())
        assert decoder.tracking is tracking


def theirs(address, *arguments):
    builder = OscMessageBuilder(address)
    for value, kind in arguments:
        builder.add_arg(value, kind)
    return builder.build()


def random_arguments(rng):
    makers = {
        "i": lambda: int(rng.integers(-(2**31), 2**31)),
        "f": lambda: float(np.float32(rng.normal())),
        "s": lambda: "".join(rng.choice(list("abcäß漢"), rng.integers(0, 9))),
        "d": lambda: float(rng.normal()),
        "h": lambda: int(rng.integers(-(2**62), 2**62)),
    }
    kinds = [*rng.choice(["s", ""], 1), *rng.choice(list("ifdh"), rng.integers(0, 7))]
    return [(makers[kind](), str(kind)) for kind in kinds if kind]


def test_python_osc_and_we_read_what_the_other_writes_to_a_depth():
    rng = np.random.default_rng(0)
    for _ in range(300):
        dgram = theirs("/a/b", *random_arguments(rng)).dgram
        reference = OscMessage(dgram)
        assert parse_packet(dgram) == [Message(reference.address, tuple(reference.params))]
    inner = OscBundleBuilder(IMMEDIATELY)
    inner.add_content(theirs("/inner", (1, "i")))
    outer = OscBundleBuilder(IMMEDIATELY)
    for content in (theirs("/first", (0.5, "f")), inner.build(), theirs("/last", ("x", "s"))):
        outer.add_content(content)
    assert parse_packet(outer.build().dgram) == [("/first", (0.5,)), ("/inner", (1,)), ("/last", ("x",))]
    rng = np.random.default_rng(1)
    for _ in range(100):
        arguments = [value for value, kind in random_arguments(rng) if kind in "ifs"]
        reference = OscMessage(build_message("/x", *arguments))
        assert (reference.address, list(reference.params)) == ("/x", arguments)
    bundle = OscBundle(build_bundle([build_message("/a", 1), build_message("/b", "two")]))
    assert [list(message.params) for message in bundle] == [[1], ["two"]]
    packet = build_message("/a", 1)
    for _ in range(8):
        packet = build_bundle([packet])
    assert parse_packet(packet) == [("/a", (1,))]
    with pytest.raises(MalformedError, match="nested"):
        parse_packet(build_bundle([packet]))


@pytest.mark.parametrize("letters", [b",q\0\0", b",[i]", b",b\0\0", b",is\0", b",TFN", b"," + b"[" * 99])
def test_arguments_that_vmc_does_not_send_drop_their_message_only(letters):
    other = b"/a\0\0" + letters + bytes(4 - len(letters) % 4) + bytes(8)
    assert parse_packet(build_bundle([other, build_message("/b", 2)])) == [("/b", (2,))]
    assert parse_packet(b"/a\0\0") == [("/a", ())]  # a sender of before 1.0


LIES = {
    "empty": b"",
    "not a multiple of four": b"/a\0",
    "no address": b"abc\0,i\0\0" + bytes(4),
    "no type letters": b"/a\0\0" + b"i\0\0\0" + bytes(4),
    "an address that does not end": b"/abc",
    "types that do not end": b"/a\0\0,iii",
    "arguments cut short": b"/a\0\0,ff\0" + bytes(4),
    "a string that does not end": b"/a\0\0,s\0\0abcd",
    "not UTF-8": b"/\xff\0\0,\0\0\0",
    "an element beyond the end": b"#bundle\0" + bytes(8) + b"\x7f\xff\xff\xff" + bytes(4),
    "an element of size zero": b"#bundle\0" + bytes(8) + bytes(4),
    "half a bundle": b"#bundle\0",
    "too large": b"/a\0\0,\0\0\0" + bytes(LARGEST),
    "too many messages": build_bundle([build_message("/a")] * (MOST_MESSAGES + 1)),
}


@pytest.mark.parametrize("lie", LIES)
def test_what_is_no_packet_is_refused(lie):
    with pytest.raises(MalformedError):
        parse_packet(LIES[lie])


def test_a_bundle_whose_last_number_is_cut_off_is_refused_by_its_element():
    with pytest.raises(MalformedError, match="an element of 12 bytes in a bundle with 8 left"):
        parse_packet(build_bundle([build_message("/a", 1.5)])[:-4])
