"""The thread that listens: UDP datagrams or WebSocket messages into an inbox. Bound to this machine unless told."""

import errno
import socket
import struct
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

from avatar.errors import AssetError
from player.address import Address
from player.live.inbox import Inbox

# Linux: the kernel's time of arrival comes with the datagram
SO_TIMESTAMPNS = 35
STAMP = struct.Struct("@qq")
LARGEST_MESSAGE = 65536  # bytes; a WebSocket that sends more is closed
MOST_CLIENTS = 8
LOCAL_PAGES = ("localhost", "127.0.0.1", "[::1]")


class UdpListener:
    """Reads datagrams until closed. `address` has the port that was really bound."""

    def __init__(self, address: Address, inbox: Inbox):
        self.inbox, self.closing = inbox, False
        try:
            family, kind, proto, _, place = socket.getaddrinfo(address.host, address.port, type=socket.SOCK_DGRAM)[0]
            self.socket = socket.socket(family, kind, proto)
        except OSError as error:
            raise AssetError(f"{address}: {error.strerror or error}") from None
        try:
            self.socket.bind(place)
        except OSError as error:
            self.socket.close()
            raise AssetError(f"{address}: {_reason(error)}") from None
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
        self.stamped = sys.platform == "linux" and self._ask_for_stamps()
        self.socket.settimeout(0.1)
        self.address = address._replace(port=self.socket.getsockname()[1])
        self.thread = threading.Thread(target=self._listen, name="live poses", daemon=True)
        self.thread.start()

    def _ask_for_stamps(self) -> bool:
        try:
            self.socket.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        except OSError:
            return False
        return True

    def _listen(self) -> None:
        while not self.closing:
            try:
                if self.stamped:
                    data, ancillary, _, _ = self.socket.recvmsg(65536, 64)
                    received = arrival(ancillary)
                else:
                    data = self.socket.recv(65536)
                    received = time.monotonic()
            except TimeoutError:
                continue
            except OSError:
                if self.closing:
                    return
                continue  # Windows reports a sender's closed port here
            self.inbox.feed(data, received)

    def close(self) -> None:
        self.closing = True
        self.thread.join()
        self.socket.close()


def arrival(ancillary: list) -> float:
    """Monotonic seconds of a datagram's arrival, from the kernel's stamp where it has a plausible one."""
    now = time.monotonic()
    for level, kind, data in ancillary:
        if level == socket.SOL_SOCKET and kind == SO_TIMESTAMPNS and len(data) == STAMP.size:
            seconds, nanoseconds = STAMP.unpack(data)
            waited = time.time() - (seconds + 1e-9 * nanoseconds)
            # else the wall clock was set meanwhile
            if 0 <= waited < 1:
                return now - waited
    return now


def _reason(error: OSError) -> str:
    if error.errno == errno.EADDRINUSE:
        return "the port is in use by another program"
    return error.strerror or str(error)


class WebSocketListener:
    """A WebSocket server for pose messages. Pages of other sites are refused: a browser lets them reach us."""

    def __init__(self, address: Address, inbox: Inbox):
        self.inbox, self.clients = inbox, threading.Semaphore(MOST_CLIENTS)
        serve = _websocket_server()
        try:
            self.server = serve(
                self._client,
                address.host,
                address.port,
                max_size=LARGEST_MESSAGE,
                process_request=refuse_foreign_pages,
                compression=None,
                server_header=None,
            )
        except OSError as error:
            raise AssetError(f"{address}: {_reason(error)}") from None
        self.address = address._replace(port=self.server.socket.getsockname()[1])
        self.open: set[Any] = set()
        self.thread = threading.Thread(target=self.server.serve_forever, name="live poses", daemon=True)
        self.thread.start()

    def _client(self, connection: Any) -> None:
        from websockets.exceptions import ConnectionClosed

        if not self.clients.acquire(blocking=False):
            connection.close(1013, "too many senders")
            return
        self.open.add(connection)
        try:
            for message in connection:
                self.inbox.feed(message, time.monotonic())
        except ConnectionClosed as error:
            if error.sent is not None and error.sent.code == 1009:
                self.inbox.oversize()
        finally:
            self.open.discard(connection)
            self.clients.release()

    def close(self) -> None:
        for connection in list(self.open):
            connection.close()
        self.server.shutdown()
        self.thread.join()


def _websocket_server() -> Callable[..., Any]:
    try:
        from websockets.sync.server import serve
    except ModuleNotFoundError:
        raise AssetError("ws: needs the package 'websockets': pip install 'selfscan[live]'") from None
    return serve


def refuse_foreign_pages(connection: Any, request: Any) -> Any:
    """Programs have no origin; pages must come from this machine."""
    origin = request.headers.get("Origin")
    if origin in (None, "null"):
        return None if origin is None else connection.respond(403, "only pages of this machine\n")
    host = origin.partition("://")[2]
    name = host.partition("]")[0] + "]" if host.startswith("[") else host.partition(":")[0]
    return None if name in LOCAL_PAGES else connection.respond(403, "only pages of this machine\n")


def listen(address: Address, inbox: Inbox) -> UdpListener | WebSocketListener:
    """Start to listen at an address.

    Raises:
        AssetError: the port is taken, the host is not of this machine, or websockets is not installed.
    """
    return (WebSocketListener if address.kind == "ws" else UdpListener)(address, inbox)
