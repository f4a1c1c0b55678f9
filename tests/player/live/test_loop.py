"""Out over sockets and in again: stream to receiver, receiver to window, all on this machine."""

import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import ExitStack, suppress
from dataclasses import replace

import numpy as np
import pytest
from pictures import pixels
from pose_twins import angles_between
from refusals import refused
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from avatar.body import builtin_body
from avatar.motion.amass import read_amass
from avatar.motion.read import builtin_motion
from command.errors import AssetError
from player.draw.drawing import Pose
from player.live.command import encoder, send, stream_main, timed_poses
from player.live.inbox import Inbox
from player.live.json_pose import build_pose
from player.live.osc import build_message
from player.live.playback import LivePlayback
from player.live.receiver import listen, udp_socket
from player.play_command import play_main
from player.scene.address import Address, parse_address
from player.scene.framing import pelvis_height


def free_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def test_a_motion_streams_at_another_rate_and_loops():
    motion = builtin_motion("counting")
    poses = list(timed_poses(motion, 2 * motion.rate, loop=False))
    assert len(poses) == 2 * motion.frames - 1
    assert np.allclose(poses[80][1].axis_angle, motion.read(40, 41).axis_angle[0], atol=1e-9)
    looping = timed_poses(motion, motion.rate, loop=True)
    seconds = [next(looping) for _ in range(motion.frames + 3)]
    assert np.array_equal(seconds[motion.frames + 1][1].axis_angle, seconds[1][1].axis_angle)
    assert np.allclose(np.diff([at for at, _ in seconds]), 1 / motion.rate)


def test_a_sender_that_was_stopped_does_not_hurry_through_what_it_missed():
    now, waits = [0.0], []

    def deliver(_data):
        now[0] += 10.0 * (len(waits) == 5 and now[0] < 10)  # suspended once

    def sleep(wait):
        waits.append(wait)
        now[0] += wait

    poses = ((n / 10, Pose(np.zeros((52, 3)), np.zeros(3))) for n in range(30))
    assert send(poses, lambda *_: b"", deliver, clock=lambda: now[0], sleep=sleep) == 30
    assert min(waits) > 0 and len(waits) >= 26 and abs(now[0] - 12.9) < 0.2


@pytest.fixture
def web_socket():
    """An inbox that a web socket fills, and the socket's address."""
    inbox = Inbox("ws")
    listener = listen(Address("ws", "127.0.0.1", 0), inbox)
    yield inbox, f"ws://127.0.0.1:{listener.address.port}"
    listener.close()


def test_web_sockets_take_poses_of_programs_and_of_no_foreign_page(web_socket):
    inbox, url = web_socket
    message = build_pose(Pose(np.full((52, 3), 0.1), np.zeros(3)), time=0.0, sequence=0)
    with connect(url) as sender:
        sender.send(message.decode())
        assert inbox.wait(0, 600)
        sender.send("x" * 20_000)  # larger than a pose: counted
        sender.send("{}")
        sender.send(build_pose(Pose(np.zeros((52, 3)), np.zeros(3)), time=0.1, sequence=1))  # bytes do as well
        assert inbox.wait(1, 600)
        assert (inbox.counters.oversized, inbox.counters.malformed) == (1, 1)
        with pytest.raises(ConnectionClosed):
            sender.send("x" * 200_000)  # much larger: closed
            sender.recv()
    with pytest.raises(InvalidStatus):
        connect(url, origin="https://example.org")
    with connect(url, origin="http://localhost:8000") as page:
        page.send(build_pose(Pose(np.zeros((52, 3)), np.zeros(3)), time=0.2, sequence=2))
        assert inbox.wait(2, 600)


WEB_SOCKETS = """
import resource, socket, sys, time
resource.setrlimit(resource.RLIMIT_NOFILE, (256, 256))
import numpy as np
from websockets.exceptions import WebSocketException
from websockets.sync.client import connect
from player.draw.drawing import Pose
from player.scene.address import Address
from player.live.inbox import Inbox
from player.live.json_pose import build_pose
from player.live.receiver import listen

inbox = Inbox("ws")
listener = listen(Address("ws", "127.0.0.1", 0), inbox)
place = ("127.0.0.1", listener.address.port)
"""
ENDING = """
deadline = time.monotonic() + 600
while inbox.counters.frames == 0 and time.monotonic() < deadline:
    try:
        with connect(f"ws://127.0.0.1:{place[1]}", open_timeout=2) as sender:
            sender.send(build_pose(Pose(np.zeros((52, 3)), np.zeros(3)), time=0.0, sequence=0))
            inbox.wait(0, 2)
    except (OSError, WebSocketException):
        time.sleep(0.2)
assert inbox.counters.frames == 1, inbox.counters
began = time.monotonic()
listener.close()
assert time.monotonic() - began < 300
"""


