"""Runs tests/gui in a real Blender window, once for each GPU backend.

Usage: python tests/run_gui.py [FILE…] [-- ARGUMENTS FOR PYTEST]
BLENDER=/path/to/blender names one of your own; otherwise Debian's is built once into .cache: BLENDER_SUITE=trixie
(4.3.2, the default) or sid (5.2). BLENDER_BACKEND=opengl or vulkan; the default is opengl, for sid one after the other.
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "scripts"))

from blender_window import build_package, find_blender  # noqa: E402


def main() -> int:
    """Run the tests; return 1 if any failed on any backend."""
    blender = find_blender()
    cut = sys.argv.index("--") if "--" in sys.argv else len(sys.argv)
    arguments = [*(sys.argv[1:cut] or [str(ROOT / "tests" / "gui")]), *sys.argv[cut + 1 :]]
    chosen = os.environ.get("BLENDER_BACKEND")
    backends = [chosen] if chosen else ["opengl", "vulkan"] if blender.name == "sid" else ["opengl"]
    results = ROOT / ".cache" / "gui"
    package = build_package(results / "dist")
    codes = []
    for backend in backends:
        shutil.rmtree(results / f"{blender.name}-{backend}", ignore_errors=True)
        print(f"{blender.name}, {backend}:", flush=True)
        variables = os.environ | {"BLENDER_BACKEND": backend, "IRPSO_PACKAGE": str(package)}
        command = [sys.executable, "-m", "pytest", "-q", *arguments]
        codes.append(subprocess.run(command, cwd=ROOT, env=variables).returncode)
        print(f"pictures and logs: {results / f'{blender.name}-{backend}'}", flush=True)
    return int(any(codes))


if __name__ == "__main__":
    sys.exit(main())
