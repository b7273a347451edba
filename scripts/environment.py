"""Makes a virtual environment holding some dependency groups of pyproject.toml, unless it already does."""

import argparse
import hashlib
import subprocess
import sys
import tomllib
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


def requirements(groups: list[str], bpy: str | None) -> list[str]:
    """Return the requirements of the groups; ``bpy`` replaces that on Blender's wheel."""
    table = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["dependency-groups"]
    chosen = [line for group in groups for line in table[group]]
    if bpy is None:
        return chosen
    return [bpy, *(line for line in chosen if not line.startswith("bpy"))]


def stamp_text(lines: list[str]) -> str:
    """Return a digest of an environment's interpreter and requirements."""
    return hashlib.sha256("\n".join([sys.executable, sys.version, *sorted(lines)]).encode()).hexdigest()


def serves(python: Path) -> bool:
    """Return whether an environment's interpreter exists, has pip, and is of the running version."""
    if not python.exists():
        return False
    probe = subprocess.run([python, "-c", "import sys, pip; print(sys.version)"], capture_output=True, text=True)
    return probe.stdout.strip() == sys.version.strip()


def link(environment: Path) -> None:
    """Add the program to the import path of an environment."""
    for packages in [*environment.glob("lib/python3*/site-packages"), *environment.glob("Lib/site-packages")]:
        (packages / "irpso.pth").write_text(f"{ROOT}\n", encoding="utf-8")


def main() -> int:
    """Make the environment; return pip's exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("environment", type=Path)
    parser.add_argument("groups", nargs="+")
    parser.add_argument("--bpy", help="a requirement that takes the place of the one in pyproject.toml")
    options = parser.parse_args()

    wanted = requirements(options.groups, options.bpy)
    # One stamp per set of groups, so that `make demo` after `make test` installs nothing twice.
    stamp = options.environment / f"installed-{'-'.join(sorted(options.groups))}"
    if stamp.is_file() and stamp.read_text(encoding="utf-8") == stamp_text(wanted):
        link(options.environment)
        return 0
    python = options.environment / ("Scripts/python.exe" if sys.platform == "win32" else "bin/python")
    if not serves(python):
        print(f"making {options.environment} with {sys.executable}", file=sys.stderr)
        venv.create(options.environment, with_pip=True, clear=True)
    print(f"installing {', '.join(wanted)}", file=sys.stderr)
    install = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *wanted]
    code = subprocess.run(install).returncode
    if code == 0:
        link(options.environment)
        stamp.write_text(stamp_text(wanted), encoding="utf-8")
    return code


if __name__ == "__main__":
    sys.exit(main())
