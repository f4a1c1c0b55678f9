"""A page in headless Chromium, driven by its debugging protocol: open, ask, look, and what it asked the network for.

Chromium is found and chosen as in chromium.py; it draws with its own software rasteriser.
"""

import base64
import json
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.request import ProxyHandler, build_opener

import numpy as np
from chromium import running
from websockets.sync.client import ClientConnection, connect

# seconds after which a browser is no longer slow, on a machine however busy
HANGS = 600


class BrowserPage:
    """One tab."""

    def __init__(self, socket: ClientConnection):
        self.socket, self.number = socket, 0
        # addresses the tab asked for, its own first; and what it wrote to its console as errors
        self.requests: list[str] = []
        self.problems: list[str] = []
        for domain in ("Page", "Network", "Runtime", "Log"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """One command of the protocol; what happens meanwhile is noted."""
        self.number += 1
        self.socket.send(json.dumps({"id": self.number, "method": method, "params": parameters}))
        while True:
            answer = json.loads(self.socket.recv(timeout=HANGS))
            if answer.get("id") == self.number:
                assert "error" not in answer, f"{method}: {answer['error']}"
                return answer["result"]
            self._note(answer)

    def _note(self, event: dict[str, Any]) -> None:
        match event.get("method"):
            case "Network.requestWillBeSent":
                url = event["params"]["request"]["url"]
                # what the page itself holds is asked of nobody
                self.requests += [url] * (not url.startswith("data:"))
            case "Log.entryAdded" if event["params"]["entry"]["level"] == "error":
                self.problems.append(event["params"]["entry"]["text"])
            case "Runtime.exceptionThrown":
                self.problems.append(event["params"]["exceptionDetails"]["exception"].get("description", "thrown"))

    def open(self, path: Path, settings: str = "") -> None:
        """Open a file, its settings after the #, and wait until it is ready or says why it is not."""
        self.requests.clear()
        # a change after the # alone would not load it anew
        self.call("Page.navigate", url="about:blank")
        self.requests.clear()
        self.call("Page.navigate", url=f"{path.as_uri()}{'#' if settings else ''}{settings}")
        self.wait("document.body && (document.body.classList.contains('ready') || failure.textContent)")
        failure = self.ask("document.getElementById('failure').textContent")
        assert not failure, failure

    def wait(self, condition: str) -> None:
        """Until an expression is true."""
        end = time.monotonic() + HANGS
        while not self.ask(f"(() => {{ try {{ return Boolean({condition}) }} catch {{ return false }} }})()"):
            assert time.monotonic() < end, f"not within {HANGS} s: {condition}; {self.problems}"
            time.sleep(0.05)

    def ask(self, expression: str) -> Any:
        """The value of an expression; a promise is awaited."""
        result = self.call("Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True)
        assert "exceptionDetails" not in result, result["exceptionDetails"]
        return result["result"].get("value")

    def bytes(self, expression: str) -> bytes:
        """An array of bytes."""
        text = f"(async () => {{ const b = await ({expression}); let s = ''; for (let i = 0; i < b.length; i += 8192)"
        text += " s += String.fromCharCode(...b.subarray(i, i + 8192)); return btoa(s); })()"
        return base64.b64decode(self.ask(text))

    def size(self, width: int, height: int, *, density: float = 1, mobile: bool = False) -> None:
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=density,
                  mobile=mobile)  # fmt: skip

    def screenshot(self, path: Path | None = None) -> bytes:
        data = base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])
        if path is not None:
            path.write_bytes(data)
        return data

    def frame(self) -> np.ndarray:
        """What a page of `selfscan web` last drew, RGB, row 0 on top."""
        width, height = self.ask("[selfscan.shown.width, selfscan.shown.height]")
        data = self.bytes(f"selfscan.drawing.pixels(selfscan.shown.into, {width}, {height})")
        return np.frombuffer(data, np.uint8).reshape(height, width, 4)[::-1, :, :3].copy()


@contextmanager
def browser_page(profile: Path) -> Iterator[BrowserPage]:
    """A tab of a browser of its own; `profile` is an empty folder for its files."""
    with running(profile, "--disable-background-networking", "about:blank") as (browser, log):
        address = _address(browser, profile, log)
        with connect(address, max_size=None, compression=None, proxy=None) as socket:
            yield BrowserPage(socket)


def _address(browser: subprocess.Popen, profile: Path, log: Path) -> str:
    """Where the first tab listens."""
    place, end = profile / "DevToolsActivePort", time.monotonic() + HANGS
    while not (place.exists() and place.read_text().count("\n")):
        assert browser.poll() is None and time.monotonic() < end, f"Chromium: {log.read_text()[-2000:]}"
        time.sleep(0.05)
    port = int(place.read_text().split()[0])
    # whatever proxy this machine uses, a tab of its own is not behind it
    with build_opener(ProxyHandler({})).open(f"http://127.0.0.1:{port}/json/list", timeout=HANGS) as answer:
        tabs = json.load(answer)
    return next(tab["webSocketDebuggerUrl"] for tab in tabs if tab["type"] == "page")
