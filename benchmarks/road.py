"""Seconds and clicks of each step in a real Blender window, from photographs to a kept material.

Usage: python -m benchmarks.road [--quick] [--again] [--output FOLDER]

Needs what `make test-gui` needs. Roads with rti_icon, of the folder IRPSO_DATA or of ../shared/data, are skipped where
it is absent. The extension is the built zip. Nothing is typed. A click is one on a button, on OK of a dialog or on
Accept of the file browser, in which the folder is already open. IRPSO_ROADS=icon,rig takes some roads.
"""

from __future__ import annotations

import os
import re
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from benchmarks import report

sys.path.insert(0, str(report.ROOT / "scripts"))

DATA = Path(os.environ.get("IRPSO_DATA", report.ROOT.parent / "shared" / "data"))
ICON = DATA / "rti_icon"
FACE = ((0.25, 0.8), (0.75, 0.8), (0.75, 0.3), (0.25, 0.3))  # of the icon, in parts of its picture
PICTURES = report.CACHE / "road"  # screenshots of every step
MODULE = "bl_ext.user_default.irpso.irpso_addon.ui"
SLOW = 3000  # seconds
SETUP = f"""
import importlib, time
session = importlib.import_module("{MODULE}.session.session")
capture_import = importlib.import_module("{MODULE}.operators.capture_import")
failures = importlib.import_module("{MODULE}.common.failures")
turn = {{"last": 0.0, "longest": 0.0}}
bpy.context.preferences.view.filebrowser_display_type = "SCREEN"

def beat():
    now = time.perf_counter()
    turn["longest"] = max(turn["longest"], now - turn["last"])
    turn["last"] = now
    return 0.0

def settings():
    return bpy.context.scene.irpso

def busy():
    running = session.current()
    at_work = running is not None and running.state != "done"
    modal = [o for o in main_window().modal_operators if o.bl_idname.startswith("IRPSO_")]
    return bool(modal) or at_work or bool(capture_import.checking(bpy.context.scene))

bpy.app.timers.register(beat, persistent=True)
"""
QUICK = f"""
from functools import partial
sample = importlib.import_module("{MODULE}.operators.sample")
sample._rendering = partial(sample._rendering, options=["--size", "300x225", "--photographs", "6"])
"""