# at 256 descriptors; each connection takes one here and one there
MET = {
    "connections that say nothing": """
silent = [socket.create_connection(place) for _ in range(110)]
time.sleep(0.5)
assert len(listener.listener.connections) <= 32
""",
    "no descriptor left for the listener's end": """
time.sleep(0.5)
waiting = socket.socket()
kept = []
while True:
    try:
        kept.append(open("/dev/null"))
    except OSError:
        break
waiting.connect(place)
time.sleep(0.5)
assert listener.thread.is_alive()
waiting.close()
for file in kept:
    file.close()
""",
    "two origins, and nonsense": """
both = socket.create_connection(place)
both.sendall(b"GET / HTTP/1.1\\r\\nHost: a\\r\\nUpgrade: websocket\\r\\nConnection: Upgrade\\r\\nSec-WebSocket-Key: "
             b"dGhlIHNhbXBsZSBub25jZQ==\\r\\nSec-WebSocket-Version: 13\\r\\nOrigin: http://localhost\\r\\n"
             b"Origin: http://localhost\\r\\n\\r\\n")
assert both.recv(100).startswith(b"HTTP/1.1 403"), "not refused"
junk = socket.create_connection(place)
junk.sendall(b"nonsense\\r\\n\\r\\n")
junk.recv(100)
""",
}


@pytest.mark.parametrize("case", MET)
def test_a_listener_meets_odd_connections_without_a_word_and_then_takes_a_pose(case):
    done = subprocess.run([sys.executable, "-c", WEB_SOCKETS + MET[case] + ENDING], capture_output=True, text=True)
    assert done.returncode == 0 and done.stderr == "", done.stderr


def closed_one(senders, why):
    """The one of them that is closed so; they were not admitted in the order in which they connected."""
    for one in senders * 3000:
        with suppress(TimeoutError):
            refused(ConnectionClosed, why, one.recv, timeout=0.02)
            return one
    raise AssertionError(f"none is closed: {why}")


def test_silent_senders_give_their_place_to_a_new_one(web_socket, monkeypatch):
    inbox, url = web_socket
    monkeypatch.setattr("player.live.receiver.SILENT", 3600.0)
    with ExitStack() as senders:
        silent = [senders.enter_context(connect(url)) for _ in range(9)]
        silent.remove(closed_one(silent, "too many senders"))
        monkeypatch.setattr("player.live.receiver.SILENT", 0.0)
        sender = senders.enter_context(connect(url))
        sender.send(build_pose(Pose(np.zeros((52, 3)), np.zeros(3)), time=0.0, sequence=0))
        assert inbox.wait(0, 600)
        closed_one(silent, "silent, and others wait")


def test_taken_ports_foreign_hosts_and_a_missing_package_are_one_line(monkeypatch):
    monkeypatch.setitem(sys.modules, "websockets.sync.server", None)
    refused(AssetError, r"pip install -e '\.\[live\]'", lambda: listen(Address("ws", "127.0.0.1", 0), Inbox("ws")))
    listener = listen(Address("vmc", "127.0.0.1", 0), Inbox("vmc"))
    refused(AssetError, "in use by another program", lambda: listen(listener.address, Inbox("vmc")))
    listener.close()
    refused(AssetError, r"192\.0\.2\.1", lambda: listen(Address("vmc", "192.0.2.1", 39539), Inbox("vmc")))


@pytest.mark.slow
def test_addresses_are_of_this_machine_and_stream_sends_the_motion(capsys):
    kinds = ("vmc", "udp", "ws")
    assert parse_address("vmc", kinds) == Address("vmc", "127.0.0.1", 39539)
    assert parse_address("udp:9000", kinds) == Address("udp", "127.0.0.1", 9000)
    assert parse_address("udp::9000", kinds) == Address("udp", "127.0.0.1", 9000)
    assert parse_address("ws:[::1]:9000", kinds) == Address("ws", "::1", 9000)
    named = parse_address("vmc:0.0.0.0:39539", kinds)
    assert named.host == "0.0.0.0" and not named.local and parse_address("vmc:1", kinds).local
    for wrong in ("", "osc:1", "vmc:x", "vmc:70000", "udp:-1", "udp:::1:90", "udp:1.2.3.4:"):
        refused(ValueError, "expected", parse_address, wrong, kinds)
    inbox = Inbox("udp")
    listener = listen(Address("udp", "127.0.0.1", 0), inbox)
    assert stream_main(["counting", "--to", str(listener.address), "--rate", "1000"]) == 0
    listener.close()
    assert "poses sent in" in capsys.readouterr().out and inbox.counters.frames > 0
    for wrong in (["--to", "ws:1"], ["--to", "udp:0"], ["--to", "udp:1", "--rate", "0"], []):
        with pytest.raises(SystemExit):
            stream_main(["counting", *wrong])
    refused(AssetError, "no such file", stream_main, ["absent.npz", "--to", "udp:1"])


