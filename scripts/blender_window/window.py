"""A Blender window for a test: runs code inside it, sends mouse and key events, takes pictures."""

from __future__ import annotations

import json
import re
import subprocess
import time
from pathlib import Path

import numpy as np

from .blenders import Blender
from .layout import Box

# Lines of the log by which Blender and its add-ons report an error.
COMPLAINT = re.compile(
    r"Traceback \(most|^Error: |\bERROR\b|Exception in|^Writing: .*crash|memory leak|Not freed|GPUShader|Shader.*failed"
)
SHORTEST_WAIT = 0.02  # seconds between checks for the answer


class FailedInside(Exception):
    """A piece of Python failed inside Blender; the text is its traceback there."""


class BlenderGone(Exception):
    """Blender ended, or does not answer; the text has the end of its log."""


class Window:
    """One running Blender, made by open_window().

    display: its X display.  process: Blender's.  folder: of requests, answers and the log.  pictures: folder of
    screenshot().
    """

    def __init__(self, blender: Blender, display: str, process: subprocess.Popen, folder: Path, pictures: Path):
        self.blender, self.display, self.process, self.folder, self.pictures = (
            blender, display, process, folder, pictures,
        )  # fmt: skip
        self.expected: list[str] = []
        self._requests = 0

    def run(self, code: str, area: str = "VIEW_3D", timeout: float = 60):
        """Run Python in Blender's main thread; return the value of its last expression, through JSON.

        code: may use ``bpy``, globals of earlier calls, and the functions of inside.py; if its last expression is a
        generator, it advances every 20 ms while Blender goes on.  area: type of the area of its context; "" for a
        timer's bare context, for code that loads a file.  timeout: seconds.
        Raises FailedInside with the traceback, BlenderGone if Blender has ended or does not answer.
        """
        number, self._requests = self._requests, self._requests + 1
        request, answer = self.folder / f"{number}.json", self.folder / f"{number}.answer.json"
        part = request.with_suffix(".part")
        part.write_text(json.dumps({"code": code, "area": area}), encoding="utf-8")
        part.rename(request)
        until = time.monotonic() + timeout
        while not answer.exists():
            if self.process.poll() is not None:
                raise BlenderGone(f"Blender ended with {self.process.returncode}\n{self._tail()}")
            if time.monotonic() > until:
                raise BlenderGone(f"Blender has not answered for {timeout:.0f} s\n{code}\n{self._tail()}")
            time.sleep(SHORTEST_WAIT)
        response = json.loads(answer.read_text(encoding="utf-8"))
        if "error" in response:
            raise FailedInside(response["error"])
        return response["value"]

    def wait(self, expression: str, timeout: float = 30, area: str = "VIEW_3D"):
        """Return the value of a Python expression inside Blender once it is true. Raises TimeoutError."""
        until = time.monotonic() + timeout
        while not (value := self.run(expression, area)):
            if time.monotonic() > until:
                raise TimeoutError(f"after {timeout} s still {value!r}: {expression}\n{self._tail()}")
            time.sleep(0.05)
        return value

    def settle(self) -> None:
        """Wait until Blender has handled the events sent so far."""
        self.run("settled()", area="")

    def move(self, x: int, y: int) -> None:
        """Move the mouse to a pixel of the screen, y from the top."""
        self._events("mousemove", x, y)

    def click(self, x: int, y: int, button: int = 1, times: int = 1, held: str = "") -> None:
        """Click at a pixel: 1 left, 2 middle, 3 right, 4 and 5 the wheel up and down. held: a key, such as ctrl."""
        down, up = (("keydown", held), ("keyup", held)) if held else ((), ())
        click = ("click", "--repeat", times, "--delay", 60, button)
        self._events("mousemove", x, y, "sleep", 0.1, *down, *click, *up)

    def drag(self, start: tuple[int, int], end: tuple[int, int], button: int = 1) -> None:
        """Press at a pixel, move to another in steps, release."""
        steps = [
            part
            for k in range(1, 9)
            for part in (
                "mousemove",
                *(round(a + (b - a) * k / 8) for a, b in zip(start, end, strict=True)),
                "sleep",
                0.02,
            )
        ]
        self._events("mousemove", *start, "sleep", 0.1, "mousedown", button, *steps, "mouseup", button)

    def key(self, *keys: str) -> None:
        """Press keys in turn, over the area under the mouse. keys: xdotool's names, such as Escape, ctrl+z, n."""
        self._events("key", "--delay", 60, *keys)

    def type(self, text: str) -> None:
        """Type text."""
        self._events("type", "--delay", 30, text)

    def region(self, area: str = "VIEW_3D", region: str = "WINDOW") -> Box:
        """Return the rectangle of a region of the largest area of a type."""
        return Box(*self.run(f"region_box({area!r}, {region!r})", area=""))

    def open_sidebar(self, tab: str, area: str = "VIEW_3D") -> Box:
        """Show a tab of an area's sidebar; return the sidebar's rectangle. Raises FailedInside without such a tab."""
        self.run(f"open_sidebar({tab!r}, {area!r})", area="")
        return self.region(area, "UI")

    def choose_in_browser(self, folder: Path) -> None:
        """Choose a folder in the file browser, which opens in the same window; press Return; wait until it closes."""
        self.wait("any(area.type == 'FILE_BROWSER' for area in main_window().screen.areas)", area="")
        self.run(f"largest('FILE_BROWSER').spaces.active.params.directory = {f'{folder}/'.encode()!r}", area="")
        self.settle()
        self.move(*self.region("FILE_BROWSER").centre)
        self.key("Return")
        self.wait("all(area.type != 'FILE_BROWSER' for area in main_window().screen.areas)", area="")

    def find_button(self, call: str, area: str = "VIEW_3D", region: str = "UI") -> tuple[int, int]:
        """Return a pixel of a button in a region, found by moving the mouse over it (some seconds).

        call: a part of the operator's call in Python (``irpso.recover``) or of the property's data path
        (``irpso.resolution``). Raises FailedInside, naming the buttons in sight; greyed ones are found too.
        """
        x, y = self.run(f"find_button({call!r}, {area!r}, {region!r})", area="", timeout=180)
        return x, y

    def screenshot(self, name: str, box: Box | None = None) -> Path:
        """Take a picture of the screen, or of a part of it, into NAME.png; return its path."""
        self.run("redrawn()", area="")
        self.pictures.mkdir(parents=True, exist_ok=True)
        path = self.pictures / f"{name}.png"
        path.write_bytes(self._import("png:-", box))
        return path

    def pixels(self, box: Box | None = None) -> np.ndarray:
        """Return the screen's pixels, or those of a part: (H, W, 3) uint8, row 0 at the TOP."""
        self.run("redrawn()", area="")
        box = box or Box(0, 0, *self.run("main_window().width, main_window().height", area=""))
        raw = self._import("rgb:-", box)
        return np.frombuffer(raw, np.uint8).reshape(box.height, box.width, 3)

    def log(self) -> str:
        """Return Blender's output so far."""
        return (self.folder / "log").read_text(encoding="utf-8", errors="replace")

    def expect(self, pattern: str) -> None:
        """Ignore lines of the log that match a regular expression in complaints()."""
        self.expected.append(pattern)

    def reports(self) -> list[str]:
        """Return all reports of operators, oldest first; log() lacks those of cancelled ones."""
        return self.run("reports()", area="")

    def complaints(self) -> list[str]:
        """Return the unexpected error lines of the log."""
        lines = [line for line in self.log().splitlines() if COMPLAINT.search(line)]
        return [line for line in lines if not any(re.search(pattern, line) for pattern in self.expected)]

    def _import(self, form: str, box: Box | None) -> bytes:
        crop = [] if box is None else ["-crop", f"{box.width}x{box.height}+{box.x}+{box.y}", "+repage"]
        arguments = ["-window", "root", *crop, "-depth", "8", form]
        with self.blender.start(
            "import", *arguments, variables={"DISPLAY": self.display}, stdout=subprocess.PIPE, stderr=subprocess.PIPE
        ) as process:
            image, errors = process.communicate(timeout=60)
        if process.returncode or not image:
            raise BlenderGone(f"no picture could be taken: {errors.decode(errors='replace')}")
        return image

    def _events(self, *arguments) -> None:
        done = self.blender.run("xdotool", *map(str, arguments), variables={"DISPLAY": self.display})
        if done.returncode:
            raise BlenderGone(f"xdotool {arguments}: {done.stdout}{self._tail()}")
        self.settle()

    def _tail(self) -> str:
        return "\n".join(self.log().splitlines()[-40:])