class Walk:
    """A user's steps in a window; ``rows``: clicks, seconds and reports of each."""

    def __init__(self, window: Any, name: str):
        self.window, self.name, self.rows = window, name, list[dict[str, Any]]()
        window.run("session.current() is not None and bpy.ops.irpso.cancel()")
        window.run("bpy.ops.wm.read_homefile(app_template='')", area="")
        window.open_sidebar("IRPSO")
        self.picture("start")

    def picture(self, step: str) -> None:
        """Take a screenshot."""
        self.window.screenshot(f"{self.name} {len(self.rows)} {step}")

    def step(self, name: str, clicks: int, act: Callable[[], object]) -> None:
        """Take a step, wait until the program is idle, and add a row."""
        reported = len(self.window.reports())
        self.window.run("turn.update(last=time.perf_counter(), longest=0.0)", area="")
        begun = time.perf_counter()
        act()
        self.window.settle()
        self.window.wait("not busy()", SLOW, area="")
        seconds = time.perf_counter() - begun
        longest = self.window.run("turn['longest']", area="")
        reports = self.window.reports()[reported:]
        self.rows.append({"step": name, "clicks": clicks, "seconds": seconds, "turn": longest, "said": reports})
        report.say(f"{self.name}: {name}: {seconds:.1f} s, longest turn {longest:.2f} s, {reports}")
        self.picture(name)

    def press(self, name: str, operator: str, then: Callable[[], object] = lambda: None, clicks: int = 1) -> None:
        """Click a button of the sidebar, and call ``then``."""
        place = self.window.find_button(operator)

        def act() -> None:
            self.window.click(*place)
            then()

        self.step(name, clicks, act)

    def choose(self, folder: Path | None) -> None:
        """Accept a folder in the file browser, or what it offers."""
        self.window.wait("any(area.type == 'FILE_BROWSER' for area in main_window().screen.areas)", area="")
        if folder is not None:
            path = f"{folder}/".encode()
            self.window.run(f"largest('FILE_BROWSER').spaces.active.params.directory = {path!r}", area="")
        self.window.settle()
        self.window.move(*self.window.region("FILE_BROWSER").centre)
        self.window.key("Return")
        self.window.wait("all(area.type != 'FILE_BROWSER' for area in main_window().screen.areas)", area="")
        self.window.settle()

    def saved(self, name: str, operator: str) -> None:
        """Choose an entry of the menu of photographs, and accept the name that the file browser offers."""

        def act() -> None:
            self.window.run(f"bpy.ops.{operator}('INVOKE_DEFAULT')")
            self.choose(None)

        self.step(name, 3, act)

    def accept(self) -> None:
        """Click OK of a dialog."""
        self.window.settle()
        self.picture("dialog")
        self.window.key("Return")

    def corners(self) -> None:
        """Search the card's corners, in the popover Frame."""
        self.step("Frame › Find Corners", 2, lambda: self.window.run("bpy.ops.irpso.find_corners('INVOKE_DEFAULT')"))

    def mark(self, marks: Sequence[tuple[float, float]]) -> None:
        """Click the corners of a part of the photograph, in parts of its width and height from the lower left."""

        def act() -> None:
            self.window.run("bpy.ops.irpso.mark_card('INVOKE_DEFAULT')")
            self.window.wait("any(area.type == 'IMAGE_EDITOR' for area in main_window().screen.areas)", area="")
            self.window.run("redrawn()", area="")
            box = self.window.region("IMAGE_EDITOR")
            for mark in marks:
                to_region = f"bpy.context.region.view2d.view_to_region({mark[0]}, {mark[1]}, clip=False)"
                x, y = self.window.run(to_region, area="IMAGE_EDITOR")
                self.window.click(round(box.x + x), round(box.y + box.height - 1 - y))
            self.picture("marks")
            self.window.key("Return")

        self.step("Frame › Mark in Photograph", 2 + len(marks) + 1, act)

    def recover_and_keep(self, quick: bool) -> None:
        """Press Recover, and Keep at its end."""
        if quick:
            self.window.run("settings().picture_scale = 0.2")
        self.press("Recover", "irpso.recover")
        self.press("Keep", "irpso.keep")


def measure(quick: bool) -> dict[str, Any]:
    """Return the steps of each road, and the load of the machine before each."""
    from blender_window import build_package, find_blender, install, open_window

    blender, backend = find_blender(), os.environ.get("BLENDER_BACKEND") or "opengl"
    shutil.rmtree(PICTURES, ignore_errors=True)
    roads: dict[str, Any] = {}
    with tempfile.TemporaryDirectory(prefix="irpso-bench-") as scratch:
        folder = Path(scratch)
        install(blender, build_package(folder / "dist"), folder / "user")
        with open_window(blender, folder / "user", PICTURES, backend) as window:
            window.run(
                SETUP + f"from pathlib import Path\nPath.home = lambda: Path({scratch!r})" + QUICK * quick, area=""
            )
            for name, road in ROADS.items():
                if name not in os.environ.get("IRPSO_ROADS", name).split(","):
                    continue
                if name in OF_ICON and not ICON.is_dir():
                    roads[name] = {"skipped": "rti_icon is not in the folder of test data"}
                    continue
                load = os.getloadavg()[0]
                walk = Walk(window, name)
                road(walk, folder)
                texels = 0
                if name != "rig":
                    walk.recover_and_keep(quick)
                    texels = window.run("__import__('math').prod(session.current().job.size)")
                roads[name] = {"load": load, "steps": walk.rows, "texels": texels}
    return {"blender": blender.name, "backend": backend, "roads": roads}


def _sample(walk: Walk, folder: Path) -> None:
    walk.press("Open Sample…", "irpso.open_sample", walk.accept, 2)


