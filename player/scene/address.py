"""Where live poses come from or go to: vmc:PORT, udp:PORT, ws:PORT ..., with HOST: before the port to name one."""

import ipaddress
from typing import NamedTuple

LOCAL = "127.0.0.1"
# kinds of senders that are heard, and their ports where nothing else is said; ours are udp and ws
PORTS = {"vmc": 39539, "udp": 39550, "ws": 39551, "ifacialmocap": 49983, "livelinkface": 11111, "openseeface": 11573}
# those that send faces alone: beside them a motion moves the body
FACE_SENDERS = ("ifacialmocap", "livelinkface", "openseeface")


class Address(NamedTuple):
    kind: str  # one of PORTS
    host: str
    port: int  # 0: any free one

    def __str__(self) -> str:
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{self.kind}:{host}:{self.port}"

    @property
    def local(self) -> bool:
        """Whether only this machine can reach it."""
        if self.host == "localhost":
            return True
        try:
            return ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return False


def parse_address(text: str, kinds: tuple[str, ...]) -> Address:
    """An address as a command takes it: KIND, KIND:PORT, KIND:HOST:PORT or KIND:[IPV6]:PORT.

    Raises:
        ValueError: not such a text.
    """
    kind, _, rest = text.partition(":")
    host, _, port = rest.rpartition(":")
    if kind not in kinds:
        raise ValueError(f"expected one of {', '.join(f'{k}:PORT' for k in kinds)}, found {text!r}")
    if not rest:
        return Address(kind, LOCAL, PORTS[kind])
    if not (port.isascii() and port.isdigit() and int(port) <= 65535):
        raise ValueError(f"expected a port from 0 to 65535 at the end of {text!r}")
    if (host.startswith("[") and host.endswith("]")) or ":" not in host:
        return Address(kind, host.strip("[]") or LOCAL, int(port))
    raise ValueError(f"expected an IPv6 host in brackets, found {text!r}")
