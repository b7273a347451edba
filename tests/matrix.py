"""Runs tests/gpu on every supported version of Blender, each in its own environment, and prints a table.

Usage: python tests/matrix.py [VERSION…] [-- ARGUMENTS FOR tests/run.py]
A version whose Python is not on this machine is reported as skipped; the exit code is 1 if any test failed.
"""

import os
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
# What a version is tested with: the last of its wheels, and the one Python that the wheels of a version are built for.
VERSIONS = {
    "4.2": ("bpy==4.2.23", "3.11"),
    "4.5": ("bpy==4.5.15", "3.11"),
    "5.0": ("bpy==5.0.1", "3.11"),
    "5.2": ("bpy~=5.2.0", "3.13"),
}
SUMMARY = re.compile(r"(\d+) passed, (\d+) failed, (\d+) skipped")


def run_version(version: str, arguments: list[str]) -> tuple[bool, str]:
    """Test one version; return whether nothing failed, and the line for the table."""
    requirement, python = VERSIONS[version]
    environment = ROOT / f".venv-{version}"
    # PYTHON may name the interpreter of the environment that runs this, which is right for one version only.
    variables = {name: value for name, value in os.environ.items() if name != "PYTHON"} | {"WANTED": python}
    make = [ROOT / "scripts" / "environment.sh", environment, "runtime", "test", "--bpy", requirement]
    made = subprocess.run(make, env=variables, stderr=subprocess.PIPE, text=True)
    if made.returncode:
        reason = made.stderr.strip().splitlines()
        return made.returncode == 2, f"skipped: {reason[0] if reason else 'the environment could not be made'}"
    command = [environment / "bin" / "python", ROOT / "tests" / "run.py", *(arguments or ["tests/gpu"])]
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True)
    last = ""
    for line in process.stdout:
        print(f"[{version}] {line}", end="", flush=True)
        last = line.strip()
    return process.wait() == 0, last if SUMMARY.fullmatch(last) else f"ended with {process.returncode}"


def main() -> int:
    """Test the versions named on the command line, or all; return 1 if any failed."""
    cut = sys.argv.index("--") if "--" in sys.argv else len(sys.argv)
    chosen = sys.argv[1:cut] or list(VERSIONS)
    rows = {version: run_version(version, sys.argv[cut + 1 :]) for version in chosen}
    print("\nBlender  Python  result")
    for version, (_, line) in rows.items():
        print(f"{version:7}  {VERSIONS[version][1]:6}  {line}")
    return 0 if all(good for good, _ in rows.values()) else 1


if __name__ == "__main__":
    sys.exit(main())