# The window -----------------------------------------------------------------------------------------------------


class Sender(threading.Thread):
    """Sends one pose 240 times a second until stopped, with what else is given in between."""

    def __init__(self, kind, pose, others=()):
        super().__init__(daemon=True)
        self.address = Address(kind, "127.0.0.1", free_port())
        self.encode, self.pose = encoder(kind, builtin_body("male")), pose
        self.others, self.stop, self.sent = others, threading.Event(), 0

    def run(self):
        with udp_socket(self.address, listens=False) as connection:
            while not self.stop.wait(1 / 240):
                packets = [self.encode(self.sent, self.sent / 240, self.pose), *self.others]
                for packet in packets:
                    with suppress(ConnectionRefusedError):  # the window is not open yet
                        connection.send(packet)
                self.sent += 1

    def __enter__(self):
        self.start()
        return self

    def __exit__(self, *_):
        self.stop.set()
        self.join()


def play_live(avatar_path, source, path, script, *more):
    arguments = [avatar_path, "--live", str(source), "--platform", "null", "--size", "160x200", "--script", script]
    assert play_main([*arguments, "--screenshot", str(path), *more]) == 0
    return pixels(path)[:170]  # without the line of text


@pytest.mark.usefixtures("osmesa")
@pytest.mark.parametrize("kind", ["vmc", "udp"])
def test_the_window_shows_what_a_sender_sends(kind, avatar_path, tmp_path, capsys):
    clip = builtin_motion("counting").read(40, 41)
    rng = np.random.default_rng(0)
    nonsense = [rng.bytes(200), b"#bundle\0" + bytes(9), b"[" * 500]
    still = play_live(avatar_path, f"{kind}:{free_port()}", tmp_path / "still.png", "wait wait")
    with Sender(kind, Pose(clip.axis_angle[0], clip.root[0]), nonsense) as sender:
        options = ("--record", str(tmp_path / "take.npz"), "--smooth")
        posed = play_live(avatar_path, sender.address, tmp_path / "a.png", "pose " * 12, *options)
    assert (posed != still).any(-1).mean() > 0.02
    expected = play_file(avatar_path, tmp_path, clip)
    assert (np.abs(posed - expected).max(-1) > 1).mean() < 0.002  # float32 on the wire moves a contour pixel
    printed = capsys.readouterr().out
    assert "this machine only" in printed and "received to drawn: p50" in printed
    take = read_amass(tmp_path / "take.npz")
    assert take.frames >= 11 and angles_between(take.read(0, 1).axis_angle, clip.axis_angle).max() < 1e-4


def play_file(avatar_path, tmp_path, clip):
    """The same pose from a file, standing at the origin, drawn by the live window's camera: held by a silent sender."""
    with Sender("udp", Pose(clip.axis_angle[0], clip.root[0] * [0, 1, 0])) as sender:
        return play_live(avatar_path, sender.address, tmp_path / "b.png", "pose pose pose")


PLAYED = """
import sys
from selfscan.__main__ import main
sys.exit(main(["play", *sys.argv[1:]]))
"""


@pytest.mark.slow
@pytest.mark.usefixtures("osmesa")
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_take_outlives_what_ends_the_window(number, code, avatar_path, tmp_path):
    path, recording = tmp_path / "take.npz", tmp_path / "take.npz.recording"
    with Sender("vmc", Pose(np.full((52, 3), 0.1), np.array([0.0, 0.9, 0.0]))) as sender:
        arguments = [avatar_path, "--live", str(sender.address), "--platform", "null", "--size", "160x200"]
        process = subprocess.Popen(
            [sys.executable, "-c", PLAYED, *arguments, "--record", str(path)],
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        )  # fmt: skip
        deadline = time.monotonic() + 600
        while time.monotonic() < deadline and not (recording.exists() and recording.stat().st_size > 30_000):
            time.sleep(0.05)
        process.send_signal(number)
        said, _ = process.communicate(timeout=600)
    assert process.returncode == code, said
    assert "frames at" in said and "Traceback" not in said
    assert not recording.exists()
    take = read_amass(path)
    assert take.frames >= 10 and angles_between(take.read(0, 1).axis_angle, np.full((1, 52, 3), 0.1)).max() < 1e-4


