"""A headless Chromium, spoken to over a pipe in the DevTools protocol: no driver is needed."""

from __future__ import annotations

import base64
import json
import os
import select
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
FLAGS = [
    *("--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--disable-dev-shm-usage"),
    *("--no-first-run", "--disable-background-networking", "--disable-component-update"),
    *("--disable-sync", "--hide-scrollbars", "--remote-debugging-pipe"),
]
# the browser reads from descriptor 3 and writes to 4, whichever our ends are called
_LAUNCH = (
    "import fcntl, os, sys\n"
    "ends = [fcntl.fcntl(int(number), fcntl.F_DUPFD, 10) for number in sys.argv[1:3]]\n"
    "os.dup2(ends[0], 3)\n"
    "os.dup2(ends[1], 4)\n"
    "os.execvp(sys.argv[3], sys.argv[3:])\n"
)
Json = dict[str, Any]
_PATIENCE_S = 300.0  # of a machine that has other things to do: a test must not hang for ever


class BrowserGoneError(Exception):
    """The browser ended, or does not answer."""


def installed() -> str | None:
    return next((path for name in NAMES if (path := shutil.which(name))), None)


class Browser:
    """One page of a headless Chromium; `errors` are what its console complained of."""

    def __init__(self, program: str) -> None:
        self.errors: list[str] = []
        self._number, self._waiting, self._loaded = 0, b"", False
        self._session: str | None = None
        self._profile = Path(tempfile.mkdtemp(prefix="specmap-browser-"))
        theirs_in, self._out = os.pipe()
        self._in, theirs_out = os.pipe()
        self._process = subprocess.Popen(
            [
                *(sys.executable, "-c", _LAUNCH, str(theirs_in), str(theirs_out)),
                *(program, *FLAGS, f"--user-data-dir={self._profile}", "about:blank"),
            ],
            pass_fds=(theirs_in, theirs_out),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(theirs_in)
        os.close(theirs_out)
        try:
            target = self._send("Target.createTarget", {"url": "about:blank"})["targetId"]
            attached = self._send("Target.attachToTarget", {"targetId": target, "flatten": True})
            self._session = attached["sessionId"]
            for domain in ("Page", "Runtime", "Log", "Network"):
                self._send(f"{domain}.enable")
        except (BrowserGoneError, BrokenPipeError) as error:
            self.__exit__()
            raise BrowserGoneError(f"{program} does not start here") from error

    def __enter__(self) -> Browser:
        return self

    def __exit__(self, *_: object) -> None:
        """End the browser; nothing of it stays."""
        self._process.terminate()
        try:
            self._process.wait(30)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        os.close(self._in)
        os.close(self._out)
        shutil.rmtree(self._profile, ignore_errors=True)

    def size(self, width: int, height: int, *, phone: bool = False) -> None:
        """Make the window so large; a phone has a touch screen."""
        sizes = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": phone}
        self._send("Emulation.setDeviceMetricsOverride", sizes)

    def prefers(self, **features: str) -> None:
        """Media features of the reader: `prefers(color_scheme="dark")`; `media` may be print."""
        media = features.pop("media", "")
        listed = [
            {"name": f"prefers-{name.replace('_', '-')}", "value": value}
            for name, value in features.items()
        ]
        self._send("Emulation.setEmulatedMedia", {"media": media, "features": listed})

    def open(self, page: Path) -> None:
        """Load a file and wait until it is there."""
        self.errors.clear()
        self._loaded = False
        self._send("Page.navigate", {"url": page.resolve().as_uri()})
        while not self._loaded:
            self._take()

    def run(self, script: str) -> Any:
        """The value of an expression, awaited."""
        sent = {"expression": script, "returnByValue": True, "awaitPromise": True}
        answer = self._send("Runtime.evaluate", sent)
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def press(self, key: str, *, shift: bool = False) -> None:
        text = {"Enter": "\r", "Space": " "}.get(key, key if len(key) == 1 else "")
        codes = {"Enter": 13, "Escape": 27, "Tab": 9, "ArrowLeft": 37, "ArrowUp": 38}
        codes |= {"ArrowRight": 39, "ArrowDown": 40, "End": 35, "Home": 36}
        sent: Json = {"key": key, "code": key, "modifiers": 8 if shift else 0}
        sent |= {"windowsVirtualKeyCode": codes.get(key, 0)}
        down = {"type": "keyDown" if text else "rawKeyDown", **({"text": text} if text else {})}
        self._send("Input.dispatchKeyEvent", sent | down)
        self._send("Input.dispatchKeyEvent", sent | {"type": "keyUp"})

    def click(self, x: float, y: float) -> None:
        for kind in ("mouseMoved", "mousePressed", "mouseReleased"):
            self.mouse(kind, x, y)

    def mouse(self, kind: str, x: float, y: float, **more: Any) -> None:
        """One event of the mouse; a press is of the left button."""
        pressed = kind != "mouseMoved" or more.get("buttons")
        button = {"button": "left", "clickCount": 1} if pressed else {}
        self._send("Input.dispatchMouseEvent", {"type": kind, "x": x, "y": y, **button, **more})

    def touch(self, kind: str, *points: tuple[float, float]) -> None:
        fingers = [{"x": x, "y": y, "id": number} for number, (x, y) in enumerate(points)]
        self._send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": fingers})

    def paper(self) -> bytes:
        """The page as it is printed: a PDF."""
        sent = {"printBackground": True, "preferCSSPageSize": True}
        return base64.b64decode(self._send("Page.printToPDF", sent)["data"])

    def _send(self, method: str, values: Json | None = None) -> Json:
        self._number += 1
        message = {"id": self._number, "method": method, "params": values or {}}
        if self._session is not None:
            message["sessionId"] = self._session
        os.write(self._out, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._take()
            if answer.get("id") == self._number:
                assert "error" not in answer, (method, answer["error"])
                return dict(answer["result"])

    def _take(self) -> Json:
        while b"\0" not in self._waiting:
            ready, _, _ = select.select([self._in], [], [], _PATIENCE_S)
            part = os.read(self._in, 1 << 20) if ready else b""
            if not part:
                raise BrowserGoneError("it has gone" if ready else "it says nothing any more")
            self._waiting += part
        line, _, self._waiting = self._waiting.partition(b"\0")
        message: Json = json.loads(line)
        self._hear(message.get("method", ""), message.get("params", {}))
        return message

    def _hear(self, event: str, values: Json) -> None:
        """Keep what a test may ask for later."""
        if event == "Page.loadEventFired":
            self._loaded = True
        elif event == "Runtime.exceptionThrown":
            self.errors.append(str(values["exceptionDetails"]))
        elif event == "Log.entryAdded" and values["entry"]["level"] == "error":
            self.errors.append(values["entry"]["text"])
        elif event == "Network.requestWillBeSent" and not values["request"]["url"].startswith(
            ("file:", "data:")
        ):
            self.errors.append(f"asks for {values['request']['url']}")
