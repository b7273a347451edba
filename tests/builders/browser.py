"""Headless Chromium, driven by the DevTools protocol over pipes: no port, no library."""

import base64
import fcntl
import io
import json
import os
import shutil
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np
from PIL import Image

NAMES = ("chromium", "chromium-browser", "google-chrome")
# Software WebGL, as there is no GPU; and root may not use the sandbox.
FLAGS = (
    "--headless=new", "--remote-debugging-pipe", "--no-sandbox", "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader", "--hide-scrollbars", "--force-color-profile=srgb", "--disable-dev-shm-usage",
    "--disable-background-networking", "--disable-component-update", "--no-first-run", "--mute-audio",
)  # fmt: skip
_SECONDS = 60


def chromium():
    """Return the path of Chromium, None if it is not installed."""
    return next(filter(None, map(shutil.which, NAMES)), None)


class Browser:
    """One page of Chromium, at width × height pixels."""

    def __init__(self, width=800, height=600):
        self._folder = tempfile.TemporaryDirectory(prefix="irpso-chromium-", ignore_cleanup_errors=True)
        read, self._out = os.pipe()
        self._in, write = os.pipe()
        # Chromium reads commands from descriptor 3 and writes answers to 4; a shell moves the pipes there.
        ends = [fcntl.fcntl(end, fcntl.F_DUPFD, 10) for end in (read, write)]
        script = f'exec "$@" 3<&{ends[0]} 4>&{ends[1]}'
        command = [
            "bash",
            "-c",
            script,
            "bash",
            chromium(),
            *FLAGS,
            f"--user-data-dir={self._folder.name}",
            "about:blank",
        ]
        self._process = subprocess.Popen(command, pass_fds=ends, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        for end in (read, write, *ends):
            os.close(end)
        self._buffer, self._number, self.events = b"", 0, []
        targets = self._call("Target.getTargets", session=None)["targetInfos"]
        target = next(t["targetId"] for t in targets if t["type"] == "page")
        self._session = None
        self._session = self._call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Network", "Log"):
            self._call(f"{domain}.enable")
        self.resize(width, height)

    def resize(self, width, height, ratio=1, mobile=False):
        """Set the page's size in CSS pixels. ratio: screen pixels along a CSS pixel."""
        metrics = {"width": width, "height": height, "deviceScaleFactor": ratio, "mobile": mobile}
        self._call("Emulation.setDeviceMetricsOverride", **metrics)
        self._call("Emulation.setTouchEmulationEnabled", enabled=mobile)

    def scheme(self, name):
        """Set the preferred colour scheme: "light" or "dark"."""
        self._call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": name}])

    def open(self, page, state=""):
        """Open a file with ``state`` as its fragment (after #), and wait until the page is drawn."""
        self._call("Page.navigate", url="about:blank")
        self._call("Page.navigate", url=f"{Path(page).resolve().as_uri()}#{state}")
        self.wait()

    def wait(self, value="yes"):
        """Wait until the page's ``data-ready`` has this value."""
        self.until(f"document.documentElement?.dataset.ready === {value!r}")

    def until(self, condition):
        """Wait until a condition holds on the page."""
        deadline = time.monotonic() + _SECONDS
        while not self.run(condition):
            if time.monotonic() > deadline:
                raise TimeoutError(f"{condition}: {self.run('document.body.innerText')[:2000]}\n{self.events[-5:]}")
            time.sleep(0.02)

    def state(self, text):
        """Set the page's fragment and wait until the page is drawn."""
        self.run(f"location.hash = {json.dumps(text)}")
        self.settle()

    def settle(self):
        """Wait until the page has drawn two more frames and is ready."""
        self.run("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => done(1))))")
        self.wait()

    def run(self, script):
        """Return the value of a script; a promise is awaited."""
        answer = self._call("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in answer:
            raise RuntimeError(answer["exceptionDetails"])
        return answer["result"].get("value")

    def key(self, key, code=None, shift=False):
        """Press and release a key."""
        text = key if len(key) == 1 else ""
        number = {"Escape": 27, "Tab": 9}.get(key, 0)
        common = {"key": key, "code": code or key, "modifiers": 8 if shift else 0, "windowsVirtualKeyCode": number}
        self._call("Input.dispatchKeyEvent", type="keyDown", text=text, **common)
        self._call("Input.dispatchKeyEvent", type="keyUp", **common)
        self.settle()

    def drag(self, start, end, button="left"):
        """Press the mouse at a point, move it to another, and release it."""
        mask = {"left": 1, "right": 2}[button]
        steps = ("Moved", start, 0), ("Pressed", start, mask), ("Moved", end, mask), ("Released", end, 0)
        for kind, (x, y), buttons in steps:
            mouse = {"x": x, "y": y, "buttons": buttons, "clickCount": 1, "modifiers": 0}
            name = button if buttons or kind == "Released" else "none"
            self._call("Input.dispatchMouseEvent", type=f"mouse{kind}", button=name, **mouse)
        self.settle()

    def wheel(self, place, down):
        """Turn the wheel at a point."""
        self._call("Input.dispatchMouseEvent", type="mouseWheel", x=place[0], y=place[1], deltaX=0, deltaY=down)
        self.settle()

    def touch(self, *steps):
        """Touch, move and lift fingers. steps: lists of points, from the first touch to the last."""
        kinds = ["touchStart", *["touchMove"] * (len(steps) - 1)]
        for kind, places in zip(kinds, steps, strict=True):
            points = [{"x": x, "y": y, "id": number} for number, (x, y) in enumerate(places)]
            self._call("Input.dispatchTouchEvent", type=kind, touchPoints=points)
        self._call("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])
        self.settle()

    def screenshot(self):
        """Return (H, W, 3) uint8, rows from the top."""
        data = self._call("Page.captureScreenshot", format="png")["data"]
        return np.asarray(Image.open(io.BytesIO(base64.b64decode(data))).convert("RGB"))

    def faults(self):
        """Return errors of scripts, console and network so far."""
        kinds = ("Runtime.exceptionThrown", "Log.entryAdded", "Network.loadingFailed")
        return [event for event in self.events if event["method"] in kinds]

    def requests(self):
        """Return the URLs that the page has requested."""
        sent = [event for event in self.events if event["method"] == "Network.requestWillBeSent"]
        return [event["params"]["request"]["url"] for event in sent]

    def close(self):
        """End Chromium."""
        try:
            self._call("Browser.close", session=None)
            self._process.wait(20)
        except (OSError, subprocess.TimeoutExpired):
            self._process.kill()
            self._process.wait()
        os.close(self._in)
        os.close(self._out)
        self._folder.cleanup()

    def _call(self, method, session="own", **params):
        self._number += 1
        message = {"id": self._number, "method": method, "params": params}
        if session and getattr(self, "_session", None):
            message["sessionId"] = self._session
        os.write(self._out, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._read()
            if answer.get("id") == self._number:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']}")
                return answer["result"]
            if "method" in answer:
                self.events.append(answer)

    def _read(self):
        while b"\0" not in self._buffer:
            part = os.read(self._in, 1 << 20)
            if not part:
                raise OSError("Chromium has ended")
            self._buffer += part
        message, self._buffer = self._buffer.split(b"\0", 1)
        return json.loads(message)
