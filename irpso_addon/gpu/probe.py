"""Probe of a machine's GPU with real kernels, not capability flags."""

from __future__ import annotations

import functools
import json
import statistics
import subprocess
import sys
import time
from collections.abc import Mapping
from typing import Any

import numpy as np

from ..core.errors import GpuUnavailableError
from . import context, textures
from .child import child_command
from .kernel import Entry, Kernel, Output
from .passes import Pass

COMPUTE_WORTHWHILE = 1.5  # least speed-up of the compute entry over the paper's fragment passes
_SIZE = 256
_ROUNDS = 400
_TOLERANCE = 1e-4  # of the probe's values, of order 1, after 400 float32 steps
_PROBE_SECONDS = 120


def probe() -> dict:
    """Try a context and the probe kernel in a child process; return its description. Raises GpuUnavailableError.

    In a child, because without a usable EGL the process that creates a context dies.
    """
    command = child_command("from irpso_addon.gpu.probe import main; main()")
    try:
        child = subprocess.run(command, capture_output=True, text=True, timeout=_PROBE_SECONDS)
    except subprocess.TimeoutExpired as error:
        raise GpuUnavailableError(
            f"the GPU probe did not answer in {_PROBE_SECONDS} s; close other programs that use the GPU, or update its"
            " driver"
        ) from error
    lines = [line for line in child.stdout.splitlines() if line.startswith('{"irpso_probe"')]
    if lines:
        answer = json.loads(lines[-1])["irpso_probe"]
        if "error" not in answer:
            return answer
        raise GpuUnavailableError(answer["error"])
    why = (child.stderr.strip().splitlines() or ["no message"])[-1]
    raise GpuUnavailableError(
        f"no GPU context: the probe ended with exit code {child.returncode} ({why});"
        " a machine without a GPU needs Mesa: libegl1 libgl1 libgl1-mesa-dri"
    )


def main() -> None:
    """Write the probe's result to standard output for the parent, then end the process."""
    try:
        context.ensure(quiet=False)  # if it dies, the parent reads the reason
        answer = {**context.describe(), **check()}
    except GpuUnavailableError as error:
        answer = {"error": str(error)}
    sys.stdout.write("\n" + json.dumps({"irpso_probe": answer}) + "\n")
    context.exit_process(0)


def check() -> dict[str, float]:
    """Run the probe kernel both ways in this process, compare with numpy, and time it. Raises GpuUnavailableError."""
    expected = _expected()
    seconds = {}
    for entry in ("fragment", "compute"):
        value, seconds[f"{entry}_seconds"] = _run(entry)
        if not np.allclose(value, expected, atol=_TOLERANCE):
            worst = float(np.abs(value - expected).max())
            other = "compute" if entry == "fragment" else "fragment"
            raise GpuUnavailableError(
                f"this GPU computes wrongly: the {entry} probe is off by {worst:.3g}; update its driver, or try --entry"
                f" {other} (Passes, in the preferences)"
            )
    return seconds


@functools.cache
def measured() -> dict[str, Any]:
    """Return the description of this device and the times of the probe kernel. Raises GpuUnavailableError."""
    return {**context.describe(), **check()}


def faster_entry() -> Entry:
    """Return "compute" where it is sufficiently faster on this device, else "fragment"."""
    return chosen_entry(measured())


def rounds_per_second(seconds: float) -> float:
    """Return the texel rounds per second of a device that runs the probe kernel in ``seconds``."""
    return _SIZE**2 * _ROUNDS / seconds


def chosen_entry(probed: Mapping[str, Any]) -> Entry:
    """Return the entry chosen by the result of ``probe``.

    A software renderer runs both on the same cores: the difference of their times is noise.
    """
    if context.is_software(str(probed["renderer"])):
        return "fragment"
    seconds = probed["fragment_seconds"], probed["compute_seconds"]
    return "compute" if seconds[0] > COMPUTE_WORTHWHILE * seconds[1] else "fragment"


def _run(entry: Entry) -> tuple[np.ndarray, float]:
    kernel = Kernel("common/probe.glsl", (Output("o_value"),), {}, {"u_rounds": "INT"}, {})
    pass_ = Pass(kernel, entry)
    copy = Pass(Kernel("common/copy.glsl", (Output("o_copy"),), {"u_source": "FLOAT_2D"}, {}, {}))
    target, result = textures.empty(_SIZE, _SIZE), textures.empty(_SIZE, _SIZE)
    times = []
    for _ in range(4):
        pass_.fence([target])
        start = time.perf_counter()
        pass_.run([target], {}, {"u_rounds": _ROUNDS})
        pass_.fence([target])
        times.append(time.perf_counter() - start)
    copy.run([result], {"u_source": target})
    value = textures.download(result)[..., 0]
    pass_.close()
    copy.close()
    return value, statistics.median(times[1:])


def _expected() -> np.ndarray:
    y, x = np.mgrid[:_SIZE, :_SIZE].astype(np.float64)
    value = (x + _SIZE * y) / _SIZE**2
    for _ in range(_ROUNDS):
        value = 0.5 * np.exp(-value * value) + 0.25 * value
    return value
