"""`selfscan stream`: a motion goes out as live poses; and the live options of `selfscan play`."""

import argparse
import itertools
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from avatar.body import Body, builtin_body, read_body
from avatar.hull import body_hull
from avatar.motion.clip import Clip, Motion, builtin_skeleton, fitted
from avatar.motion.ground import on_ground
from avatar.motion.read import read_motion
from command.command_line import Help, Option, parse
from command.errors import AssetError
from command.settings import AtLeast, AtMost
from player.draw.drawing import Pose
from player.live import json_pose
from player.live.one_euro import LEAST
from player.live.receiver import udp_socket
from player.live.vmc import VmcEncoder
from player.scene.address import PORTS, Address, parse_address
from player.scene.arguments import LIVE
from player.scene.track import Track

FASTEST = 1000.0  # frames a second
# seconds; a sender that was stopped for longer goes on from now instead of hurrying
CATCH_UP = 1.0

EXAMPLES = """examples
  selfscan stream counting --to udp:127.0.0.1:39550          (beside: selfscan play me.glb --live udp:39550)
  selfscan stream walk.npz --to vmc:192.168.1.20:39539 --loop
  selfscan stream take.npz --to vmc:127.0.0.1:39540 --rate 30"""


def source(text: str) -> Address:
    return _address(text, tuple(PORTS))


def target(text: str) -> Address:
    address = _address(text, ("vmc", "udp"))
    if address.port == 0:
        raise argparse.ArgumentTypeError(f"expected a port from 1 to 65535, found {text!r}")
    return address


def _address(text: str, kinds: tuple[str, ...]) -> Address:
    try:
        return parse_address(text, kinds)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


@dataclass(frozen=True)
class LiveCommand:
    live: Annotated[Address | None, LIVE, Option(metavar="vmc:PORT|udp:PORT|ws:PORT|...", parse=source),
        "pose by what arrives: VMC (usual port 39539), our JSON over UDP or WebSocket, or a face alone: ifacialmocap, "
        "livelinkface, openseeface; this machine only, unless HOST:PORT names another interface (0.0.0.0: all)"] = None
    smooth: Annotated[float | None, LIVE.rare, AtLeast(0.01), AtMost(1000), Option(metavar="HZ", const=LEAST),
        f"One-Euro smoothing; cut-off at rest, lower is steadier (default {LEAST:g})"] = None
    calibrate: Annotated[float | None, LIVE.rare, AtLeast(0), AtMost(3600), Option(metavar="S"),
        "S seconds after the first pose, take the pose of then for the T-pose (key t does it too)"] = None
    grimace: Annotated[bool, LIVE.rare,
        "from the first face on pull faces for 5 seconds: each shape then goes from 0 to 1"] = False
    record: Annotated[str | None, LIVE.rare, Option(metavar="FILE.npz"),
        "write what came as an AMASS pose file at the end"] = None


@dataclass(frozen=True)
class StreamCommand:
    motion: Annotated[str, Option(positional=True, metavar="MOTION"), "pose file (.npz, .bvh), or: counting, walking"]
    to: Annotated[Address, Option(metavar="vmc:HOST:PORT|udp:HOST:PORT", parse=target),
        "VMC or our JSON; HOST may be left out: this machine"]
    rate: Annotated[float | None, AtLeast(0.1), AtMost(FASTEST), Option(metavar="R"),
        "poses a second (default: the motion's)"] = None
    loop: Annotated[bool, "start over at the end, until stopped"] = False
    body: Annotated[str | None, Option(metavar="MODEL"), "SMPL+H model (.npz) that the pose file was made for"] = None


SENDS = "Send a motion as live poses: to `selfscan play --live`, or to any program that takes VMC."
STREAM = Help("selfscan stream", SENDS, EXAMPLES)


def stream_main(argv: list[str]) -> int:
    """Send a motion as live poses."""
    options = parse(StreamCommand, argv, STREAM)
    motion = read_motion(options.motion, body=read_body(options.body) if options.body else None)
    motion = on_ground(fitted(motion, builtin_skeleton().pelvis_height), body_hull(builtin_body("male")))
    for note in motion.notes:
        print(note)
    encode = encoder(options.to.kind, builtin_body("male"))
    poses = timed_poses(motion, options.rate or motion.rate, loop=options.loop)
    began = time.monotonic()
    with udp_socket(options.to, listens=False) as connection:
        print(f"{motion.name} to {options.to}, {options.rate or motion.rate:g} poses a second")
        try:
            sent = send(poses, encode, lambda data: deliver(connection, data))
        except OSError as error:
            raise AssetError(f"{options.to}: {error.strerror or error}") from None
    print(f"{sent} poses sent in {time.monotonic() - began:.1f} s")
    return 0


def deliver(connection: socket.socket, data: bytes) -> None:
    """Send; that no one listens (yet) is no error."""
    with suppress(ConnectionRefusedError):
        connection.send(data)


Encode = Callable[[int, float, Pose], bytes]  # number, seconds since the start, pose


def encoder(kind: str, body: Body, wall: Callable[[], float] = time.time) -> Encode:
    """Poses to datagrams, with the root fitted to the body whose bones are sent; JSON carries the `wall` time."""
    height = -float(body.vertices[:, 1].min())
    if kind == "vmc":
        vmc = VmcEncoder(body.joints.astype(np.float64))
        return lambda _number, seconds, pose: vmc.encode(pose, seconds)
    return lambda number, _seconds, pose: json_pose.build_pose(
        pose, time=wall(), sequence=number, sender="selfscan", pelvis_height=height
    )


def timed_poses(motion: Motion | Clip, rate: float | int, *, loop: bool) -> Iterator[tuple[float, Pose]]:
    """The motion at a rate: seconds since the start, and the pose then, between frames on the shorter arc. The last
    pose is the last that is not after the motion's last frame; looping, the first frame follows one step after it."""
    count = int(np.floor((motion.frames - 1) / motion.rate * rate * (1 + 1e-12))) + 1
    track = Track(motion)
    for index in itertools.count() if loop else range(count):
        at = min(index % count * (motion.rate / rate), motion.frames - 1)
        frame = int(at + 1e-9)
        part = at - frame
        yield index / rate, track.pose_beside(frame / motion.rate, part / motion.rate if part >= 1e-6 else 0.0)


def send(
    poses: Iterator[tuple[float, Pose]],
    encode: Encode,
    deliver: Callable[[bytes], object],
    *,
    clock: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], object] = time.sleep,
) -> int:
    """Send each pose at its time; how many were sent. Late by a little it hurries, by more it goes on from now."""
    began, sent = clock(), 0
    for seconds, pose in poses:
        wait = began + seconds - clock()
        if wait > 0:
            sleep(wait)
        elif wait < -CATCH_UP:
            began -= wait
        deliver(encode(sent, seconds, pose))
        sent += 1
    return sent
