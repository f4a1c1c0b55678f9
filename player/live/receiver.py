"""Threads that receive UDP datagrams or WebSocket messages into an inbox, from this machine unless a host is given."""

import errno
import logging
import socket
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from command.errors import AssetError, missing_package
from player.live.inbox import Inbox
from player.scene.address import Address

LARGEST_MESSAGE = 65536  # bytes; a WebSocket that sends more is closed
MOST_CLIENTS = 8
# connections at once, those whose handshake is not done included
MOST_CONNECTIONS = 32
# seconds for a connection's handshake
HANDSHAKE = 5.0
# seconds; a sender silent for longer gives its place to a new one
SILENT = 5.0
# out of descriptors or memory, or the other side has gone already: nothing that lasts
PASSING = (errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM, errno.ECONNABORTED, errno.EPROTO)
LOCAL_PAGES = ("localhost", "127.0.0.1", "[::1]")


def udp_socket(address: Address, *, listens: bool) -> socket.socket:
    """A UDP socket that listens at an address, or sends there.

    Raises:
        AssetError: there is no such host, or the port is taken.
    """
    try:
        family, kind, proto, _, place = socket.getaddrinfo(address.host, address.port, type=socket.SOCK_DGRAM)[0]
        opened = socket.socket(family, kind, proto)
        try:
            (opened.bind if listens else opened.connect)(place)
        except OSError:
            opened.close()
            raise
    except OSError as error:
        raise AssetError(f"{address}: {_reason(error)}") from None
    return opened


class UdpListener:
    """Reads datagrams until closed. `address` has the port that was really bound."""

    def __init__(self, address: Address, inbox: Inbox):
        self.inbox, self.closing, self.socket = inbox, False, udp_socket(address, listens=True)
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
        self.socket.settimeout(0.1)
        self.address = address._replace(port=self.socket.getsockname()[1])
        self.thread = threading.Thread(target=self._listen, name="live poses", daemon=True)
        self.thread.start()

    def _listen(self) -> None:
        while not self.closing:
            try:
                data = self.socket.recv(65536)
            # nothing came for a while; Windows also reports a sender's closed port here
            except OSError:
                continue
            self.inbox.feed(data, time.monotonic())

    def close(self) -> None:
        self.closing = True
        self.thread.join()
        self.socket.close()


def _reason(error: OSError) -> str:
    if error.errno == errno.EADDRINUSE:
        return "the port is in use by another program"
    return error.strerror or str(error)


class BoundedListener(socket.socket):
    """A listening socket with at most MOST_CONNECTIONS open connections; others are closed, passing errors retried."""

    # open now
    connections: set[socket.socket]

    def accept(self) -> tuple[socket.socket, Any]:
        """The next connection and its address; waits for one."""
        while True:
            try:
                connection, place = super().accept()
            except OSError as error:
                if error.errno not in PASSING:
                    raise
                time.sleep(0.05)
                continue
            if len(self.connections) < MOST_CONNECTIONS:
                self.connections.add(connection)
                return connection, place
            connection.close()


class WebSocketListener:
    """A WebSocket server for pose messages. Pages of other sites are refused: a browser lets them reach us.

    At most MOST_CLIENTS senders are heard; one more takes the place of the one that has been silent for longest.
    """

    def __init__(self, address: Address, inbox: Inbox):
        self.inbox, self.lock = inbox, threading.Lock()
        # time of each sender's last message
        self.last_message: dict[Any, float] = {}
        try:
            from websockets.sync.server import serve
        except ModuleNotFoundError:
            raise missing_package("websockets", "live", "ws:") from None
        try:
            family, kind, proto, _, place = socket.getaddrinfo(address.host, address.port, type=socket.SOCK_STREAM)[0]
            listening = socket.create_server(place[:2], family=family)
        except OSError as error:
            raise AssetError(f"{address}: {_reason(error)}") from None
        self.listener = BoundedListener(family, kind, proto, listening.detach())
        self.listener.connections = set()
        quiet = logging.getLogger("selfscan.live")
        quiet.addHandler(logging.NullHandler())
        quiet.propagate = False
        self.server = serve(
            self._client,
            sock=self.listener,
            max_size=LARGEST_MESSAGE,
            process_request=refuse_foreign_pages,
            compression=None,
            server_header=None,
            open_timeout=HANDSHAKE,
            close_timeout=1,
            logger=quiet,
        )
        self.server.handler = self._with_release(self.server.handler)
        self.address = address._replace(port=self.listener.getsockname()[1])
        self.thread = threading.Thread(target=self.server.serve_forever, name="live poses", daemon=True)
        self.thread.start()

    def _with_release(self, handler: Callable[[socket.socket, Any], None]) -> Callable[[socket.socket, Any], None]:
        """The handler of a connection, which no longer counts once it returns."""

        def handled(connection: socket.socket, place: Any) -> None:
            try:
                handler(connection, place)
            finally:
                self.listener.connections.discard(connection)

        return handled

    def _client(self, connection: Any) -> None:
        from websockets.exceptions import ConnectionClosed

        if not self._admit(connection):
            connection.close(1013, "too many senders")
            return
        try:
            for message in connection:
                self.last_message[connection] = time.monotonic()
                self.inbox.feed(message, self.last_message[connection])
        except ConnectionClosed as error:
            if error.sent is not None and error.sent.code == 1009:
                self.inbox.oversize()
        finally:
            with self.lock:
                self.last_message.pop(connection, None)

    def _admit(self, connection: Any) -> bool:
        """Register a sender; False where all places are taken by senders that are not silent."""
        with self.lock:
            now, leaving = time.monotonic(), None
            if len(self.last_message) >= MOST_CLIENTS:
                leaving = min(self.last_message, key=lambda sender: self.last_message[sender])
                if now - self.last_message[leaving] < SILENT:
                    return False
                del self.last_message[leaving]
            self.last_message[connection] = now
        if leaving is not None:
            leaving.close(1008, "silent, and others wait")
        return True

    def close(self) -> None:
        for connection in list(self.listener.connections):
            with suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)
        self.server.shutdown()
        self.thread.join()


def refuse_foreign_pages(connection: Any, request: Any) -> Any:
    """Programs have no origin; pages must come from this machine."""
    # a list: a request may name several, or none
    origins = request.headers.get_all("Origin")
    if not origins:
        return None
    host = origins[0].partition("://")[2]
    name = host.partition("]")[0] + "]" if host.startswith("[") else host.partition(":")[0]
    allowed = len(origins) == 1 and name in LOCAL_PAGES
    return None if allowed else connection.respond(403, "only pages of this machine\n")


def listen(address: Address, inbox: Inbox) -> UdpListener | WebSocketListener:
    """Start to listen at an address.

    Raises:
        AssetError: the port is taken, the host is not of this machine, or websockets is not installed.
    """
    return (WebSocketListener if address.kind == "ws" else UdpListener)(address, inbox)
