"""The OSC parser and builder against python-osc, and against packets that lie."""

import numpy as np
import pytest
from pythonosc.osc_bundle import OscBundle
from pythonosc.osc_bundle_builder import IMMEDIATELY, OscBundleBuilder
from pythonosc.osc_message import OscMessage
from pythonosc.osc_message_builder import OscMessageBuilder

from player.live.osc import LARGEST, MOST_MESSAGES, Message, OscError, build_bundle, build_message, parse_packet


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


def test_messages_of_python_osc_read_as_it_reads_them_itself():
    rng = np.random.default_rng(0)
    for _ in range(300):
        dgram = theirs("/a/b", *random_arguments(rng)).dgram
        reference = OscMessage(dgram)
        assert parse_packet(dgram) == [Message(reference.address, tuple(reference.params))]


def test_nested_bundles_of_python_osc_read_in_order():
    inner = OscBundleBuilder(IMMEDIATELY)
    inner.add_content(theirs("/inner", (1, "i")))
    outer = OscBundleBuilder(IMMEDIATELY)
    for content in (theirs("/first", (0.5, "f")), inner.build(), theirs("/last", ("x", "s"))):
        outer.add_content(content)
    assert parse_packet(outer.build().dgram) == [("/first", (0.5,)), ("/inner", (1,)), ("/last", ("x",))]


def test_python_osc_reads_what_is_built_here():
    rng = np.random.default_rng(1)
    for _ in range(100):
        arguments = [value for value, kind in random_arguments(rng) if kind in "ifs"]
        reference = OscMessage(build_message("/x", *arguments))
        assert (reference.address, list(reference.params)) == ("/x", arguments)
    bundle = OscBundle(build_bundle([build_message("/a", 1), build_message("/b", "two")]))
    assert [list(message.params) for message in bundle] == [[1], ["two"]]


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
    with pytest.raises(OscError):
        parse_packet(LIES[lie])


def test_bundles_nested_too_deep_are_refused():
    packet = build_message("/a", 1)
    for _ in range(8):
        packet = build_bundle([packet])
    assert parse_packet(packet) == [("/a", (1,))]
    with pytest.raises(OscError, match="nested"):
        parse_packet(build_bundle([packet]))