def _photographs(walk: Walk, folder: Path) -> None:
    source = folder / "irpso-sample" / "photographs"
    photographs = folder / "photographs"
    photographs.mkdir()
    for path in source.glob("*.jpg"):
        shutil.copy(path, photographs)

    def chosen() -> None:
        walk.choose(photographs)
        walk.accept()

    walk.press("Find Lights…", "irpso.choose_photographs", chosen, 3)
    walk.corners()


def _icon(walk: Walk, folder: Path) -> None:
    shutil.copytree(ICON, folder / "icon")
    walk.press("Import Capture…", "irpso.import_capture", lambda: walk.choose(folder / "icon"), 2)
    walk.press("Find Lights…", "irpso.find_lights", walk.accept, 2)
    walk.corners()
    walk.mark(FACE)


def _rig(walk: Walk, folder: Path) -> None:
    shutil.copytree(ICON, folder / "first")
    (folder / "second").mkdir()
    for path in ICON.glob("*.jpg"):
        shutil.copy(path, folder / "second")
    walk.press("Import Capture…", "irpso.import_capture", lambda: walk.choose(folder / "first"), 2)
    walk.saved("▾ › Save Rig…", "irpso.save_rig")

    def chosen() -> None:
        walk.window.run("bpy.ops.irpso.apply_rig('INVOKE_DEFAULT')")
        walk.choose(folder / "second")
        walk.accept()

    walk.step("▾ › Apply Rig…", 4, chosen)


ROADS = {"sample": _sample, "photographs": _photographs, "icon": _icon, "rig": _rig}
OF_ICON = ("icon", "rig")
_TITLES = {
    "sample": "Open Sample",
    "photographs": "The sample's photographs, as if they were your own",
    "icon": "The middle of a painted icon, with the lights of its .lp list: it shows no ball and no outline",
    "rig": "The icon's lamps as a rig, applied to other photographs without a list of lights",
}


def write(data: dict[str, Any], folder: Path) -> list[str]:
    """Return the page's lines."""
    lines = [
        f"Debian {data['blender']}'s Blender, {data['backend']}, a window of 1600 × 1000 under Xvfb; the extension is"
        " the built zip. Nothing is typed. A click is one on a button, on OK of a dialog or on Accept of the file"
        " browser, in which the folder is already open. Longest turn: of Blender's main loop, all that a window can"
        " stall. Load: programs that want the cores; times and turns grow with it."
    ]
    for name, road in data["roads"].items():
        lines += ["", f"## {_TITLES[name]}", ""]
        if "skipped" in road:
            lines.append(f"Skipped: {road['skipped']}.")
            continue
        rows = [
            [row["step"], row["clicks"], report.short(row["seconds"]), report.short(row["turn"]), _said(row["said"])]
            for row in road["steps"]
        ]
        total = ["together", sum(row["clicks"] for row in road["steps"]),
                 report.short(sum(row["seconds"] for row in road["steps"])), "", ""]  # fmt: skip
        texels = f"{road['texels']} texels. " if road["texels"] else ""
        lines += [f"{texels}Load of the machine before: {road['load']:.1f}.", ""]
        lines += report.table(["step", "clicks", "s", "longest turn, s", "what the window says"], [*rows, total])
    return lines


def _said(lines: list[str]) -> str:
    """Return reports in a line, without the scratch folder of this machine."""
    return re.sub(r"\S*irpso-bench-\w+", "…", "; ".join(lines)).replace("|", "\\|")


def headline(data: dict[str, Any]) -> str:
    """Return the page's result in a line."""
    return ", ".join(
        f"{name}: {sum(row['clicks'] for row in road['steps'])} clicks, "
        f"{sum(row['seconds'] for row in road['steps']):.0f} s"
        for name, road in data["roads"].items()
        if "steps" in road
    )


PROGRAM = report.Program(
    "road", "From photographs to a material in the window", __file__, measure, write, headline,
    (*report.RECOVER, "irpso_addon/calibration", "irpso_addon/sample", "irpso_addon/ui"),
)  # fmt: skip

if __name__ == "__main__":
    report.run(PROGRAM)
