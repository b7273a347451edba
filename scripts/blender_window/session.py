"""Life and end of a Blender window: the zip installed, an X server, Blender on it, and all of it gone afterwards."""

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


class Complained(Exception):
    """Blender did not end as it should, or said on the way that something was wrong."""


def build_package(folder: Path) -> Path:
    """Build the extension's zip for this system, with its wheels; return its path in ``folder``."""
    sys.path.insert(0, str(ROOT / "scripts"))
    import extension

    system = extension.this_platform()
    return extension.build_all(folder, [system])[system][0]


def install(blender: Blender, package: Path, user: Path) -> str:
    """Install and enable a zip in a Blender that has nothing else, as the README says; return what Blender said.

    user: an empty folder for Blender's settings and extensions. Raises Complained where it does not work.
    """
    command = ["--command", "extension", "install-file", "--repo", "user_default", "--enable", str(package)]
    done = blender.run(blender.executable, *command, variables=_own_places(user, user.parent), timeout=300)
    if done.returncode or not list(user.glob("extensions/user_default/irpso/blender_manifest.toml")):
        raise Complained(f"{package.name} could not be installed (exit code {done.returncode}):\n{done.stdout}")
    return done.stdout


@contextmanager
def open_window(
    blender: Blender, user: Path, pictures: Path, backend: str = "opengl", log_name: str = "blender"
) -> Iterator[Window]:
    """Open Blender in a window that fills a screen of its own; end it when done.

    user: Blender's settings and extensions, of which it gets a copy.  pictures: folder of the screenshots and of
    LOG_NAME.log, what Blender said.  backend: ``opengl`` or ``vulkan``. Raises Complained in the end where Blender
    said that something was wrong and nobody expected it, or did not end as it should.
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
    """Return the environment that keeps Blender's settings and its temporary files in folders of its own."""
    return {"BLENDER_USER_RESOURCES": str(user), "TMPDIR": str(scratch)}


def _end(window: Window) -> None:
    """Have Blender end as a user would and see that it did so without a complaint."""
    try:
        window.run("bpy.ops.wm.quit_blender()", timeout=30)
    except (BlenderGone, FailedInside):
        if window.process.poll() is None:
            raise
    code = window.process.wait(30)
    complaints = window.complaints()
    if code or complaints:
        text = "\n".join(complaints)
        raise Complained(f"Blender ended with {code} and complained:\n{text}\n\nall it said:\n{window.log()[-6000:]}")


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
