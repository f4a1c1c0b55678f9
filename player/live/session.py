"""A live session from start to end: listens while the block runs, then writes what was asked for."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from avatar.baked_avatar import Avatar
from player.address import Address
from player.live.inbox import Inbox
from player.live.latency import Latency
from player.live.playback import LivePlayback
from player.live.receiver import listen
from player.live.take import Take


@dataclass(frozen=True)
class LiveOptions:
    address: Address
    smooth: float | None = None  # cut-off at rest, Hz
    buffer: float | None = None  # seconds; None: the newest pose
    record: str | None = None  # AMASS file
    latency: str | None = None  # CSV file
    calibrate_after: float | None = None  # seconds from the first pose


@contextmanager
def live_session(
    options: LiveOptions, avatars: Sequence[Avatar], beside: Sequence[Float[np.ndarray, "3"]]
) -> Iterator[LivePlayback]:
    """Listen, and give the playback. At the end the take and the stamps are written, and all is printed.

    Raises:
        AssetError: the address cannot be listened at, or a file cannot be written.
        ValueError: an option out of its range.
    """
    take = Take() if options.record else None
    inbox = Inbox(options.address.kind, delay=options.buffer, take=take)
    latency = Latency(options.latency)
    try:
        listener = listen(options.address, inbox)
        try:
            playback = LivePlayback(
                inbox,
                listener.address,
                avatars,
                beside,
                smooth=options.smooth,
                latency=latency,
                calibrate_after=options.calibrate_after,
            )
            print(f"live: {listener.address}", end="")
            print(" (this machine only)" if options.address.local else ": anyone who reaches this port poses it")
            yield playback
        finally:
            listener.close()
            inbox.finish()
    finally:
        latency.close()
    for line in playback.summary():
        print(line)
    if options.latency:
        print(f"{options.latency} written")
    if take is not None and options.record:
        if not take.times:
            print("no pose came: no take written")
        else:
            clip = take.write(options.record, playback.sender_height())
            for note in clip.notes:
                print(note)
            print(f"{options.record}: {len(clip.root)} frames at {clip.rate:g} a second")
