"""Runs a command; reports an error as one line and an exit code."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from importlib import import_module

from ..core.errors import InputError, IrpsoError, print_error
from ..core.interrupt import INTERRUPTED, interrupt_on_signals
from .parser import build_parser

_ZIP = "install the extension from the zip that `make extension` builds, which holds it, or {} with pip"
_REMEDIES = {  # by missing module
    "numpy": "install numpy (for Debian's Blender: the package python3-numpy)",
    "OpenEXR": _ZIP.format("OpenEXR"),
    "PIL": _ZIP.format("Pillow"),
    "bpy": "install bpy with pip, or use an installed Blender",
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code; a bad option returns 2, like any bad input."""
    argv = sys.argv[1:] if argv is None else list(argv)
    try:
        options = build_parser().parse_args(argv)
    except InputError as error:
        return print_error(error, "--json" in argv)
    except SystemExit as stop:  # --help; this process may be Blender
        return int(stop.code or 0)
    interrupt_on_signals()
    try:
        result = import_module(f"..commands.{options.command}", __package__).run(options)
    except IrpsoError as error:
        return print_error(error, options.json)
    except ModuleNotFoundError as error:
        if error.name not in _REMEDIES:
            raise
        return print_error(InputError(f"Python has no module {error.name}; {_REMEDIES[error.name]}"), options.json)
    except MemoryError as error:
        text = f"memory is full ({error}); choose a smaller --resolution, or smaller or fewer images"
        return print_error(InputError(text), options.json)
    except KeyboardInterrupt as stop:
        sys.stderr.write(f"\nirpso: interrupted{f'; {stop}' if str(stop) else ''}\n")
        return INTERRUPTED
    if options.json:
        sys.stdout.write(json.dumps(result) + "\n")
    return int(result.get("exit_code", 0))
