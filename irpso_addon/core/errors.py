"""The program's exceptions. Each message names the fault, its place and the remedy."""

import json
import re
import sys
from collections.abc import Sequence

_SOURCE_LINE = re.compile(r"(\S+\.glsl:\d+(?::\d+)?):\s*(?:error:\s*)?(.+)", re.IGNORECASE)


def some(names: Sequence[str], most: int = 6) -> str:
    """Return the first names of a list as words of a message."""
    return ", ".join(f"'{name}'" for name in names[:most]) + (", …" if len(names) > most else "")


class IrpsoError(Exception):
    """Base of all errors for the user. exit_code: of the command line."""

    exit_code = 1


class InputError(IrpsoError):
    """A file, folder, mesh or setting that cannot be used. Nothing has been written."""

    exit_code = 2


class CheckpointError(InputError):
    """An unusable checkpoint: missing, damaged, or of another recovery."""


class ShaderError(InputError):
    """A shader does not compile. ``log`` holds the driver's own lines, with file and line of the .glsl source."""

    def __init__(self, message: str, log: str = ""):
        super().__init__(message if not log else f"{message}\n{log}")
        self.log, self._message = log, message

    @property
    def summary(self) -> str:
        """One line: the first fault of the log with its file and line, as in "my.glsl:5:10: type mismatch"."""
        if found := _SOURCE_LINE.search(self.log):
            return f"{found[1]}: {found[2].strip()}; correct the shader there"
        lines = [line.strip() for line in self.log.splitlines() if line.strip()]
        return ": ".join([self._message, *lines[:1]])


class GpuUnavailableError(IrpsoError):
    """No usable GPU context can be made, or the device computes wrongly."""

    exit_code = 3


def print_error(error: IrpsoError, as_json: bool) -> int:
    """Print an error as one line of standard error; return its exit code.

    as_json: also print it as JSON on standard output. Only that has a compiler's whole log.
    """
    text = error.summary if isinstance(error, ShaderError) else " ".join(str(error).splitlines())
    sys.stderr.write(f"irpso: {text}\n")
    if as_json:
        log = {"log": error.log} if isinstance(error, ShaderError) else {}
        sys.stdout.write(json.dumps({"error": text, "exit_code": error.exit_code, **log}) + "\n")
    sys.stdout.flush()
    return error.exit_code
