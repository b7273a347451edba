"""Runs tests/gui in real Blender windows, once for each GPU backend: a module in a window of its own, two at a time.

Usage: python tests/run_gui.py [FILE…] [-- ARGUMENTS FOR PYTEST]
BLENDER=/path/to/blender names one of your own; otherwise Debian's is built once into .cache: BLENDER_SUITE=trixie
(4.3.2, the default) or sid (5.2). BLENDER_BACKEND=opengl or vulkan; the default is opengl, for sid one after the other.
The last line is `N passed, N failed, N skipped`, as of run.py.
"""

import os
import shutil
import sys
import tempfile
from pathlib import Path

from run import ROOT, TESTS, run_all, summarize

sys.path.insert(0, str(ROOT / "scripts"))

from blender_window import build_package, find_blender, install  # noqa: E402

# Those that begin first because they take longest.
SLOW = ("test_import", "test_find_lights", "test_run", "test_journey", "test_panels", "test_rounds")
JOBS = 2  # a window waits for its events half of the time
SECONDS = 1800  # limit of one module on a busy machine


def main() -> int:
    """Run the tests; return 1 if any failed on any backend."""
    blender = find_blender()
    cut = sys.argv.index("--") if "--" in sys.argv else len(sys.argv)
    modules = [Path(name).resolve() for name in sys.argv[1:cut]] or list((TESTS / "gui").glob("test_*.py"))
    modules.sort(key=lambda path: (path.stem not in SLOW, path))
    chosen = os.environ.get("BLENDER_BACKEND")
    backends = [chosen] if chosen else ["opengl", "vulkan"] if blender.name == "sid" else ["opengl"]
    pictures = ROOT / ".cache" / "gui"
    results = []
    with tempfile.TemporaryDirectory(prefix="irpso-gui-") as scratch:
        installed = Path(scratch) / "user"
        install(blender, build_package(pictures / "dist"), installed)
        for backend in backends:
            folder = pictures / f"{blender.name}-{backend}"
            shutil.rmtree(folder, ignore_errors=True)
            print(f"{blender.name}, {backend}:", flush=True)
            os.environ |= {"BLENDER_BACKEND": backend, "IRPSO_INSTALLED": str(installed)}
            results += run_all(modules, JOBS, SECONDS, sys.argv[cut + 1 :])
            print(f"pictures and logs: {folder}", flush=True)
    return summarize(results)


if __name__ == "__main__":
    sys.exit(main())
