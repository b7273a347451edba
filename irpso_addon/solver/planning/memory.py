"""Memory budgets: of the user, of the machine."""

from __future__ import annotations

import ctypes
import os
import re
import sys
from dataclasses import dataclass
from pathlib import Path

from ...core.errors import InputError
from ...gpu.context import is_software

ASSUMED_DEVICE = 4 << 30  # bytes, where the driver reports none or less, as for a GPU inside a processor
_USABLE = 0.8  # usable part of the free memory: other programs need some, and a process needs more than its arrays
_UNITS = {"": 1, "K": 1 << 10, "M": 1 << 20, "G": 1 << 30, "T": 1 << 40}
_NO_MACHINE = 1 << 60  # bytes that none has
_AMOUNT = re.compile(r"(\d+(?:\.\d*)?|\.\d+)\s*([KMGT]?)(?:I?B)?", re.IGNORECASE)
_MEMINFO = Path("/proc/meminfo")


@dataclass(frozen=True)
class Memory:
    """Bytes that a recovery may use on the device and on the host, and the origin of each figure in words."""

    device: int
    host: int
    device_from: str = "--memory"
    host_from: str = "--memory"


def parse_memory(text: str) -> dict[str, int]:
    """Parse "4G" (both) or "device=4G,host=8G" to {"device": bytes, "host": bytes}, or one of them.

    K, M, G and T are powers of 1024. Raises InputError that names --memory.
    """
    wanted: dict[str, int] = {}
    for part in text.split(","):
        name, equals, amount = (piece.strip() for piece in part.rpartition("="))
        names = ("device", "host") if not equals else (name.lower(),)
        match = _AMOUNT.fullmatch(amount)
        size = float(match[1]) * _UNITS[match[2].upper()] if match else 0.0
        if not 1 <= size < _NO_MACHINE or not set(names) <= {"device", "host"} or set(names) & set(wanted):
            raise InputError(
                f"--memory {text[:80]}: write an amount, as in 4G, or device=4G,host=8G (units K, M, G, T)"
            )
        wanted |= dict.fromkeys(names, int(size))
    return wanted


def amount(size: int) -> str:
    """Return bytes as text: "1.5 GiB"."""
    for unit in ("T", "G", "M", "K"):
        if size >= _UNITS[unit]:
            return f"{size / _UNITS[unit]:.{0 if size >= 100 * _UNITS[unit] else 1}f} {unit}iB"
    return f"{size} B"


def machine_memory(text: str | None, renderer: str, free_device: int | None = None, held: int = 0) -> Memory:
    """Return the budget of --memory, completed from the machine's memory. renderer: the GPU's name.

    free_device: free bytes of the GPU's own memory, None where the driver does not report them. held: bytes of main
    memory in use that the plan counts again. A software renderer's textures are in host memory; device and host then
    share it evenly.
    """
    requested = parse_memory(text) if text else {}
    host, host_from = int(_USABLE * (free_memory() + held)), f"{100 * _USABLE:.0f} % of the free memory"
    device, device_from = int(_USABLE * (free_device or 0)), f"{100 * _USABLE:.0f} % of the device's free memory"
    if device < ASSUMED_DEVICE:
        report = "reports none" if free_device is None else f"reports {amount(free_device)} free"
        device, device_from = ASSUMED_DEVICE, f"assumed: the driver {report}; set it with --memory device=…"
    if is_software(renderer):
        host //= 2
        host_from = f"half of {host_from}"
        device, device_from = host, f"{host_from}: a software renderer"
    return Memory(
        requested.get("device", device), requested.get("host", host),
        "--memory" if "device" in requested else device_from, "--memory" if "host" in requested else host_from,
    )  # fmt: skip


def free_memory() -> int:
    """Return the free bytes of main memory, or the total where the system does not report them."""
    if _MEMINFO.is_file():
        for line in _MEMINFO.read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return int(line.split()[1]) << 10
    if hasattr(os, "sysconf"):
        pages = "SC_AVPHYS_PAGES" if "SC_AVPHYS_PAGES" in os.sysconf_names else "SC_PHYS_PAGES"
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf(pages)
    return _windows_free()


def _windows_free() -> int:
    if sys.platform != "win32":
        raise InputError("this system does not report its memory; set it with --memory")

    class Status(ctypes.Structure):
        _fields_ = [("length", ctypes.c_ulong), ("load", ctypes.c_ulong)] + [
            (name, ctypes.c_ulonglong)
            for name in ("total", "free", "total_file", "free_file", "total_virtual", "free_virtual", "extended")
        ]

    status = Status(length=ctypes.sizeof(Status))
    ctypes.windll.kernel32.GlobalMemoryStatusEx(ctypes.byref(status))
    return int(status.free)
