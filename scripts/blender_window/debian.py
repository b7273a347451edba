"""Builds a Debian with Blender in a folder, once, without risk for this machine's files.

Each process makes its mounts in its own mount namespace (``unshare --mount``): other processes do not see them, they
end with the process, and deleting the folder never follows one.
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
# Debian's package lacks dependencies: without cattrs and requests Blender 5.2 has no extensions (bl_pkg does not
# register), and extensions have no numpy.
PACKAGES = (
    "blender", "python3-numpy", "python3-cattr", "python3-requests", "libgl1-mesa-dri", "libegl1",
    "mesa-vulkan-drivers", "xvfb", "xauth", "xdotool", "imagemagick",
)  # fmt: skip
# In a mirror that is a snapshot sid's release file has expired.
APT = 'Acquire::Check-Valid-Until "false";\nAPT::Install-Recommends "false";\n'
# Syncing every file to the disk and unpacking documentation would take longer than the rest.
DPKG = (
    "force-unsafe-io\npath-exclude=/usr/share/doc/*\npath-exclude=/usr/share/man/*\npath-exclude=/usr/share/locale/*\n"
)
STAMP = "what-is-installed"
PRIVATE = ("unshare", "--mount", "--propagation", "private")


def debian(suite: str) -> Path:
    """Return the folder of a Debian with Blender, built if it is missing.

    suite: ``trixie`` (Blender 4.3.2) or ``sid`` (5.2). Raises SystemExit, with the remedy, if it cannot be built.
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
    """Install the Debian packages of missing programs, if this is root.

    programs: program -> its package. Raises SystemExit, naming the packages, if they cannot be installed.
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
    """Hold the lock of a suite: one process at a time builds it."""
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
    """Return the Debian mirror of this machine's apt; empty for debootstrap's default."""
    lines = _apt("apt-get", "indextargets", "--format", "$(LABEL) $(REPO_URI)").splitlines()
    return next(([line.split()[1]] for line in lines if line.startswith("Debian http")), [])


def _proxy() -> dict[str, str]:
    """Return the environment variable with the proxy of this machine's apt, for debootstrap and apt."""
    address = _apt("apt-config", "shell", "proxy", "Acquire::http::Proxy/f").strip().removeprefix("proxy=").strip("'")
    return {"http_proxy": address} if address else {}


def _apt(*command: str) -> str:
    """Return the output of a command of apt; "" on a system without it."""
    if not shutil.which(command[0]):
        return ""
    return subprocess.run(command, capture_output=True, text=True).stdout


def _build(suite: str, folder: Path) -> None:
    """Build into FOLDER.part and rename it when complete; in a complete folder, only add packages."""
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
