"""Control of a headless Chromium over its DevTools protocol: open a page, click, take screenshots."""

from __future__ import annotations

import base64
import io
import itertools
import json
import re
import shutil
import subprocess
import time
import urllib.request
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from waiting import ENOUGH_S

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
ARGUMENTS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    # WebGL without a GPU.
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    # No host name resolves, so the page can use this computer only.
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
    "--remote-debugging-port=0",
)
Picture = NDArray[np.int16]


class Browser:
    """A browser window with one page."""

    def __init__(self, folder: Path, width: int, height: int) -> None:
        """Starts Chromium; skips the test if Chromium or websockets is not installed."""
        client = pytest.importorskip("websockets.sync.client", reason="websockets comes with viser")
        program = next(filter(None, map(shutil.which, NAMES)), None)
        if program is None:
            pytest.skip(f"no browser is installed: looked for {', '.join(NAMES)}")
        log = (folder / "browser.log").open("w+")
        self._process = subprocess.Popen(
            [program, *ARGUMENTS, f"--user-data-dir={folder / 'profile'}", "about:blank"],
            stdout=subprocess.DEVNULL,
            stderr=log,
        )
        self._numbers = itertools.count(1)
        self._events: list[dict[str, Any]] = []
        try:
            until = time.monotonic() + 90.0
            while not (found := re.search(r"ws://127\.0\.0\.1:(\d+)/", Path(log.name).read_text())):
                if time.monotonic() > until or self._process.poll() is not None:
                    pytest.skip(f"{program} does not start: {Path(log.name).read_text()[-300:]}")
                time.sleep(0.05)
            with urllib.request.urlopen(f"http://127.0.0.1:{found[1]}/json") as answer:
                pages = [page for page in json.load(answer) if page["type"] == "page"]
            # Without pings: Chromium does not answer them in time while it draws on a slow machine.
            address, patient = pages[0]["webSocketDebuggerUrl"], {"open_timeout": ENOUGH_S, "ping_interval": None}
            self._socket = client.connect(address, max_size=None, **patient)
        except BaseException:
            self._process.kill()
            raise
        self.call("Network.enable")
        self.call("Runtime.enable")
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Sends a command of the protocol and returns its result."""
        number = next(self._numbers)
        self._socket.send(json.dumps({"id": number, "method": method, "params": parameters}))
        while True:
            message: dict[str, Any] = json.loads(self._socket.recv(timeout=ENOUGH_S))
            if message.get("id") == number:
                return dict(message.get("result", {}))
            self._events.append(message)

    def open(self, url: str) -> None:
        self.call("Page.navigate", url=url)

    def evaluate(self, expression: str) -> Any:
        """The value of a JavaScript expression in the page."""
        return self.call("Runtime.evaluate", expression=expression, returnByValue=True).get("result", {}).get("value")

    def picture(self) -> Picture:
        """Screenshot, (height, width, 3), 0 to 255."""
        from PIL import Image

        data = base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])
        return np.asarray(Image.open(io.BytesIO(data)).convert("RGB"), dtype=np.int16)

    def click(self, x: float, y: float) -> None:
        for kind in ("mousePressed", "mouseReleased"):
            self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    def place(self, selector: str, text: str = "") -> tuple[float, float, float, float]:
        """Left, top, width, height of the first element of ``selector`` that contains ``text``."""
        found = self.evaluate(
            f"(() => {{ const e = [...document.querySelectorAll({json.dumps(selector)})]"
            f".find(e => e.textContent.includes({json.dumps(text)}));"
            " if (!e) return null; const r = e.getBoundingClientRect(); return [r.x, r.y, r.width, r.height]; })()"
        )
        assert found, f"no {selector} with '{text}' on the page"
        return found[0], found[1], found[2], found[3]

    def until(self, what: str, holds: Callable[[], bool], timeout_s: float = 2.0 * ENOUGH_S) -> None:
        end = time.monotonic() + timeout_s
        while not holds():
            assert time.monotonic() < end, f"waited {timeout_s:g} s for {what}"
            time.sleep(0.1)

    def requested(self) -> list[str]:
        """All addresses that the page requested."""
        self.evaluate("0")
        return [
            event["params"]["request"]["url"]
            for event in self._events
            if event.get("method") == "Network.requestWillBeSent"
        ]

    def errors(self) -> list[str]:
        """Exceptions raised in the page."""
        return [str(event["params"]) for event in self._events if event.get("method") == "Runtime.exceptionThrown"]

    def close(self) -> None:
        self._socket.close()
        self._process.terminate()
        self._process.wait(ENOUGH_S)
