"""Starts and ends a Blender window: installs the zip, runs an X server and Blender, and removes both."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from .blenders import Blender
from .debian import ROOT
from .window import BlenderGone, FailedInside, Window

SCREEN = (1600, 1000)
DRIVER = Path(__file__).resolve().parent / "driver.py"


class BlenderError(Exception):
    """Blender ended with an error, or logged one."""


def build_package(folder: Path) -> Path:
    """Build the extension's zip, with wheels, for this system; return its path in ``folder``."""
    sys.path.insert(0, str(ROOT / "scripts"))
    import extension

    system = extension.this_platform()
    return extension.build_all(folder, [system])[system][0]


def install(blender: Blender, package: Path, user: Path) -> str:
    """Install and enable a zip in a fresh Blender, as in the README; return Blender's output.

    user: an empty folder for Blender's settings and extensions. Raises BlenderError if it fails.
    """
    command = ["--command", "extension", "install-file", "--repo", "user_default", "--enable", str(package)]
    done = blender.run(blender.executable, *command, variables=_own_places(user, user.parent), timeout=300)
    if done.returncode or not list(user.glob("extensions/user_default/irpso/blender_manifest.toml")):
        raise BlenderError(f"{package.name} could not be installed (exit code {done.returncode}):\n{done.stdout}")
    return done.stdout


@contextmanager
def open_window(
    blender: Blender, user: Path, pictures: Path, backend: str = "opengl", log_name: str = "blender"
) -> Iterator[Window]:
    """Open Blender in a window that fills a virtual screen; end it on exit.

    user: Blender's settings and extensions, which are copied.  pictures: folder of the screenshots and of LOG_NAME.log,
    Blender's output.  backend: ``opengl`` or ``vulkan``. Raises BlenderError on exit if Blender logged unexpected
    errors or ended with one.
    """
    with tempfile.TemporaryDirectory(prefix="irpso-window-") as scratch, _screen(blender) as display:
        folder = Path(scratch)
        shutil.copytree(user, folder / "user")
        arguments = ["--window-geometry", "0", "0", *map(str, SCREEN), "--gpu-backend", backend]
        arguments += ["--python", str(DRIVER), "--", str(folder)]
        variables = _own_places(folder / "user", folder) | {"DISPLAY": display}
        with open(folder / "log", "wb") as log:
            process = blender.start(
                blender.executable, *arguments, variables=variables, stdout=log, stderr=subprocess.STDOUT
            )
        window = Window(blender, display, process, folder, pictures)
        try:
            window.run("redrawn()", area="", timeout=120)
            yield window
            _end(window)
        finally:
            process.kill()
            process.wait()
            pictures.mkdir(parents=True, exist_ok=True)
            shutil.copy(folder / "log", pictures / f"{log_name}.log")


def _own_places(user: Path, scratch: Path) -> dict[str, str]:
    """Return the environment variables for Blender's settings and temporary files in these folders."""
    return {"BLENDER_USER_RESOURCES": str(user), "TMPDIR": str(scratch)}


def _end(window: Window) -> None:
    """Quit Blender as a user would. Raises BlenderError if it fails or has logged unexpected errors."""
    try:
        window.run("bpy.ops.wm.quit_blender()", timeout=30)
    except (BlenderGone, FailedInside):
        if window.process.poll() is None:
            raise
    code = window.process.wait(30)
    complaints = window.complaints()
    if code or complaints:
        text = "\n".join(complaints)
        raise BlenderError(f"Blender ended with {code} and complained:\n{text}\n\nall it said:\n{window.log()[-6000:]}")


@contextmanager
def _screen(blender: Blender) -> Iterator[str]:
    """Start an X server on a free display; yield the display's name."""
    size = f"{SCREEN[0]}x{SCREEN[1]}x24"
    arguments = ["-displayfd", "1", "-screen", "0", size, "-nolisten", "tcp", "-noreset"]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL, "text": True}
    with blender.start("Xvfb", *arguments, **pipes) as server:
        try:
            number = server.stdout.readline().strip()
            if not number:
                raise BlenderGone("Xvfb, the X server, did not start")
            yield f":{number}"
        finally:
            server.terminate()
