"""Builds a Debian with Blender in a folder, once, without a file of this machine being at risk.

Mounts are made in a mount namespace of the process that needs them (``unshare --mount``): nobody else sees them, they
end with the process, and deleting the folder never reaches through one.
"""

import fcntl
import os
import shutil
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent.parent
CACHE = ROOT / ".cache"
# Debian's Blender does not ask for all it needs: without cattrs and requests 5.2 has no extensions (bl_pkg does not
# register), and extensions have no numpy.
PACKAGES = (
    "blender", "python3-numpy", "python3-cattr", "python3-requests", "libgl1-mesa-dri", "libegl1",
    "mesa-vulkan-drivers", "xvfb", "xauth", "xdotool", "imagemagick",
)  # fmt: skip
# sid's release file has expired where the mirror is a snapshot.
APT = 'Acquire::Check-Valid-Until "false";\nAPT::Install-Recommends "false";\n'
# To sync every file to the disk, and to unpack what nobody reads, takes longer than the rest.
DPKG = (
    "force-unsafe-io\npath-exclude=/usr/share/doc/*\npath-exclude=/usr/share/man/*\npath-exclude=/usr/share/locale/*\n"
)
STAMP = "what-is-installed"
PRIVATE = ("unshare", "--mount", "--propagation", "private")


def debian(suite: str) -> Path:
    """Return the folder of a Debian that has Blender in it, building it if it is not there.

    suite: ``trixie`` (Blender 4.3.2) or ``sid`` (5.2). Raises SystemExit, with the remedy, where it cannot be built.
    """
    folder = CACHE / f"blender-{suite}"
    with _only_one(suite):
        stamp = folder / STAMP
        if stamp.is_file() and stamp.read_text(encoding="utf-8") == _recipe():
            return folder
        _need_root(suite)
        need_programs({"debootstrap": "debootstrap", "unshare": "util-linux", "chroot": "coreutils"})
        print(f"building {folder.relative_to(ROOT)}, Debian {suite} with Blender, once (minutes, 2 GB)", flush=True)
        _build(suite, folder)
    return folder


def need_programs(programs: dict[str, str]) -> None:
    """See that programs are there; install the Debian packages that are missing, as root, or say which they are.

    programs: program -> the package that brings it. Raises SystemExit where they are missing and cannot be installed.
    """
    missing = sorted({package for program, package in programs.items() if not shutil.which(program)})
    if not missing:
        return
    install = ["apt-get", "install", "--yes", "--quiet", "--no-install-recommends", *missing]
    if os.geteuid() or not shutil.which("apt-get"):
        raise SystemExit(
            f"Missing: {', '.join(missing)}. Install it; on Debian or Ubuntu, as root: {' '.join(install)}"
        )
    print(f"installing {', '.join(missing)}", flush=True)
    subprocess.run(["apt-get", "-qq", "update"], check=False)
    subprocess.run(install, check=True, env=os.environ | {"DEBIAN_FRONTEND": "noninteractive"}, stdout=sys.stderr)


@contextmanager
def _only_one(suite: str):
    """Let one process at a time build a suite."""
    CACHE.mkdir(exist_ok=True)
    with open(CACHE / f"blender-{suite}.lock", "w", encoding="utf-8") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def _recipe() -> str:
    return "\n".join([*PACKAGES, APT, DPKG])


def _need_root(suite: str) -> None:
    if os.geteuid():
        raise SystemExit(
            f"Building Debian {suite} with Blender wants root. Run `make test-gui` as root, or name a Blender of your "
            "own: make test-gui BLENDER=/path/to/blender"
        )


def _mirror() -> list[str]:
    """Return the mirror that this machine's own apt takes Debian from; empty for debootstrap's default."""
    told = _apt("apt-get", "indextargets", "--format", "$(LABEL) $(REPO_URI)").splitlines()
    return next(([line.split()[1]] for line in told if line.startswith("Debian http")), [])


def _proxy() -> dict[str, str]:
    """Return the environment that hands this machine's own apt proxy on, as debootstrap and apt read it."""
    address = _apt("apt-config", "shell", "proxy", "Acquire::http::Proxy/f").strip().removeprefix("proxy=").strip("'")
    return {"http_proxy": address} if address else {}


def _apt(*command: str) -> str:
    """Return what a command of apt says; nothing on a system that has none."""
    if not shutil.which(command[0]):
        return ""
    return subprocess.run(command, capture_output=True, text=True).stdout


def _build(suite: str, folder: Path) -> None:
    """Build into a folder beside it, which gets its name when it is whole; in one that is whole, only add packages."""
    log = folder.with_name(f"{folder.name}.log")
    environment = os.environ | _proxy() | {"DEBIAN_FRONTEND": "noninteractive", "LC_ALL": "C.UTF-8"}
    with open(log, "w", encoding="utf-8") as sink:

        def step(*command: str | Path) -> None:
            if subprocess.run([*PRIVATE, *command], env=environment, stdout=sink, stderr=sink).returncode:
                tail = log.read_text(encoding="utf-8", errors="replace").splitlines()[-12:]
                raise SystemExit("\n".join([*tail, f"Debian {suite} could not be built; all that was said: {log}"]))

        part = folder
        if not (folder / STAMP).is_file():
            part = folder.with_name(f"{folder.name}.part")
            for old in (part, folder):
                shutil.rmtree(old, ignore_errors=True)
            step("debootstrap", "--variant=minbase", suite, part, *_mirror())
        (part / "etc/apt/apt.conf.d/90window").write_text(APT, encoding="utf-8")
        (part / "etc/dpkg/dpkg.cfg.d/90window").write_text(DPKG, encoding="utf-8")
        step("chroot", part, "apt-get", "update")
        step("chroot", part, "apt-get", "install", "--yes", "--quiet", *PACKAGES)
        step("chroot", part, "apt-get", "clean")
    (part / STAMP).write_text(_recipe(), encoding="utf-8")
    if part != folder:
        part.rename(folder)
