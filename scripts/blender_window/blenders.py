"""Finds the Blender for a window, and starts programs in its environment."""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

from .debian import PRIVATE, ROOT, debian, need_programs

# The Debian has no translations (debian.py). With this list Blender offers the languages, for texts of add-ons.
LANGUAGES = Path(__file__).with_name("languages")
# Makes the mounts of a Debian in a folder, then runs the program. $1: the folder; $2: number of this machine's folders
# to mount at the same paths; then these, then the program with its arguments.
ENTER = f"""
set -e
root=$1 count=$2
shift 2
mount --rbind /dev "$root/dev"
mount --rbind /proc "$root/proc"
mount -t tmpfs none "$root/usr/share/locale"
cp {shlex.quote(str(LANGUAGES))} "$root/usr/share/locale/languages"
while [ "$count" -gt 0 ]; do
    mkdir -p "$root$1"
    mount --bind "$1" "$root$1"
    shift
    count=$((count - 1))
done
exec chroot "$root" "$@"
"""
# The tools that a window needs -> the package of Debian that brings each.
TOOLS = {"Xvfb": "xvfb", "xdotool": "xdotool", "import": "imagemagick"}
# Prefixes of the environment variables that a Debian in a folder gets.
HANDED_ON = ("IRPSO_", "LP_", "GALLIUM_", "MESA_", "OCIO")


@dataclass(frozen=True)
class Blender:
    """One Blender and the tools beside it.

    name: of the folder of its pictures, such as ``trixie``.  executable: its path, or name on PATH.
    root: the folder of its Debian; None for this machine.  visible: folders that it must see.
    """

    name: str
    executable: str
    root: Path | None = None
    visible: tuple[Path, ...] = ()

    def start(self, program: str, *arguments: str, variables: dict[str, str] | None = None, **how) -> subprocess.Popen:
        """Start a program in this Blender's system; it ends with this process.

        variables: added to its environment.  how: options of subprocess.Popen.
        """
        command = ["setpriv", "--pdeathsig", "KILL", *self._enter(variables or {}), program, *arguments]
        return subprocess.Popen(command, env=self._environment(variables or {}), stdin=subprocess.DEVNULL, **how)

    def run(self, program: str, *arguments: str, variables=None, timeout: float = 120) -> subprocess.CompletedProcess:
        """Run a program in this Blender's system to its end; return its exit code and its output as text."""
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
        with self.start(program, *arguments, variables=variables, **pipes) as process:
            try:
                output, _ = process.communicate(timeout=timeout)
            except subprocess.TimeoutExpired:
                process.kill()
                raise
        return subprocess.CompletedProcess([program, *arguments], process.returncode, output, "")

    def _enter(self, variables: dict[str, str]) -> list[str]:
        if self.root is None:
            return []
        folders = [str(folder) for folder in self.visible]
        passed_on = [f"{name}={value}" for name, value in os.environ.items() if name.startswith(HANDED_ON)]
        own = [f"{name}={value}" for name, value in variables.items()]
        home = ["HOME=/var/cache", "LANG=C.UTF-8", "PATH=/usr/local/bin:/usr/bin:/bin"]
        inside = ["env", "--ignore-environment", *home, *passed_on, *own]
        return [*PRIVATE, "sh", "-c", ENTER, "sh", str(self.root), str(len(folders)), *folders, *inside]

    def _environment(self, variables: dict[str, str]) -> dict[str, str]:
        if self.root is not None:
            return dict(os.environ)
        # These variables of the running Python would mislead Blender's.
        mine = ("PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV")
        return {name: value for name, value in os.environ.items() if name not in mine} | variables


def find_blender() -> Blender:
    """Return the Blender that ``BLENDER`` names, else that of ``BLENDER_SUITE`` (default ``trixie``), built if missing.

    Raises SystemExit, with the remedy, if there is none or a tool is missing.
    """
    own = os.environ.get("BLENDER", "")
    if own:
        path = shutil.which(own)
        if not path:
            raise SystemExit(f"BLENDER={own} is no program that can be run; name Blender's executable")
        need_programs(TOOLS)
        return Blender("own", str(Path(path).resolve()))
    suite = os.environ.get("BLENDER_SUITE") or "trixie"
    return Blender(suite, "blender", debian(suite), _visible())


def _visible() -> tuple[Path, ...]:
    """Return the folders that a Debian in a folder must see: temporary files, the repository, the data beside it."""
    sockets = Path("/", "tmp")  # of X servers, whatever TMPDIR is
    shared = Path(os.environ.get("IRPSO_DATA", ROOT.parent / "shared"))
    wanted = [Path(tempfile.gettempdir()), sockets, ROOT, shared]
    return tuple(dict.fromkeys(folder.resolve() for folder in wanted if folder.is_dir()))