@pytest.mark.slow
@pytest.mark.usefixtures("osmesa")
def test_pause_holds_a_pose_and_t_takes_the_t_pose(avatar_path, tmp_path, capsys):
    turned = np.zeros((52, 3))
    turned[16, 2] = -1.0
    pose = Pose(turned, np.array([5.0, 0.9, 5.0]))
    with Sender("vmc", pose) as sender:
        posed = play_live(avatar_path, sender.address, tmp_path / "a.png", "pose pose space wait wait h wait")
        assert "frames" in capsys.readouterr().out
        # 3 s at the script's 30 frames a second
        calibrated = play_live(avatar_path, sender.address, tmp_path / "b.png", "pose t " + "wait " * 92 + "pose")
        now = play_live(avatar_path, sender.address, tmp_path / "c.png", "pose " * 3, "--calibrate", "0")
    still = play_live(avatar_path, f"vmc:{free_port()}", tmp_path / "d.png", "wait")
    assert (posed != still).any(-1).mean() > 0.02
    for image in (calibrated, now):
        assert (np.abs(image - still).max(-1) > 1).mean() < 0.02


@pytest.mark.parametrize("words", [
    "--record a.npz", "--smooth", "--live vmc:1 --motion walking", "--live x:1",
    "--capture c --live vmc:1", "--motion walking --motion walking", "--at 1,2", "--at 1,2,x", "--at 0,0,0 --at 1,0,0",
])  # fmt: skip
def test_options_of_play_that_do_not_fit_are_refused(avatar_path, words):
    with pytest.raises(SystemExit) as stopped:
        play_main([avatar_path, *words.split()])
    assert stopped.value.code == 2


def playback_of(avatar, inbox, **options):
    now = [100.0]
    live = LivePlayback(inbox, Address("udp", "127.0.0.1", 1), [avatar], clock=lambda: now[0], **options)
    return live, now


def test_the_line_tells_rate_age_loss_and_silence(avatar):
    inbox = Inbox("udp")
    live, now = playback_of(avatar, inbox)
    inbox.feed(b"{}", 99.0)
    assert live.status() == "udp:127.0.0.1:1  waiting for poses, 1 packets are no poses"
    for n in range(60):
        if n != 30:
            inbox.feed(build_pose(Pose(np.zeros((52, 3)), np.zeros(3)), time=n / 60, sequence=n), 100 + n / 60)
    now[0] = 101.0
    live.poses()
    live.drawn()
    assert live.status() == "udp:127.0.0.1:1  59/s  age 17 ms  lost 1  bad 1  p95 17 ms"
    now[0] = 111.0
    assert "SILENT 10 s, last pose held  lost 1" in live.status()


def test_roots_are_scaled_placed_and_lifted(avatar):
    inbox = Inbox("udp")
    live, _ = playback_of(avatar, inbox)
    height = live.heights[0]
    assert live.poses()[0][1][1] == height  # standing until something comes

    def feed(n, root, pelvis_height=None):
        data = build_pose(Pose(np.zeros((52, 3)), np.array(root)), time=n / 60, sequence=n, pelvis_height=pelvis_height)
        inbox.feed(data, 100 + n / 60)
        return live.poses()[0][1]

    assert np.allclose(feed(0, [5.0, 1.8, 7.0], 2 * height), [0, 0.9, 0], atol=1e-5)
    assert np.allclose(feed(1, [6.0, 1.8, 7.0], 2 * height), [0.5, 0.9, 0], atol=1e-5)
    live.calibrate()
    assert np.allclose(feed(2, [6.0, 0.0, 7.0], 2 * height), [0, height, 0], atol=1e-5)  # no height was measured
    child = replace(avatar, levels=(replace(avatar.levels[0], positions=0.6 * avatar.levels[0].positions),))
    live.fit(0, child)
    assert np.allclose(feed(3, [6.0, 0.0, 7.0], 2 * height), [0, pelvis_height(child), 0], atol=1e-5)


def test_a_first_frame_of_vmc_that_has_arrived_in_part_does_not_lift_the_avatar(avatar):
    inbox = Inbox("vmc")
    (early, _), (late, _) = playback_of(avatar, inbox), playback_of(avatar, inbox)
    for n in range(2):
        for bone, y in [("RightFoot", -0.4), ("Hips", 0.95)]:
            inbox.feed(build_message("/VMC/Ext/Bone/Pos", bone, 0.0, y, 0.0, 0.0, 0.0, 0.0, 1.0), 100 + n / 60)
            early.poses()
    assert np.array_equal(early.poses()[0].root, late.poses()[0].root)
