"""A live session: listens while the block runs, then writes the take that was asked for."""

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager

from avatar.baked_avatar import Avatar
from command.interrupt import deferred_stop
from player.live.command import LiveCommand
from player.live.gains import Gains
from player.live.inbox import Inbox
from player.live.playback import LivePlayback
from player.live.receiver import listen
from player.live.take import Take
from player.scene.address import Address


@contextmanager
def live_session(address: Address, options: LiveCommand, avatars: Sequence[Avatar]) -> Iterator[LivePlayback]:
    """Listen, and give the playback. However the block ends, the take is written, and all is printed.

    Raises:
        AssetError: the address cannot be listened at, or a file cannot be written.
        ValueError: an option out of its range.
    """
    # from here on the other way round: the take is written last
    with ExitStack() as ending:
        take = None
        if options.record:
            take = Take(options.record)
            ending.callback(_write_take, take)
        inbox = Inbox(address.kind, take=take)
        listener = listen(address, inbox)
        ending.callback(listener.close)
        playback = LivePlayback(
            inbox, listener.address, avatars, smooth=options.smooth, calibrate_after=options.calibrate,
            gains=Gains() if options.grimace else None,
        )
        if take is not None:
            take.sender_height = playback.sender_height
        ending.callback(lambda: print("\n".join(playback.summary())))
        ending.callback(inbox.finish)
        print(f"live: {listener.address}", end="")
        print(" (this machine only)" if address.local else ": anyone who reaches this port poses it")
        yield playback


def _write_take(take: Take) -> None:
    # a signal that comes twice, to the process and to its group, ends no writing
    with deferred_stop():
        for line in take.finish():
            print(line)
