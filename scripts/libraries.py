"""Prints the Debian packages whose shared libraries Blender's wheel needs and this machine lacks, on one line."""

import ctypes
import glob
import sys

# Debian package -> a library in it. Without the X libraries `import bpy` fails; without EGL it has no GPU.
LIBRARIES = {
    "libegl1": "libEGL.so.1",
    "libgl1": "libGL.so.1",
    "libxi6": "libXi.so.6",
    "libxxf86vm1": "libXxf86vm.so.1",
    "libxfixes3": "libXfixes.so.3",
    "libxrender1": "libXrender.so.1",
    "libxkbcommon0": "libxkbcommon.so.0",
    "libsm6": "libSM.so.6",
}
# EGL without a driver behind it kills the process: either NVIDIA's, or a Mesa driver file.
DRIVER_PACKAGE = "libgl1-mesa-dri"
DRIVER_FILES = (
    "/usr/lib/*/dri/*_dri.so",
    "/usr/lib/*/libgallium*.so",
    "/usr/lib/dri/*_dri.so",
    "/usr/lib64/dri/*_dri.so",
    "/usr/lib64/libgallium*.so",
)


def loads(library: str) -> bool:
    """Return whether the dynamic linker finds and loads the library."""
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True


def missing_packages() -> list[str]:
    """Return the packages to install; empty on systems other than Linux, where Blender's wheel needs none."""
    if not sys.platform.startswith("linux"):
        return []
    missing = [package for package, library in LIBRARIES.items() if not loads(library)]
    if not loads("libEGL_nvidia.so.0") and not any(glob.glob(pattern) for pattern in DRIVER_FILES):
        missing.append(DRIVER_PACKAGE)
    return missing


if __name__ == "__main__":
    print(*missing_packages())
