"""A live sender in a process of its own: 55-bone VMC at a steady rate, with spoilt packets between when asked.

python -m experiments.live_sender PORT RATE FUZZ SECONDS
"""

import socket
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from avatar.body import builtin_body
from avatar.motion.read import builtin_motion
from player.live.command import encoder, timed_poses
from player.live.osc import build_message

CLOCK = b"/VMC/Ext/T\0\0,f\0\0"  # what comes before the sender's time
EXTRA = ("LeftEye", "RightEye", "Jaw")  # with our 52 they are Unity's 55


def bundle_of_55(bundle: bytes) -> bytes:
    """A bundle of the 52 joints with the three bones that Unity has besides."""
    for name in EXTRA:
        message = build_message("/VMC/Ext/Bone/Pos", name, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
        bundle += len(message).to_bytes(4, "big") + message
    return bundle


def spoilt(rng: np.random.Generator, bundle: bytes) -> bytes:
    """A packet that no sender would send: noise, a bundle cut short, or one with bytes changed in its structure."""
    kind = rng.integers(3)
    if kind == 0:
        return rng.bytes(int(rng.integers(1, 200)))
    if kind == 1:
        # not a multiple of four
        return bundle[: int(rng.integers(1, len(bundle) - 1)) // 4 * 4 + 3]
    broken = bytearray(bundle)
    broken[16:20] = rng.bytes(3) + b"\x01"  # the first element's length
    return bytes(broken)


def main(port: int, rate: float, fuzz: float, seconds: float) -> None:
    encode = encoder("vmc", builtin_body("male"))
    rng = np.random.default_rng(0)
    motion = timed_poses(builtin_motion("counting"), rate, loop=True)
    poses = [bytearray(bundle_of_55(encode(n, 0.0, pose))) for n, (_, pose) in zip(range(480), motion, strict=False)]
    clock = poses[0].index(CLOCK) + len(CLOCK)
    trash = [spoilt(rng, bytes(poses[0])) for _ in range(500)]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        out.connect(("127.0.0.1", port))
        begun = time.monotonic()
        sent = thrown = 0
        while (now := time.monotonic() - begun) < seconds:
            try:
                while sent <= now * rate:
                    bundle = poses[sent % len(poses)]
                    struct.pack_into(">f", bundle, clock, sent / rate)
                    out.send(bundle)
                    sent += 1
                while thrown < now * fuzz:
                    out.send(trash[thrown % len(trash)])
                    thrown += 1
            except ConnectionRefusedError:
                # no one listens any more, or not yet
                pass
            time.sleep(min(1e-3, max(0.0, sent / rate - (time.monotonic() - begun))))


@contextmanager
def sending(port: int, *, rate: float | int, fuzz: float | int = 0.0, seconds: float | int = 120.0) -> Iterator[None]:
    """A sender runs beside the block."""
    command = [sys.executable, "-m", "experiments.live_sender", *map(str, (port, rate, fuzz, seconds))]
    process = subprocess.Popen(command)
    try:
        yield
    finally:
        process.terminate()
        process.wait()


if __name__ == "__main__":
    main(int(sys.argv[1]), *map(float, sys.argv[2:5]))
